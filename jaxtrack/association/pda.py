"""Probabilistic data association: every track by itself, at most one detection is its own."""

import jax.numpy as jnp

from jaxtrack.association.gating import (
    Association,
    AssociationParams,
    Predicted,
)
from jaxtrack.association.ratios import from_marginals, likelihood_ratios
from jaxtrack.types import Array, Key, Scan


def marginals(likelihood_ratio: Array, miss: Array) -> Array:
    """Return the probability of each detection, and last of the miss, for each track: [T, M + 1].

        p_ij = w_ij / (w_0j + Σ_k w_kj)

    Args:
        likelihood_ratio: [T, M] w ≥ 0.
        miss: [T] w_0 > 0.

    Example:
        >>> print(marginals(jnp.array([[3.0, 0.0]]), jnp.array([1.0])))
        [[0.75 0.   0.25]]
    """
    weight = jnp.concatenate([likelihood_ratio, floored(miss)[:, None]], axis=1)
    return weight / weight.sum(-1, keepdims=True)


def associate(
    predicted: Predicted, scan: Scan, params: AssociationParams, key: Key | None = None
) -> Association:
    """Associate each track as if it were alone (PDA).

    Args:
        predicted: T tracks.
        scan: one look of M detections.
        params: detection probability, clutter density and gate.
        key: not used.

    Raises:
        ValueError: shapes do not fit.
        TypeError: not real numbers.

    Example:
        >>> predicted = Predicted(jnp.zeros((1, 2)), jnp.eye(2)[None], jnp.eye(2), jnp.ones(1, bool))
        >>> places = jnp.array([[0.0, 0.0], [2.0, 0.0]])
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), places, jnp.ones(2, bool))
        >>> print((100 * associate(predicted, scan, AssociationParams(0.9, 1e-3)).weight).round())
        [[73. 27.]]

    Source: Y. Bar-Shalom and E. Tse, "Tracking in a cluttered environment with probabilistic data
        association", 1975.
    """  # noqa: E501
    return from_marginals(marginals(*likelihood_ratios(predicted, scan, params)))


def floored(miss: Array) -> Array:
    """Return w_0, at least 1e-12: without a miss some tables of tracks have no joint event.

    Example:
        >>> print(floored(jnp.array([0.0, 0.5])))
        [1.e-12 5.e-01]
    """
    return jnp.where(miss > 1e-12, miss, jnp.asarray(1e-12, miss.dtype))
