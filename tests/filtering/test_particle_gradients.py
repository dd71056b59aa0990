"""Gradients of the particle filter: against loops, differences, and the Kalman filter's."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.filtering.particle import particle_filter
from jaxtrack.filtering.resampling import soft, stop_gradient, systematic
from jaxtrack.filtering.transport import optimal_transport
from tests.filtering import linear_gaussian
from tests.filtering.linear_gaussian import MODEL, Model, kalman_run, log_normal, looks
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import particle as oracle

DRAW = jax.random.key(99)
KEY = jax.random.key(0)


def always(key, particles, log_weight):
    """Resample with one and the same number."""
    return systematic(DRAW, particles, log_weight)


def test_the_score_is_that_of_a_loop():
    size, length = 8, 6
    rng = np.random.default_rng(1)
    z, start, noise = looks(1, length), rng.normal(size=(size, 1)), rng.normal(size=(length, size))
    phi, q, r = MODEL

    def loss(model):
        filter = particle_filter(
            lambda key, x, look: model.phi * x + model.process_sigma * look[1][:, None],
            lambda x, look: log_normal(look[0] - x[:, 0], model.noise_sigma),
            stop_gradient(always),
            particles=size,
            initial=lambda key, n: jnp.asarray(start),
            log_density=lambda before, after, look: log_normal(
                (after - model.phi * before)[:, 0], model.process_sigma
            ),
        )
        state, info = jax.lax.scan(filter.step, filter.init(KEY), (z, noise))
        return state.log_likelihood, info

    def slopes(z, before, after):
        moved, error = (after - phi * before)[0], z - after[0]
        return np.array(
            [moved * before[0] / q**2, moved**2 / q**3 - 1 / q, error**2 / r**3 - 1 / r]
        )

    dicts = [
        {"valid": True, "z": z[k], "noise": noise[k], "slopes": functools.partial(slopes, z[k])}
        for k in range(length)
    ]
    u = float(jax.random.uniform(DRAW, (), jnp.float64))
    done = oracle.run(
        start,
        dicts,
        lambda particle, i, look: phi * particle + q * look["noise"][i],
        lambda particle, look: (
            np.exp(-(((look["z"] - particle[0]) / r) ** 2) / 2) / r / np.sqrt(2 * np.pi)
        ),
        lambda weights: oracle.systematic(weights, u),
        2 / 3,
    )
    gradient, info = jax.jit(jax.grad(loss, has_aux=True))(Model(*map(jnp.asarray, MODEL)))
    assert 0 < info.resampled.sum() < length
    np.testing.assert_array_equal(info.resampled, [one["resampled"] for one in done])
    np.testing.assert_allclose(gradient, sum(one["score"] for one in done), rtol=1e-9)


@pytest.mark.parametrize(
    ("resampler", "share"),
    [(systematic, 0.0), (soft(systematic, 0.5), 0.9), (optimal_transport(iterations=20), 0.9)],
)
def test_gradients_through_states_agree_with_central_differences(resampler, share):
    # Ancestors do not change within the step of the differences.
    z = looks(2, 6)

    def loss(model, z):
        run = linear_gaussian.run(
            Model(*model), z, KEY, resampler, particles=10, scored=False, share=share
        )
        return run[0].log_likelihood + run[1].mean.sum()

    gradients = assert_gradients_agree(loss, np.array(MODEL), z, rtol=1e-5, atol=1e-7)
    assert all(np.abs(g).min() > 1e-4 for g in gradients)


def test_a_density_leaves_values_alone_and_stops_the_states():
    z = looks(3, 8)
    a, b = (linear_gaussian.run(MODEL, z, KEY, particles=50, scored=s) for s in (True, False))
    for x, y in zip(a[1], b[1], strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-12)

    def spread(phi):
        model = MODEL._replace(phi=phi)
        return linear_gaussian.run(model, z, KEY, particles=50)[1].particles.sum()

    assert float(jax.grad(spread)(0.9)) == 0


def errors(z, runs, particles, seed):
    """Return estimates of the score less the Kalman filter's, [runs, 3]."""
    model = Model(*map(jnp.asarray, MODEL))
    exact = jax.grad(lambda m: kalman_run(m, z)[2])(model)

    def score(key):
        loss = lambda m: linear_gaussian.run(m, z, key, particles=particles)[0].log_likelihood
        return jnp.stack(jax.grad(loss)(model)) - jnp.stack(exact)

    keys = jax.random.split(jax.random.key(seed), runs)
    return np.asarray(jax.jit(lambda keys: jax.lax.map(score, keys, batch_size=4))(keys))


def assert_unbiased(error, times):
    bound = times * error.std(0, ddof=1) / len(error) ** 0.5
    assert (np.abs(error.mean(0)) < bound).all(), (error.mean(0), bound / times)
    return bound


def test_the_score_is_the_kalman_filters():
    bound = assert_unbiased(errors(jnp.asarray(looks(4, 20)), 64, 400, seed=4), 4)
    assert bound.max() < 2.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_the_score_is_the_kalman_filters_at_full_size(seed):
    bound = assert_unbiased(errors(jnp.asarray(looks(seed, 50)), 200, 1600, seed=seed + 10), 3)
    assert bound.max() < 1.0


def test_without_correction_the_score_is_biased():
    z, runs = jnp.asarray(looks(4, 20)), 32
    exact = jax.grad(lambda phi: kalman_run(MODEL._replace(phi=phi), z)[2])(0.9)

    def slope(key):
        loss = lambda phi: (
            linear_gaussian.run(
                MODEL._replace(phi=phi), z, key, systematic, particles=400, scored=False
            )[0].log_likelihood
        )
        return jax.grad(loss)(0.9)

    got = np.asarray(jax.jit(jax.vmap(slope))(jax.random.split(jax.random.key(5), runs)))
    assert abs(got.mean() - exact) > 4 * got.std() / runs**0.5
