"""What a look says of each pair of track and detection, against clutter and a missed detection."""

import jax.numpy as jnp

from jaxtrack.association.gating import Association, AssociationParams, Predicted, gate
from jaxtrack.types import Array, Scan


def likelihood_ratios(
    predicted: Predicted, scan: Scan, params: AssociationParams
) -> tuple[Array, Array]:
    """Return how likely each pair is against clutter, [T, M], and a missed detection, [T].

        w_ij = P_D N(z_i; ẑ_j, S_ij) / β,    w_0 = 1 − P_D P_G,    P_G = 1 − exp(−γ/2)

    Args:
        predicted: T tracks.
        scan: one look of M detections; weights multiply the densities.
        params: detection probability, clutter and gate; β below 1e-30 acts as 1e-30.

    Example:
        >>> predicted = Predicted(jnp.zeros((1, 2)), jnp.eye(2)[None], jnp.eye(2), jnp.ones(1, bool))
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), jnp.zeros((1, 2)), jnp.ones(1, bool))
        >>> ratio, miss = likelihood_ratios(predicted, scan, AssociationParams(0.9, 1e-3))
        >>> print(ratio.round(1), miss.round(3))
        [[71.6]] [0.109]
    """  # noqa: E501
    gated = gate(predicted, scan, params.gate)
    dtype = gated.density_per_m2.dtype
    detect = detection_probability(predicted, params)
    clutter = jnp.asarray(params.clutter_per_m2, dtype)
    clutter = jnp.where(clutter > 1e-30, clutter, jnp.asarray(1e-30, dtype))
    in_gate = -jnp.expm1(-jnp.asarray(params.gate, dtype) / 2)
    return (detect / clutter)[:, None] * gated.density_per_m2, 1 - detect * in_gate


def detection_probability(predicted: Predicted, params: AssociationParams) -> Array:
    """Return P_D of each slot, [T]; zero where there is no track.

    Example:
        >>> predicted = Predicted(jnp.zeros((2, 2)), jnp.zeros((2, 2, 2)), jnp.eye(2),
        ...                       jnp.array([True, False]))
        >>> print(detection_probability(predicted, AssociationParams(0.5, 1e-3)))
        [0.5 0. ]
    """
    detect = jnp.asarray(params.p_detect, predicted.position_m.dtype)
    return jnp.where(predicted.mask, jnp.broadcast_to(detect, predicted.mask.shape), 0.0)


def from_marginals(marginals: Array) -> Association:
    """Return the association of marginal probabilities [T, M + 1], the last column the miss.

    Example:
        >>> print(from_marginals(jnp.array([[0.25, 0.75]])).miss)
        [0.75]
    """
    return Association(marginals[:, :-1], marginals[:, -1], jnp.asarray(True))
