"""From recordings to tracks and motion elements, as a user's file goes through."""

import typing

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.cli.files import estimate
from jaxtrack.cli.files import track as track_file
from jaxtrack.hough import SpeedGate
from jaxtrack.hough.pairs import distant_pairs
from jaxtrack.models import POSITION, BeamSonar
from jaxtrack.sensors import motion_elements_scene, observe_beams
from jaxtrack.tracking import ESTIMATORS, TRACKERS, motion_elements, track
from jaxtrack.tracking.prepared import joint_sizes
from jaxtrack.tracking.track_program import program
from jaxtrack.tracking.window_sizes import _admissible, most_pairs
from jaxtrack.types import Scan

SPEED, SIGMA_M, LOOKS = SpeedGate(0.0, 60.0), 4.0, 14
TRUTH = np.array([[0.0, 500.0, 30.0, -20.0], [400.0, 0.0, -10.0, 35.0]])


def recording(seed=0, *, clutter=3, p_seen=0.9):
    """Two targets and clutter over a field of 1 km²; the first two places are the targets'."""
    rng = np.random.default_rng(seed)
    time = np.arange(float(LOOKS))
    path = TRUTH[:, None, :2] + time[None, :, None] * TRUTH[:, None, 2:]
    own = path.swapaxes(0, 1) + SIGMA_M * rng.normal(size=(LOOKS, 2, 2))
    other = rng.uniform(-200, 800, (LOOKS, clutter, 2))
    mask = np.concatenate(
        [rng.random((LOOKS, 2)) < p_seen, np.ones((LOOKS, clutter), bool)], axis=1
    )
    return Scan(time, np.ones(LOOKS, bool), np.concatenate([own, other], axis=1), mask)


@pytest.mark.parametrize("tracker", ["joint", "belief_propagation"])
def test_targets_in_clutter_are_followed_and_clutter_is_not(tracker):
    tracks, info = track(
        recording(),
        tracker=tracker,
        speed=SPEED,
        sigma_m=SIGMA_M,
        max_tracks=8 + 16 * (tracker != "joint"),
    )
    last = np.asarray(tracks.mask[-1])
    assert last.sum() == 2
    found = np.asarray(tracks.mean[-1])[last]
    end = TRUTH[:, :2] + (LOOKS - 1) * TRUTH[:, 2:]
    gap = np.linalg.norm(found[:, None, :2] - end[None], axis=-1)
    assert sorted(gap.argmin(1)) == [0, 1]
    assert gap.min(1).max() < 3 * SIGMA_M
    assert len(np.unique(np.asarray(tracks.identity)[np.asarray(tracks.mask)])) == 2
    assert info.notes == ()
    # Neither waits for a window of ten looks.
    assert np.flatnonzero(np.asarray(tracks.mask).sum(1) == 2)[0] < 8


@pytest.mark.parametrize("tracker", ["csht", "sht", "kalman_paper"])
def test_the_papers_trackers_follow_a_lone_target(tracker):
    """They are weak, as their papers have them: among others' tracks there is one of the target."""
    scans = recording(3, clutter=1)
    alone = scans._replace(mask=scans.mask & (np.arange(3) == 0))
    tracks, info = track(alone, tracker=tracker, speed=SPEED, sigma_m=SIGMA_M, max_tracks=6)
    mask = np.asarray(tracks.mask)
    path = TRUTH[0, :2] + np.arange(float(LOOKS))[:, None] * TRUTH[0, 2:]
    off = np.linalg.norm(np.asarray(tracks.mean)[..., :2] - path[:, None], axis=-1)
    near = (mask & (off < 5 * SIGMA_M)).any(1)
    assert near[-7:].mean() > 0.6  # the clusters share a lone target's detections
    assert info.unit == ("nats" if tracker == "kalman_paper" else "detections")
    assert (np.asarray(tracks.log_score)[mask] >= (0 if info.unit == "nats" else 1)).all()


def test_motion_elements_are_those_of_the_targets():
    scans = recording(1)
    found = motion_elements(scans, speed=SPEED, sigma_m=SIGMA_M, max_tracks=4)
    initial = np.asarray(found.initial)[np.asarray(found.tracks.mask)]
    order = initial[:, 0].argsort()
    assert len(order) == 2
    np.testing.assert_allclose(initial[order], TRUTH, atol=3 * SIGMA_M)


@pytest.mark.parametrize("method", ["csht", "sht"])
def test_the_papers_votes_find_a_lone_target_in_cells_of_the_data(method):
    scans = recording(2, clutter=1)
    alone = scans._replace(mask=scans.mask & (np.arange(3) == 0))
    found = motion_elements(alone, method=method, speed=SPEED, sigma_m=SIGMA_M, max_tracks=3)
    initial = np.asarray(found.initial)[np.asarray(found.tracks.mask)]
    gap = np.abs(initial - TRUTH[0]).max(1)
    assert gap.min() < 5 * SIGMA_M


@pytest.mark.slow
def test_a_burst_in_the_last_looks_fits_too():
    rng = np.random.default_rng(4)
    counts = np.array([9] * 20 + [30, 60, 90, 120])
    mask = np.arange(120)[None] < counts[:, None]
    scans = Scan(np.arange(24.0), counts > 0, rng.uniform(-90, 90, (24, 120, 2)), mask)
    sizes, notes = joint_sizes(scans, SPEED, window=20, tracks=2)
    window = jax.tree.map(lambda x: jnp.asarray(x[-20:]), scans)
    _, _, overflow = distant_pairs(window, SPEED, gap=sizes.gap, hypotheses=sizes.hypotheses)
    assert not overflow
    assert notes == ()
    loop = [
        sum(
            int(_admissible(scans, k, m, SPEED).sum())
            for k in range(e - 19, e)
            for m in range(k + 3, e + 1)
        )
        for e in range(19, 24)
    ]
    assert most_pairs(scans, SPEED, gap=3, window=20) == max(loop)


