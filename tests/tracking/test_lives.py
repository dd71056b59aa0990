"""The Kalman tracker with soft lives: what it tends to, and its slopes."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.tracking import (
    KalmanTrackerParams,
    LifecycleParams,
    Softness,
    kalman_tracker,
    soft_lives,
)
from jaxtrack.types import Scan
from tests.metrics.differences import assert_gradients_agree
from tests.tracking.test_kalman_tracker import scene

SLOTS = 3
LIVES = LifecycleParams(2, 3.0)


def params(numbers):
    sigma, sigma_a, gate, birth, level = numbers
    lives = LIVES._replace(confirm_score=level)
    return KalmanTrackerParams(sigma, sigma_a, 0.9, 1e-3, birth, gate=gate, lifecycle=lives)


NUMBERS = np.array([1.0, 0.3, 9.21, 4.0, 3.0])


@functools.cache
def compiled(soft):
    def run(scans, numbers, softness):
        lives = soft_lives(softness) if soft else None
        tracker = kalman_tracker(params(numbers), max_tracks=SLOTS, lives=lives)
        step = jax.checkpoint(tracker.step, prevent_cse=False)
        return jax.lax.scan(step, tracker.init(jax.random.key(0)), scans)[1].tracks

    return jax.jit(run)


def loss(scans, numbers, softness=None):
    """Return something that every track adds to by its existence."""
    tracks = compiled(True)(scans, numbers, Softness() if softness is None else softness)
    place = jnp.tanh((tracks.mean[..., 0] - 30.0) / 20.0) + 1.5
    return (tracks.existence * place).mean()


slopes = jax.jit(jax.grad(loss, argnums=1))


def test_tracks_tend_to_those_with_hard_lives():
    far = []
    for seed in range(6):
        scans = scene(seed)
        hard = compiled(False)(scans, NUMBERS, Softness())
        confirmed = np.asarray(hard.stage >= 2)
        found = [
            compiled(True)(scans, NUMBERS, Softness(*(f * w for w in Softness())))
            for f in (1.0, 0.1, 1e-5)
        ]
        far.append([np.abs(np.asarray(soft.existence) - confirmed).mean() for soft in found])
        np.testing.assert_array_equal(found[-1].stage, hard.stage)
        np.testing.assert_array_equal(found[-1].identity, hard.identity)
        np.testing.assert_allclose(found[-1].mean, hard.mean, rtol=1e-9, atol=1e-9)
        assert confirmed.any()
    wide, narrow, none = np.mean(far, axis=0)
    assert wide > narrow > none
    assert none < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_jitted_gradients_equal_differences(seed):
    of = functools.partial(loss, scene(seed))
    (gradient,) = assert_gradients_agree(of, NUMBERS, rtol=1e-5, atol=1e-8)
    assert (np.abs(gradient) > 1e-6).all()  # all five count


@pytest.mark.slow
def test_slopes_are_finite_where_there_is_nothing_or_too_much():
    plain = scene(5)
    full = plain._replace(position_m=np.nan_to_num(plain.position_m))
    cases = {
        "full": full._replace(mask=np.ones_like(full.mask)),
        "empty": plain._replace(mask=np.zeros_like(plain.mask)),
        "coincident": full._replace(position_m=np.full_like(full.position_m, 7.0)),
        "frozen": full._replace(time_s=np.zeros_like(full.time_s)),
        "none": plain._replace(valid=np.zeros_like(plain.valid)),
    }
    for name, case in cases.items():
        for numbers in (NUMBERS, NUMBERS / 50, NUMBERS * 50):
            assert np.isfinite(slopes(case, numbers)).all(), (name, numbers)


@pytest.mark.slow
def test_single_precision_stays_single_and_its_slopes_are_near():
    scans = scene(2)
    single = Scan(*(None if x is None else np.asarray(x, x.dtype if x.dtype == bool else np.float32)
                    for x in scans))  # fmt: skip
    softness = Softness(*map(np.float32, Softness()))
    found = jax.jit(jax.grad(loss, argnums=1))(single, np.float32(NUMBERS), softness)
    assert found.dtype == np.float32
    expected = slopes(scans, NUMBERS)
    np.testing.assert_allclose(found, expected, rtol=1e-2, atol=1e-4)
