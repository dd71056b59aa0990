"""The particle filter against a loop over particles, the Kalman filter and another library."""

from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtrack.filtering.particle import (
    effective_size,
    particle_filter,
    weigh,
    weighted_mean,
)
from jaxtrack.filtering.resampling import (
    jittered,
    multinomial,
    residual,
    stop_gradient,
    stratified,
    systematic,
)
from jaxtrack.types import Array, Scan
from tests.filtering import linear_gaussian
from tests.filtering.linear_gaussian import MODEL, kalman_run, looks
from tests.oracles import particle as oracle

few = settings(max_examples=10, deadline=None, derandomize=True, database=None)
LOOKS, SIZE = 8, 12
flags = st.lists(st.booleans(), min_size=LOOKS, max_size=LOOKS)
DRAW = jax.random.key(99)
START = np.random.default_rng(0).normal(size=(SIZE, 2))
SPREAD, REACH = 0.4, 0.8


class Look(NamedTuple):
    """An observation that brings its own noise for the motion."""

    valid: Array  # []
    place: Array  # [2]
    noise: Array  # [N, 2]


def drift(key, x, look):
    return 0.9 * x + SPREAD * look.noise


def within(x, look):
    """Gauss, but nothing at all beyond a distance."""
    square = ((x - look.place[None, :]) ** 2).sum(-1)
    return jnp.where(square < 9 * REACH**2, -square / (2 * REACH**2), -jnp.inf)


def always(key, particles, log_weight):
    """Resample with one and the same number."""
    return systematic(DRAW, particles, log_weight)


def build(resampler=None, share=2 / 3):
    resampler = stop_gradient(always) if resampler is None else resampler
    return particle_filter(
        drift,
        within,
        resampler,
        particles=SIZE,
        initial=lambda key, size: jnp.asarray(START),
        resample_below=share,
    )


@jax.jit
def run(seen, share=2 / 3):
    estimator = build(share=share)
    return jax.lax.scan(estimator.step, estimator.init(jax.random.key(0)), seen)


def observations(seed, valid=None):
    """Return looks at a walking target, NaN where not valid, and the oracle's dicts."""
    rng = np.random.default_rng(seed)
    valid = np.ones(LOOKS, bool) if valid is None else np.array(valid)
    place = np.cumsum(rng.normal(size=(LOOKS, 2)), axis=0) * 0.5
    noise = rng.normal(size=(LOOKS, SIZE, 2))
    dicts = [
        {"valid": v, "place": p, "noise": n} for v, p, n in zip(valid, place, noise, strict=True)
    ]
    place[~valid], noise[~valid] = np.nan, np.nan
    return Look(valid, place, noise), dicts  # pyright: ignore


def expected(dicts, share=2 / 3):
    def move(particle, i, look):
        return 0.9 * particle + SPREAD * look["noise"][i]

    def likelihood(particle, look):
        square = sum((particle - look["place"]) ** 2)
        return np.exp(-square / (2 * REACH**2)) if square < 9 * REACH**2 else 0.0

    u = float(jax.random.uniform(DRAW, (), jnp.float64))
    resample = lambda weights: oracle.systematic(weights, u)
    return oracle.run(START, dicts, move, likelihood, resample, share)


