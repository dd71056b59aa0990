"""Several echoes of one target: the probabilistic multiple hypothesis tracker, in one pass.

Every detection by itself comes from one of the tracks or from clutter, so that a track may take
any number of them. `moments.update_centroid` updates a track with what it took.
"""

import jax.numpy as jnp

from jaxtrack.association.gating import (
    Association,
    AssociationParams,
    Predicted,
    gate,
)
from jaxtrack.association.ratios import detection_probability
from jaxtrack.numerics.safe import safe_divide
from jaxtrack.types import Key, Scan


def associate(
    predicted: Predicted, scan: Scan, params: AssociationParams, key: Key | None = None
) -> Association:
    """Give each detection's probabilities to come from each of the tracks (PMHT, one pass).

        w_ij = c_i P_D λ N(z_i; ẑ_j, S_ij) / (β + Σ_k P_D λ N(z_i; ẑ_k, S_ik))

    with c_i the detection's weight: it counts as c_i echoes. The miss is Π_i (1 − w_ij).

    Args:
        predicted: T tracks.
        scan: one look of M detections.
        params: detection probability, clutter density, gate and mean number of echoes λ.
        key: not used.

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers.

    Example:
        >>> predicted = Predicted(jnp.array([[0.0, 0.0], [3.0, 0.0]]), jnp.stack([jnp.eye(2)] * 2),
        ...                       jnp.eye(2), jnp.ones(2, bool))
        >>> places = jnp.array([[0.0, 0.0], [1.5, 0.0]])
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), places, jnp.ones(2, bool))
        >>> params = AssociationParams(0.9, 1e-3, echoes=2.0)
        >>> print(associate(predicted, scan, params).weight.round(2))
        [[0.9  0.5 ]
         [0.09 0.5 ]]

    Source: R. Streit and T. Luginbuhl, "Probabilistic multi-hypothesis tracking", 1995, equation of
        the assignment weights, at the predicted tracks and with the predicted covariances.
    """
    whole = gate(predicted, scan._replace(weight=None), params.gate).density_per_m2
    dtype = whole.dtype
    echoes = detection_probability(predicted, params) * jnp.asarray(params.echoes, dtype)
    expected = echoes[:, None] * whole
    total = jnp.asarray(params.clutter_per_m2, dtype) + expected.sum(0)
    weight = safe_divide(expected, total[None, :])
    if scan.weight is not None:
        weight = weight * jnp.where(scan.mask & scan.valid, scan.weight, 0.0)[None, :]
    return Association(weight, (1 - weight).prod(-1), jnp.asarray(True))
