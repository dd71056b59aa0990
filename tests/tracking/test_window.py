"""From a recording to tracks: sizes and gate come from the data, wrong options are told."""

import math
import pathlib

import jax
import numpy as np
import pytest

from jaxtrack.hough import SpeedGate
from jaxtrack.io import read_detections
from jaxtrack.tracking import initiate_window
from jaxtrack.tracking.window_sizes import choose_sizes, field_of
from jaxtrack.types import Scan

EXAMPLE = pathlib.Path(__file__).parents[2] / "notebooks" / "radar_example.csv"
LAST_DOTS = np.array([[-7248.0, 26643.0], [-17794.0, 14169.0], [-16459.0, 28155.0]])
FIELD = {"sigma_m": 50.0, "false_per_run": 0.5}


@pytest.fixture(scope="module")
def recording():
    return read_detections(EXAMPLE)


def two_targets(looks: int = 5) -> Scan:
    """Two crossing targets, noise-free, with a masked NaN beside them."""
    time_s = 2.0 * np.arange(looks)
    x = np.stack([200.0 * time_s, 3000.0 - 150.0 * time_s, np.full(looks, np.nan)], -1)
    y = np.stack([np.full(looks, 80.0), 60.0 * time_s, np.full(looks, np.nan)], -1)
    mask = np.broadcast_to([True, True, False], x.shape)
    return Scan(time_s, np.ones(looks, bool), np.stack([x, y], -1), mask)  # pyright: ignore


@pytest.mark.parametrize(
    "method",
    [
        "joint",
        pytest.param("neutrosophic", marks=pytest.mark.slow),
        pytest.param("improved", marks=pytest.mark.slow),
    ],
)
def test_finds_the_three_targets_of_the_radar(recording, method):
    tracks, info = initiate_window(recording.scans, method=method, **FIELD)
    found = np.asarray(tracks.mean)[np.asarray(tracks.mask)]
    away = np.linalg.norm(found[:, None, :2] - LAST_DOTS[None], axis=-1)
    assert (away.min(axis=0) < 150.0).all()
    assert (np.asarray(tracks.log_score)[np.asarray(tracks.mask)] >= info.gate).all()
    assert info.trials == 20
    assert info.notes == ()


@pytest.mark.slow
@pytest.mark.parametrize("method", ["modified", "standard"])
def test_methods_without_a_speed_gate_run_on_few_detections(method):
    tracks, info = initiate_window(two_targets(), method=method, false_per_run=1.0)
    assert np.isfinite(np.asarray(tracks.mean)).all()
    assert math.isfinite(info.gate)
    assert info.smoothed_m.shape == (8, 5, 2)


@pytest.mark.slow
def test_states_looks_and_paths_agree():
    tracks, info = initiate_window(two_targets(), false_per_run=1.0)
    order = np.argsort(np.asarray(tracks.mean)[:2, 0])
    expected = np.array([[1600.0, 80.0, 200.0, 0.0], [1800.0, 480.0, -150.0, 60.0]])
    np.testing.assert_allclose(np.asarray(tracks.mean)[order], expected, atol=1.0)
    assert np.asarray(info.looks)[order].tolist() == [5, 5]
    np.testing.assert_allclose(
        np.asarray(info.smoothed_m)[order, 0], [[0.0, 80.0], [3000.0, 0.0]], atol=5.0
    )


def test_a_rarer_false_track_needs_a_higher_gate(recording):
    often, seldom = (
        initiate_window(recording.scans, sigma_m=50.0, false_per_run=rate)[1].gate
        for rate in (1, 0.1)
    )
    assert 0 < often < seldom


def test_the_seed_decides_the_gate_and_progress_is_told(recording):
    seen = []
    run = lambda seed: (
        initiate_window(
            recording.scans,
            key=jax.random.key(seed),
            on_progress=lambda done, total: seen.append((done, total)),
            **FIELD,
        )[1].gate
    )
    assert run(0) == run(0) != run(1)
    assert seen[-1] == (20, 20)


