"""A linear-Gaussian model of one variable, for which the Kalman filter is exact.

x_k = φ x_{k−1} + q ξ_k,   z_k = x_k + r η_k,   x_0 ~ N(0, 1)
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.filtering import gaussian, kalman
from jaxtrack.filtering.particle import particle_filter
from jaxtrack.types import Array


class Model(NamedTuple):
    phi: Array | float = 0.9
    process_sigma: Array | float = 0.7  # q
    noise_sigma: Array | float = 0.5  # r


MODEL = Model()


def looks(seed, size):
    """Return measurements [T]."""
    rng = np.random.default_rng(seed)
    x, z = rng.normal(), []
    for _ in range(size):
        x = MODEL.phi * x + MODEL.process_sigma * rng.normal()
        z.append(x + MODEL.noise_sigma * rng.normal())
    return np.array(z)


def log_normal(error, sigma):
    return -((error / sigma) ** 2) / 2 - jnp.log(sigma) - math.log(2 * math.pi) / 2


def build(model, resampler=None, *, particles, scored=True, share=2 / 3):
    """Return the particle filter of a model; `scored`: with the density of its motion."""

    def move(key, x, z):
        return model.phi * x + model.process_sigma * jax.random.normal(key, x.shape, x.dtype)

    def density(before, after, z):
        return log_normal((after - model.phi * before)[:, 0], model.process_sigma)

    def likelihood(x, z):
        return log_normal(z - x[:, 0], model.noise_sigma)

    return particle_filter(
        move,
        likelihood,
        resampler,
        particles=particles,
        initial=lambda key, size: jax.random.normal(key, (size, 1)),
        log_density=density if scored else None,
        resample_below=share,
    )


def run(model, z, key, resampler=None, **options):
    """Return state and info of the particle filter over measurements [T]."""
    filter = build(model, resampler, **options)
    return jax.lax.scan(filter.step, filter.init(key), z)


def kalman_run(model, z):
    """Return means [T], variances [T] and the log-likelihood of all measurements."""
    one = jnp.ones((1, 1))
    f, q, r = (x * one for x in (model.phi, model.process_sigma**2, model.noise_sigma**2))

    def step(state, z):
        after = kalman.update(*gaussian.predict(*state, f, q), z[None], one, r)
        return after[:2], (after.mean[0], after.covariance[0, 0], after.log_likelihood)

    mean, variance, log_likelihood = jax.lax.scan(step, (jnp.zeros(1), one), z)[1]
    return mean, variance, log_likelihood.sum()
