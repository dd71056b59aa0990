"""Clusters of points that a gap parts from each other: single linkage, cut at a distance.

Two points are of one cluster if a chain of points leads from one to the other in steps of at most
the gap, or of the larger of two points' own gaps. How many clusters there are comes out, not in.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.numerics.checks import check_array, check_mask, check_positive, check_size
from jaxtrack.numerics.safe import safe_divide
from jaxtrack.types import Array


class Clusters(NamedTuple):
    """Clusters in the order of falling mass."""

    centre: Array  # [K, D] weighted means; zero in free places
    mass: Array  # [K] summed weights
    count: Array  # [K] int32: members
    mask: Array  # [K]
    label: Array  # [N] int32: a point's place among the K, −1 of none
    overflow: Array  # [] more clusters of enough members than places; the lightest are dropped


def linked(
    points: Array,
    gap: Array | float,
    *,
    weights: Array | None = None,
    mask: Array | None = None,
    members: Array | int = 1,
    clusters: int = 16,
) -> Clusters:
    """Return the clusters of points that are linked by steps of at most `gap`.

    Every point takes the least label of those it reaches in one step, then in two, four, …: labels
    jump along the labels that they have come to, and settle after a logarithm of the longest chain.

    Args:
        points: [N, D], N ≥ 1.
        gap: > 0, in the unit of the points: one, or [N] each point's own.
        weights: [N] ≥ 0, of the points in centres and masses; None: all alike.
        mask: [N] which points exist; None: all.
        members: clusters of fewer are none. Traced.
        clusters: K places, static.

    Returns:
        At most K clusters, the heaviest first. Labels carry no gradient, centres and masses do.

    Example:
        >>> found = linked(jnp.array([[0.0], [9.0], [1.0], [2.0], [5.0]]), 1.0, members=2, clusters=2)
        >>> print(found.centre.ravel(), found.count, found.label)
        [1. 0.] [3 0] [ 0 -1  0  0 -1]

    Source: single-linkage clustering; the Point Cloud Library's extraction of clusters by distance,
        which the Zernike moment paper (2023) uses, is the same.
    """  # noqa: E501
    check_array("points", points, shape=("N", "D"))
    number = points.shape[0]
    check_size("points, N", number)
    check_size("clusters", clusters)
    dtype = points.dtype
    here = jnp.ones(number, bool) if mask is None else mask
    check_mask("mask", here, shape=(number,))
    heavy = jnp.ones(number, dtype) if weights is None else weights
    check_array("weights", heavy, shape=(number,))
    check_array("gap", gap, shape=(number,) if jnp.ndim(gap) else ())
    gaps = check_positive("gap", jnp.where(here, gap, 1.0) if jnp.ndim(gap) else gap, dtype)
    gaps = jax.lax.stop_gradient(jnp.broadcast_to(gaps, (number,)))

    clean = jnp.where(here[:, None], points, 0.0)
    heavy = jnp.where(here, heavy, 0.0).astype(dtype)
    still = jax.lax.stop_gradient(clean)
    square = sum((x[:, None] - x[None, :]) ** 2 for x in still.T)
    near = (
        (square <= jnp.maximum(gaps[:, None], gaps[None, :]) ** 2) & here[:, None] & here[None, :]
    )
    root = _roots(near)

    own = here & (root == jnp.arange(number, dtype=jnp.int32))
    belongs = (root[:, None] == root[None, :]) & here[None, :]  # [N, N], by the row's cluster
    count = belongs.sum(axis=1, dtype=jnp.int32)
    mass = (belongs.astype(dtype) * heavy[None, :]).sum(axis=1)
    counts = own & (count >= members)
    places = min(clusters, number)
    still_mass = jax.lax.stop_gradient(jnp.where(counts, mass, -1.0))
    _, first = jax.lax.top_k(still_mass, places)
    first = jnp.pad(first, (0, clusters - places))
    found = counts.sum(dtype=jnp.int32)
    live = jnp.arange(clusters, dtype=jnp.int32) < found
    share = jnp.where(belongs[first], heavy[None, :], 0.0)
    even = belongs[first].astype(dtype)  # where no member has weight, all count alike
    share = jnp.where((share.sum(axis=1) > 0)[:, None], share, even)
    centre = safe_divide(share @ clean, share.sum(axis=1)[:, None])
    is_of = belongs[first] & live[:, None]
    return Clusters(
        jnp.where(live[:, None], centre, 0.0),
        jnp.where(live, mass[first], 0.0),
        jnp.where(live, count[first], 0),
        live,
        jnp.where(is_of.any(axis=0), jnp.argmax(is_of, axis=0), -1).astype(jnp.int32),
        found > clusters,
    )


def _roots(near: Array) -> Array:
    """Return the least index that each point is linked to, [N], of a symmetric relation [N, N]."""
    number = near.shape[0]
    alone = jnp.arange(number, dtype=jnp.int32)

    def spread(state: tuple[Array, Array]) -> tuple[Array, Array]:
        root, _ = state
        least = jnp.where(near, root[None, :], jnp.asarray(number, jnp.int32)).min(axis=1)
        # The root learns what its members found, and members follow their root.
        new = root.at[root].min(jnp.minimum(least, root))
        new = jnp.minimum(new[root], jnp.minimum(least, root))
        new = new[new]
        return new, (new != root).any()

    start = alone, jnp.ones((), bool)
    return jax.lax.while_loop(lambda state: state[1], spread, start)[0]