@pytest.mark.slow
def test_weights_covariances_and_delays_of_a_recording_are_used():
    scans = two_targets()
    shape = scans.mask.shape
    own = np.broadcast_to(25.0 * np.eye(2), (*shape, 2, 2))
    full = scans._replace(
        weight=np.ones(shape),  # pyright: ignore
        covariance_m2=own,  # pyright: ignore
        delay_s=np.zeros(shape),  # pyright: ignore
    )
    tracks, _ = initiate_window(full, false_per_run=1.0)
    assert int(tracks.mask.sum()) == 2
    nobody = full._replace(weight=np.zeros(shape))  # pyright: ignore
    assert int(initiate_window(nobody, false_per_run=1.0)[0].mask.sum()) == 0


def test_one_look_or_no_detection_starts_no_track():
    scans = two_targets()
    one = jax.tree.map(lambda x: x[:1], scans)
    none = scans._replace(mask=np.zeros_like(scans.mask))
    for few, why in ((one, "one look"), (none, "no detections")):
        tracks, info = initiate_window(few)
        assert not np.asarray(tracks.mask).any()
        assert info.gate == math.inf
        assert why in info.notes[0]


@pytest.mark.slow
def test_two_looks_are_enough_to_try():
    scans = jax.tree.map(lambda x: x[:2], two_targets())
    tracks, info = initiate_window(scans, method="improved", false_per_run=1.0)
    assert math.isfinite(info.gate)
    assert tracks.mask.shape == (8,)


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("sigma_m", -1.0),
        ("sigma_m", math.nan),
        ("p_detect", 1.0),
        ("p_detect", 0.0),
        ("false_per_run", 0.0),
        ("false_per_run", 1e-9),
        ("max_tracks", 0),
        ("method", "magic"),
        ("speed", SpeedGate(400.0, 100.0)),
        ("speed", SpeedGate(-1.0, 100.0)),
        ("speed", SpeedGate(1.0, math.inf)),
    ],
)
def test_wrong_options_are_named(option, value):
    with pytest.raises(ValueError, match=f"{option}.*: got .*, want"):
        initiate_window(two_targets(), **{option: value})


def test_field_and_density_of_a_box():
    scans = two_targets()
    field = field_of(scans, 10.0)
    np.testing.assert_allclose(field.centre_m, [1500.0, 240.0])
    assert field.detections_per_look == 2.0
    assert field.clutter_per_m2 == pytest.approx(2.0 / (3000.0 * 480.0))
    still = scans._replace(position_m=np.zeros_like(scans.position_m))
    assert field_of(still, 10.0).clutter_per_m2 == pytest.approx(2.0 / 100.0**2)


def test_limits_that_are_hit_are_told(monkeypatch):
    scans = two_targets()
    field = field_of(scans, 10.0)
    args = (scans, field, SpeedGate(), 10.0)
    sizes, notes = choose_sizes(*args, method="modified", tracks=4)
    assert sizes.pairs >= 4  # pyright: ignore
    assert notes == ()
    monkeypatch.setattr("jaxtrack.tracking.window_sizes.MOST_PAIRS", 3)
    _, notes = choose_sizes(*args, method="modified", tracks=4)
    assert notes == ("there are 4 pairs of successive looks, of which 3 fit",)
    wide = field._replace(rho_max_m=1e6)
    _, notes = choose_sizes(scans, wide, SpeedGate(), 10.0, method="standard", tracks=4)
    assert "977 m along ρ instead of 5 m" in notes[-1]


def test_too_many_distant_pairs_are_sought_farther_apart(monkeypatch):
    scans = two_targets(looks=8)
    field = field_of(scans, 10.0)
    args = (scans, field, SpeedGate(), 10.0)
    free, _ = choose_sizes(*args, method="joint", tracks=4)
    assert free.gap == 4  # pyright: ignore
    monkeypatch.setattr("jaxtrack.tracking.window_sizes.MOST_HYPOTHESES", 16)
    tight, notes = choose_sizes(*args, method="joint", tracks=4)
    assert tight.gap > 4  # pyright: ignore
    assert notes == ()


def test_broken_recordings_are_refused():
    scans = two_targets()
    position = np.asarray(scans.position_m).copy()
    position[1, 0, 1] = np.nan
    with pytest.raises(ValueError, match=r"position_m: got .* at \[1, 0\], want finite"):
        initiate_window(scans._replace(position_m=position))  # pyright: ignore
    back = np.asarray(scans.time_s)[::-1]
    with pytest.raises(ValueError, match=r"time_s: got .* do not run back"):
        initiate_window(scans._replace(time_s=back))  # pyright: ignore
