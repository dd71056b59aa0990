"""Scenes of the scanned sonar: what they promise of paths, places, truth and navigation."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.models import polar_to_earth
from jaxtrack.sensors import (
    IMAGENEX_881L,
    SUPER_SEAKING_LOW,
    DraggedBucket,
    PingSizes,
    ScanningPreset,
    ScanningSonar,
    dragged_bucket,
    meeting_pings,
    meeting_targets,
    situations,
)
from jaxtrack.types import Pose
from tests.oracles import frames
from tests.oracles import pings as oracle

SONAR = IMAGENEX_881L.sonar
FRAMES, RUNS = 14, 4
COARSE = ScanningPreset(SONAR, PingSizes(bins=200, facets=6, rays=4))


@functools.cache
def runs(motion, surroundings="clean", **scene):
    draw = lambda key, scene: dragged_bucket(
        key, motion, surroundings, scene=scene, frames=FRAMES, preset=COARSE
    )
    keys = jax.random.split(jax.random.key(7), RUNS)
    found = jax.jit(jax.vmap(draw, (0, None)))(keys, DraggedBucket(**scene))
    return jax.tree.map(np.asarray, found)


@pytest.mark.parametrize("motion", ["static", "hovering", "following"])
def test_targets_and_vehicles_move_as_the_motion_says(motion):
    found = runs(motion)
    place, state = found.pose.position_m, found.truth.state[:, :, 0]
    assert found.truth.mask.all()
    speed = np.linalg.norm(state[..., 2:], axis=-1)
    np.testing.assert_allclose(speed, 0.0 if motion == "static" else 0.1, atol=1e-12)
    assert found.crossing_s.shape == (RUNS, FRAMES, 1)
    came = np.linalg.norm(state[:, -1, :2] - state[:, 0, :2], axis=-1)
    duration = (found.crossing_s[:, -1] - found.crossing_s[:, 0])[:, 0]
    if motion == "static":
        assert (came == 0).all()
    else:
        assert (came < 0.1 * duration).all()
        assert (came > 0.09 * duration).all()
        # Towards the dike in the west.
        assert (state[:, -1, 1] < state[:, 0, 1] - 0.8 * came).all()
    ran = np.linalg.norm(place[:, -1, -1] - place[:, 0, 0], axis=-1)
    whole = 0.1 * 0.06 * (FRAMES * 101 - 1)
    if motion == "following":
        np.testing.assert_allclose(ran, whole, atol=1.7)
        gap = np.linalg.norm(state[..., :2] - place[:, :, 50], axis=-1)
        assert ((gap > 6.0) & (gap < 14.0)).all()
    else:
        assert (ran < 1.7).all()
    assert (ran > 0).all()
    gap = np.linalg.norm(state[:, 0, :2] - place[:, 0, 50], axis=-1)
    assert ((gap > 8.0) & (gap < 12.0)).all()
    assert (np.abs(found.pose.heading_rad + np.pi / 2) < np.deg2rad(6.0)).all()
    # One draw is not like the other.
    assert np.unique(state[:, 0, 0].round(6)).size == RUNS


def test_truth_is_taken_when_the_beam_crosses_the_target():
    found = runs("following")
    bearing, heading = found.pings.bearing_rad[0], found.pose.heading_rad
    for run in range(2):
        for t in range(FRAMES):
            q = round(float(found.crossing_s[run, t, 0]) / 0.06) - 101 * t
            now = found.truth.state[run, t, 0]
            places = now[:2] + 0.06 * (np.arange(101)[:, None] - q) * now[2:]  # all but straight
            at = found.pose.position_m[run, t], heading[run, t], SONAR.mount_m, SONAR.mount_rad
            ping, off = oracle.crossing(places, bearing[t], *at)
            assert (ping, off <= SONAR.step_rad) == (q, True)


def loud_cells(found, run, t, level=4.0):
    """Return earth positions of the cells above a level in one sweep, with the reported pose."""
    pings = jax.tree.map(lambda x: x[run, t], found.pings)
    width = 40.0 / pings.intensity.shape[1]
    return np.array([
        frames.to_earth((r + 0.5) * width, pings.bearing_rad[q] + SONAR.mount_rad,
                        pings.pose.position_m[q], pings.pose.heading_rad[q], SONAR.mount_m)
        for q, r in zip(*np.nonzero(pings.intensity > level), strict=True)
    ])  # fmt: skip


@pytest.mark.slow
def test_the_target_and_the_objects_beside_its_path_are_heard_where_they_are():
    quiet = ("hovering", "static")
    for motion in quiet:
        clean, cluttered = runs(motion), runs(motion, "two_objects")
        np.testing.assert_array_equal(clean.truth.state, cluttered.truth.state)
        for run in range(2):
            start, end = cluttered.truth.state[run, [0, -1], 0, :2]
            for t in (0, FRAMES // 2, FRAMES - 1):
                for found, objects in ((clean, 0), (cluttered, 2)):
                    here = found.truth.state[run, t, 0, :2]
                    cells = loud_cells(found, run, t)
                    near = cells[np.linalg.norm(cells - here, axis=1) < 1.0]
                    assert len(near) >= 3
                    # What faces the vehicle, in the east, is loud.
                    assert 0.0 < near.mean(axis=0)[1] - here[1] < 0.45
                    if motion == "static":
                        gap = np.linalg.norm(cells - here, axis=1)
                        beside = (gap > 1.0) & (gap < 2.5)
                        assert (beside.sum() > 3) == (objects > 0)
            assert np.linalg.norm(end - start) < 40.0


def test_the_dike_and_the_boat_are_heard():
    found = runs("hovering")
    cells = loud_cells(found, 0, 0)
    dike = (cells[:, 1] < -37.5) & (cells[:, 1] > -39.5)
    assert dike.sum() > 50
    boat = found.truth.state[0, 0, 0, :2] + 60.0 * found.truth.state[0, 0, 0, 2:]
    assert (np.linalg.norm(cells - boat, axis=1) < 1.5).sum() >= 3


def test_reported_poses_drift_and_echoes_come_from_the_true_one():
    exact, drifting = runs("following"), runs("following", drift=0.007)
    np.testing.assert_array_equal(exact.pings.pose.position_m, exact.pose.position_m)
    np.testing.assert_array_equal(exact.pose.position_m, drifting.pose.position_m)
    np.testing.assert_array_equal(exact.pings.intensity, drifting.pings.intensity)
    np.testing.assert_array_equal(exact.truth.state, drifting.truth.state)
    off = drifting.pings.pose.position_m - drifting.pose.position_m
    for run in range(RUNS):
        course = drifting.pose.position_m[run].reshape(-1, 2)
        distance = np.cumsum(np.linalg.norm(np.diff(course, axis=0), axis=1))
        got = np.linalg.norm(off[run].reshape(-1, 2), axis=1)
        np.testing.assert_allclose(got, np.r_[0.0, 0.007 * distance], atol=1e-9)


def test_a_target_that_is_gone_is_not_heard_and_not_true():
    there = jnp.arange(FRAMES) != 3
    draw = jax.jit(
        lambda there: dragged_bucket(
            jax.random.key(1), "static", there=there, frames=FRAMES, preset=COARSE
        )
    )
    found = jax.tree.map(lambda x: np.asarray(x)[None], draw(there))
    assert found.truth.mask[0, :, 0].tolist() == there.tolist()
    here = found.truth.state[0, 0, 0, :2]
    for t in (2, 3):
        near = np.linalg.norm(loud_cells(found, 0, t) - here, axis=1) < 1.0
        assert (near.sum() >= 3) == (t == 2)
    whole = draw(jnp.ones(FRAMES, bool))
    np.testing.assert_array_equal(whole.pings.intensity[4], found.pings.intensity[0, 4])


def test_two_targets_meet_a_sweep_a_step():
    meeting = situations()["B"].meeting._replace(sigma_a_m_s2=0.0)
    run = jax.jit(lambda key: meeting_pings(key, meeting))(jax.random.key(0))
    expected = np.asarray(meeting_targets(jax.random.key(0), meeting, looks=25).state[..., :2])
    state, mask = np.asarray(run.truth.state), np.asarray(run.truth.mask)
    assert mask.all()
    pings, ping_s = SUPER_SEAKING_LOW.sizes.pings, SUPER_SEAKING_LOW.sonar.ping_s
    share = np.asarray(run.crossing_s) / (pings * ping_s) - np.arange(24)[:, None]
    assert ((share >= 0) & (share < 1)).all()
    moved = expected[:-1] + share[..., None] * np.diff(expected, axis=0)
    np.testing.assert_allclose(state[..., :2], moved, atol=1e-9)
    np.testing.assert_allclose(
        state[..., 2:] * pings * ping_s, np.diff(expected, axis=0), atol=1e-9
    )
    # The loudest cell of a sweep is at one of the two.
    intensity = np.asarray(run.pings.intensity)
    for t in range(0, 24, 3):
        q, r = np.unravel_index(intensity[t].argmax(), intensity[t].shape)
        pose = Pose(run.pings.pose.position_m[t, q], run.pings.pose.heading_rad[t, q])
        at = polar_to_earth(jnp.array((r + 0.5) * 0.1), run.pings.bearing_rad[t, q], pose, (0, 0))
        assert np.linalg.norm(np.asarray(at) - state[t, :, :2], axis=-1).min() < 1.5


def test_one_trace_for_all_numbers_and_seeds_that_tell():
    traces = []

    @jax.jit
    def run(key, scene):
        traces.append(1)
        found = dragged_bucket(key, "hovering", scene=scene, frames=2, preset=COARSE)
        return found.pings.intensity

    scene = DraggedBucket()
    first = run(jax.random.key(0), scene)
    np.testing.assert_array_equal(first, run(jax.random.key(0), scene))
    assert not np.allclose(first, run(jax.random.key(1), scene))
    assert not np.allclose(first, run(jax.random.key(0), scene._replace(speed_m_s=0.25)))
    assert len(traces) == 1


def test_wrong_arguments_are_named():
    key = jax.random.key(0)
    with pytest.raises(ValueError, match="motion: got 'sinking', want one of static, hovering"):
        dragged_bucket(key, "sinking")
    with pytest.raises(ValueError, match="surroundings: got 'weeds', want one of clean"):
        dragged_bucket(key, "static", "weeds")
    with pytest.raises(ValueError, match=r"there: got shape \[3\], want \[30\]"):
        dragged_bucket(key, "static", there=jnp.ones(3, bool))
    with pytest.raises(ValueError, match="frames: got 0"):
        meeting_pings(key, situations()["A"].meeting, frames=0)
    assert ScanningSonar() == SONAR
