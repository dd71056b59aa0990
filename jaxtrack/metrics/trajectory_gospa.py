"""Trajectory GOSPA: localization, missed and false targets, and switches, over a whole run.

The distance is a least cost over assignments that may change from look to look. It is found
exactly, by a dynamic programme over the looks: the cost of every assignment of the fewer
trajectories to the more stands in a tensor with one axis for each of the fewer, and what a change
costs is a sum over these axes, so that a look costs n (m + 1)^n and not its square.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.metrics.cutoff import check_tracks, distances_over_time, safe_power
from jaxtrack.numerics.checks import check_array, check_positive
from jaxtrack.types import Array

MAX_ASSIGNMENTS = 2**18


class TrajectoryGospa(NamedTuple):
    """The distance and its four parts, each a root, in the unit of the cut-off.

    distance^p = localization^p + missed^p + false^p + switch^p; the number of missed targets,
    summed over looks, is 2 (missed / c)^p, that of false ones 2 (false / c)^p, and that of
    switches (switch / γ)^p, where beginning and ending an assignment are half a switch each.
    """

    distance: Array  # []
    localization: Array  # []
    missed: Array  # []
    false: Array  # []
    switch: Array  # []


def trajectory_gospa(
    estimates: Array,
    estimates_mask: Array,
    truths: Array,
    truths_mask: Array,
    *,
    cutoff: Any,
    order: Any,
    switch_cost: Any,
) -> TrajectoryGospa:
    """Measure how far a set of trajectories is from the set of true ones.

    Over all sequences of assignments π_t, each from estimates to truths, one to one, and free to
    leave out anybody:

        distance^p = min_π Σ_t [ Σ_{(i, j) ∈ θ_t} d(x_ti, y_tj)^p + c^p / 2 (missed_t + false_t) ]
                           + γ^p Σ_t switches(π_t, π_{t+1})

    where θ_t are the assigned pairs that both exist and are less than c apart, and switches counts
    1 for each estimate that goes from one truth to another, ½ where it goes from or to none. An
    estimate may stay assigned while it does not exist. The sum over looks is not divided by their
    number. The gradient is that of the assignments at hand, and zero where two points coincide.

    Args:
        estimates: [T, I, D] states by identity, as `trajectories` lays them out, in the unit of c.
        estimates_mask: [T, I].
        truths: [T, K, D].
        truths_mask: [T, K].
        cutoff: c > 0: from where on an estimate has nothing to do with a target.
        order: p ≥ 1, not necessarily whole.
        switch_cost: γ > 0, in the unit of c.

    Returns:
        Roots, not powered costs. Over trials average the parts' p-th powers, which add up.

    Raises:
        ValueError: shapes do not fit, a known number is out of range, or there are more than
            `MAX_ASSIGNMENTS` assignments (m + 1)^n, n and m the smaller and the larger number of
            columns: up to 6 against 6, 4 against 21 or 3 against 63.
        TypeError: not real numbers.

    Example:
        Two tracks that exchange targets half-way: two switches.

        >>> truths = jnp.zeros((4, 2, 1)) + jnp.array([0.0, 6.0])[:, None]
        >>> swapped = jnp.concatenate([truths[:2], truths[2:, ::-1]])
        >>> there = jnp.ones((4, 2), bool)
        >>> score = trajectory_gospa(
        ...     swapped, there, truths, there, cutoff=10.0, order=1.0, switch_cost=2.0
        ... )
        >>> print(score.distance, score.switch)
        4.0 4.0

    Source:
        García-Fernández, Rahmathullah and Svensson, "A Metric on the Space of Finite Sets of
        Trajectories for Evaluation of Multi-Target Tracking Algorithms" (2020): the
        multi-dimensional assignment itself, not its relaxation to a linear programme.

    Note:
        With n = min(I, K), m = max(I, K) and A = (m + 1)^n it takes about 5 T n A additions and
        comparisons and, until the assignments are read off, (T + 3) A numbers: 4 (T + 3) A bytes in
        float32, 8 (T + 3) A in float64, at most 1 or 2 MiB a look, and that for every run of a
        batch. Tracing makes a table of 8 n A bytes once. The gradient goes through the assigned
        pairs alone and keeps nothing else.
    """
    _, left, right = check_tracks(estimates, estimates_mask, truths, truths_mask)
    check_array("switch_cost", switch_cost, shape=())
    check_positive("switch_cost", switch_cost, float)
    _check_number(left, right)
    costs = distances_over_time(
        estimates, estimates_mask, truths, truths_mask, cutoff=cutoff, order=order
    )
    dtype = costs.cost.dtype
    change = safe_power(jnp.asarray(switch_cost, dtype) / costs.cutoff, costs.order)
    both = costs.estimates_mask[:, :, None] & costs.truths_mask[:, None, :]
    pairs = jnp.where(both, safe_power(costs.cost, costs.order), 1.0)
    # A pair that exists saves at most its missed and its false half; others save nothing.
    saved = jax.lax.stop_gradient(pairs - 1.0)
    turned = saved.shape[1] > saved.shape[2]
    if turned:
        saved = jnp.swapaxes(saved, 1, 2)
    chosen = assignments(saved, jax.lax.stop_gradient(change))  # [T, n], 0: none
    columns = jnp.arange(1, saved.shape[2] + 1, dtype=chosen.dtype)
    assigned = chosen[:, :, None] == columns[None, None, :]
    assigned = jnp.swapaxes(assigned, 1, 2) if turned else assigned
    matched = assigned & (pairs < 1.0)

    count = matched.sum(dtype=dtype)
    localization = jnp.where(matched, pairs, 0.0).sum()
    missed = (costs.truths_mask.sum(dtype=dtype) - count) / 2
    false = (costs.estimates_mask.sum(dtype=dtype) - count) / 2
    switch = change * _halves(chosen[:-1], chosen[1:]).sum(dtype=dtype) / 2
    parts = (localization + missed + false + switch, localization, missed, false, switch)
    return TrajectoryGospa(*(costs.cutoff * safe_power(part, 1.0 / costs.order) for part in parts))


def assignments(cost: Array, change: Array) -> Array:
    """Return the assignments, one a look, whose costs and changes add up to the least.

    Args:
        cost: [T, n, m] of assigning row i to column j; of leaving a row out: 0.
        change: [] of a row that goes from one column to another; half of it from or to none.

    Returns:
        [T, n] int32: j + 1, or 0 where a row is left out.

    Example:
        >>> cost = jnp.array([[[-3.0, 0.0]], [[-1.0, -2.0]], [[-3.0, 0.0]]])
        >>> print(assignments(cost, jnp.array(4.0))[:, 0], assignments(cost, jnp.array(0.1))[:, 0])
        [1 1 1] [1 2 1]
    """
    _, rows, columns = cost.shape
    size = (columns + 1,) * rows
    place = np.indices(size)  # [n, (m + 1)^n]
    clash = np.zeros(size, bool)
    for row in range(rows):
        for other in range(row):
            clash |= (place[row] == place[other]) & (place[row] > 0)
    forbidden = jnp.where(jnp.asarray(clash), jnp.inf, 0.0).astype(cost.dtype)
    along = lambda values, row: values.reshape([-1 if k == row else 1 for k in range(rows)])
    half = change / 2
    names = jnp.arange(columns + 1, dtype=jnp.int32)

    def here(at: Array) -> Array:
        full = jnp.pad(at, ((0, 0), (1, 0)))  # column 0: left out
        total = forbidden
        for row in range(rows):
            total = total + along(full[row], row)
        return total

    def forward(best: Array, at: Array) -> tuple[Array, Array]:
        # The cheapest way to each assignment, a row after the other: by way of none, or staying.
        moved = best
        for row in range(rows):
            none = jax.lax.slice_in_dim(moved, 0, 1, axis=row)
            leave = moved.min(row, keepdims=True) + half
            through = jnp.minimum(none, leave)
            arrive = through + half
            first = along(names == 0, row)
            moved = jnp.where(first, through, jnp.minimum(moved, arrive))
        return moved + here(at), best

    def backward(after: Array, best: Array) -> tuple[Array, Array]:
        for row in range(rows):
            best = best + along(half * _halves(names, after[row]).astype(best.dtype), row)
        before = jnp.stack(jnp.unravel_index(jnp.argmin(best), size)).astype(jnp.int32)
        return before, before

    last, best = jax.lax.scan(forward, here(cost[0]), cost[1:])
    end = jnp.stack(jnp.unravel_index(jnp.argmin(last), size)).astype(jnp.int32)
    _, before = jax.lax.scan(backward, end, best, reverse=True)
    return jnp.concatenate([before, end[None]])


def _halves(before: Array, after: Array) -> Array:
    """Return half switches: 0 for the same, 1 from or to none (0), 2 from one to another."""
    none = (before == 0) | (after == 0)
    return jnp.where(before == after, 0, jnp.where(none, 1, 2))


def _check_number(left: int, right: int) -> None:
    """Refuse tables of assignments that would not fit into memory."""
    count = (max(left, right, 1) + 1) ** max(min(left, right), 1)
    if count > MAX_ASSIGNMENTS:
        raise ValueError(
            f"estimates, truths: got {left} and {right} columns, which are {count} assignments a "
            f"look, want at most {MAX_ASSIGNMENTS}"
        )
