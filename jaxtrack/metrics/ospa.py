"""Optimal sub-pattern assignment (OSPA): one distance for wrong places and wrong numbers."""

from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxtrack.metrics.cutoff import CutoffCosts, cutoff_costs, safe_power
from jaxtrack.numerics.assignment import assign
from jaxtrack.types import Array


class Ospa(NamedTuple):
    """The OSPA distance and its two parts: distance^p = localization^p + cardinality^p."""

    distance: Array  # []  in the unit of the cut-off, at most the cut-off
    localization: Array  # []
    cardinality: Array  # []


def ospa(
    estimates: Array,
    estimates_mask: Array,
    truths: Array,
    truths_mask: Array,
    *,
    cutoff: Any,
    order: Any,
) -> Ospa:
    """Measure how far a set of estimates is from the set of truths, per target.

    With m estimates, n truths, m ≤ n (else the sets change places) and d⁽ᶜ⁾ = min(c, d):

        distance     = ((min_π Σᵢ d⁽ᶜ⁾(xᵢ, y_π(i))^p + c^p (n − m)) / n)^(1/p)
        localization = ( min_π Σᵢ d⁽ᶜ⁾(xᵢ, y_π(i))^p / n)^(1/p)
        cardinality  = ( c^p (n − m) / n)^(1/p)

    Two empty sets are at distance 0; an empty and a non-empty one at distance c. The assignment is
    exact; the gradient is that of the assignment at hand, and zero where two points coincide.

    Args:
        estimates: [M, D] points, in the unit of `cutoff` (metres, as a rule).
        estimates_mask: [M] which of them exist.
        truths: [N, D] points, in the unit of `cutoff`.
        truths_mask: [N] which of them exist.
        cutoff: c > 0: what a target too many or too few costs.
        order: p ≥ 1, not necessarily whole: how much large errors outweigh small ones.

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers.

    Example:
        >>> truths, there = jnp.asarray([[0.0, 0.0]]), jnp.ones(1, bool)
        >>> estimates = jnp.asarray([[3.0, 4.0], [90.0, 0.0]])
        >>> score = ospa(estimates, jnp.ones(2, bool), truths, there, cutoff=20.0, order=1.0)
        >>> [round(float(part), 3) for part in score]  # (5 + 20) / 2
        [12.5, 2.5, 10.0]

    Source:
        Yan et al., "Clustering Statistic Hough Transform Based Estimation Method for Motion
        Elements of Multiple Underwater Targets" (2018), eqs 42–46; after Schuhmacher, Vo and Vo,
        "A Consistent Metric for Performance Evaluation of Multi-Object Filters" (2008).

    Note:
        The assignment minimizes the sum of the *powered* cut-off distances, as eq 42 demands. Some
        implementations assign on the plain ones, which is another number for p > 1.
    """
    return ospa_of_costs(
        cutoff_costs(estimates, estimates_mask, truths, truths_mask, cutoff=cutoff, order=order)
    )


def ospa_of_costs(costs: CutoffCosts) -> Ospa:
    """Return the OSPA distance of two sets whose members' distances are given.

    Args:
        costs: of every pair, as `cutoff_costs` makes them.
    """
    dtype = costs.cost.dtype
    estimated = jnp.sum(costs.estimates_mask, dtype=dtype)
    present = jnp.sum(costs.truths_mask, dtype=dtype)
    larger = jnp.where(estimated > present, estimated, present)
    per_target = jnp.where(larger > 0, larger, 1.0)

    localization = assign(costs.cost, costs.estimates_mask, costs.truths_mask).cost / per_target
    cardinality = jnp.abs(estimated - present) / per_target
    parts = (localization + cardinality, localization, cardinality)
    return Ospa(*(costs.cutoff * safe_power(part, 1.0 / costs.order) for part in parts))