@few
@given(st.integers(0, 2**32 - 1), flags, st.sampled_from([0.0, 2 / 3, 1.0]))
def test_equals_a_loop(seed, valid, share):
    seen, dicts = observations(seed, valid)
    state, info = run(seen, share)
    done = expected(dicts, share)
    column = lambda name: np.array([one[name] for one in done])
    for name in ("resampled", "vanished"):
        np.testing.assert_array_equal(getattr(info, name), column(name))
    for name in ("particles", "mean", "effective_size", "log_likelihood"):
        np.testing.assert_allclose(getattr(info, name), column(name), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(np.exp(info.log_weight), column("weights"), rtol=1e-9)
    total = sum(column("log_likelihood"))
    np.testing.assert_allclose(state.log_likelihood, total, rtol=1e-9, atol=1e-12)
    assert not np.asarray(info.unsound).any()


def test_an_invalid_look_changes_nothing():
    seen, _ = observations(1)
    gaps, _ = observations(1, [True, True, False, True, False, True, True, True])
    estimator = build(systematic)
    step = jax.jit(estimator.step)
    state = estimator.init(jax.random.key(3))
    for k in range(LOOKS):
        after, info = step(state, jax.tree.map(lambda x, k=k: x[k], gaps))
        if not gaps.valid[k]:
            for a, b in zip(jax.tree.leaves(after), jax.tree.leaves(state), strict=True):
                assert (a == b).all()
            assert float(info.log_likelihood) == 0
            assert not (info.resampled | info.vanished | info.unsound)
        assert not any(np.isnan(x).any() for x in info)
        state = after
    rest = jax.tree.map(lambda x: x[gaps.valid], seen)
    left = jax.lax.scan(estimator.step, estimator.init(jax.random.key(3)), rest)[0]
    np.testing.assert_allclose(state.particles, left.particles, rtol=1e-12)
    np.testing.assert_allclose(state.log_likelihood, left.log_likelihood, rtol=1e-12)


def test_a_mapping_says_by_its_key_that_there_was_no_look():
    drift = lambda key, x, z: x + jax.random.normal(key, x.shape)
    near = lambda x, z: -((x[:, 0] - z["z"]) ** 2) / 2
    initial = lambda key, size: jax.random.normal(key, (size, 1))
    estimator = particle_filter(drift, near, particles=8, initial=initial)
    state = estimator.init(jax.random.key(0))
    after, info = estimator.step(state, {"z": jnp.nan, "valid": False})
    np.testing.assert_array_equal(after.particles, state.particles)
    assert not info.vanished


def test_where_all_weights_vanish_the_old_ones_are_kept():
    seen, dicts = observations(2)
    place = seen.place.copy()
    place[3] = dicts[3]["place"] = [1e3, 0.0]
    state, info = run(seen._replace(place=place), 0.0)
    np.testing.assert_array_equal(info.vanished, np.arange(LOOKS) == 3)
    np.testing.assert_array_equal(info.log_weight[3], info.log_weight[2])
    np.testing.assert_allclose(info.mean, [one["mean"] for one in expected(dicts, 0.0)], rtol=1e-9)
    assert float(info.log_likelihood[3]) == -np.inf == float(state.log_likelihood)
    assert np.isfinite(info.particles).all()
    assert np.isfinite(info.mean).all()

    def loss(place):
        info = run(seen._replace(place=place))[1]
        return jnp.where(info.vanished, 0.0, info.log_likelihood).sum() + info.mean.sum()

    assert np.isfinite(jax.jit(jax.grad(loss))(place)).all()


def test_gradients_are_finite_behind_invalid_looks():
    seen, _ = observations(4, [True, False] * 4)

    def loss(place, noise):
        return run(seen._replace(place=place, noise=noise))[0].log_likelihood

    for gradient in jax.jit(jax.grad(loss, argnums=(0, 1)))(seen.place, seen.noise):
        assert np.isfinite(gradient).all()
        np.testing.assert_array_equal(gradient[1::2], 0.0)
        assert all(np.abs(gradient[k]).max() > 1e-3 for k in range(0, LOOKS, 2))


def test_what_is_no_number_weighs_nothing_and_is_flagged():
    def move(key, x, z):
        return x.at[0].set(jnp.where(z > 1, jnp.nan, x[0]))

    def likelihood(x, z):
        return jnp.where(jnp.arange(SIZE) == 5, jnp.where(z > 2, jnp.nan, 0.0), -x[:, 0])

    estimator = particle_filter(
        move, likelihood, particles=SIZE, initial=lambda key, size: START, resample_below=0.0
    )
    state, info = jax.lax.scan(estimator.step, estimator.init(jax.random.key(0)), jnp.arange(4.0))
    np.testing.assert_array_equal(info.unsound, [False, False, True, True])
    assert np.isfinite(info.mean).all()
    assert np.isfinite(state.particles).all()
    np.testing.assert_array_equal(np.exp(info.log_weight[:, 0]) == 0, [False, False, True, True])
    np.testing.assert_array_equal(np.exp(info.log_weight[:, 5]) == 0, [False] * 3 + [True])
    np.testing.assert_allclose(np.exp(info.log_weight).sum(1), 1.0)


def test_the_order_of_particles_does_not_matter():
    rng = np.random.default_rng(5)
    order = rng.permutation(SIZE)
    weight, told = rng.normal(size=(2, SIZE))
    told[2] = -np.inf
    a, b = weigh(weight, told), weigh(weight[order], told[order])
    np.testing.assert_allclose(b.log_likelihood, a.log_likelihood, rtol=1e-12)
    np.testing.assert_allclose(b.log_weight, a.log_weight[order], rtol=1e-12)
    for summary in (weighted_mean, lambda x, w: effective_size(w)):
        np.testing.assert_allclose(
            summary(START[order], b.log_weight), summary(START, a.log_weight), rtol=1e-12
        )


def test_a_batch_is_its_rows_and_traces_once():
    several = [observations(seed, [True] * 6 + [False, True])[0] for seed in range(3)]
    batch = jax.jit(jax.vmap(run, (0, None)))(jax.tree.map(lambda *x: np.stack(x), *several), 2 / 3)

    @jax.jit
    @chex.assert_max_traces(n=1)
    def once(seen, share):
        return run(seen, share)

    for n, seen in enumerate(several):
        alone = once(seen, 0.6 + n / 30)  # rates are traced
        alone = once(seen, 2 / 3)
        for a, b in zip(alone[1], batch[1], strict=True):
            np.testing.assert_allclose(a, b[n], rtol=1e-9, atol=1e-12)


def test_the_mean_is_the_kalman_filters():
    z, runs = jnp.asarray(looks(6, 20)), 64
    mean, _, _ = kalman_run(MODEL, z)
    one = lambda key: linear_gaussian.run(MODEL, z, key, particles=1000)[1].mean[:, 0]
    got = np.asarray(jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(6), runs)))
    error = 4 * got.std(0, ddof=1) / runs**0.5
    assert error.max() < 0.02
    assert (np.abs(got.mean(0) - mean) < error).all()


