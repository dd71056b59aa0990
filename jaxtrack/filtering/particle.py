"""The particle filter: any motion that can be drawn from, any likelihood that can be evaluated.

    x_k^i ~ f(x | x_{k−1}^i),   w_k^i ∝ w_{k−1}^i g(z_k | x_k^i),   p(z_k | z_1 … z_{k−1}) ≈ Σ_i w_{k−1}^i g(z_k | x_k^i)

Where 1/Σ w² falls below a share of N, the particles are resampled. `weigh`, `effective_size` and
`weighted_mean` are its steps on arrays, `particle_filter` the estimator.
"""  # noqa: E501

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp

from jaxtrack.filtering.gaussian import choose
from jaxtrack.filtering.resampling import Resampler, normalized, stop_gradient, systematic
from jaxtrack.numerics.checks import check_array, check_known, check_size
from jaxtrack.numerics.masked import masked_logsumexp
from jaxtrack.numerics.safe import as_float
from jaxtrack.types import Array, Estimator, Key


class Transition(Protocol):
    """Draws where particles move."""

    def __call__(self, key: Key, particles: Array, observation: Any) -> Array:
        """Return particles [N, S] at the time of the observation."""
        ...


class LogLikelihood(Protocol):
    """Says how likely an observation is at each particle, log g(z | x)."""

    def __call__(self, particles: Array, observation: Any) -> Array:
        """Return [N] of particles [N, S], all of which it sees; −inf is a likelihood of zero."""
        ...


class LogDensity(Protocol):
    """Says how likely a motion is, log f(after | before)."""

    def __call__(self, before: Array, after: Array, observation: Any) -> Array:
        """Return [N] of particles [N, S] before and after."""
        ...


class Weighed(NamedTuple):
    """Weights after an observation."""

    log_weight: Array  # [N]; their sum is 1, unless they vanished
    log_likelihood: Array  # [] of the observation; −inf where all weights vanished
    vanished: Array  # [] True: no particle had a weight left, so all kept theirs


class ParticleState(NamedTuple):
    """What the next observation needs."""

    key: Key
    particles: Array  # [N, S]
    log_weight: Array  # [N]
    log_likelihood: Array  # [] of all observations so far


class ParticleInfo(NamedTuple):
    """What an observation did. Particles and weights are those before resampling."""

    particles: Array  # [N, S]
    log_weight: Array  # [N]
    mean: Array  # [S] weighted
    effective_size: Array  # [] from 1 to N
    log_likelihood: Array  # [] of this observation alone; 0 where there was none
    resampled: Array  # []
    vanished: Array  # [] True: all weights were zero, and the old ones were kept
    unsound: Array  # [] True: a transition, density or likelihood was none; it weighs nothing


def weigh(log_weight: Array, log_likelihood: Array) -> Weighed:
    """Multiply weights by likelihoods.

        w'_i = w_i g_i / Σ_j w_j g_j,   log-likelihood = log Σ_j w_j g_j

    Args:
        log_weight: [N] log w.
        log_likelihood: [N] log g; what is not finite is a likelihood of zero.

    Raises:
        ValueError: shapes differ.

    Example:
        >>> found = weigh(jnp.log(jnp.array([0.5, 0.5])), jnp.log(jnp.array([0.3, 0.1])))
        >>> print(jnp.exp(found.log_weight).round(2), f"{jnp.exp(found.log_likelihood):.1f}")
        [0.75 0.25] 0.2

    Source: Zernike-moment particle filter (2023), equation 30 and Algorithm 1, rows 8 to 11.
    """
    check_array("log_weight", log_weight, shape=("N",))
    check_array("log_likelihood", log_likelihood, shape=jnp.shape(log_weight))
    joint = log_weight + log_likelihood
    alive = jnp.isfinite(joint)
    some = alive.any()
    total = masked_logsumexp(joint, alive)
    after = jnp.where(alive, jnp.where(alive, joint, 0.0) - total, -jnp.inf)
    return Weighed(
        jnp.where(some, after, log_weight), jnp.where(some, total, -jnp.inf), jnp.logical_not(some)
    )


def effective_size(log_weight: Array) -> Array:
    """Return how many equal weights would be worth as much, 1 / Σ w², with Σ w = 1.

    Args:
        log_weight: [N].

    Example:
        >>> print(effective_size(jnp.log(jnp.array([0.5, 0.5, 0.0]))).round(3))
        2.0

    Source: Zernike-moment particle filter (2023), equation 32.
    """
    return 1 / (jnp.exp(normalized(log_weight)) ** 2).sum()


def weighted_mean(particles: Array, log_weight: Array) -> Array:
    """Return Σ w_i x_i, [S], with Σ w = 1.

    Args:
        particles: [N, S].
        log_weight: [N].

    Example:
        >>> print(weighted_mean(jnp.array([[0.0], [4.0]]), jnp.log(jnp.array([3.0, 1.0]))).round(2))
        [1.]

    Source: Zernike-moment particle filter (2023), equation 31.

    Note:
        The equation as printed divides by N once more.
    """
    weight = jnp.exp(normalized(log_weight))[:, None]
    return (weight * jnp.where(weight > 0, particles, 0.0)).sum(0)


