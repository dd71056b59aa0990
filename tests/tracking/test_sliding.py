import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack import hough
from jaxtrack.models import PositionSensor
from jaxtrack.tracking import sliding
from jaxtrack.types import BeamScan, Pose, Scan

WINDOW = 5


def moving_target(looks, lost=()):
    """One target at 200 m/s, seen at every valid look, and one false detection."""
    time_s = 2.0 * np.arange(looks)
    target = np.stack([200.0 * time_s, np.full(looks, 80.0)], -1)
    false = np.random.default_rng(0).uniform(0.0, 3000.0, (looks, 2))
    valid = ~np.isin(np.arange(looks), lost)
    position = np.where(valid[:, None, None], np.stack([target, false], 1), np.nan)
    return Scan(time_s, valid, position, np.ones((looks, 2), bool))


def estimate(scans):
    sensor = PositionSensor(0.99, 1e-6, 10.0)
    sizes = hough.joint.JointSizes(tracks=2, hypotheses=64, candidates=16, starts=4)
    return hough.joint.estimate(scans, hough.joint.JointParams(sensor, gate=8.0), sizes=sizes)


def run(scans):
    tracker = sliding(estimate, like=jax.tree.map(lambda x: x[0], scans), window=WINDOW)
    return jax.lax.scan(tracker.step, tracker.init(jax.random.key(0)), scans)


RUN = jax.jit(run)


def test_each_step_is_the_estimate_of_its_window():
    scans = moving_target(9)
    _, info = RUN(scans)
    np.testing.assert_array_equal(info.looks, [1, 2, 3, 4, 5, 5, 5, 5, 5])
    alone = jax.jit(estimate)
    for last in (4, 6, 8):
        expected, _ = alone(jax.tree.map(lambda x, k=last: x[k - 4 : k + 1], scans))
        got = jax.tree.map(lambda x, k=last: x[k], info.tracks)
        assert expected.mask.any()
        for a, b in zip(got, expected, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9)
    # Three looks apart are the least that a pair needs.
    np.testing.assert_array_equal(info.tracks.mask.any(1), [False] * 3 + [True] * 6)


def test_a_look_that_was_lost_changes_nothing():
    scans = moving_target(9, lost=(5, 7))
    state, info = RUN(scans)
    np.testing.assert_array_equal(state.time_s, 2.0 * np.array([2, 3, 4, 6, 8]))
    assert state.valid.all()
    for lost in (5, 7):
        for leaf in jax.tree.leaves(info.tracks):
            np.testing.assert_array_equal(leaf[lost], leaf[lost - 1])
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(info.tracks))


def test_any_kind_of_look_will_do():
    pose = Pose(jnp.zeros((4, 2)), jnp.zeros(4))
    scans = BeamScan(
        jnp.arange(4.0), jnp.ones(4, bool), jnp.ones((4, 3)), jnp.ones((4, 3), bool), pose
    )
    tracker = sliding(
        lambda scans: (scans.range_m.sum(), None),
        like=jax.tree.map(lambda x: x[0], scans),
        window=2,
    )
    _, info = jax.lax.scan(tracker.step, tracker.init(jax.random.key(0)), scans)
    np.testing.assert_array_equal(info.tracks, [3.0, 6.0, 6.0, 6.0])


def test_the_window_is_checked():
    with pytest.raises(ValueError, match="window: got 0"):
        sliding(estimate, like=moving_target(1), window=0)
