"""Resampling by optimal transport: particles move a short way instead of being copied or dropped.

A plan P moves the mass of the weighted particles to as many of equal weight, at the least cost up
to an entropy. It is found by Sinkhorn's iterations, on logarithms, and differentiable.
"""

import math

import jax
import jax.numpy as jnp

from jaxtrack.filtering.resampling import Resampled, Resampler, normalized
from jaxtrack.numerics.checks import check_array, check_positive, check_size
from jaxtrack.numerics.safe import safe_divide
from jaxtrack.types import Array, Key

_LIGHTEST = -60.0  # log of a weight that is as good as none: no infinities in the iterations


def optimal_transport(epsilon: Array | float = 0.5, *, iterations: int = 50) -> Resampler:
    """Return a resampler that blends particles by a plan of optimal transport.

        P = argmin Σ_ij P_ij C_ij + ε Σ_ij P_ij log P_ij,   Σ_i P_ij = w_j,   Σ_j P_ij = 1/N,
        x̃_i = Σ_j P_ij x_j / Σ_j P_ij,   w̃_i = Σ_j P_ij,
        C_ij = mean over components s of (x_is − x_js)² / var(x_·s)

    The weighted mean is kept exactly, whatever ε and however many iterations; of the spread some
    is lost, the more the larger ε. Nothing is drawn: the key is not used. Cost and memory are N².

    Args:
        epsilon: [] ε > 0, in units of C.
        iterations: of Sinkhorn. Static. The smaller ε, the more it takes until w̃ is 1/N.

    Raises:
        TypeError: `iterations` is not an int.
        ValueError: it is less than 1, or a known ε is not positive.

    Example:
        >>> x, w = jnp.arange(4.0)[:, None], jnp.log(jnp.array([0.5, 0.0, 0.25, 0.25]))
        >>> x, _, _ = optimal_transport(0.5)(jax.random.key(0), x, w)
        >>> print(*(f"{a:.1f}" for a in x.ravel()), f"mean {x.mean():.2f}")
        0.0 0.1 2.1 2.8 mean 1.25

    Source: Corenflos, Thornton, Deligiannidis and Doucet, *Differentiable particle filtering via
        entropy-regularized optimal transport*, 2021.

    Note:
        There C is scaled by the largest deviation of all components; here each has its own scale,
        because positions and velocities have different units. There w̃ is 1/N and the mean kept
        up to convergence; here w̃ is what the plan gives, 1/N up to convergence. There the
        gradient is that of the last iteration; here all are differentiated.
    """
    check_size("iterations", iterations)
    check_positive("epsilon", epsilon, float)

    def resample(key: Key, particles: Array, log_weight: Array) -> Resampled:
        check_array("particles", particles, shape=("N", "S"))
        size, components = jnp.shape(particles)
        check_array("log_weight", log_weight, shape=(size,))
        scale = check_positive("epsilon", epsilon, particles.dtype)
        equal = -math.log(size)
        weights = normalized(log_weight)
        weights = jnp.where(weights > _LIGHTEST, weights, _LIGHTEST)
        centred = particles - particles.mean(0, keepdims=True)
        variance = (centred**2).mean(0)
        # What rounding leaves of particles that are all alike is no spread.
        rounding = (8 * jnp.finfo(particles.dtype).eps) ** 2 * (particles**2).mean(0)
        inverse = safe_divide(1.0, jnp.where(variance > rounding, variance, 0.0))
        apart = (particles[:, None, :] - particles[None, :, :]) ** 2
        cost = (apart * inverse[None, None, :]).sum(-1) / (components * scale)

        @jax.checkpoint  # or the backward pass would keep N² numbers of every iteration
        def improve(columns: Array, _: None) -> tuple[Array, Array]:
            rows = equal - jax.nn.logsumexp(columns[None, :] - cost, axis=1)
            return weights - jax.nn.logsumexp(rows[:, None] - cost, axis=0), rows

        columns, rows = jax.lax.scan(improve, jnp.zeros_like(weights), length=iterations)
        plan = rows[-1][:, None] + columns[None, :] - cost
        mass = jax.nn.logsumexp(plan, axis=1)
        moved = jnp.exp(plan - mass[:, None]) @ particles
        return Resampled(moved, mass, None)

    return resample