def particle_filter(
    transition: Transition,
    log_likelihood: LogLikelihood,
    resampler: Resampler | None = None,
    *,
    particles: int,
    initial: Callable[[Key, int], Array],
    log_density: LogDensity | None = None,
    resample_below: Array | float = 2 / 3,
) -> Estimator[Any, ParticleState, ParticleInfo]:
    """Return the particle filter.

    Observations are any tree of arrays. Where they have a field, or a mapping's key, `valid` and it
    is False, there is no look and nothing changes, the key included; what stands in it may be
    anything. Transition and likelihood are then evaluated on zeros, and forgotten: where gradients
    are wanted, these have to be finite there too.

    Args:
        transition: draws particles at the time of an observation.
        log_likelihood: how likely the observation is at each of them.
        resampler: by default `stop_gradient(systematic)`.
        particles: N. Static.
        initial: (key, N) → particles [N, S] before the first observation, of equal weight.
        log_density: log f of the transition, for gradients: the drawn states then carry none, and
            a motion weighs f / sg(f). With `stop_gradient` that is the estimate of Ścibior and
            Wood. Without it gradients go through the states, which the transition must then draw
            as a smooth function of its parameters; they are far noisier. The values are the same.
        resample_below: [] share of N below which the effective size starts a resampling; 0 is
            never.

    Returns:
        An estimator over observations. `exp(state.log_likelihood)` is an unbiased estimate of the
        likelihood of all of them, with any resampler that copies.

    Raises:
        TypeError: `particles` is not an int.
        ValueError: it is less than 1, a known share is negative, or a shape does not fit.

    Example:
        >>> def drift(key, x, z):
        ...     return x + jax.random.normal(key, x.shape)
        >>> def near(x, z):
        ...     return -((x[:, 0] - z) ** 2) / 2
        >>> filter = particle_filter(drift, near, particles=1000,
        ...     initial=lambda key, size: jax.random.normal(key, (size, 1)))
        >>> z = 2 * jnp.arange(20.0)
        >>> state, info = jax.lax.scan(filter.step, filter.init(jax.random.key(0)), z)
        >>> print(info.mean.shape, bool(abs(info.mean[-1, 0] - 36.8) < 0.3))  # it lags behind
        (20, 1) True

    Source: Zernike-moment particle filter (2023), Algorithm 1 and section 2.3.5; Gordon, Salmond
        and Smith, 1993.

    Note:
        The filter keeps no time: where looks are unevenly spaced, an observation carries its step
        since the last valid one, or the particles the time as a component. Parameters of `initial`
        get no gradient where `log_density` is given.
    """
    check_size("particles", particles)
    check_known("resample_below", resample_below, lambda x: x >= 0, "a share of N, at least 0")
    resample = stop_gradient(systematic) if resampler is None else resampler
    stop = jax.lax.stop_gradient if log_density is not None else lambda x: x

    def init(key: Key) -> ParticleState:
        key, draw = jax.random.split(key)
        drawn = as_float(initial(draw, particles))
        check_array("initial(key, particles)", drawn, shape=(particles, "S"))
        equal = jnp.full(particles, -math.log(particles), drawn.dtype)
        return ParticleState(key, drawn, equal, jnp.zeros((), drawn.dtype))

    def step(state: ParticleState, observation: Any) -> tuple[ParticleState, ParticleInfo]:
        named = isinstance(observation, Mapping)
        flag = observation.get("valid", True) if named else getattr(observation, "valid", True)
        valid = jnp.asarray(flag)
        # What is behind an invalid look may be NaN, which a gradient would carry past the choice.
        observation = jax.tree.map(lambda x: jnp.where(valid, x, jnp.zeros_like(x)), observation)
        key, move, draw = jax.random.split(state.key, 3)
        share = jnp.asarray(resample_below, state.log_weight.dtype)
        before, weight = stop(state.particles), state.log_weight
        shape = jnp.shape(before)
        moved = stop(transition(move, before, observation))
        check_array("transition(…)", moved, shape=shape)
        finite = jnp.isfinite(moved).all(-1)
        moved = jnp.where(finite[:, None], moved, before)
        sound = finite
        if log_density is not None:
            density = log_density(before, moved, observation)
            check_array("log_density(…)", density, shape=shape[:1])
            sound = sound & jnp.isfinite(density)
            weight = weight + jnp.where(sound, density - stop(density), 0.0)
        told = log_likelihood(moved, observation)
        check_array("log_likelihood(…)", told, shape=shape[:1])
        after = weigh(weight, jnp.where(sound, told, -jnp.inf))
        unsound = ~(sound & (jnp.isfinite(told) | jnp.isneginf(told))).all()
        few = effective_size(after.log_weight) < share * particles
        kept, log_weight = jax.lax.cond(
            few & valid,
            lambda: tuple(resample(draw, moved, after.log_weight)[:2]),
            lambda: (moved, after.log_weight),
        )
        nothing, no = jnp.zeros_like(after.log_likelihood), jnp.zeros((), bool)
        return choose(
            valid,
            (
                ParticleState(key, kept, log_weight, state.log_likelihood + after.log_likelihood),
                _info(moved, after, few, unsound),
            ),
            (state, _info(before, Weighed(state.log_weight, nothing, no), no, no)),
        )

    return Estimator(init, step)


def _info(particles: Array, weighed: Weighed, resampled: Array, unsound: Array) -> ParticleInfo:
    weight, log_likelihood, vanished = weighed
    mean, effective = weighted_mean(particles, weight), effective_size(weight)
    return ParticleInfo(
        particles, weight, mean, effective, log_likelihood, resampled, vanished, unsound
    )
