"""Recursive least squares against the batch problem that it solves."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtrack.filtering.rls import RlsInput, RlsParams, RlsState, rls, update
from tests.metrics.differences import assert_gradients_agree
from tests.oracles.rls import batch

few = settings(max_examples=25, deadline=None, derandomize=True, database=None)
SIZE = 7


@jax.jit
def run(inputs, forgetting, initial_variance):
    # Rebuilt inside, so that its parameters are traced.
    estimator = rls(RlsParams(forgetting, initial_variance), regressors=2, dimensions=2)
    return jax.lax.scan(estimator.step, estimator.init(jax.random.key(0)), inputs)


def random_inputs(seed, mask=None):
    """Return times and measurements of a moving point; NaN where masked."""
    rng = np.random.default_rng(seed)
    time_s = np.cumsum(rng.uniform(0.5, 1.5, SIZE))
    mask = np.ones(SIZE, bool) if mask is None else mask
    z = rng.normal(scale=20.0, size=2) + time_s[:, None] * rng.normal(scale=5.0, size=2)
    z = np.where(mask[:, None], z + rng.normal(size=(SIZE, 2)), np.nan)
    phi = np.stack([np.ones(SIZE), time_s - time_s[-1]], axis=-1)
    return time_s, z, RlsInput(phi, z, mask)  # pyright: ignore[reportArgumentType]


@few
@given(
    st.integers(0, 2**32 - 1),
    st.lists(st.booleans(), min_size=SIZE, max_size=SIZE),
    st.sampled_from([1.0, 0.9]),
    st.floats(0.0, 3.0),
)
def test_equals_the_batch_problem(seed, mask, forgetting, exponent):
    mask, delta = np.array(mask), 10.0**exponent
    time_s, z, inputs = random_inputs(seed, mask)
    state, fitted = run(inputs, forgetting, delta)
    for n in range(1, SIZE + 1):
        kept = mask & (np.arange(SIZE) < n)
        coefficients, inverse = batch(time_s, z, kept, time_s[-1], forgetting, delta)
        expected = inputs.regressors[n - 1] @ coefficients
        np.testing.assert_allclose(fitted[n - 1], expected, rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(state.coefficients, coefficients, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(state.inverse, inverse, rtol=1e-10, atol=1e-10)


def test_it_starts_where_its_state_stands():
    time_s, z, inputs = random_inputs(1)
    start = np.array([[3.0, -4.0], [0.5, 2.0]])
    state = RlsState(jnp.asarray(start), 5.0 * jnp.eye(2))
    for phi, measurement in zip(inputs.regressors, z, strict=True):
        state = update(state, jnp.asarray(phi), jnp.asarray(measurement), 0.95)
    expected, inverse = batch(time_s, z, np.ones(SIZE, bool), time_s[-1], 0.95, 5.0, start)
    np.testing.assert_allclose(state.coefficients, expected, rtol=1e-10)
    np.testing.assert_allclose(state.inverse, inverse, rtol=1e-10)


def test_other_sizes():
    rng = np.random.default_rng(2)
    phi, truth = rng.normal(size=(40, 3)), rng.normal(size=(3, 1))
    estimator = rls(RlsParams(initial_variance=1e10), regressors=3, dimensions=1)
    inputs = RlsInput(phi, phi @ truth, np.ones(40, bool))  # pyright: ignore
    state, fitted = jax.jit(jax.lax.scan, static_argnums=0)(
        estimator.step, estimator.init(jax.random.key(0)), inputs
    )
    np.testing.assert_allclose(state.coefficients, truth, rtol=1e-7)
    assert fitted.shape == (40, 1)


def test_what_is_masked_changes_nothing():
    mask = np.array([True, False, True, True, False, True, False])
    _, z, inputs = random_inputs(3, mask)
    expected, fitted = run(inputs, 0.9, 100.0)
    anything = inputs._replace(measurement=np.where(mask[:, None], z, 1e9))
    for a, b in zip(run(anything, 0.9, 100.0)[0], expected, strict=True):
        np.testing.assert_array_equal(a, b)
    alone = jax.tree.map(lambda x: x[mask], inputs)
    for a, b in zip(run(alone, 0.9, 100.0)[0], expected, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12)
    assert np.isfinite(fitted).all()


@pytest.mark.parametrize("forgetting", [1.0, 0.9])
def test_gradients_agree_with_central_differences(forgetting):
    mask = np.array([True, True, False, True, False, True, True])
    _, z, inputs = random_inputs(4)
    hidden = np.where(mask, 0.0, np.nan)

    def loss(z, phi, settings):
        seen = RlsInput(phi, 10.0 * z + hidden[:, None], mask)  # pyright: ignore
        state, fitted = run(seen, forgetting * settings[0], 100.0 * settings[1])
        return (fitted**2).sum() / 1e3 + state.coefficients.sum() / 10 + state.inverse.sum()

    arguments = (z / 10.0, inputs.regressors, np.ones(2))
    assert_gradients_agree(loss, *arguments, atol=1e-8)
    gradients = jax.jit(jax.grad(loss, argnums=(0, 1, 2)))(*arguments)
    assert all(np.abs(g).max() > 1e-3 for g in gradients)
    np.testing.assert_array_equal(gradients[0][~mask], 0.0)


@pytest.mark.parametrize("forgetting", [1.0, 0.98])
def test_ten_thousand_steps_in_float32(forgetting):
    rng = np.random.default_rng(5)
    steps = 10_000
    phi = np.stack([np.ones(steps), rng.uniform(-1.0, 1.0, steps)], -1).astype(np.float32)
    truth = np.array([[120.0, -40.0], [7.0, 300.0]])
    z = (phi @ truth + rng.normal(size=(steps, 2))).astype(np.float32)
    estimator = rls(RlsParams(forgetting), regressors=2, dimensions=2)
    begin = jax.tree.map(lambda x: x.astype(jnp.float32), estimator.init(jax.random.key(0)))

    def step(state, scan):
        state, fitted = estimator.step(state, scan)
        return state, (state.inverse, fitted)

    inputs = RlsInput(phi, z, np.ones(steps, bool))  # pyright: ignore
    state, (inverse, fitted) = jax.jit(jax.lax.scan, static_argnums=0)(step, begin, inputs)
    assert state.coefficients.dtype == state.inverse.dtype == fitted.dtype == np.float32
    assert np.isfinite(fitted).all()
    # But for the last bit, as compilers may fuse one of the two sums with a product.
    np.testing.assert_allclose(inverse, np.swapaxes(inverse, 1, 2), rtol=3e-7)
    assert (np.linalg.eigvalsh(inverse) > 0).all()
    expected, _ = batch(phi[:, 1], z, np.ones(steps, bool), 0.0, forgetting, 1e6)
    np.testing.assert_allclose(state.coefficients, expected, rtol=1e-3)
