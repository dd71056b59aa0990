"""The linear assignment problem with masked rows and columns, by shortest augmenting paths.

Every row may also stay alone, at a price. With potentials u_i and v_j such that C_ij ≥ u_i + v_j,
equal for the pairs that are made, and u_i no more than the price, no pairs cost less. To begin with
u_i is the row's own minimum and v is zero: rows that want different columns are done at once. What
loops is the rest, one path (Dijkstra's, over the differences) a row: few, where few rows compete,
as tracks do for the detections in their gates.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

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
        R. Jonker and A. Volgenant, "A shortest augmenting path algorithm for dense and sparse
        linear assignment problems", 1987.
    """
    check_array("cost", cost, shape=("M", "N"))
    rows, columns = cost.shape
    check_array("row_mask", row_mask, shape=(rows,))
    check_array("column_mask", column_mask, shape=(columns,))

    cost = as_float(cost)
    valid = row_mask.astype(bool)[:, None] & column_mask.astype(bool)[None, :]
    allowed = valid & jnp.isfinite(cost)
    if rows == 0 or columns == 0:
        return Assignment(jnp.full(rows, -1, jnp.int32), jnp.zeros(rows, bool), cost.sum())
    known, price = _priced(jax.lax.stop_gradient(cost), valid, allowed)
    # Paths are fewer and shorter where the rows are the fewer.
    found = (
        _cheapest(known, price) if rows <= columns else _inverse(_cheapest(known.T, price), rows)
    )
    matched = found >= 0
    taken = matched[:, None] & (found[:, None] == jnp.arange(columns, dtype=jnp.int32)[None, :])
    return Assignment(found, matched, masked_sum(cost, taken).sum())


def pair_up(gain: Array) -> Array:
    """Return the column of each row, [M], such that the total gain is the largest; −1: alone.

    Pairs are made only where they gain, so not as many as possible.

    Args:
        gain: [M, N]; what is not positive, or no number, is no pair.

    Raises:
        TypeError: not an array of real numbers.
        ValueError: not a matrix.

    Example:
        >>> print(pair_up(jnp.array([[3.0, 2.0], [2.5, -1.0], [1.0, 0.0]])))
        [ 1  0 -1]
    """
    check_array("gain", gain, shape=("M", "N"))
    rows, columns = gain.shape
    if rows == 0 or columns == 0:
        return jnp.full(rows, -1, jnp.int32)
    gain = jax.lax.stop_gradient(as_float(gain))
    return _cheapest(jnp.where(gain > 0, -gain, jnp.inf), jnp.zeros((), gain.dtype))


def _priced(cost: Array, valid: Array, allowed: Array) -> tuple[Array, Array]:
    """Return costs, infinite where no pair may be, and the price at which a row stays alone.

    A larger matching must always be the cheaper one. Let all allowed costs lie in [a, b], and a row
    stay alone at price p.

    *Valid pairs all finite: p > b suffices.* If k < min(m, n) pairs are made, some valid row and
    some valid column are free, and to pair them changes the total by at most b − p < 0.

    *Some forbidden: p > b + (K − 1)(b − a) suffices*, K = min(M, N). Of two matchings, of k and of
    k − j pairs, 1 ≤ j ≤ k ≤ K, the first costs at most k b, the second at least (k − j) a + j p:
    more, if j p > k b − (k − j) a = j b + (k − j)(b − a).

    So p exceeds b by the size of the costs, or by 2 K times it, and never by a huge constant that
    would swallow the digits of the costs. The costs are first divided by a power of two, which
    rounds nothing (bar underflow), so that neither p nor sums of costs overflow.
    """
    known = jnp.where(allowed, cost, 0.0)
    _, exponent = jnp.frexp(jnp.max(jnp.abs(known)))
    known = jnp.ldexp(known, -exponent)  # in (−1, 1)
    forbidden = jnp.any(valid & ~allowed)
    highest = jnp.max(jnp.where(allowed, known, -1.0))
    price = highest + jnp.where(forbidden, 2.0 * min(cost.shape), 1.0)
    return jnp.where(allowed, known, jnp.inf), price


class _Matching(NamedTuple):
    """Pairs so far, and the potentials that prove them the cheapest."""

    column: Array  # [M] of each row; −1: alone
    row: Array  # [N] of each column; −1: free
    u: Array  # [M]
    v: Array  # [N]
    waiting: Array  # [M] rows whose turn is still to come


