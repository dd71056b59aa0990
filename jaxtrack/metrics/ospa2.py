"""OSPA(2): OSPA between sets of tracks, the distance of two tracks being a mean over time."""

from typing import Any

import jax
import jax.numpy as jnp

from jaxtrack.metrics.cutoff import CutoffCosts, check_tracks, distances_over_time, safe_power
from jaxtrack.metrics.ospa import Ospa, ospa_of_costs
from jaxtrack.numerics.checks import check_size
from jaxtrack.types import Array


def ospa2(
    estimates: Array,
    estimates_mask: Array,
    truths: Array,
    truths_mask: Array,
    *,
    cutoff: Any,
    order: Any,
) -> Ospa:
    """Measure how far a set of tracks is from the set of true ones, over a window of looks.

    Two tracks are as far apart as they are on average over the looks where one of them exists,

        d̃(f, g) = Σ_{t ∈ D_f ∪ D_g} d_t / |D_f ∪ D_g|,   d_t = min(c, ‖f_t − g_t‖), c if only one exists,

    and the tracks that exist in the window are two sets, whose distance is OSPA of order p with d̃
    between their members. A track that changes its target, or ends and goes on under another name,
    costs what a set distance look by look does not see.

    Args:
        estimates: [T, I, D] states by identity, as `trajectories` lays them out, in the unit of c.
        estimates_mask: [T, I].
        truths: [T, K, D].
        truths_mask: [T, K].
        cutoff: c > 0.
        order: p ≥ 1, not necessarily whole.

    Returns:
        Distance, localization (of the paired tracks) and cardinality (tracks too many or too few).

    Raises:
        ValueError: shapes do not fit, there is no look, or a known number is out of range.
        TypeError: not real numbers.

    Example:
        Two tracks that exchange targets half-way are right in every look, but not as tracks:

        >>> truths = jnp.zeros((4, 2, 1)) + jnp.array([0.0, 6.0])[:, None]
        >>> swapped = jnp.concatenate([truths[:2], truths[2:, ::-1]])
        >>> there = jnp.ones((4, 2), bool)
        >>> print(ospa2(swapped, there, truths, there, cutoff=10.0, order=1.0).distance)
        3.0

    Source:
        Beard, Vo and Vo, "OSPA(2): Using the OSPA metric to evaluate multi-target tracking
        performance" (2017); "A Solution for Large-Scale Multi-Object Tracking" (2020), there with
        weights of the looks, which are equal here.
    """  # noqa: E501
    each = distances_over_time(
        estimates, estimates_mask, truths, truths_mask, cutoff=cutoff, order=order
    )
    found, true = each.estimates_mask[:, :, None], each.truths_mask[:, None, :]
    apart = jnp.where(found & true, each.cost, (found | true).astype(each.cost.dtype)).sum(0)
    common = (found | true).sum(0).astype(each.cost.dtype)
    mean = apart / jnp.where(common > 0, common, 1.0)
    cost = safe_power(mean, each.order)
    exist = each.estimates_mask.any(0), each.truths_mask.any(0)
    return ospa_of_costs(CutoffCosts(cost, *exist, each.cutoff, each.order))


def ospa2_over_time(
    estimates: Array,
    estimates_mask: Array,
    truths: Array,
    truths_mask: Array,
    *,
    cutoff: Any,
    order: Any,
    window: int,
) -> Ospa:
    """Return OSPA(2) at every look, over the window of looks that ends there.

    Args:
        estimates: [T, I, D] states by identity.
        estimates_mask: [T, I].
        truths: [T, K, D].
        truths_mask: [T, K].
        cutoff: c > 0.
        order: p ≥ 1.
        window: how many looks, static; the first values have fewer.

    Raises:
        ValueError: shapes do not fit, there is no look, or a known number is out of range.
        TypeError: not real numbers.

    Example:
        >>> truths, there = jnp.zeros((4, 1, 1)), jnp.ones((4, 1), bool)
        >>> found = jnp.arange(4)[:, None] > 1  # from the third look on
        >>> curve = ospa2_over_time(truths, found, truths, there, cutoff=6.0, order=1.0, window=3)
        >>> print(curve.distance)
        [6. 6. 4. 2.]

    Source: Beard, Vo and Vo (2017).
    """
    check_size("window", window)
    looks, _, _ = check_tracks(estimates, estimates_mask, truths, truths_mask)
    before = lambda x: jnp.pad(jnp.asarray(x), ((window - 1, 0),) + ((0, 0),) * (jnp.ndim(x) - 1))
    padded = [before(x) for x in (estimates, estimates_mask, truths, truths_mask)]

    def at(look: Array) -> Ospa:
        here = [jax.lax.dynamic_slice_in_dim(x, look, window) for x in padded]
        return ospa2(*here, cutoff=cutoff, order=order)

    return jax.vmap(at)(jnp.arange(looks))
