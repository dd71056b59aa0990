"""Nearest neighbours: each track takes at most one detection, with weight one.

`independent` lets tracks share a detection, as NNDA of the cloud-model paper does; `greedy` gives
the closest pair to each other, then the closest of the rest; `optimal` minimizes the total.
Distances are squared Mahalanobis distances d², and only pairs inside the gate count.
"""

import jax
import jax.numpy as jnp

from jaxtrack.association.gating import Association, AssociationParams, Gated, Predicted, gate
from jaxtrack.numerics.assignment import pair_up
from jaxtrack.numerics.masked import masked_argmin
from jaxtrack.numerics.segments import decided
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
    # A pair gains what a miss would cost more.
    limit = jnp.asarray(params.gate, gated.squared_distance.dtype)
    return _of(pair_up(jnp.where(gated.inside, limit - gated.squared_distance, 0.0)), gated)


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
    if rows == 0 or columns == 0:
        return jnp.full(rows, -1, jnp.int32)
    every_row, every_column = (jnp.arange(n, dtype=jnp.int32) for n in (rows, columns))
    distance = jnp.where(allowed, jax.lax.stop_gradient(distance), jnp.inf)

    # Rows propose to their nearest columns, columns keep the nearest row: all that is left is for
    # rows that were turned away, one at a time. Where both sides rank pairs by one number that ends
    # in the pairs of the closest first.
    least = distance.min(1)
    at = jnp.where(distance == least[:, None], every_column[None, :], columns).min(1)
    own = (every_column[None, :] == at[:, None]) & (least < jnp.inf)[:, None]
    near = jnp.where(own, least[:, None], jnp.inf).min(0)
    row = jnp.where(own & (least[:, None] == near[None, :]), every_row[:, None], rows).min(0)
    kept = (own & (row[None, :] == every_row[:, None])).any(1)
    begin = near, row, (least < jnp.inf) & ~kept

    def propose(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        near, row, waiting = state
        me = jnp.where(waiting, every_row, rows).min()
        mine = distance[me]
        welcome = (mine < near) | ((mine == near) & (me < row))
        offer = jnp.where(welcome, mine, jnp.inf)
        best = offer.min()
        chosen = jnp.where(offer == best, every_column, columns).min()
        here = (every_column == chosen) & (best < jnp.inf)
        turned_away = jnp.where(here, row, rows).min()
        waiting = (waiting & (every_row != me)) | (every_row == turned_away)
        return jnp.where(here, best, near), jnp.where(here, me, row), waiting

    row = jax.lax.while_loop(lambda state: state[2].any(), propose, begin)[1]
    own = row[None, :] == every_row[:, None]
    return jnp.where(own, every_column[None, :], -1).max(1)


def _of(columns: Array, gated: Gated) -> Association:
    """Return the one-hot association in which track j takes detection columns[j], if inside."""
    every = jnp.arange(gated.inside.shape[1], dtype=jnp.int32)
    taken = every[None, :] == decided(columns)[:, None]
    weight = taken.astype(gated.density_per_m2.dtype)
    return Association(weight, 1 - weight.sum(-1), jnp.asarray(True))
