"""Means, standard errors and intervals against NumPy, tables and simulation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.montecarlo import interval_of_mean, mean_and_error, proportion_interval


@pytest.mark.parametrize("shape", [(10_000,), (5000, 3), (2, 1, 2)])
@pytest.mark.parametrize("convert", [np.asarray, jnp.asarray])
def test_mean_and_error_against_numpy(shape, convert):
    values = 1e3 + np.random.default_rng(1).normal(size=shape)
    mean, error = mean_and_error(convert(values))
    np.testing.assert_allclose(mean, values.mean(0), rtol=1e-13)
    want = values.std(0, ddof=1) / np.sqrt(shape[0])
    np.testing.assert_allclose(error, want, rtol=1e-9)


@pytest.mark.parametrize("convert", [np.asarray, jnp.asarray])
def test_mean_and_error_along_another_axis(convert):
    values = np.random.default_rng(2).normal(size=(3, 50, 2))
    got = mean_and_error(convert(values), axis=1)
    want = mean_and_error(convert(np.moveaxis(values, 1, 0)))
    np.testing.assert_array_equal(got[0], want[0])
    np.testing.assert_array_equal(got[1], want[1])


@pytest.mark.parametrize("convert", [np.asarray, jnp.asarray])
def test_dtypes(convert):
    hits = np.array([True, False, True, True])
    mean, error = mean_and_error(convert(hits))
    assert mean.dtype == error.dtype == np.float64
    np.testing.assert_allclose([mean, error], [0.75, 0.25], rtol=1e-15)
    mean, error = mean_and_error(convert(np.arange(5, dtype=np.int32)))
    np.testing.assert_allclose([mean, error], [2.0, np.sqrt(0.5)], rtol=1e-15)
    mean, error = mean_and_error(convert(np.ones((4, 2), np.float32)))
    assert mean.dtype == error.dtype == np.float32


def test_the_host_sums_float32_without_drift():
    values = np.full(1_000_000, 0.1, np.float32)
    values[0] = 1e6
    mean, _ = mean_and_error(values)
    np.testing.assert_allclose(mean, values.astype(np.float64).mean(), rtol=1e-7)


@pytest.mark.parametrize("convert", [np.asarray, jnp.asarray])
def test_a_single_trial_has_an_infinite_error(convert):
    mean, error = mean_and_error(convert(np.array([3.0])))
    assert mean == 3.0
    assert error == np.inf
    assert f"{mean:.1f} ± {error:.1f}" == "3.0 ± inf"


@pytest.mark.parametrize("convert", [np.asarray, jnp.asarray])
def test_what_is_not_finite_stays_visible(convert):
    mean, error = mean_and_error(convert(np.array([[1.0, np.nan, np.inf], [2.0, 3.0, 4.0]])))
    np.testing.assert_array_equal(mean, [1.5, np.nan, np.inf])
    assert error[0] == 0.5
    assert np.isnan(error[1])
    assert np.isnan(error[2])


def test_gradients_of_the_error():
    values = jnp.asarray(np.random.default_rng(3).normal(size=12))
    slope = jax.jit(jax.grad(lambda x: mean_and_error(x)[1]))
    step = 1e-5
    shifted = [
        [mean_and_error(values.at[i].add(sign * step))[1] for sign in (1, -1)] for i in range(12)
    ]
    want = [(up - down) / (2 * step) for up, down in shifted]
    np.testing.assert_allclose(slope(values), want, rtol=1e-6, atol=1e-9)
    np.testing.assert_array_equal(slope(jnp.ones(12)), np.zeros(12))


@pytest.mark.parametrize(
    ("successes", "trials", "confidence", "lower", "upper"),
    [
        # Newcombe, Statistics in Medicine 17 (1998), table I: score method without correction.
        (81, 263, 0.95, 0.2553, 0.3662),
        (15, 148, 0.95, 0.0624, 0.1605),
        (0, 20, 0.95, 0.0000, 0.1611),
        (1, 29, 0.95, 0.0061, 0.1718),
        # n = 10, every trial a success: n / (n + z²) with z = 2.5758.
        (10, 10, 0.99, 0.6012, 1.0000),
    ],
)
def test_proportion_interval_against_tables(successes, trials, confidence, lower, upper):
    got = proportion_interval(successes, trials, confidence)
    np.testing.assert_allclose(got, (lower, upper), atol=6e-5)


def test_proportion_interval_has_exact_ends_and_takes_arrays():
    counts = np.arange(0, 1001)
    lower, upper = proportion_interval(counts, 1000)
    assert lower[0] == 0.0
    assert upper[-1] == 1.0
    assert np.all(lower <= counts / 1000)
    assert np.all(upper >= counts / 1000)
    assert proportion_interval(300, 1000) == (lower[300], upper[300])


def test_intervals_cover_the_truth_as_often_as_they_say():
    rng = np.random.default_rng(4)
    lower, upper = proportion_interval(rng.binomial(60, 0.3, 20_000), 60)
    covered = np.mean((lower <= 0.3) & (upper >= 0.3))
    assert 0.93 < covered < 0.97
    samples = rng.exponential(size=(400, 4000))
    lower, upper = interval_of_mean(*mean_and_error(samples), confidence=0.9)
    covered = np.mean((lower <= 1.0) & (upper >= 1.0))
    assert 0.88 < covered < 0.92


def test_interval_of_mean():
    lower, upper = interval_of_mean(10.0, 2.0)
    np.testing.assert_allclose((lower, upper), (10 - 3.919928, 10 + 3.919928), rtol=1e-7)
    assert interval_of_mean(10.0, np.inf) == (-np.inf, np.inf)


def test_errors_say_what_is_wanted():
    with pytest.raises(ValueError, match="at least one trial on axis 0"):
        mean_and_error(np.zeros((0, 3)))
    with pytest.raises(ValueError, match="at least one trial on axis 1"):
        mean_and_error(np.zeros(3), axis=1)
    with pytest.raises(TypeError, match="values: got dtype complex128"):
        mean_and_error(np.zeros(3, complex))
    with pytest.raises(ValueError, match="successes: got 3 of 2 trials"):
        proportion_interval(3, 2)
    with pytest.raises(ValueError, match="successes: got 0 of 0 trials"):
        proportion_interval(0, 0)
    with pytest.raises(ValueError, match="confidence: got 95"):
        proportion_interval(1, 2, 95)
    with pytest.raises(ValueError, match=r"confidence: got 1\.0"):
        interval_of_mean(0.0, 1.0, 1.0)
