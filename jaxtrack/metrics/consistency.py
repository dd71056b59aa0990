"""Whether a filter's errors are as large as it says: NEES and NIS, and their intervals."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.numerics.checks import check_array, check_known
from jaxtrack.numerics.definite import rounding_floor, scaled_root
from jaxtrack.numerics.safe import as_float, safe_divide
from jaxtrack.types import Array


class NormalizedError(NamedTuple):
    """A squared error in units of its own covariance."""

    squared: Array  # [] its mean is the number of its entries, where the covariance is right
    definite: Array  # [] False: the covariance was singular beyond rounding


class ConsistencyTest(NamedTuple):
    """Averages over runs beside the interval that a consistent filter's fall into."""

    mean: Array  # [...] over the runs; 0 where there is none
    lower: Array  # [...]
    upper: Array  # [...]
    inside: Array  # [...] neither overconfident (above) nor too cautious (below)
    runs: Array  # [...] how many were averaged


def nees(mean: Array, covariance: Array, truth: Array) -> NormalizedError:
    """Return the normalized estimation error squared.

        ε = (x − x̂)ᵀ P⁻¹ (x − x̂),   E ε = S

    Args:
        mean: [S] x̂.
        covariance: [S, S] P.
        truth: [S] x.

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers.

    Example:
        >>> print(nees(jnp.zeros(2), 4.0 * jnp.eye(2), jnp.array([2.0, 4.0])).squared)
        5.0

    Source: Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and
        Navigation" (2001), section 5.4.
    """
    check_array("mean", mean, shape=("S",))
    check_array("truth", truth, shape=jnp.shape(mean))
    return nis(as_float(truth) - as_float(mean), covariance)


def nis(innovation: Array, covariance: Array) -> NormalizedError:
    """Return the normalized innovation squared.

        ε = vᵀ S⁻¹ v,   E ε = Z

    Args:
        innovation: [Z] measured minus expected.
        covariance: [Z, Z] the innovation's.

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers.

    Example:
        >>> print(nis(jnp.array([3.0]), jnp.array([[9.0]])).squared)
        1.0

    Source: Bar-Shalom, Li and Kirubarajan (2001), section 5.4.
    """
    check_array("innovation", innovation, shape=("Z",))
    check_array("covariance", covariance, shape=jnp.shape(innovation) * 2)
    innovation = as_float(innovation)
    covariance = jnp.asarray(covariance, innovation.dtype)
    root, definite = scaled_root(covariance, floor=rounding_floor(covariance))
    white = root @ innovation
    return NormalizedError(white @ white, definite)


def consistency(
    squared: Array, mask: Array, *, freedom: Any, probability: Any = 0.95
) -> ConsistencyTest:
    """Return means of NEES or NIS over independent runs, and the interval they should lie in.

        N ε̄ ~ χ²(N n):   [χ²_{(1−q)/2}(N n), χ²_{(1+q)/2}(N n)] / N

    Args:
        squared: [N, ...] of each run, and of each look, for example.
        mask: [N, ...] which of them there are.
        freedom: n, entries of the state (NEES) or of the innovation (NIS).
        probability: q of the interval, two-sided.

    Raises:
        ValueError: shapes do not fit, or a known number is out of range.
        TypeError: not real numbers.

    Example:
        >>> squared = 4.0 + jnp.zeros((50, 3))
        >>> test = consistency(squared, jnp.ones((50, 3), bool), freedom=4)
        >>> print(f"{test.lower[0]:.2f} {test.upper[0]:.2f}", test.inside)
        3.25 4.82 [ True  True  True]

    Source: Bar-Shalom, Li and Kirubarajan (2001), section 5.4.

    Note:
        Over looks of one run NEES is correlated, so its mean has no such interval; NIS of a right
        filter is not.
    """
    check_array("squared", squared)
    check_array("mask", mask, shape=jnp.shape(squared))
    check_array("freedom", freedom, shape=())
    check_array("probability", probability, shape=())
    check_known("freedom", freedom, lambda n: n > 0, "a positive number")
    check_known("probability", probability, lambda q: 0 < q < 1, "a number between 0 and 1")
    if jnp.ndim(squared) == 0:
        raise ValueError("squared: got a scalar, want runs along the first axis")
    squared, mask = as_float(squared), jnp.asarray(mask, bool)
    dtype = squared.dtype
    runs = mask.sum(0)
    mean = safe_divide(jnp.where(mask, squared, 0.0).sum(0), runs.astype(dtype))
    total = runs.astype(dtype) * jnp.asarray(freedom, dtype)
    share = jnp.asarray(probability, dtype)
    some = runs > 0
    ends = [
        jnp.where(some, safe_divide(chi_squared_quantile(at, total), runs.astype(dtype)), none)
        for at, none in (((1 - share) / 2, 0.0), ((1 + share) / 2, jnp.inf))
    ]
    inside = some & (mean >= ends[0]) & (mean <= ends[1])
    return ConsistencyTest(mean, ends[0], ends[1], inside, runs)


def chi_squared_quantile(probability: Array, freedom: Array) -> Array:
    """Return the x with P(χ²_n ≤ x) = probability, by halving an interval.

    Args:
        probability: in (0, 1).
        freedom: n > 0, any shape that broadcasts; where it is not positive the result is 0.

    Example:
        >>> print(chi_squared_quantile(jnp.asarray(0.99), jnp.asarray(2.0)).round(3))
        9.21
    """
    probability, freedom = jnp.broadcast_arrays(as_float(probability), as_float(freedom))
    n = jnp.where(freedom > 0, freedom, 1.0)
    # Beyond: P(χ²_n > n + 2 √(n t) + 2 t) ≤ exp(−t) (Laurent and Massart), with t of the tail.
    tail = -jnp.log1p(-probability)
    high = n + 2 * jnp.sqrt(n * tail) + 2 * tail

    def halve(_: Array, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = ends
        middle = (low + high) / 2
        below = jax.scipy.special.gammainc(n / 2, middle / 2) < probability
        return jnp.where(below, middle, low), jnp.where(below, high, middle)

    low, high = jax.lax.fori_loop(0, 64, halve, (jnp.zeros_like(high), high))
    return jnp.where(freedom > 0, (low + high) / 2, 0.0)
