"""Tracks that switch between kinds of motion: interacting multiple models in a tracker."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.association import Association, Predicted, Update, predict_measurement
from jaxtrack.association.gating import log_densities
from jaxtrack.filtering import extended, interacting
from jaxtrack.filtering.gaussian import Moments
from jaxtrack.models import Motion
from jaxtrack.numerics.checks import check_array, check_size
from jaxtrack.numerics.safe import safe_divide, safe_log
from jaxtrack.tracking.filters import (
    Filter,
    as_it_is,
    at_rest,
    check_sigmas,
    moving,
    noise_of_positions,
)
from jaxtrack.types import Array, Scan


class Models(NamedTuple):
    """Beliefs of K models of motion beside each other."""

    mean: Array  # [T, K, S]
    covariance: Array  # [T, K, S, S]
    probability: Array  # [T, K]


def interacting_filter(
    motions: Sequence[Motion],
    probability: Array,
    switching: Array,
    sigma_m: Array | float,
    birth_sigma: Array | Sequence[Array | float],
) -> Filter[Models]:
    """Return interacting multiple models of targets that are seen as positions.

    Tracks are associated by the moments of all models together. Each model then takes the same
    association in, and is weighed by how likely it makes the detections that are the track's:

        μ'_k = β₀ μ_k + Σ_i β_i μ_k N_ik / Σ_l μ_l N_il

    Args:
        motions: K of one state size, linearized at the mean.
        probability: [K] of each in a new track.
        switching: [K, K] from row to column, between a look and the next; rows sum to 1.
        sigma_m: [] noise of each coordinate, where a scan has no covariances.
        birth_sigma: [S − 2] deviations of what a new track's detection does not tell.

    Raises:
        ValueError: probabilities or switching do not fit the motions, or a number that cannot be.

    Example:
        >>> from jaxtrack.models import coordinated_turn, straight
        >>> switching = jnp.array([[0.95, 0.05], [0.05, 0.95]])
        >>> filter = interacting_filter([straight(0.01, 0.3), coordinated_turn(0.01, 0.01)],
        ...                             jnp.array([0.9, 0.1]), switching, 1.0, (3.0, 3.0, 0.3))
        >>> scan = Scan(jnp.array(0.0), jnp.array(True), jnp.ones((1, 2)), jnp.ones(1, bool))
        >>> later = filter.predict(filter.start(scan), jnp.array(1.0))
        >>> print([f"{x:.2f}" for x in later.probability[0]])
        ['0.86', '0.14']

    Source: H. Blom and Y. Bar-Shalom, The interacting multiple model algorithm for systems with
    Markovian switching coefficients (1988); with the weights of several detections as in A. Houles
    and Y. Bar-Shalom, Multisensor tracking of a maneuvering target in clutter (1989), whose models
    have associations of their own.
    """
    models = check_size("motions, number of", len(motions))
    check_array("probability", probability, shape=(models,))
    check_array("switching", switching, shape=(models, models))
    check_sigmas(sigma_m=sigma_m)
    steps = [moving(motion, extended.linearize) for motion in motions]

    def start(look: Scan) -> Models:
        first = at_rest(look, sigma_m, birth_sigma, None)
        every = lambda x: jnp.broadcast_to(x[:, None], (x.shape[0], models, *x.shape[1:]))
        chance = jnp.asarray(probability, first.mean.dtype)
        chance = jnp.broadcast_to(chance, (first.mean.shape[0], models))
        return Models(every(first.mean), every(first.covariance), chance)

    def predict(beliefs: Models, dt_s: Array) -> Models:
        switch = jnp.asarray(switching, beliefs.mean.dtype)
        mixed, chance = jax.vmap(interacting.mix, (0, 0, 0, None))(*beliefs, switch)
        moved = [
            step(Moments(mixed.mean[:, k], mixed.covariance[:, k]), dt_s)
            for k, step in enumerate(steps)
        ]
        mean, covariance = (jnp.stack(x, axis=1) for x in zip(*moved, strict=True))
        return Models(mean, covariance, chance)

    def measure(beliefs: Models, scan: Scan, mask: Array) -> Predicted:
        together = moments(beliefs)
        return predict_measurement(*together, noise_of_positions(sigma_m, scan), mask)

    def update(
        beliefs: Models, predicted: Predicted, look: Scan, found: Association, update: Update
    ) -> Models:
        def one(mean: Array, covariance: Array) -> tuple[Array, Array, Array]:
            own = predict_measurement(mean, covariance, predicted.noise_m2, predicted.mask)
            return *update(mean, covariance, own, look, found), log_densities(own, look)

        each = jax.vmap(one, in_axes=1, out_axes=1)
        mean, covariance, density = each(beliefs.mean, beliefs.covariance)
        chance = beliefs.probability
        posterior = jax.nn.softmax(safe_log(chance)[:, :, None] + density, axis=1)
        share = safe_divide(found.weight, found.weight.sum(1, keepdims=True))
        seen = (1 - found.miss)[:, None] * (share[:, None] * posterior).sum(2)
        return Models(mean, covariance, found.miss[:, None] * chance + seen)

    def moments(beliefs: Models) -> Moments:
        return jax.vmap(interacting.combine)(*beliefs)

    return Filter(as_it_is, start, predict, measure, update, moments)
