"""Nearest neighbours: each track takes at most one detection, with weight one.

`independent` lets tracks share a detection, as NNDA of the cloud-model paper does; `greedy` gives
the closest pair to each other, then the closest of the rest; `optimal` minimizes the total.
Distances are squared Mahalanobis distances d², and only pairs inside the gate count.
"""

import jax
import jax.numpy as jnp

from jaxtrack.association.gating import Association, AssociationParams, Gated, Predicted, gate
from jaxtrack.numerics.assignment import assign
from jaxtrack.numerics.masked import masked_argmin
from jaxtrack.types import Array, Key, Scan


def independent(
    predicted: Predicted, scan: Scan, params: AssociationParams, key: Key | None = None
) -> Association:
    """Give each track its nearest gated detection, whoever else takes it (NNDA).

    Args:
        predicted: T tracks.
        scan: one look of M detections.
        params: its gate.
        key: not used.

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers.

    Example:
        >>> predicted = Predicted(jnp.array([[0.0, 0.0], [3.0, 0.0]]), jnp.stack([jnp.eye(2)] * 2),
        ...                       jnp.eye(2), jnp.ones(2, bool))
        >>> places = jnp.array([[1.0, 0.0], [-2.0, 0.0]])
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), places, jnp.ones(2, bool))
        >>> print(independent(predicted, scan, AssociationParams(0.9, 1e-3)).weight)
        [[1. 0.]
         [1. 0.]]

    Source: clustering cloud-like model (2019), the baseline NNDA of section 4.
    """
    gated = gate(predicted, scan, params.gate)
    if scan.mask.shape[0] == 0:
        return _of(jnp.full(gated.inside.shape[0], -1, jnp.int32), gated)
    nearest = masked_argmin(gated.squared_distance, gated.inside).astype(jnp.int32)
    return _of(jnp.where(gated.inside.any(-1), nearest, -1), gated)


def greedy(
    predicted: Predicted, scan: Scan, params: AssociationParams, key: Key | None = None
) -> Association:
    """Give the closest pair to each other, then the closest of those that are left.

    Args:
        predicted: T tracks.
        scan: one look of M detections.
        params: its gate.
        key: not used.

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers.

    Example:
        >>> predicted = Predicted(jnp.array([[0.0, 0.0], [3.0, 0.0]]), jnp.stack([jnp.eye(2)] * 2),
        ...                       jnp.eye(2), jnp.ones(2, bool))
        >>> places = jnp.array([[1.0, 0.0], [-2.0, 0.0]])
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), places, jnp.ones(2, bool))
        >>> print(greedy(predicted, scan, AssociationParams(0.9, 1e-3)).weight)
        [[1. 0.]
         [0. 0.]]
    """
    gated = gate(predicted, scan, params.gate)
    return _of(greedy_pairs(gated.squared_distance, gated.inside), gated)


def optimal(
    predicted: Predicted, scan: Scan, params: AssociationParams, key: Key | None = None
) -> Association:
    """Give at most one detection to each track such that the total is least (GNN).

        minimize Σ d² over the pairs + γ for every track without one

    Args:
        predicted: T tracks.
        scan: one look of M detections.
        params: its gate.
        key: not used.

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers.

    Example:
        >>> predicted = Predicted(jnp.array([[0.0, 0.0], [3.0, 0.0]]), jnp.stack([jnp.eye(2)] * 2),
        ...                       jnp.eye(2), jnp.ones(2, bool))
        >>> places = jnp.array([[1.0, 0.0], [-2.0, 0.0]])
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), places, jnp.ones(2, bool))
        >>> print(optimal(predicted, scan, AssociationParams(0.9, 1e-3)).weight)
        [[0. 1.]
         [1. 0.]]
    """
    gated = gate(predicted, scan, params.gate)
    tracks, detections = gated.inside.shape
    if tracks == 0 or detections == 0:
        return _of(jnp.full(tracks, -1, jnp.int32), gated)
    # A pair gains what a miss would cost more. Pairs of gain 0 are misses, so that every track
    # (or detection) can be matched and the largest matching that `assign` wants forbids nothing.
    limit = jnp.asarray(params.gate, gated.squared_distance.dtype)
    cost = jnp.where(gated.inside, gated.squared_distance - limit, 0.0)
    found = assign(cost, jnp.ones(tracks, bool), jnp.ones(detections, bool))
    return _of(found.columns, gated)


def greedy_pairs(distance: Array, allowed: Array) -> Array:
    """Return the column that each row gets if the closest pair always comes first; −1: none.

    Args:
        distance: [T, M].
        allowed: [T, M] which pairs may be.

    Example:
        >>> distance = jnp.array([[1.0, 4.0], [2.0, 9.0]])
        >>> print(greedy_pairs(distance, distance < 5.0))
        [ 0 -1]
    """
    rows, columns = distance.shape
    every_row, every_column = (jnp.arange(n, dtype=jnp.int32) for n in (rows, columns))
    if rows == 0 or columns == 0:
        return jnp.full(rows, -1, jnp.int32)
    distance = jax.lax.stop_gradient(distance)

    # Pairs that are each other's closest are all taken at once: none of them, nor a closer pair,
    # would take from another. A few rounds do what would else need one step a pair.
    def take(state: tuple[Array, Array]) -> tuple[Array, Array]:
        found, open_ = state
        column = masked_argmin(distance, open_, axis=1).astype(jnp.int32)
        row = masked_argmin(distance, open_, axis=0).astype(jnp.int32)
        own = every_column[None, :] == column[:, None]
        mutual = open_ & own & (every_row[:, None] == row[None, :])
        mine, theirs = mutual.any(1), mutual.any(0)
        found = jnp.where(mine, column, found)
        return found, open_ & ~mine[:, None] & ~theirs[None, :]

    start = jnp.full(rows, -1, jnp.int32), allowed
    return jax.lax.while_loop(lambda state: state[1].any(), take, start)[0]


def _of(columns: Array, gated: Gated) -> Association:
    """Return the one-hot association in which track j takes detection columns[j], if inside."""
    every = jnp.arange(gated.inside.shape[1], dtype=jnp.int32)
    taken = (every[None, :] == columns[:, None]) & gated.inside
    weight = taken.astype(gated.density_per_m2.dtype)
    return Association(weight, 1 - weight.sum(-1), jnp.asarray(True))
