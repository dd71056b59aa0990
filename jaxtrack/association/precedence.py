"""Association in two turns: some tracks choose first, the others among what those leave."""

import jax
import jax.numpy as jnp

from jaxtrack.association.gating import Associate, Association, AssociationParams, Predicted
from jaxtrack.numerics.checks import check_array
from jaxtrack.types import Array, Key, Scan


def in_turn(
    associate: Associate,
    predicted: Predicted,
    scan: Scan,
    params: AssociationParams,
    key: Key | None,
    first: Array,
) -> tuple[Association, Array]:
    """Associate some tracks, and the others with the weight that these leave of each detection.

        l_i = max(0, 1 − Σ_{j first} w_ij):   the others see detections of weight c_i l_i

    A new track's gate is wide and its S large, so that by d² it is the nearest to nearly anything:
    among equals it takes the detections of a track that is sure of itself.

    Args:
        associate: an associator.
        predicted: T tracks.
        scan: one look of M detections, of weight c.
        params: detection probability, clutter and gate.
        key: for the sampled associators.
        first: [T] which tracks choose first.

    Returns:
        The association of all, and l [M].

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers.

    Example:
        >>> from jaxtrack.association import nearest
        >>> predicted = Predicted(jnp.array([[0.0, 0.0], [1.0, 0.0]]), jnp.stack([jnp.eye(2)] * 2),
        ...                       jnp.eye(2), jnp.ones(2, bool))
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), jnp.array([[1.0, 0.0]]), jnp.ones(1, bool))
        >>> first = jnp.array([True, False])
        >>> params = AssociationParams(0.9, 1e-3)
        >>> found, left = in_turn(nearest.greedy, predicted, scan, params, None, first)
        >>> print(found.weight[:, 0], left)
        [1. 0.] [0.]
    """
    check_array("first", first, shape=(predicted.mask.shape[0],))
    keys = (None, None) if key is None else tuple(jax.random.split(key))
    early, late = predicted.mask & first, predicted.mask & ~first
    sure = associate(predicted._replace(mask=early), scan, params, keys[0])
    left = 1 - sure.weight.sum(0)
    left = jnp.where(left > 0, left, 0.0)
    weight = left if scan.weight is None else left * jnp.where(scan.mask, scan.weight, 0.0)
    rest = associate(predicted._replace(mask=late), scan._replace(weight=weight), params, keys[1])
    return Association(
        jnp.where(early[:, None], sure.weight, rest.weight),
        jnp.where(early, sure.miss, rest.miss),
        sure.converged & rest.converged,
    ), left
