"""Resampling: particles of unequal weight become as many of (nearly) equal weight.

    ancestors A_1 … A_N with E[#{j : A_j = i}] = N w_i,   x̃_j = x_{A_j},   w̃_j = 1/N

`systematic`, `stratified`, `multinomial` and `residual` differ in how much chance is in the counts.
Their gradient ignores that other weights would have drawn other ancestors. `stop_gradient` puts
that right, `soft` and `transport.optimal_transport` in part: how far off each is stands in
docs/design.md. All of them have one signature, `Resampler`; wrappers take one and return one.

Weights are logarithms, and need not add up to 1. What is not finite weighs nothing; where nothing
weighs anything, all weigh the same.
"""

import math
from typing import NamedTuple, Protocol

import jax
import jax.numpy as jnp

from jaxtrack.numerics.checks import check_array, check_known, check_probability
from jaxtrack.numerics.masked import masked_logsumexp
from jaxtrack.types import Array, Key


class Resampled(NamedTuple):
    """Particles after resampling."""

    particles: Array  # [N, S]
    log_weight: Array  # [N]; their sum is 1 on average, with `soft` not exactly
    ancestor: Array | None  # [N] int, whose copy each is; None: they are no copies


class Resampler(Protocol):
    """Makes particles of nearly equal weight."""

    def __call__(self, key: Key, particles: Array, log_weight: Array) -> Resampled:
        """Resample particles [N, S] with the logarithms of their weights, [N]."""
        ...


def normalized(log_weight: Array) -> Array:
    """Return logarithms of weights that add up to 1; all equal where nothing weighs anything.

    Args:
        log_weight: [N]; −inf, or anything else that is not finite, is no weight.

    Example:
        >>> print(jnp.exp(normalized(jnp.log(jnp.array([3.0, 1.0, 0.0])))).round(2))
        [0.75 0.25 0.  ]
        >>> print(jnp.exp(normalized(jnp.full(2, -jnp.inf))).round(2))
        [0.5 0.5]
    """
    alive = jnp.isfinite(log_weight)
    share = jnp.where(alive, log_weight, 0.0) - masked_logsumexp(log_weight, alive)
    equal = -math.log(log_weight.shape[0])
    return jnp.where(alive.any(), jnp.where(alive, share, -jnp.inf), equal)


def systematic(key: Key, particles: Array, log_weight: Array) -> Resampled:
    """Copy particles at evenly spaced points of the weights' running sum, one shift for all.

        A_j = min{i : w_1 + … + w_i > (j − 1 + U) / N},   U ~ uniform(0, 1)

    A count differs from N w_i by less than 1.

    Args:
        key: what is drawn depends on it.
        particles: [N, S].
        log_weight: [N].

    Returns:
        Copies with weights 1/N.

    Raises:
        ValueError: shapes do not fit.

    Example:
        >>> x, w = jnp.arange(4.0)[:, None], jnp.log(jnp.array([0.5, 0.0, 0.25, 0.25]))
        >>> print(systematic(jax.random.key(0), x, w).particles.ravel())
        [0. 0. 2. 3.]

    Source: Carpenter, Clifford and Fearnhead, *Improved particle filter for non-linear problems*,
        1999.
    """
    size, dtype = _check(particles, log_weight)
    points = (jnp.arange(size, dtype=dtype) + jax.random.uniform(key, (), dtype)) / size
    return _copies(particles, _ancestors(jnp.exp(normalized(log_weight)), points))


def stratified(key: Key, particles: Array, log_weight: Array) -> Resampled:
    """Copy particles at points of the weights' running sum, one in each N-th part of it.

        A_j = min{i : w_1 + … + w_i > (j − 1 + U_j) / N},   U_j ~ uniform(0, 1)

    A count differs from N w_i by less than 2. Arguments and results as of `systematic`.

    Example:
        >>> x, w = jnp.arange(4.0)[:, None], jnp.log(jnp.array([0.5, 0.0, 0.25, 0.25]))
        >>> print(stratified(jax.random.key(0), x, w).particles.ravel())
        [0. 0. 2. 3.]

    Source: Kitagawa, *Monte Carlo filter and smoother for non-Gaussian nonlinear state space
        models*, 1996.
    """
    size, dtype = _check(particles, log_weight)
    points = (jnp.arange(size, dtype=dtype) + jax.random.uniform(key, (size,), dtype)) / size
    return _copies(particles, _ancestors(jnp.exp(normalized(log_weight)), points))


