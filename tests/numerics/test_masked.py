import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from jaxtrack import numerics

REDUCTIONS = {
    "sum": (numerics.masked_sum, np.sum),
    "mean": (numerics.masked_mean, np.mean),
    "min": (numerics.masked_min, np.min),
    "max": (numerics.masked_max, np.max),
    "logsumexp": (numerics.masked_logsumexp, lambda v: np.log(np.sum(np.exp(v)))),
}
ARGS = {
    "argmin": (numerics.masked_argmin, np.argmin),
    "argmax": (numerics.masked_argmax, np.argmax),
}
JITTED = {
    name: jax.jit(jax.value_and_grad(lambda x, m, f=function: f(x, m)))
    for name, (function, _) in REDUCTIONS.items()
}
JITTED_ARGS = {name: jax.jit(function) for name, (function, _) in ARGS.items()}
EMPTY = {"logsumexp": np.finfo(np.float64).min}
RUBBISH = np.array([np.nan, np.inf, -np.inf, 1e30, -1e30])

masks = hnp.arrays(bool, 7)
values = hnp.arrays(
    np.float64, 7, elements=st.integers(-300, 300).map(lambda k: k / 8), unique=True
)


@settings(max_examples=60, deadline=None)
@given(x=values, mask=masks, shift=st.integers(0, 4))
@pytest.mark.parametrize("name", REDUCTIONS)
def test_masked_entries_change_neither_value_nor_gradient(name, x, mask, shift):
    oracle = REDUCTIONS[name][1]
    dirty = np.where(mask, x, np.resize(np.roll(RUBBISH, shift), 7))
    value, gradient = JITTED[name](dirty, mask)
    expected = oracle(x[mask]) if mask.any() else EMPTY.get(name, 0.0)
    np.testing.assert_allclose(value, expected, rtol=1e-12, atol=1e-12)

    slope = np.zeros(7)
    if mask.any():
        count = mask.sum()
        slope[mask] = {
            "sum": lambda v: np.ones(count),
            "mean": lambda v: np.full(count, 1 / count),
            "min": lambda v: np.arange(count) == np.argmin(v),
            "max": lambda v: np.arange(count) == np.argmax(v),
            "logsumexp": lambda v: np.exp(v - expected),
        }[name](x[mask])
    np.testing.assert_allclose(gradient, slope, rtol=1e-11, atol=1e-14)


@settings(max_examples=60, deadline=None)
@given(x=values, mask=masks, shift=st.integers(0, 4))
@pytest.mark.parametrize("name", ARGS)
def test_arguments_of_extremes_are_among_the_valid(name, x, mask, shift):
    dirty = np.where(mask, x, np.resize(np.roll(RUBBISH, shift), 7))
    expected = np.flatnonzero(mask)[ARGS[name][1](x[mask])] if mask.any() else 0
    assert int(JITTED_ARGS[name](dirty, mask)) == expected


@pytest.mark.parametrize("name", REDUCTIONS)
def test_an_axis_and_a_broadcast_mask(name):
    function, oracle = REDUCTIONS[name]
    x = np.random.default_rng(3).normal(size=(5, 2))
    mask = np.array([True, False, True, True, False])
    x[~mask] = np.nan
    got = jax.jit(function, static_argnums=2)(x, mask[:, None], 0)
    np.testing.assert_allclose(got, [oracle(x[mask, 0]), oracle(x[mask, 1])], rtol=1e-14)


@pytest.mark.parametrize("name", REDUCTIONS)
def test_float32_stays_float32(name):
    x, mask = jnp.array([1.0, 2.0], dtype=jnp.float32), jnp.array([True, False])
    assert REDUCTIONS[name][0](x, mask).dtype == jnp.float32


def test_fallback_of_an_empty_extreme():
    x, mask = jnp.array([jnp.nan, 1.0]), jnp.zeros(2, dtype=bool)
    assert float(numerics.masked_min(x, mask, fallback=9.0)) == 9.0
    assert float(numerics.masked_max(x, mask, fallback=-9.0)) == -9.0


def test_a_valid_infinity_goes_before_a_masked_entry():
    x, mask = jnp.array([jnp.nan, jnp.inf]), jnp.array([False, True])
    assert int(numerics.masked_argmin(x, mask)) == 1
    assert float(numerics.masked_min(x, mask)) == np.inf
    assert float(numerics.masked_max(-x, mask)) == -np.inf


def test_logsumexp_neither_overflows_nor_trips_over_impossible_terms():
    both = jnp.array([True, True])
    value_and_grad = jax.jit(jax.value_and_grad(numerics.masked_logsumexp))
    value, gradient = value_and_grad(jnp.array([1e4, 1e4]), both)
    np.testing.assert_allclose(value, 1e4 + np.log(2), rtol=1e-15)
    np.testing.assert_allclose(gradient, [0.5, 0.5])

    value, gradient = value_and_grad(jnp.array([2.0, -jnp.inf]), both)
    assert value == 2.0
    np.testing.assert_array_equal(gradient, [1.0, 0.0])

    value, gradient = value_and_grad(jnp.array([-jnp.inf, -jnp.inf]), both)
    assert value == np.finfo(np.float64).min
    np.testing.assert_array_equal(gradient, [0.0, 0.0])


@pytest.mark.parametrize("name", REDUCTIONS)
def test_jitted_gradient_of_a_loss_agrees_with_central_differences(name):
    function = REDUCTIONS[name][0]
    mask = np.random.default_rng(4).random((6, 6)) < 0.6

    def loss(points):
        square = jnp.sum((points[:, None, :] - points[None, :, :]) ** 2, axis=-1)
        return jnp.sum(jnp.sin(function(square, mask)) * points[:, 0])

    jitted, gradient_of = jax.jit(loss), jax.jit(jax.grad(loss))
    for seed in range(5):
        points = np.random.default_rng(seed).normal(size=(6, 2))
        expected = np.zeros_like(points)
        for index in np.ndindex(points.shape):
            step = np.zeros_like(points)
            step[index] = 1e-6
            expected[index] = (jitted(points + step) - jitted(points - step)) / 2e-6
        np.testing.assert_allclose(gradient_of(points), expected, rtol=1e-6, atol=1e-8)
