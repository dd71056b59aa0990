"""The joint vote on the looks of a multi-beam sonar."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.hough.joint import JointParams, JointSizes, estimate
from jaxtrack.hough.pairs import SpeedGate
from jaxtrack.models import BEAMS, BeamSensor, BeamSonar
from jaxtrack.types import BeamScan, Pose
from tests.metrics.differences import assert_gradients_agree
from tests.oracles import beam_joint as oracle

pytestmark = pytest.mark.slow  # compiles for minutes where nothing is cached

LOOKS, COUNT = 12, 30
SONAR = BeamSonar(p_miss=0.1, p_false=0.1, sigma_m=2.0)
SPEED = SpeedGate(0.5, 6.0)
TRUTH = np.array([[80.0, 20.0, 1.0, -2.0], [60.0, -15.0, -1.0, 2.0]])  # at the last look
SIZES = JointSizes(
    tracks=3, hypotheses=1024, candidates=64, starts=8, gap=6, detections=14, survivors=256,
    samples=512,
)  # fmt: skip
track = jax.jit(functools.partial(estimate, sizes=SIZES, observation=BEAMS))


def scene(seed, *, targets=2):
    """Return looks half a second apart: a target is missed at a time, clutter stands elsewhere."""
    rng = np.random.default_rng(seed)
    time_s = 0.5 * np.arange(LOOKS)
    mask = rng.random((LOOKS, COUNT)) < SONAR.p_false
    range_m = rng.uniform(0.0, 150.0, mask.shape)
    for target in TRUTH[:targets]:
        place = target[:2] + (time_s - time_s[-1])[:, None] * target[2:]
        beam = np.floor(np.arctan2(place[:, 1], place[:, 0]) * 60 / math.pi + COUNT / 2).astype(int)
        mask[np.arange(LOOKS), beam] = rng.random(LOOKS) < 1 - SONAR.p_miss
        range_m[np.arange(LOOKS), beam] = np.hypot(*place.T) + 2.0 * rng.normal(size=LOOKS)
    pose = Pose(np.zeros((LOOKS, 2)), np.zeros(LOOKS))
    return BeamScan(time_s, np.ones(LOOKS, bool), np.where(mask, range_m, np.nan), mask, pose)  # pyright: ignore


def joint_params(gate=6.0):
    return JointParams(BeamSensor(SONAR), SPEED, gate)


def test_both_targets_are_found_where_they_are():
    for seed in range(6):
        tracks, info = track(scene(seed), joint_params())
        np.testing.assert_array_equal(tracks.mask, [True, True, False])
        assert not info.overflow
        for truth in TRUTH:
            off = np.asarray(tracks.mean[:2]) - truth
            sigma = np.sqrt(np.stack([np.diag(c) for c in tracks.covariance[:2]]))
            assert (np.abs(off) / sigma).max(axis=1).min() < 5.0
        # Tracks share a detection, they do not both have it.
        claimed = np.asarray(info.responsibility).sum(0)
        assert claimed.sum() > 10
        assert claimed.max() < 1 + 1e-9


@pytest.mark.parametrize("p_false", [0.001, 0.01])
def test_where_false_alarms_are_rare_no_target_is_found_twice(p_false):
    rare = BeamSonar(p_miss=0.1, p_false=p_false, sigma_m=2.0)
    for seed in range(6):
        tracks, _ = track(scene(seed), JointParams(BeamSensor(rare), SPEED, 6.0))
        apart = np.abs(np.asarray(tracks.mean[:, None, :2] - TRUTH[None, :, :2])).max(-1)
        assert (apart[np.asarray(tracks.mask)] < 10.0).sum(0).tolist() == [1, 1]


def test_a_lost_last_look_hides_nothing():
    looks = scene(3)
    valid = np.arange(LOOKS) < LOOKS - 1
    tracks, _ = track(looks._replace(valid=valid), joint_params())
    np.testing.assert_array_equal(tracks.mask, [True, True, False])
    assert tracks.time_s == looks.time_s[-2]


def test_a_lone_track_has_the_evidence_of_brute_force():
    scan = scene(11, targets=1)
    tracks, _ = track(scan, joint_params(gate=10.0))
    assert tracks.mask[0]
    assert not tracks.mask[1]
    # Draws from a Gaussian twice as wide as the posterior, each weighted by what it stands for.
    mean, covariance = np.asarray(tracks.mean[0]), 4.0 * np.asarray(tracks.covariance[0])
    root, rng = np.linalg.cholesky(covariance), np.random.default_rng(0)
    values = []
    for z in rng.normal(size=(4000, 4)):
        state = mean + root @ z
        log_density = -0.5 * z @ z - 2 * math.log(2 * math.pi) - np.log(np.diag(root)).sum()
        speed = math.hypot(*state[2:])
        inside = SPEED.v_min_m_s <= speed <= SPEED.v_max_m_s
        value = oracle.score(state, float(scan.time_s[-1]), scan, SONAR, 0.1, 0.02)
        values.append(value - log_density if inside else -math.inf)
    disc = math.pi * (SPEED.v_max_m_s**2 - SPEED.v_min_m_s**2)
    expected = np.log(np.mean(np.exp(np.array(values) - max(values)))) + max(values)
    np.testing.assert_allclose(tracks.log_score[0], expected - math.log(disc), atol=0.15)


def test_too_many_detections_say_so():
    full = scene(0)._replace(
        mask=np.ones((LOOKS, COUNT), bool), range_m=np.full((LOOKS, COUNT), 9.0)
    )
    assert track(full, joint_params())[1].overflow


@pytest.mark.parametrize("name", ["empty", "lost", "full"])
def test_degenerate_looks_give_no_nan(name):
    scan = scene(1)
    if name == "empty":
        scan = scan._replace(mask=np.zeros_like(scan.mask))
    if name == "lost":
        scan = scan._replace(valid=np.zeros_like(scan.valid))
    if name == "full":
        scan = scan._replace(mask=np.ones_like(scan.mask), range_m=np.full(scan.mask.shape, 50.0))
    tracks, info = track(scan, joint_params())
    for leaf in jax.tree.leaves((tracks, info.responsibility)):
        assert np.isfinite(leaf).all()
    if name != "full":
        assert not tracks.mask.any()


@pytest.mark.slow
def test_slopes_are_those_of_differences():
    # The samples stand still in the gradient and move with the search in a difference, so the two
    # agree as far as the samples are many, and no further.
    scan = scene(11, targets=1)

    def loss(sigma):
        sonar = SONAR._replace(sigma_m=2.0 * sigma)
        params = JointParams(BeamSensor(sonar), SPEED, 6.0)
        return track(jax.tree.map(jnp.asarray, scan), params)[0].log_score[0]

    assert_gradients_agree(loss, np.array(1.0), rtol=0.05, atol=0.05)
