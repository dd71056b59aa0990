"""Resampling against loops over particles: counts, weights, gradients, degenerate weights."""

import functools

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtrack.filtering.resampling import (
    jittered,
    multinomial,
    normalized,
    residual,
    soft,
    stop_gradient,
    stratified,
    systematic,
)
from jaxtrack.filtering.transport import optimal_transport
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import particle as oracle

few = settings(max_examples=25, deadline=None, derandomize=True, database=None)
SIZE = 6
COPYING = {
    "systematic": systematic,
    "stratified": stratified,
    "multinomial": multinomial,
    "residual": residual,
}
EVERY = {
    **COPYING,
    "stop_gradient": stop_gradient(),
    "soft": soft(),
    "soft stop_gradient": soft(stop_gradient(residual), 0.3),
    "jittered": jittered(systematic, 0.1),
    "transport": optimal_transport(),
}
COMPILED = {name: jax.jit(resampler) for name, resampler in EVERY.items()}
MANY = {name: jax.jit(jax.vmap(resampler, (0, None, None))) for name, resampler in EVERY.items()}
every = pytest.mark.parametrize("name", EVERY)
copying = pytest.mark.parametrize("name", COPYING)
WEIGHTS = np.array([0.05, 0.0, 0.4, 0.25, 0.21, 0.09])
PLACES = np.random.default_rng(0).normal(size=(SIZE, 2)) * [1.0, 30.0]


def logs(weights):
    with np.errstate(divide="ignore"):
        return np.log(weights)


def uniforms(name, key):
    shape = () if name == "systematic" else (SIZE,)
    return np.asarray(jax.random.uniform(key, shape, jnp.float64))


@copying
@few
@given(st.integers(0, 2**32 - 1), st.lists(st.booleans(), min_size=SIZE, max_size=SIZE))
def test_ancestors_are_those_of_a_loop(name, seed, alive):
    rng = np.random.default_rng(seed)
    weights = np.where(alive, rng.uniform(0.01, 1.0, SIZE) ** 3, 0.0)
    weights[rng.integers(SIZE)] += 0.1
    key = jax.random.key(seed)
    found = COMPILED[name](key, PLACES, logs(weights) + 700.0)
    ancestors = getattr(oracle, name)(weights, uniforms(name, key))
    np.testing.assert_array_equal(found.ancestor, ancestors)
    np.testing.assert_array_equal(found.particles, PLACES[ancestors])
    np.testing.assert_allclose(np.exp(found.log_weight), 1 / SIZE, rtol=1e-12)


@pytest.mark.parametrize("name", [*COPYING, "stop_gradient", "soft", "soft stop_gradient"])
def test_counts_are_right_on_average(name):
    runs = 20_000
    found = MANY[name](jax.random.split(jax.random.key(1), runs), PLACES, logs(WEIGHTS))
    mass = np.exp(np.asarray(found.log_weight))[:, :, None]
    count = (mass * (np.asarray(found.ancestor)[:, :, None] == np.arange(SIZE))).sum(1)
    error = np.abs(count.mean(0) - WEIGHTS)
    assert (error <= 4.5 * count.std(0) / runs**0.5 + 1e-12).all()
    bound = {"systematic": (-1, 1), "stratified": (-2, 2), "residual": (-1, SIZE)}.get(name)
    if bound is not None:
        apart = SIZE * (count - WEIGHTS)
        assert (apart > bound[0]).all()
        assert (apart < bound[1]).all()


@every
def test_degenerate_weights(name):
    keys = jax.random.split(jax.random.key(2), 64)
    none = np.full(SIZE, -np.inf)
    equal = MANY[name](keys, PLACES, np.zeros(SIZE))
    for empty in (none, np.full(SIZE, np.nan)):
        found = MANY[name](keys, PLACES, empty)
        for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(equal), strict=True):
            np.testing.assert_array_equal(a, b)
            assert np.isfinite(b).all()
    one = none.copy()
    one[3] = -800.0
    found = MANY[name](keys, PLACES, one)
    weight = np.exp(np.asarray(found.log_weight))[:, :, None]
    mean = (weight * found.particles).sum(1) / weight.sum(1)
    atol = {"jittered": 0.3, "transport": 1e-12}.get(name, 0.0)
    np.testing.assert_allclose(mean, np.tile(PLACES[3], (64, 1)), rtol=1e-12, atol=atol)


@every
def test_one_particle_is_itself(name):
    found = EVERY[name](jax.random.key(0), jnp.full((1, 2), 7.0), jnp.full(1, -3.0))
    np.testing.assert_allclose(found.particles, 7.0, atol=0.5 if name == "jittered" else 1e-12)
    np.testing.assert_allclose(found.log_weight, 0.0, atol=1e-12)