@pytest.mark.parametrize("resampler", [systematic, stratified, multinomial, residual])
def test_the_likelihood_is_unbiased(resampler):
    z, runs = jnp.asarray(looks(7, 10)), 4000
    exact = kalman_run(MODEL, z)[2]
    one = lambda key: linear_gaussian.run(MODEL, z, key, resampler, particles=20)[0].log_likelihood
    ratio = np.exp(jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(7), runs)) - exact)
    assert abs(ratio.mean() - 1) < 4 * ratio.std() / runs**0.5 < 0.1


def test_float32():
    z = np.asarray(looks(8, 400), np.float32)
    model = linear_gaussian.Model(*np.float32(MODEL))  # pyright: ignore
    estimator = linear_gaussian.build(model, jittered(systematic, 1e-3), particles=500)
    begun = estimator.init(jax.random.key(8))
    begun = begun._replace(**{f: getattr(begun, f).astype(np.float32) for f in begun._fields[1:]})
    state, info = jax.lax.scan(estimator.step, begun, z)
    assert {x.dtype for x in (*state[1:], *info)} == {np.dtype("f4"), np.dtype(bool)}
    assert all(np.isfinite(x).all() for x in (*state[1:], *info))
    exact = kalman_run(MODEL, jnp.asarray(z, jnp.float64))[2]
    assert abs(float(state.log_likelihood) - float(exact)) < 4.0


def test_a_paper_like_tracker_fits_in():
    """A quantile over all particles as threshold, a coin for each in its motion, jitter."""
    truth = np.stack([np.arange(30.0), -0.5 * np.arange(30.0)], -1)

    def move(key, x, scan):
        toss, step = jax.random.split(key)
        noise = jax.random.normal(step, x.shape)
        ahead = jnp.abs(noise) * jnp.array([1.0, -1.0])[None, :]
        return x + jnp.where(jax.random.bernoulli(toss, 0.5, (x.shape[0], 1)), ahead, noise)

    def likelihood(x, scan):
        apart = jnp.sqrt(((x - scan.position_m) ** 2).sum(-1))
        threshold = jnp.sort(apart)[2 * x.shape[0] // 3]
        gain = (threshold - apart) / threshold / (2 * 0.3**2)
        return jnp.where(apart < threshold, gain, -jnp.inf)

    estimator = particle_filter(
        move,
        likelihood,
        jittered(systematic, 0.1),
        particles=120,
        initial=lambda key, size: jax.random.normal(key, (size, 2)),
    )
    position = np.broadcast_to(truth[:, None], (30, 1, 2))
    scans = Scan(np.arange(30.0), np.ones(30, bool), position, np.ones((30, 1), bool))  # pyright: ignore
    info = jax.lax.scan(estimator.step, estimator.init(jax.random.key(0)), scans)[1]
    assert np.linalg.norm(info.mean - truth, axis=1).max() < 1.0
    assert np.asarray(info.resampled).any()
    assert not np.asarray(info.vanished).any()


def test_cuthbert_agrees():
    cuthbert = pytest.importorskip("cuthbert")
    from tests.filtering.peers import cuthbert_particle_filter

    z, runs, size = jnp.asarray(looks(9, 12)), 400, 100
    keys = jax.random.split(jax.random.key(9), runs)
    ours = lambda key: linear_gaussian.run(MODEL, z, key, particles=size)[0].log_likelihood
    theirs = lambda key: cuthbert_particle_filter(cuthbert, MODEL, z, key, size)
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        a, b = (np.asarray(jax.jit(jax.vmap(one))(keys)) for one in (ours, theirs))
    assert abs(a.mean() - b.mean()) < 4 * ((a.var() + b.var()) / runs) ** 0.5
    np.testing.assert_allclose(a.std(), b.std(), rtol=0.25)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"particles": 0}, "particles"),
        ({"resample_below": -0.1}, "resample_below"),
        ({"initial": lambda key, size: jnp.zeros((3, 2))}, "initial"),
        ({"transition": lambda key, x, z: x[:, :1]}, "transition"),
        ({"log_likelihood": lambda x, z: x}, "log_likelihood"),
        ({"log_density": lambda a, b, z: 0.0}, "log_density"),
    ],
)
def test_what_does_not_fit_is_refused(options, message):
    given = {
        "transition": lambda key, x, z: x,
        "log_likelihood": lambda x, z: x[:, 0],
        "particles": SIZE,
        "initial": lambda key, size: jnp.zeros((size, 2)),
    } | options

    def once():
        estimator = particle_filter(**given)
        return estimator.step(estimator.init(jax.random.key(0)), jnp.zeros(1))

    with pytest.raises(ValueError, match=message):
        once()


def test_arrays_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="log_likelihood"):
        weigh(jnp.zeros(3), jnp.zeros(2))
