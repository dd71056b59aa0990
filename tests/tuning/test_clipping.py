"""Each realization's gradient is bounded, in free parameters; the loss is what it was."""

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from jaxtrack.numerics import bounded, positive
from jaxtrack.tuning import clip_each, fit

BIJECTORS = {"scale": positive(), "share": bounded(0.0, 1.0)}
AT = {"scale": 2.0, "share": 0.3}


def squared(params, key):
    a, b = jax.random.normal(key, (2,))
    return (params["scale"] - a) ** 2 + 4 * (params["share"] - b) ** 2


def test_gradients_are_scaled_down_to_the_norm_and_short_ones_stay():
    long = 0
    for seed in range(20):
        key = jax.random.key(seed)
        a, b = np.asarray(jax.random.normal(key, (2,)))
        raw = np.array([2 * (2.0 - a), 8 * (0.3 - b)])
        free = raw * np.array([2.0, 0.3 * 0.7])  # d params / d free
        norm = np.sqrt((free**2).sum())
        long += norm > 5.0
        value, slope = jax.jit(jax.value_and_grad(clip_each(squared, 5.0, BIJECTORS)))(AT, key)
        np.testing.assert_allclose(value, squared(AT, key), rtol=1e-12)
        got = [slope["scale"], slope["share"]]
        np.testing.assert_allclose(got, raw * min(1.0, 5.0 / norm), rtol=1e-6)
    assert 0 < long < 20


def test_gradients_whose_squares_overflow_are_scaled_down_too():
    steep = lambda x, key: (x * jnp.float32(1e25)).sum()
    slope = jax.grad(clip_each(steep, 0.5))(jnp.ones(4, jnp.float32), jax.random.key(0))
    np.testing.assert_allclose(slope, 0.25, rtol=1e-6)


def test_every_realization_under_vmap_has_a_bound_of_its_own():
    keys = jax.random.split(jax.random.key(0), 9)
    slope = jax.jit(jax.grad(clip_each(squared, 0.5, BIJECTORS)))
    together = jax.vmap(slope, (None, 0))(AT, keys)
    for n, key in enumerate(keys):
        jax.tree.map(
            lambda x, y, n=n: np.testing.assert_allclose(x[n], y), together, slope(AT, key)
        )


def test_a_fit_finds_its_way_where_one_realization_in_many_is_wild():
    def wild(x, key):
        sign, rare = jax.random.uniform(key, (2,)) - 0.5
        return (x - 3.0) ** 2 + jnp.where(jnp.abs(rare) < 0.02, 1e4 * jnp.sign(sign) * x, 0.0)

    run = lambda loss: float(
        fit(
            loss, 0.0, optax.sgd(optax.cosine_decay_schedule(0.5, 60)), key=jax.random.key(1),
            steps=60, batch=16, holdout=16, every=60,
        ).history.params[-1]
    )  # fmt: skip
    assert abs(run(clip_each(wild, 1.0)) - 3.0) < 0.2
    assert abs(run(wild) - 3.0) > 2.0


def test_what_is_not_finite_and_what_is_nothing_stay_so():
    key = jax.random.key(0)
    broken = clip_each(lambda x, key: jnp.sqrt(x), 1.0)
    assert not np.isfinite(jax.grad(broken)(0.0, key))
    assert jax.grad(clip_each(lambda x, key: 0.0 * x, 1.0))(2.0, key) == 0.0


def test_float32_stays_and_a_bound_that_is_none_is_refused():
    loss = clip_each(lambda params, _: params["scale"] * params["share"], 1e-2, BIJECTORS)
    at = jax.tree.map(np.float32, AT)
    slope = jax.grad(lambda p: loss(p, jax.random.key(0)))(at)
    assert {leaf.dtype for leaf in jax.tree.leaves(slope)} == {np.dtype(np.float32)}
    with pytest.raises(ValueError, match=r"most: got 0\.0, want a positive number"):
        clip_each(squared, 0.0)


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"most": "a"}, TypeError, "most: got str"),
        ({"most": -1.0}, ValueError, "most: got -1"),
        ({"loss": None}, TypeError, "loss: got NoneType"),
    ],
)
def test_arguments_that_cannot_be_are_refused(change, error, words):
    with pytest.raises(error, match=words):
        clip_each(**{"loss": squared, "most": 1.0, **change})
