"""From recordings to tracks and motion elements, as a user's file goes through."""

import jax
import numpy as np
import pytest

from jaxtrack.hough import SpeedGate
from jaxtrack.models import BeamSonar
from jaxtrack.sensors import motion_elements_scene, observe_beams
from jaxtrack.tracking import motion_elements, track
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
        ({"speed": SpeedGate(5.0, 5.0)}, "v_max_m_s: got 5"),
    ],
)
def test_what_cannot_be_is_named(change, word):
    with pytest.raises(ValueError, match=word):
        track(recording(), **change)


def test_beams_want_their_sonar():
    scene = motion_elements_scene()
    looks = observe_beams(jax.random.key(0), *scene)
    with pytest.raises(ValueError, match="sonar: got None"):
        track(looks)
    with pytest.raises(ValueError, match="method: got 'best'"):
        motion_elements(looks, method="best")
