"""How far a mean or a rate over trials can be trusted."""

from statistics import NormalDist
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.numerics import checks

_CHUNK = 4096  # trials summed at a time, so that no second copy of all the values ever exists


class Interval(NamedTuple):
    """A confidence interval."""

    lower: Any  # []
    upper: Any  # []


def mean_and_error(values: Any, axis: int = 0) -> tuple[Any, Any]:
    """Mean over trials and its standard error.

    m = Σᵢ xᵢ / n and SE = √(Σᵢ (xᵢ − m)² / (n (n − 1))). Booleans and integers are averaged as
    floats. One trial says nothing about the spread: its standard error is infinite. The gradient
    of the error is zero, not NaN, where all trials agree.

    Args:
        values: one array of real numbers, `[trials, ...]` when `axis` is 0. NumPy arrays are
            summed in float64 on the host; JAX arrays stay traced and keep their dtype.
        axis: the axis of the trials.

    Returns:
        The mean and the standard error, without the trial axis, of the values' own float dtype.

    Raises:
        TypeError: the values are not real numbers.
        ValueError: there is no such axis, or no trial on it.

    Example:
        >>> mean, error = mean_and_error(np.array([1.0, 2.0, 3.0, 4.0]))
        >>> print(f"{mean:.2f} ± {error:.2f}")
        2.50 ± 0.65
    """
    checks.check_array("values", values)
    shape = jnp.shape(values)
    if not -len(shape) <= axis < len(shape) or shape[axis] == 0:
        raise ValueError(f"values: got shape {list(shape)}, want at least one trial on axis {axis}")
    if isinstance(values, jax.Array):
        return _on_device(jnp.moveaxis(values, axis, 0))
    return _on_host(np.moveaxis(np.asarray(values), axis, 0))


def proportion_interval(successes: Any, trials: Any, confidence: float = 0.95) -> Interval:
    """Wilson's score interval of a rate seen as `successes` out of `trials`.

    (p + z²/2n ± z √(p (1 − p)/n + z²/4n²)) / (1 + z²/n) with p = successes / trials. Unlike the
    normal interval it stays inside [0, 1] and keeps its width when no trial, or every trial, is a
    success.

    Args:
        successes: a count, or an array of counts.
        trials: how many trials, at least one.
        confidence: the probability that the interval covers the true rate, in (0, 1).

    Raises:
        ValueError: a count or the confidence lies outside its range.

    Example:
        >>> lower, upper = proportion_interval(90, 100)
        >>> print(f"{lower:.3f} to {upper:.3f}")
        0.826 to 0.945

    Source: E. B. Wilson, Probable inference, the law of succession, and statistical inference,
    J. Am. Stat. Assoc. 22 (1927).
    """
    z = _quantile(confidence)
    n = np.asarray(trials, np.float64)
    k = np.asarray(successes, np.float64)
    if not (np.all(n >= 1) and np.all(k >= 0) and np.all(k <= n)):
        raise ValueError(f"successes: got {successes} of {trials} trials, want 0 … trials, ≥ 1")
    rate = k / n
    centre = rate + z**2 / (2 * n)
    half = z * np.sqrt(rate * (1 - rate) / n + z**2 / (4 * n**2))
    scale = 1 + z**2 / n
    # Rounding must not leave the ends a hair inside the rate that was seen.
    lower = np.where(k == 0, 0.0, (centre - half) / scale)
    upper = np.where(k == n, 1.0, (centre + half) / scale)
    return Interval(lower[()], upper[()])


def interval_of_mean(mean: Any, standard_error: Any, confidence: float = 0.95) -> Interval:
    """Normal interval of a mean over many trials: m ± z SE.

    Args:
        mean: a number or an array.
        standard_error: of the mean, as `mean_and_error` gives it; the same shape.
        confidence: the probability that the interval covers the true mean, in (0, 1).

    Raises:
        ValueError: the confidence lies outside (0, 1).

    Example:
        >>> lower, upper = interval_of_mean(2.5, 0.1)
        >>> print(f"{lower:.3f} to {upper:.3f}")
        2.304 to 2.696
    """
    z = _quantile(confidence)
    return Interval(mean - z * standard_error, mean + z * standard_error)


def _quantile(confidence: float) -> float:
    """Z with P(|N(0, 1)| ≤ z) = confidence."""
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence: got {confidence}, want a number between 0 and 1")
    return NormalDist().inv_cdf(0.5 + confidence / 2)


def _float_dtype(dtype: Any) -> Any:
    """The dtype that averages have: the values' own, or JAX's default for booleans and ints."""
    return dtype if jnp.issubdtype(dtype, jnp.floating) else jnp.result_type(float)


def _on_device(values: jax.Array) -> tuple[jax.Array, jax.Array]:
    values = values.astype(_float_dtype(values.dtype))
    n = values.shape[0]
    mean = jnp.mean(values, axis=0)
    if n == 1:
        return mean, jnp.full_like(mean, jnp.inf)
    variance = jnp.sum((values - mean[None]) ** 2, axis=0) / (n * (n - 1.0))
    # √ has no gradient at zero; `variance != 0` lets NaN through, `variance > 0` would hide it.
    spread = variance != 0
    return mean, jnp.where(spread, jnp.sqrt(jnp.where(spread, variance, 1)), 0)


def _on_host(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    dtype, n = _float_dtype(values.dtype), values.shape[0]
    chunks = [values[start : start + _CHUNK] for start in range(0, n, _CHUNK)]
    with np.errstate(invalid="ignore", over="ignore"):  # a trial of NaN or inf speaks for itself
        mean = np.sum([chunk.sum(axis=0, dtype=np.float64) for chunk in chunks], axis=0) / n
        if n == 1:
            return mean.astype(dtype), np.full_like(mean, np.inf, dtype)[()]
        squares = np.sum([np.square(chunk - mean).sum(axis=0) for chunk in chunks], axis=0)
        return mean.astype(dtype), np.sqrt(squares / (n * (n - 1.0))).astype(dtype)
