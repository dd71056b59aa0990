"""Amplitudes: the K distribution's moments and law, its correlation, the target's power."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, stats

from jaxtrack.models import BeamSonar
from jaxtrack.sensors import Echo, echo_amplitudes, observe_beams, reverberate
from jaxtrack.types import Pose, Truth

LOOKS, BEAMS = 20_000, 12
draw = jax.jit(echo_amplitudes, static_argnames=("degrees", "dtype"))


def amplitudes(seed, target, echo=None, degrees=4):
    target = jnp.broadcast_to(jnp.asarray(target), (LOOKS, BEAMS))
    echo = Echo() if echo is None else echo
    return np.asarray(draw(jax.random.key(seed), target, echo, degrees=degrees, dtype=jnp.float64))


def assert_mean(samples, expected):
    error = np.std(samples, axis=0) / np.sqrt(len(samples))
    assert (np.abs(np.mean(samples, axis=0) - expected) <= 4 * error).all()


def k_distribution(amplitude, nu):
    """P(a ≤ amplitude): an exponential power whose mean is gamma-distributed, integrated."""
    texture = stats.gamma(nu, scale=1 / nu)
    silent = lambda t: np.exp(-(amplitude**2) / t) * texture.pdf(t)
    return 1 - integrate.quad(silent, 0.0, np.inf)[0]


@pytest.mark.parametrize("degrees", [1, 4])
def test_clutter_is_k_distributed_in_every_beam(degrees):
    a = amplitudes(0, False, degrees=degrees)
    nu = degrees / 2
    assert_mean(a**2, 1.0)
    assert_mean(a**4, 2 * (1 + 1 / nu))
    for beam in (0, BEAMS - 1):
        for level in (0.3, 1.0, 2.0):
            expected = k_distribution(level, nu)
            error = np.sqrt(expected * (1 - expected) / LOOKS)
            assert abs((a[:, beam] <= level).mean() - expected) <= 4 * error


def test_the_texture_is_correlated_along_the_beams_and_no_further():
    # Powers are τ e, e ~ Exp(1): E[p p'] − 1 = cov(τ, τ') = e^(−d/ℓ) / ν.
    power = amplitudes(1, False, Echo(correlation_beams=2.0)) ** 2
    for apart in (1, 2, 5):
        products = power[:, 3] * power[:, 3 + apart]
        assert_mean(products, 1 + np.exp(-apart / 2.0) / 2.0)
    assert_mean(power[1:, 3] * power[:-1, 3], 1.0)


def test_a_target_adds_its_power():
    a = amplitudes(2, jnp.arange(BEAMS) == 5, Echo(snr_db=10.0))
    assert_mean(a[:, 5] ** 2, 11.0)
    assert_mean(np.delete(a, 5, axis=1) ** 2, 1.0)


def test_intensities_come_with_detections_and_change_nothing_else():
    looks = 500
    truth = Truth(jnp.zeros(looks), jnp.tile(jnp.array([80.0, 1, 0, 0]), (looks, 1, 1)),
                  jnp.ones((looks, 1), bool))  # fmt: skip
    pose = Pose(jnp.zeros((looks, 2)), jnp.zeros(looks))
    sonar = BeamSonar(p_miss=0.3, clutter_in_missed_beam=1.0)
    run = jax.jit(lambda echo: observe_beams(jax.random.key(0), truth, pose, sonar, echo=echo))
    silent, loud = run(None), run(Echo(snr_db=20.0))
    assert silent.intensity is None
    np.testing.assert_array_equal(silent.range_m, loud.range_m)
    np.testing.assert_array_equal(silent.mask, loud.mask)
    mask, intensity = np.asarray(loud.mask), np.asarray(loud.intensity)
    assert not intensity[~mask].any()
    assert (intensity[mask] > 0).all()
    detected = mask[:, 45] & (np.abs(np.asarray(loud.range_m)[:, 45] - 80.0) < 15.0)
    assert intensity[:, 45][detected].mean() > 5 * intensity[:, :40][mask[:, :40]].mean()


def test_reverberation_is_k_distributed_in_independent_cells_and_echoes_add_to_it():
    run = jax.jit(reverberate, static_argnames="shape")
    power = jnp.broadcast_to(jnp.array([0.0, 0.0, 10.0]), (LOOKS, 3))
    for shape in (1, 3):
        a = np.asarray(run(jax.random.key(3), power, shape=shape))
        assert_mean(a[:, 0] ** 2, 1.0)
        assert_mean(a[:, 0] ** 4, 2 * (1 + 1 / shape))
        assert_mean(a[:, 0] ** 2 * a[:, 1] ** 2, 1.0)
        assert_mean(a[:, 2] ** 2, 11.0)
        for level in (0.3, 1.0, 2.0):
            expected = k_distribution(level, shape)
            error = np.sqrt(expected * (1 - expected) / LOOKS)
            assert abs((a[:, 0] <= level).mean() - expected) <= 4 * error
    assert run(jax.random.key(0), jnp.zeros(4, jnp.float32)).dtype == jnp.float32
    with pytest.raises(ValueError, match="shape: got 33, want an int ≤ 32"):
        reverberate(jax.random.key(0), power, shape=33)
