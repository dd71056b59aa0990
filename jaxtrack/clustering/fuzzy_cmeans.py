"""Fuzzy c-means of weighted samples, with gradients through the fixed point.

    μ_ij = 1 / Σ_k (d_ij / d_kj)^(2/(m−1)),     Z_i = Σ_j w_j μ_ij^m x_j / Σ_j w_j μ_ij^m

the stationary points of J = Σ_ij w_j μ_ij^m d_ij², are iterated to their fixed point. A sample of
weight w counts as w samples at one place. Where centres coincide with a sample, they share it
equally. Patterns live in slots, some of which are not active.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.numerics.checks import check_array, check_known, check_size
from jaxtrack.numerics.safe import as_float, safe_divide
from jaxtrack.types import Array


class CMeans(NamedTuple):
    """What fuzzy c-means found."""

    centres: Array  # [K, D] inactive slots hold what they were given
    membership: Array  # [K, N] zero in inactive slots and for masked samples
    objective: Array  # [] J
    residual: Array  # [] how far the last update moved any centre, in the samples' unit


def memberships(
    samples: Array, centres: Array, *, active: Array, fuzzifier: Array | float
) -> Array:
    """Return how far each sample belongs to each pattern, [K, N]: columns add up to 1.

        μ_ij = 1 / Σ_k (d_ij / d_kj)^(2/(m−1))

    Args:
        samples: [N, D] in units in which the features compare.
        centres: [K, D] in the same units.
        active: [K] which slots hold a pattern; the others get zeros.
        fuzzifier: m > 1; towards 1 the memberships become crisp.

    Example:
        >>> samples, centres = jnp.array([[1.0], [0.0]]), jnp.array([[0.0], [3.0]])
        >>> print(memberships(samples, centres, active=jnp.ones(2, bool), fuzzifier=2.0))
        [[0.8 1. ]
         [0.2 0. ]]

    Source: clustering-statistic Hough transform (2018), equation 22.
    """
    _, share, _ = _shares(samples, centres, active, _fuzzifier(fuzzifier, samples.dtype))
    total = share.sum(0)
    return share / jnp.where(total > 0, total, 1.0)[None, :]


def update(
    samples: Array, weights: Array, centres: Array, *, active: Array, fuzzifier: Array | float
) -> Array:
    """Return the centres after one iteration, [K, D]; what no sample belongs to stays.

        Z_i = Σ_j w_j μ_ij^m x_j / Σ_j w_j μ_ij^m

    Args:
        samples: [N, D].
        weights: [N] ≥ 0.
        centres: [K, D].
        active: [K] which slots hold a pattern.
        fuzzifier: m > 1.

    Example:
        >>> samples, ones = jnp.array([[0.0], [2.0]]), jnp.ones(2)
        >>> print(update(samples, ones, jnp.array([[5.0]]), active=jnp.ones(1, bool), fuzzifier=2.0))
        [[1.]]

    Source: clustering-statistic Hough transform (2018), equations 22 and 23.
    """  # noqa: E501
    power = _fuzzifier(fuzzifier, samples.dtype)
    moved, alive = _means(samples, weights, centres, active, power)
    return jnp.where(alive[:, None], moved, centres)


def fuzzy_cmeans(
    samples: Array,
    weights: Array,
    centres: Array,
    *,
    mask: Array | None = None,
    active: Array | None = None,
    fuzzifier: Array | float = 2.0,
    tolerance: Array | float = 1e-6,
    iterations: int = 100,
) -> CMeans:
    """Return the fuzzy c-means that the updates lead to from given centres.

    The gradient is that of the fixed point, by the implicit function theorem: its cost does not
    grow with the iterations, and where they started has none.

    Args:
        samples: [N, D] in units in which the features compare.
        weights: [N] ≥ 0.
        centres: [K, D] where to start.
        mask: [N] which samples exist; all by default.
        active: [K] which slots hold a pattern; all by default.
        fuzzifier: m > 1.
        tolerance: iterations end when no centre moves farther, in the samples' unit.
        iterations: at most so many. Static.

    Raises:
        ValueError: shapes do not fit, a weight is negative, or m ≤ 1.
        TypeError: not real numbers, or `iterations` is not an int.

    Example:
        >>> samples = jnp.array([[0.0], [1.0], [10.0], [11.0]])
        >>> found = fuzzy_cmeans(samples, jnp.ones(4), jnp.array([[3.0], [7.0]]))
        >>> print(found.centres.round(1).tolist(), found.membership.round().tolist())
        [[0.5], [10.5]] [[1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0]]

    Source: clustering-statistic Hough transform (2018), equations 21–23.

    Note:
        J is that of squared distances, of which equations 22 and 23 are the stationary points;
        equation 21 prints the distance itself. The gradient is meaningful where `residual` is
        small; along directions in which the fixed point is not isolated it is zero.
    """
    check_size("iterations", iterations)
    samples, weights, mask, active = check_samples(samples, weights, centres, mask, active)
    dtype = samples.dtype
    start = jax.lax.stop_gradient(jnp.asarray(centres, dtype))
    fuzzifier = _fuzzifier(fuzzifier, dtype)
    bound = jax.lax.stop_gradient(jnp.asarray(tolerance, dtype)) ** 2

    def residual(z: Array) -> Array:
        moved, alive = _means(samples, weights, z, active, fuzzifier)
        # A slot that is not alive stays, whatever the samples do: the system stays regular.
        return jnp.where(alive[:, None], moved, jax.lax.stop_gradient(z)) - z

    def settle(_: object, z: Array) -> Array:
        def go_on(state: tuple[Array, Array, Array]) -> Array:
            count, _, square = state
            return (count < iterations) & (square > bound)

        def go(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            count, z, _ = state
            step = residual(z)
            return count + 1, z + step, (step * step).sum(-1).max()

        far = jnp.asarray(jnp.inf, dtype)
        return jax.lax.while_loop(go_on, go, (jnp.asarray(0, jnp.int32), z, far))[1]

    centres = jax.lax.custom_root(residual, start, settle, _solve)
    squares, share, share_m = _shares(samples, centres, active, fuzzifier)
    total = share.sum(0)
    step = jax.lax.stop_gradient(residual(centres))
    return CMeans(
        centres,
        jnp.where(mask[None, :], share / jnp.where(total > 0, total, 1.0)[None, :], 0.0),
        (weights[None, :] * share_m * squares).sum(),
        jnp.sqrt((step * step).sum(-1).max()),
    )


def check_samples(
    samples: Array, weights: Array, centres: Array, mask: Array | None, active: Array | None
) -> tuple[Array, Array, Array, Array]:
    """Return samples and weights, zero where they do not exist, and both masks.

    Raises:
        ValueError: shapes do not fit, or a weight is negative.
        TypeError: not real numbers.

    Example:
        >>> samples, ones = jnp.array([[4.0], [jnp.nan]]), jnp.ones(2)
        >>> print(check_samples(samples, ones, samples, jnp.array([True, False]), None)[0].ravel())
        [4. 0.]
    """
    check_array("samples", samples, shape=("N", "D"))
    check_array("weights", weights, shape=(samples.shape[0],))
    check_array("centres", centres, shape=("K", samples.shape[1]))
    mask = jnp.ones(samples.shape[0], bool) if mask is None else jnp.asarray(mask)
    active = jnp.ones(centres.shape[0], bool) if active is None else jnp.asarray(active)
    check_array("mask", mask, shape=(samples.shape[0],))
    check_array("active", active, shape=(centres.shape[0],))
    samples = jnp.where(mask[:, None], as_float(samples), 0.0)
    weights = jnp.where(mask, jnp.asarray(weights, samples.dtype), 0.0)
    check_known("weights", weights, lambda w: w >= 0, "numbers of at least 0")
    return samples, weights, mask, active


def _fuzzifier(value: Array | float, dtype: jnp.dtype) -> Array:
    """Return m as an array; a known one has to be above 1."""
    check_known("fuzzifier", value, lambda m: (m > 1) & np.isfinite(m), "a finite number above 1")
    return jnp.asarray(value, dtype)


def _shares(
    samples: Array, centres: Array, active: Array, fuzzifier: Array
) -> tuple[Array, Array, Array]:
    """Return d² and, up to a factor a sample for the first, μ and exactly μ^m; each [K, N].

    With r_ij = min_k d²_kj / d²_ij and q = r^(1/(m−1)), μ = q / Σq and μ^m = q r / (Σq)^m: one
    logarithm and one exponential an entry, and nothing overflows.
    """
    squares = jnp.zeros((centres.shape[0], samples.shape[0]), samples.dtype)
    for feature in range(samples.shape[1]):
        squares += (samples[:, feature][None, :] - centres[:, feature][:, None]) ** 2
    # A common factor of a sample's distances cancels, so this minimum needs no gradient.
    fixed = jnp.where(active[:, None], jax.lax.stop_gradient(squares), jnp.inf)
    nearest = fixed.min(0)[None, :]
    # Within rounding of a sample a centre stands on it: there the distance has no digits left.
    rounding = 4 * jnp.finfo(samples.dtype).eps
    tiny = rounding**2 * jax.lax.stop_gradient(samples * samples).sum(-1)[None, :]
    tiny = tiny + jnp.finfo(samples.dtype).tiny
    on_it = (active[:, None] & (squares < tiny)).astype(samples.dtype)
    far = active[:, None] & (squares >= tiny) & (nearest >= tiny)
    ratio = safe_divide(jnp.where(far, nearest, 1.0), jnp.where(far, squares, 1.0))
    power = jnp.exp(jnp.log(ratio) / (fuzzifier - 1))
    ratio = jnp.where(far, ratio, on_it)
    share = jnp.where(far, power, on_it)
    total = share.sum(0)
    some = total > 0
    scale = jnp.where(some, jnp.exp(-fuzzifier * jnp.log(jnp.where(some, total, 1.0))), 0.0)
    return squares, share, share * ratio * scale[None, :]


def _means(
    samples: Array, weights: Array, centres: Array, active: Array, fuzzifier: Array
) -> tuple[Array, Array]:
    """Return the weighted means of the patterns [K, D], and which patterns have any weight."""
    _, _, share_m = _shares(samples, centres, active, fuzzifier)
    pull = weights[None, :] * share_m
    total = pull.sum(-1)
    alive = total > 0
    return pull @ samples / jnp.where(alive, total, 1.0)[:, None], alive


def _solve(linear: Callable[[Array], Array], y: Array) -> Array:
    """Solve linear(x) = y for a linear map of [K, D] by its dense matrix."""
    size = y.size
    basis = jnp.eye(size, dtype=y.dtype).reshape(size, *y.shape)
    matrix = jax.vmap(linear)(basis).reshape(size, size).T
    return (_inverse(matrix) @ y.reshape(size)).reshape(y.shape)


def _inverse(matrix: Array) -> Array:
    """Invert [n, n] by Gauss–Jordan elimination with row pivots; singular directions give zeros.

    Written out because a batch of small matrices through LAPACK blocks the CPU's worker threads.
    """
    n, dtype = matrix.shape[0], matrix.dtype
    floor = 16 * n * jnp.finfo(dtype).eps
    order = jnp.arange(n)

    def eliminate(k: Array, work: Array) -> Array:
        column = work[:, k]
        best = jnp.argmax(jnp.where(order >= k, jnp.abs(column), -1.0))
        pivot_row, this_row = work[best], work[k]
        work = jnp.where((order == best)[:, None], this_row[None, :], work)
        pivot = pivot_row[k]
        regular = jnp.abs(pivot) > floor
        row = jnp.where(regular, pivot_row / jnp.where(regular, pivot, 1.0), 0.0)
        factor = jnp.where(order == k, 0.0, work[:, k])
        work = work - factor[:, None] * row[None, :]
        return jnp.where((order == k)[:, None], row[None, :], work)

    work = jnp.concatenate([matrix, jnp.eye(n, dtype=dtype)], axis=1)
    return jax.lax.fori_loop(0, n, eliminate, work)[:, n:]
