"""The linear assignment problem with masked rows and columns."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax

from jaxtrack.numerics.checks import check_array
from jaxtrack.numerics.masked import masked_sum
from jaxtrack.numerics.safe import as_float
from jaxtrack.types import Array


class Assignment(NamedTuple):
    """Which column each row got, and what it costs."""

    columns: Array  # [M] int32; −1: unmatched
    matched: Array  # [M] bool
    cost: Array  # []  sum over the matched pairs


def assign(cost: Array, row_mask: Array, column_mask: Array) -> Assignment:
    """Match as many allowed pairs as possible, at the least total cost.

        minimize Σ_ij C_ij X_ij,  X_ij ∈ {0, 1},  Σ_i X_ij ≤ 1,  Σ_j X_ij ≤ 1,
        over the X with the largest possible Σ_ij X_ij.

    A pair is allowed if its row and its column are valid and its cost is finite; an infinite cost
    therefore forbids a pair of valid ones. With finite costs min(m, n) pairs are matched, m and n
    being the numbers of valid rows and columns. The total is differentiable in `cost`, with the
    assignment held fixed: the gradient is 1 at the matched pairs and 0 elsewhere.

    Args:
        cost: [M, N] in any unit, negative ones included.
        row_mask: [M] booleans.
        column_mask: [N] booleans.

    Raises:
        TypeError: an argument is not an array of real numbers.
        ValueError: the shapes do not fit.

    Example:
        >>> both = jnp.array([True, True])
        >>> found = assign(jnp.array([[1.0, 2.0], [1.0, 5.0]]), both, both)
        >>> found.columns.tolist(), float(found.cost)
        ([1, 0], 3.0)

    Source:
        J. Munkres, "Algorithms for the assignment and transportation problems", 1957.
    """
    check_array("cost", cost, shape=("M", "N"))
    rows, columns = cost.shape
    check_array("row_mask", row_mask, shape=(rows,))
    check_array("column_mask", column_mask, shape=(columns,))

    cost = as_float(cost)
    valid = row_mask.astype(bool)[:, None] & column_mask.astype(bool)[None, :]
    allowed = valid & jnp.isfinite(cost)
    padded = _pad(jax.lax.stop_gradient(cost), valid, allowed)
    # Both promotions happen inside optax and are harmless there.
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        row, column = optax.assignment.hungarian_algorithm(padded)
    column = column.astype(jnp.int32)

    pair_allowed = allowed[row, column]
    assigned = jnp.where(pair_allowed, column, -1)
    found = jnp.full(rows, -1, dtype=jnp.int32).at[row].set(assigned)
    return Assignment(
        columns=found,
        matched=found >= 0,
        cost=masked_sum(cost[row, column], pair_allowed),
    )


def _pad(cost: Array, valid: Array, allowed: Array) -> Array:
    """Fill the pairs that are not allowed with a cost that cannot disturb the optimum.

    The algorithm matches all K = min(M, N) rows (or columns) of the filled matrix. Let all allowed
    costs lie in [a, b] and all others be p. A full matching with k allowed pairs of total cost c
    costs c + (K − k) p, so among those with the same k the cheapest is the one we want, and p only
    has to make a larger k win.

    *Valid pairs all finite: p > b suffices.* If k < min(m, n), some valid row r and some valid
    column s have no allowed partner. They cannot both be free, for the matching is full. If one is
    free, the other sits in a pair of cost p: replace that pair by (r, s). If neither is, they sit
    in pairs (r, s′) and (r′, s) of cost p each: replace them by (r, s) and (r′, s′), the latter of
    cost at most p. Either way the total changes by at most C_rs − p ≤ b − p < 0, so no matching
    with k < min(m, n) is the cheapest.

    *Some forbidden: p > b + (K − 1)(b − a) suffices.* A full matching with k allowed pairs costs
    at most k b + (K − k) p, one with k − j of them at least (k − j) a + (K − k + j) p. The
    second is larger if j p > k b − (k − j) a = j b + (k − j)(b − a), and 1 ≤ j ≤ k ≤ K.

    So p exceeds b by the size of the costs, or by 2 K times it, and never by a huge constant that
    would swallow the digits of the costs. The costs are first divided by a power of two, which
    rounds nothing (bar underflow), so that neither p nor sums of costs overflow.
    """
    known = jnp.where(allowed, cost, 0.0)
    _, exponent = jnp.frexp(jnp.max(jnp.abs(known)))
    known = jnp.ldexp(known, -exponent)  # in (−1, 1)
    forbidden = jnp.any(valid & ~allowed)
    highest = jnp.max(jnp.where(allowed, known, -1.0))
    return jnp.where(allowed, known, highest + jnp.where(forbidden, 2.0 * min(cost.shape), 1.0))
