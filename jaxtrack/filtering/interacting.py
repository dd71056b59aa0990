"""Interacting multiple models: a target that switches between kinds of motion.

Each model has its own filter. Before every look the filters' states are mixed by the chance that
the target has switched (`mix`); after it the models are weighed by how well they foresaw it
(`reweigh`), and their states combined for people to look at (`combine`). States of all models
have the same size: `models.straight` stands beside `models.coordinated_turn`.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.filtering import extended
from jaxtrack.filtering.gaussian import Moments, Prior, begin, choose, correct, elapsed, symmetric
from jaxtrack.filtering.kalman import position_seen
from jaxtrack.models.process import Motion
from jaxtrack.numerics.checks import check_array, check_size
from jaxtrack.numerics.safe import safe_divide, safe_log
from jaxtrack.types import Array, Estimator, Scan


class InteractingParams(NamedTuple):
    """What the filter knows of target and sensor. Traced."""

    prior: Prior  # of the models' common state [S], which begins with x, y, vx, vy
    probability: Array  # [M] of each model before the first look
    switching: Array  # [M, M] from row to column, between a look and the next; rows sum to 1
    sigma_m: Array | float  # [] noise of each coordinate, where a scan has no covariance of its own


class InteractingState(NamedTuple):
    """What the next look needs."""

    time_s: Array  # []
    mean: Array  # [M, S]
    covariance: Array  # [M, S, S]
    probability: Array  # [M]


class InteractingInfo(NamedTuple):
    """What a look did."""

    seen: Array  # []
    predicted: Moments  # of all models together
    filtered: Moments
    models: Moments  # [M, S], [M, S, S] filtered, model by model
    probability: Array  # [M]
    log_likelihood: Array  # [] of the look, over all models; 0 where unseen
    definite: Array  # [] False: numerical trouble, see `gaussian.Update`


def combine(mean: Array, covariance: Array, probability: Array) -> Moments:
    """Return the moments of a mixture of Gaussians.

        m = Σ μ_j m_j,   P = Σ μ_j (P_j + (m_j − m)(m_j − m)ᵀ)

    Args:
        mean: [M, S].
        covariance: [M, S, S].
        probability: [M] μ, sums to one.

    Example:
        >>> both = combine(jnp.array([[0.0], [2.0]]), jnp.ones((2, 1, 1)), jnp.full(2, 0.5))
        >>> print(both.mean, both.covariance)
        [1.] [[2.]]
    """
    middle = probability @ mean
    apart = mean - middle[None, :]
    within = jnp.einsum("m,mij->ij", probability, covariance)
    between = jnp.einsum("m,mi,mj->ij", probability, apart, apart)
    return Moments(middle, symmetric(within + between))


def mix(
    mean: Array, covariance: Array, probability: Array, switching: Array
) -> tuple[Moments, Array]:
    """Return what each model starts from, if the target may have switched to it.

        μ⁻_j = Σ_i π_ij μ_i,   model j: the mixture of all models i with weights π_ij μ_i / μ⁻_j

    Args:
        mean: [M, S].
        covariance: [M, S, S].
        probability: [M] μ.
        switching: [M, M] π, from row to column.

    Returns:
        mean [M, S] and covariance [M, S, S] of each model, and their probabilities μ⁻ [M].

    Example:
        >>> switching = jnp.array([[0.9, 0.1], [0.1, 0.9]])
        >>> mixed, probability = mix(
        ...     jnp.array([[0.0], [2.0]]), jnp.ones((2, 1, 1)), jnp.array([0.5, 0.5]), switching
        ... )
        >>> print([round(float(x), 2) for x in mixed.mean[:, 0]], probability)
        [0.2, 1.8] [0.5 0.5]

    Source: H. Blom and Y. Bar-Shalom, The interacting multiple model algorithm for systems with
    Markovian switching coefficients (1988).
    """
    predicted = probability @ switching
    weights = safe_divide(probability[:, None] * switching, predicted[None, :])
    return jax.vmap(combine, (None, None, 1))(mean, covariance, weights), predicted


def reweigh(probability: Array, log_likelihood: Array) -> tuple[Array, Array]:
    """Return the models' probabilities after a look, [M], and the look's log-likelihood, [].

        Λ = Σ_j μ_j Λ_j,   μ'_j = μ_j Λ_j / Λ

    Args:
        probability: [M] μ before.
        log_likelihood: [M] log Λ_j.

    Example:
        >>> probability, total = reweigh(jnp.array([0.5, 0.5]), jnp.log(jnp.array([3.0, 1.0])))
        >>> print(probability.round(2), total.round(3))
        [0.75 0.25] 0.693
    """
    joint = safe_log(probability) + log_likelihood
    total = jax.scipy.special.logsumexp(joint)
    return jnp.exp(joint - total), total


def interacting(
    params: InteractingParams, motions: Sequence[Motion]
) -> Estimator[Scan, InteractingState, InteractingInfo]:
    """Return the interacting multiple model filter of one target, seen at most once a look.

    A look without the target moves the models on and their probabilities towards the switching's
    own; where there is no look (`valid` False) nothing happens.

    Args:
        params: prior, probabilities and noise of the sensor.
        motions: M of one state size, linearized at the mean; e.g. two `models.straight` of
            different noise and a `models.coordinated_turn`.

    Returns:
        An estimator over `Scan` with room for one detection.

    Raises:
        ValueError: probabilities or switching do not fit the motions.

    Example:
        >>> from jaxtrack.models import coordinated_turn, straight
        >>> prior = Prior(jnp.array([0.0, 0.0, 10.0, 0.0, 0.0]), jnp.diag(jnp.full(5, 0.1)))
        >>> switching = jnp.array([[0.95, 0.05], [0.05, 0.95]])
        >>> params = InteractingParams(prior, jnp.array([0.9, 0.1]), switching, 1.0)
        >>> filter = interacting(params, [straight(0.01, 0.3), coordinated_turn(0.01, 0.01)])
        >>> t = jnp.arange(1.0, 11.0)
        >>> at = 33 * jnp.stack([jnp.sin(0.3 * t), 1 - jnp.cos(0.3 * t)], axis=-1)[:, None]
        >>> scans = Scan(t, jnp.ones(10, bool), at, jnp.ones((10, 1), bool))
        >>> state, info = jax.lax.scan(filter.step, filter.init(jax.random.key(0)), scans)
        >>> print(info.probability[-1].round(1), info.filtered.mean[-1, 4].round(1))
        [0. 1.] 0.3
    """
    models = check_size("motions, number of", len(motions))
    check_array("params.probability", params.probability, shape=(models,))
    check_array("params.switching", params.switching, shape=(models, models))

    def init(key: Array) -> InteractingState:
        first = begin(params.prior)
        every = lambda x: jnp.broadcast_to(x, (models, *x.shape))
        probability = jnp.asarray(params.probability, first.mean.dtype)
        return InteractingState(
            first.time_s, every(first.mean), every(first.covariance), probability
        )

    def step(state: InteractingState, scan: Scan) -> tuple[InteractingState, InteractingInfo]:
        switching = jnp.asarray(params.switching, state.mean.dtype)
        dt = elapsed(state.time_s, scan)
        mixed, chance = mix(state.mean, state.covariance, state.probability, switching)
        moved = [
            extended.predict(
                mixed.mean[m],
                mixed.covariance[m],
                lambda x, motion=motion: motion.propagate(x, dt),
                motion.noise(dt),
            )
            for m, motion in enumerate(motions)
        ]
        predicted, chance = choose(
            scan.valid,
            (Moments(*(jnp.stack(x) for x in zip(*moved, strict=True))), chance),
            (Moments(state.mean, state.covariance), state.probability),
        )
        seen = jax.vmap(position_seen, (0, None, None))(predicted.mean, scan, params.sigma_m)
        after = jax.vmap(correct)(*predicted, seen.innovation, seen.matrix, seen.noise)
        weighed, log_likelihood = reweigh(chance, after.log_likelihood)
        here = seen.mask[0]
        filtered, probability = choose(
            here, (Moments(after.mean, after.covariance), weighed), (predicted, chance)
        )
        info = InteractingInfo(
            here,
            combine(*predicted, chance),
            combine(*filtered, probability),
            filtered,
            probability,
            jnp.where(here, log_likelihood, 0.0),
            after.definite.all() | ~here,
        )
        time_s = jnp.where(scan.valid, scan.time_s, state.time_s)
        return InteractingState(time_s, *filtered, probability), info

    return Estimator(init, step)
