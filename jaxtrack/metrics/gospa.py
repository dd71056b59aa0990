"""Generalized OSPA (GOSPA, α = 2): localization, missed and false targets told apart."""

from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxtrack.metrics.cutoff import cutoff_costs, safe_power
from jaxtrack.numerics.assignment import assign
from jaxtrack.types import Array


class Gospa(NamedTuple):
    """The GOSPA distance and its three parts, each a root, in the unit of the cut-off.

    distance^p = localization^p + missed^p + false^p; the number of missed targets is
    2 (missed / c)^p, that of false ones 2 (false / c)^p.
    """

    distance: Array  # []
    localization: Array  # []
    missed: Array  # []
    false: Array  # []


def gospa(
    estimates: Array,
    estimates_mask: Array,
    truths: Array,
    truths_mask: Array,
    *,
    cutoff: Any,
    order: Any,
) -> Gospa:
    """Measure how far a set of estimates is from the set of truths, not averaged over targets.

    Over all assignments γ of estimates to truths that need not assign everybody:

        distance^p = min_γ Σ_{(i, j) ∈ γ} d(xᵢ, yⱼ)^p + c^p / 2 (missed + false)

    where missed truths and false estimates are those γ leaves out. Pairs at least c apart are never
    assigned: leaving both out costs c^p / 2 + c^p / 2, no more than assigning them. The gradient is
    that of the assignment at hand, and zero where two points coincide.

    Args:
        estimates: [M, D] points, in the unit of `cutoff` (metres, as a rule).
        estimates_mask: [M] which of them exist.
        truths: [N, D] points, in the unit of `cutoff`.
        truths_mask: [N] which of them exist.
        cutoff: c > 0: from where on an estimate has nothing to do with a target.
        order: p ≥ 1, not necessarily whole: how much large errors outweigh small ones.

    Returns:
        Roots, not powered costs. Over trials average the parts' p-th powers, which add up.

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers.

    Example:
        >>> truths, there = jnp.asarray([[0.0, 0.0]]), jnp.ones(1, bool)
        >>> estimates = jnp.asarray([[3.0, 4.0], [90.0, 0.0]])
        >>> score = gospa(estimates, jnp.ones(2, bool), truths, there, cutoff=20.0, order=1.0)
        >>> [round(float(part), 3) for part in score]  # one at 5 m, one false
        [15.0, 5.0, 0.0, 10.0]

    Source:
        Rahmathullah, García-Fernández and Svensson, "Generalized Optimal Sub-Pattern Assignment
        Metric" (2017), proposition 1 (α = 2).
    """
    costs = cutoff_costs(estimates, estimates_mask, truths, truths_mask, cutoff=cutoff, order=order)
    dtype = costs.cost.dtype
    # Any full assignment on the cut-off costs is optimal: c^p for a far pair is that of a missed
    # and a false target.
    assignment = assign(costs.cost, costs.estimates_mask, costs.truths_mask)
    columns = jnp.arange(costs.cost.shape[1], dtype=assignment.columns.dtype)
    chosen = assignment.columns[:, None] == columns[None, :]  # no row is, if unmatched (−1)
    pairs = chosen & (costs.cost < 1.0)

    matched = jnp.sum(pairs, dtype=dtype)
    localization = jnp.sum(jnp.where(pairs, costs.cost, 0.0))
    missed = (jnp.sum(costs.truths_mask, dtype=dtype) - matched) / 2.0
    false = (jnp.sum(costs.estimates_mask, dtype=dtype) - matched) / 2.0
    parts = (localization + missed + false, localization, missed, false)
    return Gospa(*(costs.cutoff * safe_power(part, 1.0 / costs.order) for part in parts))