def multinomial(key: Key, particles: Array, log_weight: Array) -> Resampled:
    """Copy particles drawn one by one with probabilities w.

        P(A_j = i) = w_i, independently

    Arguments and results as of `systematic`, which adds less noise.

    Example:
        >>> x, w = jnp.arange(4.0)[:, None], jnp.log(jnp.array([0.0, 0.0, 1.0, 0.0]))
        >>> print(multinomial(jax.random.key(0), x, w).particles.ravel())
        [2. 2. 2. 2.]

    Source: Gordon, Salmond and Smith, *Novel approach to nonlinear/non-Gaussian Bayesian state
        estimation*, 1993.
    """
    size, dtype = _check(particles, log_weight)
    points = jax.random.uniform(key, (size,), dtype)
    return _copies(particles, _ancestors(jnp.exp(normalized(log_weight)), points))


def residual(key: Key, particles: Array, log_weight: Array) -> Resampled:
    """Copy each particle ⌊N w_i⌋ times, and draw the rest one by one from what is left of w.

        P(A_j = i) = (N w_i − ⌊N w_i⌋) / (N − Σ ⌊N w⌋) for the places that are left

    No count is below ⌊N w_i⌋. Arguments and results as of `systematic`.

    Example:
        >>> x, w = jnp.arange(4.0)[:, None], jnp.log(jnp.array([0.5, 0.0, 0.5, 0.0]))
        >>> print(residual(jax.random.key(0), x, w).particles.ravel())
        [0. 0. 2. 2.]

    Source: Liu and Chen, *Sequential Monte Carlo methods for dynamic systems*, 1998.
    """
    size, dtype = _check(particles, log_weight)
    expected = size * jnp.exp(normalized(log_weight))
    whole = jnp.floor(expected)
    drawn = _ancestors(expected - whole, jax.random.uniform(key, (size,), dtype))
    place, filled = jnp.arange(size, dtype=dtype), jnp.cumsum(whole)
    sure = jnp.searchsorted(filled, place, side="right")
    return _copies(particles, jnp.where(place < filled[-1], sure, drawn))


def stop_gradient(resampler: Resampler = systematic) -> Resampler:
    """Return a resampler whose weights carry the gradient of the draw.

        w̃_j = w_{A_j} / (N sg(w_{A_j})),   sg(w) = w without a gradient

    The value is 1/N; the gradient is that of Σ_i w_i f(x_i), on average over the draws. With it a
    particle filter's log-likelihood has the score as its gradient, up to O(1/N).

    Args:
        resampler: one whose particles are copies.

    Raises:
        ValueError: when called, if the particles are no copies.

    Example:
        >>> x = jnp.arange(4.0)[:, None]
        >>> def mean(log_weight):
        ...     found = stop_gradient(systematic)(jax.random.key(0), x, log_weight)
        ...     return (jnp.exp(found.log_weight) * found.particles[:, 0]).sum()
        >>> print(jax.grad(mean)(jnp.zeros(4)))  # w_i (x_i − mean), exact for equal weights
        [-0.375 -0.125  0.125  0.375]

    Source: Ścibior and Wood, *Differentiable particle filtering without modifying the forward
        pass*, 2021.
    """
    stop = jax.lax.stop_gradient

    def resample(key: Key, particles: Array, log_weight: Array) -> Resampled:
        found = resampler(key, particles, stop(log_weight))
        taken = normalized(log_weight)[_origin(found)]
        taken = jnp.where(jnp.isfinite(taken), taken, 0.0)
        return found._replace(log_weight=found.log_weight + (taken - stop(taken)))

    return resample


