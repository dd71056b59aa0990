"""Floors with known association: against brute-force integration, a loopy fit, and each other."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.metrics import (
    KnownDetections,
    all_pass_at_truth,
    known_least_squares,
    known_posterior_mean,
)
from jaxtrack.models import BeamSonar
from jaxtrack.types import Pose
from tests.oracles import beam_floor as oracle
from tests.oracles.beam_joint import seen_from_sonar

pytestmark = pytest.mark.slow  # compiles for minutes where nothing is cached

COUNT = 12  # beams of 7.5°: wide, so that the beams' edges matter
SONAR = BeamSonar(p_miss=0.3, sigma_m=3.0, mount_m=(1.0, 0.5))
SPEED = (0.5, 6.0)
mean_of = jax.jit(functools.partial(known_posterior_mean, beams=COUNT, samples=4096))
fit = jax.jit(functools.partial(known_least_squares, beams=COUNT))


def known(seed, looks=10):
    """Return a target's state at the last look, and its detections there and before."""
    rng = np.random.default_rng(seed)
    dt = 0.8 * np.arange(1.0 - looks, 1.0)
    truth = np.array([80.0, 10.0, *rng.uniform(-2.5, 2.5, 2)])
    position, heading = rng.normal(size=(looks, 2)), rng.normal(scale=0.1, size=looks)
    ranges, beams = np.zeros(looks), np.zeros(looks, int)
    for k in range(looks):
        place = truth[:2] + dt[k] * truth[2:]
        pose = (*position[k], heading[k])
        rho, bearing = seen_from_sonar(*place, pose, SONAR.mount_m)
        ranges[k] = rho + 3.0 * rng.normal()
        beams[k] = math.floor(bearing / (SONAR.sector_rad / COUNT) + COUNT / 2)
    mask = rng.random(looks) < 0.8
    ranges = np.where(mask, ranges, np.nan)
    return truth, KnownDetections(dt, Pose(position, heading), ranges, beams, mask)  # pyright: ignore


def loops(seen):
    poses = np.concatenate([seen.pose.position_m, seen.pose.heading_rad[:, None]], axis=1)
    return seen.elapsed_s, poses, seen.range_m, seen.beam, seen.mask, SONAR, COUNT


@pytest.mark.parametrize("seed", [0])
def test_posterior_mean_is_that_of_brute_force(seed):
    truth, seen = known(seed)
    got = mean_of(jax.random.key(seed), seen, SONAR, SPEED, truth)
    spread = np.sqrt(np.diag(got.covariance))
    density = lambda state: oracle.log_posterior(state, *loops(seen), SPEED)
    rng = np.random.default_rng(0)
    expected = oracle.posterior_mean(density, got.state, np.asarray(got.covariance), 12_000, rng)
    assert got.effective_samples > 100
    np.testing.assert_allclose((got.state - expected) / spread, 0.0, atol=0.15)


def test_least_squares_is_that_of_the_loop():
    for seed in range(3):
        truth, seen = known(seed)
        got = fit(seen, SONAR, truth)
        state, covariance = oracle.least_squares(truth, *loops(seen))
        assert got.determined
        np.testing.assert_allclose(got.state, state, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(got.covariance, covariance, rtol=1e-4, atol=1e-8)


def test_on_average_nothing_lies_below_the_floor():
    def errors(seed):
        truth, seen = known(seed, looks=7)
        floor = mean_of(jax.random.key(seed), seen, SONAR, SPEED, truth).state
        return [((np.asarray(x) - truth) ** 2) for x in (floor, fit(seen, SONAR, truth).state)]

    floor, reference = np.array([errors(seed) for seed in range(40)]).mean(axis=0)
    assert (floor[:2].sum() < reference[:2].sum()) & (floor[2:].sum() < reference[2:].sum())


def test_too_few_detections_give_no_nan():
    truth, seen = known(0)
    for count in (0, 1):
        few = seen._replace(mask=np.arange(10) < count)
        least = fit(few, SONAR, truth)
        assert not least.determined
        np.testing.assert_array_equal(least.state, truth)
        for leaf in jax.tree.leaves(mean_of(jax.random.key(0), few, SONAR, SPEED, truth)):
            assert np.isfinite(leaf).all()


def test_the_ceiling_asks_all_that_exist():
    scores, there = jnp.array([12.0, 9.5, -jnp.inf, jnp.nan]), np.array([True, True, False, False])
    passes = jax.jit(all_pass_at_truth)
    assert passes(scores, there, 9.4)
    assert not passes(scores, there, 9.6)  # one of them does not
    assert not passes(scores, there | [False, False, True, False], 9.4)
    assert passes(scores, np.zeros(4, bool), 9.4)  # of nobody, all pass


def test_wrong_shapes_are_told():
    truth, seen = known(0)
    with pytest.raises(ValueError, match="start"):
        known_least_squares(seen, SONAR, jnp.asarray(truth[:2]), beams=COUNT)