class _Path(NamedTuple):
    """The shortest paths from a waiting row, as far as they are known."""

    distance: Array  # [N]
    before: Array  # [N] row from which a column is reached
    reached: Array  # [N] the distance is final
    at: Array  # [] row that is looked at
    so_far: Array  # [] distance to it
    alone: Array  # [] least distance to a row that would then stay alone
    leaver: Array  # [] which row
    end: Array  # [] nearest column that is not reached
    total: Array  # [] distance to it
    open: Array  # [] the search goes on


def _cheapest(cost: Array, price: Array) -> Array:
    """Return the column of each row at the least total cost and price of those alone."""
    rows, columns = cost.shape
    every_row, every_column = (jnp.arange(n, dtype=jnp.int32) for n in (rows, columns))
    least, first = _first_least(cost, every_column)
    wants = least < price
    own = wants[:, None] & (every_column[None, :] == first[:, None])
    row = jnp.where(own, every_row[:, None], rows).min(0)
    served = (own & (row[None, :] == every_row[:, None])).any(1)
    begin = _Matching(
        jnp.where(served, first, -1),
        jnp.where(row < rows, row, -1),
        jnp.where(wants, least, price),
        jnp.zeros(columns, cost.dtype),
        wants & ~served,
    )

    def augment(now: _Matching) -> _Matching:
        start = jnp.where(now.waiting, every_row, rows).min()

        def look(path: _Path) -> _Path:
            through = path.so_far + cost[path.at] - now.u[path.at] - now.v
            better = ~path.reached & (through < path.distance)
            distance = jnp.where(better, through, path.distance)
            before = jnp.where(better, path.at, path.before)
            leave = path.so_far + price - now.u[path.at]
            sooner = leave < path.alone
            alone = jnp.where(sooner, leave, path.alone)
            leaver = jnp.where(sooner, path.at, path.leaver)
            total, end = _first_least(jnp.where(path.reached, jnp.inf, distance), every_column)
            holder = now.row[end]
            goes_on = (total < alone) & (holder >= 0)
            return _Path(
                distance,
                before,
                path.reached | (goes_on & (every_column == end)),
                jnp.where(goes_on, holder, path.at),
                jnp.where(goes_on, total, path.so_far),
                alone,
                leaver,
                end,
                total,
                goes_on,
            )

        zero = jnp.zeros((), cost.dtype)
        nothing = jnp.full(columns, jnp.inf, cost.dtype)
        path = _Path(
            nothing, jnp.zeros_like(every_column), jnp.zeros(columns, bool), start, zero,
            zero + jnp.inf, start, start, zero, jnp.asarray(True),
        )  # fmt: skip
        path = jax.lax.while_loop(lambda path: path.open, look, path)
        leaves = path.alone <= path.total
        total = jnp.where(leaves, path.alone, path.total)
        closer = jnp.where(path.reached, total - path.distance, 0.0)
        mine = jnp.where(now.column >= 0, closer[now.column], 0.0)
        u = now.u + mine + jnp.where(every_row == start, total, 0.0)

        def flip(pairs: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            column, row, end = pairs
            new = path.before[end]
            turn = every_row == new
            after = jnp.where(turn, column, -1).max()
            column = jnp.where(turn, end, column)
            return column, jnp.where(every_column == end, new, row), after

        given_up = jnp.where(every_row == path.leaver, now.column, -1).max()
        column = jnp.where(leaves & (every_row == path.leaver), -1, now.column)
        end = jnp.where(leaves, given_up, path.end)
        column, row, _ = jax.lax.while_loop(
            lambda pairs: pairs[2] >= 0, flip, (column, now.row, end)
        )
        return _Matching(column, row, u, now.v - closer, now.waiting & (every_row != start))

    return jax.lax.while_loop(lambda now: now.waiting.any(), augment, begin).column


def _first_least(x: Array, order: Array) -> tuple[Array, Array]:
    """Return the least along the last axis and its first index; two plain reductions are fast."""
    least = x.min(-1)
    at = jnp.where(x == least[..., None], order, x.shape[-1] - 1)
    return least, at.min(-1)


def _inverse(rows: Array, size: int) -> Array:
    """Return the column of each of `size` rows from the row of each column, −1: alone."""
    every_row = jnp.arange(size, dtype=jnp.int32)
    every_column = jnp.arange(rows.shape[0], dtype=jnp.int32)
    own = rows[None, :] == every_row[:, None]
    return jnp.where(own, every_column[None, :], -1).max(1)