@every
def test_float32_copies_nothing_of_zero_weight(name):
    rng = np.random.default_rng(3)
    size = 2000 if name != "transport" else 50
    weights = np.where(rng.random(size) < 0.3, rng.random(size), 0.0)
    weights[-size // 4 :] = 0.0
    places = rng.normal(size=(size, 2)).astype(np.float32)
    found = MANY[name](
        jax.random.split(jax.random.key(4), 16), places, logs(weights).astype(np.float32)
    )
    assert found.particles.dtype == found.log_weight.dtype == np.float32
    assert np.isfinite(found.particles).all()
    total = np.exp(np.asarray(found.log_weight, np.float64)).sum(1)
    np.testing.assert_allclose(total, 1.0, atol=0.1 if "soft" in name else 1e-4)
    if name in COPYING or name == "stop_gradient":
        assert (weights[np.asarray(found.ancestor)] > 0).all()


@every
def test_a_batch_is_its_rows_and_traces_once(name):
    keys = jax.random.split(jax.random.key(5), 4)
    batch = MANY[name](keys, PLACES, logs(WEIGHTS))
    chex.clear_trace_counter()  # it tells functions apart by where they are defined
    once = jax.jit(chex.assert_max_traces(n=1)(EVERY[name]))
    for n, key in enumerate(keys):
        for a, b in zip(
            jax.tree.leaves(once(key, PLACES, logs(WEIGHTS))), jax.tree.leaves(batch), strict=True
        ):
            np.testing.assert_allclose(a, b[n], rtol=1e-12)


def test_a_soft_draw_is_weighed_as_by_a_loop():
    key, mix = jax.random.key(6), 0.3
    found = jax.jit(soft(stratified, mix))(key, PLACES, logs(WEIGHTS))
    ancestors = oracle.stratified(oracle.mixed(WEIGHTS, mix), uniforms("stratified", key))
    np.testing.assert_array_equal(found.ancestor, ancestors)
    weights = oracle.soft_weights(WEIGHTS, ancestors, mix)
    np.testing.assert_allclose(np.exp(found.log_weight), weights, rtol=1e-12, atol=1e-300)
    whole = soft(stratified, 1.0)(key, PLACES, logs(WEIGHTS))
    np.testing.assert_array_equal(
        whole.ancestor, oracle.stratified(WEIGHTS, uniforms("stratified", key))
    )
    np.testing.assert_allclose(np.exp(whole.log_weight), 1 / SIZE, rtol=1e-12)


def weighted(resampler, key, log_weight, places):
    """Return a smooth function of what resampling yields."""
    found = resampler(key, places, log_weight)
    return (jnp.exp(found.log_weight)[:, None] * jnp.sin(found.particles)).sum()


ALIVE = logs(np.array([0.05, 0.11, 0.3, 0.24, 0.21, 0.09]))


@pytest.mark.parametrize("name", ["soft", "jittered", "transport"])
def test_gradients_agree_with_central_differences(name):
    # Counts do not change within the step, so a draw with a fixed key is differentiable.
    loss = functools.partial(weighted, EVERY[name], jax.random.key(7))
    by_weight, by_place = assert_gradients_agree(loss, ALIVE, PLACES / 30, rtol=1e-5)
    assert np.abs(by_place).max() > 1e-3
    assert np.abs(by_weight).max() > 1e-3 or name == "jittered"


def test_stop_gradient_adds_the_gradient_of_the_draw():
    value = jnp.sin(PLACES).sum(1)

    def loss(log_weight, key):
        return weighted(stop_gradient(multinomial), key, log_weight, jnp.asarray(PLACES))

    keys = jax.random.split(jax.random.key(8), 20_000)
    got = np.asarray(jax.jit(jax.vmap(jax.grad(loss), (None, 0)))(ALIVE, keys))
    one = multinomial(keys[0], jnp.asarray(PLACES), ALIVE)
    weights = np.exp(ALIVE)
    chosen = np.asarray(one.ancestor)[:, None] == np.arange(SIZE)
    by_hand = (np.asarray(value)[chosen.argmax(1)][:, None] * (chosen - weights)).mean(0)
    np.testing.assert_allclose(got[0], by_hand, rtol=1e-10, atol=1e-12)
    exact = jax.grad(lambda lw: (jax.nn.softmax(lw) * value).sum())(ALIVE)
    assert (np.abs(got.mean(0) - exact) < 4.5 * got.std(0) / len(keys) ** 0.5).all()
    bare = jax.grad(lambda lw: weighted(multinomial, keys[0], lw, jnp.asarray(PLACES)))(ALIVE)
    np.testing.assert_array_equal(bare, 0.0)


@every
def test_gradients_are_finite_on_degenerate_input(name):
    loss = functools.partial(weighted, EVERY[name], jax.random.key(9))
    gradient = jax.jit(jax.grad(loss, argnums=(0, 1)))
    one = np.array([-np.inf] * (SIZE - 1) + [0.0])
    together = np.ones_like(PLACES)
    for log_weight in (np.full(SIZE, -np.inf), one, np.full(SIZE, np.nan), ALIVE):
        for places in (PLACES, together):
            for part in gradient(log_weight, places):
                assert np.isfinite(part).all()


def test_transport_is_that_of_a_loop():
    epsilon = 0.5
    found = jax.jit(optimal_transport(epsilon, iterations=40))(
        jax.random.key(0), PLACES, np.asarray(ALIVE)
    )
    moved, mass = oracle.transport(PLACES, np.exp(ALIVE), epsilon, 40)
    np.testing.assert_allclose(found.particles, moved, rtol=1e-9)
    np.testing.assert_allclose(np.exp(found.log_weight), mass, rtol=1e-9)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_transport_takes_what_rounding_leaves_for_no_spread(dtype):
    blend = optimal_transport(0.5, iterations=10)
    of = lambda x: jnp.sin(blend(jax.random.key(0), x, jnp.zeros(5, dtype)).particles).sum()
    alike = np.tile(np.array([0.26906076, -0.00339742, 1e5], dtype), (5, 1))
    slope = jax.jit(jax.grad(of))(alike)
    np.testing.assert_allclose(slope, np.cos(alike), rtol=1e-3)


@pytest.mark.parametrize("iterations", [1, 40])
def test_transport_keeps_the_mean_and_the_order(iterations):
    blend = jax.jit(optimal_transport(0.2, iterations=iterations))
    key = jax.random.key(0)
    found = blend(key, PLACES, logs(WEIGHTS))
    mean = (np.exp(found.log_weight)[:, None] * found.particles).sum(0)
    np.testing.assert_allclose(mean, (WEIGHTS[:, None] * PLACES).sum(0), rtol=1e-12)
    order = np.random.default_rng(10).permutation(SIZE)
    turned = blend(key, PLACES[order], logs(WEIGHTS)[order])
    np.testing.assert_allclose(turned.particles, found.particles[order], rtol=1e-9)
    np.testing.assert_allclose(turned.log_weight, found.log_weight[order], rtol=1e-9)


def test_transport_tends_to_the_exact_one_on_a_line():
    places = PLACES[:, :1]
    exact = oracle.monotone(places[:, 0], WEIGHTS)
    for epsilon, apart in ((0.1, 0.08), (0.01, 0.01), (0.003, 1e-4)):
        blend = jax.jit(optimal_transport(epsilon, iterations=10_000))
        found = blend(jax.random.key(0), places, logs(WEIGHTS))
        np.testing.assert_allclose(np.sort(found.particles[:, 0]), exact, atol=apart)
        np.testing.assert_allclose(np.exp(found.log_weight), 1 / SIZE, rtol=1e-6)


def test_jitter_has_the_deviation_asked_for():
    sigma = np.array([0.5, 2.0])
    places = np.zeros((4000, 2))
    found = jittered(systematic, sigma)(jax.random.key(11), places, jnp.zeros(4000))
    np.testing.assert_allclose(found.particles.std(0), sigma, rtol=0.05)
    still = jittered(systematic, 0.0)(jax.random.key(11), PLACES, jnp.zeros(SIZE))
    np.testing.assert_array_equal(still.particles, PLACES)


def test_normalized_weights():
    got = np.exp(normalized(jnp.array([700.0, 701.0, jnp.nan, -jnp.inf])))
    np.testing.assert_allclose(got, [1 / (1 + np.e), np.e / (1 + np.e), 0, 0], rtol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda: systematic(jax.random.key(0), PLACES, jnp.zeros(2)), "log_weight"),
        (lambda: residual(jax.random.key(0), jnp.zeros(3), jnp.zeros(3)), "particles"),
        (lambda: soft(systematic, 1.5), "mix"),
        (lambda: jittered(systematic, -1.0), "sigma"),
        (lambda: optimal_transport(0.0), "epsilon"),
        (lambda: optimal_transport(iterations=0), "iterations"),
        (
            lambda: soft(optimal_transport())(jax.random.key(0), jnp.zeros((3, 1)), jnp.zeros(3)),
            "got one that blends",
        ),
    ],
)
def test_what_does_not_fit_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        change()