def test_recordings_alike_share_one_program():
    before = program.cache_info().misses
    for seed in (5, 6):
        tracks, _ = track(recording(seed), tracker="greedy", speed=SPEED, sigma_m=4.0 + seed)
        assert tracks.mask.any()
    run = program("greedy", None, POSITION, 10, 32)
    assert program.cache_info().misses == before + 1
    assert run._cache_size() == 1  # pyright: ignore[reportFunctionMemberAccess]


def test_where_nothing_is_nothing_is_found():
    scans = recording()
    nothing = scans._replace(mask=np.zeros_like(scans.mask))
    tracks, _ = track(nothing, tracker="optimal", speed=SPEED, sigma_m=SIGMA_M)
    assert not tracks.mask.any()
    found = motion_elements(nothing, method="sht", speed=SPEED, sigma_m=SIGMA_M, max_tracks=2)
    assert not found.tracks.mask.any()


@pytest.mark.slow
@pytest.mark.parametrize("tracker", ["joint", "optimal"])
def test_a_sonars_beams_are_followed_where_it_can_see(tracker):
    scene = motion_elements_scene()
    sonar = BeamSonar(p_miss=0.1, p_false=0.02)
    looks = observe_beams(jax.random.key(3), scene.truth, scene.pose, sonar)
    tracks, _ = track(
        looks, tracker=tracker, sonar=sonar, speed=SpeedGate(0.0, 6.0), window=20, max_tracks=16
    )
    last = np.asarray(tracks.mask[-1])
    found = np.asarray(tracks.mean[-1])[last][:, :2]
    end = np.asarray(scene.truth.state[-1, :, :2])
    gap = np.linalg.norm(found[:, None] - end[None], axis=-1)
    assert sorted(gap.argmin(1)) == [0, 1, 2]
    assert gap.min(1).max() < 9.0


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"tracker": "best"}, "tracker: got 'best'"),
        ({"tracker": "jpda", "max_tracks": 11}, "max_tracks: got 11, want at most 10"),
        ({"sigma_m": 0.0}, "sigma_m: got 0"),
        ({"sigma_a_m_s2": -1.0}, "sigma_a_m_s2: got -1"),
        ({"p_detect": 1.0}, "p_detect: got 1"),
        ({"false_per_window": 0.0}, "false_per_window: got 0"),
        ({"window": 2}, "window: got 2"),
        ({"echoes": 0.5}, "echoes: got 0.5"),
        (
            {"echoes": 3.0, "tracker": "jpda"},
            "echoes: got 3.0, want 1 with jpda; several take cloud",
        ),
        ({"speed": SpeedGate(5.0, 5.0)}, "v_max_m_s: got 5"),
    ],
)
def test_what_cannot_be_is_named(change, word):
    with pytest.raises(ValueError, match=word):
        track(recording(), **change)


@pytest.mark.slow
@pytest.mark.parametrize("p_false", [0.0, 1.0])
def test_a_sonar_without_or_full_of_false_alarms_finds_its_targets(p_false):
    scene = motion_elements_scene()
    sonar = BeamSonar(p_miss=0.1, p_false=p_false, sigma_m=1.0)
    looks = observe_beams(jax.random.key(3), scene.truth, scene.pose, sonar)
    found = motion_elements(looks, sonar=sonar, speed=SpeedGate(0.0, 6.0), max_tracks=4)
    position = np.asarray(found.tracks.mean)[np.asarray(found.tracks.mask)][:, :2]
    end = np.asarray(scene.truth.state[-1, :, :2])
    gap = np.linalg.norm(position[:, None] - end[None], axis=-1)
    assert sorted(gap.argmin(1)) == [0, 1, 2]


def test_targets_that_no_detection_supports_are_left_out():
    scans = recording(1, clutter=1)
    clutter = scans._replace(mask=scans.mask & (np.arange(3) == 2))
    found = motion_elements(clutter, method="csht", speed=SPEED, sigma_m=SIGMA_M, max_tracks=6)
    # Three clusters to start with are three targets, where there is none.
    assert "left out, as no detection is near: 2 targets" in found.notes
    mask = np.asarray(found.tracks.mask)
    assert mask.sum() == 1
    assert (np.asarray(found.tracks.log_score)[mask] > 0).all()


def test_beams_want_their_sonar():
    scene = motion_elements_scene()
    looks = observe_beams(jax.random.key(0), *scene)
    with pytest.raises(ValueError, match="sonar: got None"):
        track(looks)
    with pytest.raises(ValueError, match="method: got 'best'"):
        motion_elements(looks, method="best")
    with pytest.raises(ValueError, match="sonar: got one with looks at positions"):
        track(recording(), sonar=BeamSonar())


def test_the_command_line_offers_every_tracker_and_estimator():
    for command, option, names in (
        (track_file, "tracker", TRACKERS),
        (estimate, "method", ESTIMATORS),
    ):
        assert typing.get_args(typing.get_type_hints(command)[option]) == names
