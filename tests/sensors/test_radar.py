"""The simulated radar's statistics, each within four standard errors of what is asked for."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.sensors import Radar, clutter_per_scan, move, observe
from jaxtrack.types import Truth
from tests.oracles.joint import moved

LOOKS = 20_000


def standing(targets, looks=LOOKS):
    state = jnp.tile(jnp.array([900.0, 700.0, 0.0, 0.0]), (looks, targets, 1))
    return Truth(jnp.arange(float(looks)), state, jnp.ones((looks, targets), bool))


def assert_mean(samples, expected):
    error = np.std(samples, axis=0) / np.sqrt(len(samples))
    assert (np.abs(np.mean(samples, axis=0) - expected) <= 4 * error).all()


def test_detections_are_as_frequent_and_as_noisy_as_asked_for():
    radar = Radar(p_detect=0.8, sigma_m=10.0, clutter_per_scan=0.0)
    scans = observe(jax.random.key(0), standing(3), radar, detections=3)
    mask = np.asarray(scans.mask)
    assert_mean(mask.sum(axis=1), 3 * 0.8)
    assert_mean((mask.sum(axis=1) - 2.4) ** 2, 3 * 0.8 * 0.2)
    error = (np.asarray(scans.position_m) - (900.0, 700.0))[mask]
    assert_mean(error, 0.0)
    assert_mean(error**2, 10.0**2)
    assert_mean(error[:, 0] * error[:, 1], 0.0)
    assert_mean(error**4, 3 * 10.0**4)
    # One look's errors have nothing to do with the next one's.
    first = error[: len(error) // 2 * 2].reshape(-1, 2, 2)
    assert_mean(first[:, 0] * first[:, 1], 0.0)


def test_clutter_is_poisson_and_uniform_over_the_field():
    radar = Radar(p_detect=0.0, clutter_per_scan=10.0)
    scans = observe(jax.random.key(1), standing(1), radar, detections=48)
    count = np.asarray(scans.mask).sum(axis=1)
    assert_mean(count, 10.0)
    assert_mean((count - 10.0) ** 2, 10.0)
    low, high = np.array(radar.field_low_m), np.array(radar.field_high_m)
    place = (np.asarray(scans.position_m)[np.asarray(scans.mask)] - low) / (high - low)
    assert (place >= 0.0).all()
    assert (place < 1.0).all()
    cells = np.floor(place * 4).astype(int) @ [4, 1]
    share = np.bincount(cells, minlength=16) / len(cells)
    error = np.sqrt(share * (1 - share) / len(cells))
    assert (np.abs(share - 1 / 16) <= 4 * error).all()


def test_targets_stand_at_any_place_of_a_look():
    radar = Radar(p_detect=1.0, sigma_m=0.0, clutter_per_scan=100.0)
    scans = observe(jax.random.key(2), standing(1), radar, detections=6)
    assert scans.mask.all()
    target = (np.asarray(scans.position_m) == (900.0, 700.0)).all(axis=-1)
    assert (target.sum(axis=1) == 1).all()
    assert_mean(target, np.full(6, 1 / 6))


def test_what_is_not_there_is_not_seen():
    truth = standing(2, looks=50)
    mask = truth.mask.at[:, 1].set(False)
    state = truth.state.at[:, 1].set(jnp.nan)
    radar = Radar(p_detect=1.0, clutter_per_scan=0.0)
    scans = observe(jax.random.key(3), truth._replace(mask=mask, state=state), radar, detections=4)
    assert (scans.mask.sum(axis=1) == 1).all()
    assert np.isfinite(np.asarray(scans.position_m)[np.asarray(scans.mask)]).all()
    np.testing.assert_array_equal(scans.time_s, truth.time_s)
    assert scans.valid.all()


def test_keys_make_the_difference():
    run = jax.jit(lambda key: observe(key, standing(2, looks=5), Radar(), detections=8))
    first, again, other = (run(jax.random.key(n)).position_m for n in (0, 0, 1))
    assert (first == again).all()
    assert not (first == other).any()


def test_too_small_a_look_is_refused():
    with pytest.raises(ValueError, match="detections: got 1, want an int ≥ 2"):
        observe(jax.random.key(0), standing(2, looks=3), Radar(), detections=1)


def test_density_is_times_the_area():
    radar = Radar(field_low_m=(-1000.0, 500.0), field_high_m=(2000.0, 1500.0))
    np.testing.assert_allclose(clutter_per_scan(2.5, radar), 7.5)


def test_undisturbed_targets_run_straight():
    initial = np.random.default_rng(0).normal(scale=100.0, size=(4, 4))
    time_s = np.array([1.0, 1.5, 4.0])
    truth = jax.jit(move)(jax.random.key(0), initial, time_s)
    for k, now in enumerate(time_s):
        expected = [moved(state, now - 1.0) for state in initial]
        np.testing.assert_allclose(truth.state[k], expected, rtol=1e-12, atol=1e-10)
    assert truth.mask.all()
    np.testing.assert_array_equal(truth.time_s, time_s)


def test_process_noise_has_the_covariance_of_equation_33():
    dt, sigma, targets = 2.0, 5.0, 40
    time_s = dt * jnp.arange(500.0)
    initial = jnp.zeros((targets, 4))
    state = np.asarray(move(jax.random.key(1), initial, time_s, sigma).state)
    propagated = state[:-1] + dt * np.concatenate([state[:-1, :, 2:], 0 * state[:-1, :, 2:]], -1)
    step = (state[1:] - propagated).reshape(-1, 4)
    g = np.array([[dt / 2, 0.0], [0.0, dt / 2], [1.0, 0.0], [0.0, 1.0]])
    products = (step[:, :, None] * step[:, None, :]).reshape(-1, 16)
    assert_mean(products, (sigma**2 * g @ g.T).ravel())
    assert_mean(step, 0.0)