def soft(resampler: Resampler = systematic, mix: Array | float = 0.5) -> Resampler:
    """Return a resampler that draws from weights mixed with equal ones, and corrects for it.

        q_i = α w_i + (1 − α) / N,   A_j drawn by q,   w̃_j = w_{A_j} / (N q_{A_j})

    Weights thus stay unequal, and differentiable. The gradient misses the draw's own.

    Args:
        resampler: one whose particles are copies.
        mix: [] α in [0, 1]; 1 is the resampler itself.

    Raises:
        ValueError: a known mix outside [0, 1]; when called, if the particles are no copies.

    Example:
        >>> x, w = jnp.arange(4.0)[:, None], jnp.log(jnp.array([1.0, 0.0, 0.0, 0.0]))
        >>> found = soft(systematic, 0.5)(jax.random.key(1), x, w)
        >>> print(found.particles.ravel(), *(f"{w:.1f}" for w in jnp.exp(found.log_weight)))
        [0. 0. 0. 2.] 0.4 0.4 0.4 0.0

    Source: Karkus, Hsu and Lee, *Particle filter networks with application to visual localization*,
        2018.

    Note:
        The weights are not scaled to the sum 1, which would bias the likelihood's estimate.
    """
    check_probability("mix", mix, float)

    def resample(key: Key, particles: Array, log_weight: Array) -> Resampled:
        share = check_probability("mix", mix, log_weight.dtype)
        weights = normalized(log_weight)
        alive = jnp.isfinite(weights)
        mixed = share * jnp.exp(weights) + (1 - share) / weights.shape[0]
        drawable = mixed > 0
        proposal = jnp.where(drawable, jnp.log(jnp.where(drawable, mixed, 1.0)), -jnp.inf)
        found = resampler(key, particles, proposal)
        origin = _origin(found)
        ratio = jnp.where(alive, weights, 0.0) - jnp.where(drawable, proposal, 0.0)
        ratio = jnp.where(alive, ratio, -jnp.inf)
        return found._replace(log_weight=found.log_weight + ratio[origin])

    return resample


def jittered(resampler: Resampler, sigma: Array | float) -> Resampler:
    """Return a resampler that moves every particle a little afterwards, so that copies differ.

        x̃_j + σ ξ_j,   ξ_j ~ N(0, I)

    Args:
        resampler: any.
        sigma: [] or [S] ≥ 0, in the particles' units.

    Raises:
        ValueError: a known sigma that is negative or not finite.

    Example:
        >>> x = jnp.zeros((1000, 1))
        >>> found = jittered(systematic, 0.1)(jax.random.key(0), x, jnp.zeros(1000))
        >>> print(f"{found.particles.std():.1f}")
        0.1

    Source: Zernike-moment particle filter (2023), section 2.3.5.
    """
    check_known("sigma", sigma, lambda x: (x >= 0) & (x < jnp.inf), "a finite number ≥ 0")

    def resample(key: Key, particles: Array, log_weight: Array) -> Resampled:
        draw, move = jax.random.split(key)
        found = resampler(draw, particles, log_weight)
        spread = jnp.broadcast_to(jnp.asarray(sigma, particles.dtype), particles.shape)
        noise = jax.random.normal(move, particles.shape, particles.dtype)
        return found._replace(particles=found.particles + spread * noise)

    return resample


def _check(particles: Array, log_weight: Array) -> tuple[int, jnp.dtype]:
    check_array("particles", particles, shape=("N", "S"))
    check_array("log_weight", log_weight, shape=(jnp.shape(particles)[0],))
    return log_weight.shape[0], log_weight.dtype


def _ancestors(weight: Array, points: Array) -> Array:
    """Return the first index whose running sum of weights [N] exceeds each point of [0, 1)."""
    weight, points = jax.lax.stop_gradient((weight, points))
    running = jnp.cumsum(weight)
    total = running[-1]
    # A point that rounded up to 1 would lie beyond the last weight.
    points = jnp.minimum(points, 1 - jnp.finfo(points.dtype).epsneg)
    found = jnp.searchsorted(running / jnp.where(total > 0, total, 1.0), points, side="right")
    return jnp.minimum(found, weight.shape[0] - 1)


def _copies(particles: Array, ancestor: Array) -> Resampled:
    size = ancestor.shape[0]
    equal = jnp.full(size, -math.log(size), particles.dtype)
    return Resampled(particles[ancestor], equal, ancestor.astype(jnp.int32))


def _origin(found: Resampled) -> Array:
    if found.ancestor is None:
        raise ValueError("resampler: got one that blends particles, want one that copies them")
    return found.ancestor
