import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtrack.io import DataError, scans_from_arrays

UNIX_S = 1.7e9
UTM_M = np.array([565_432.1, 5_934_567.8])


def test_unix_time_and_utm_survive_float32():
    rng = np.random.default_rng(1)
    time_s = UNIX_S + 0.1 * np.arange(50)
    position_m = UTM_M + rng.uniform(-800.0, 800.0, (50, 2))
    recording = scans_from_arrays(time_s, position_m)

    # What would be lost without the origin: the test is worth something.
    assert np.abs(position_m.astype(np.float32) - position_m).max() > 0.1
    assert np.abs(time_s.astype(np.float32) - time_s).max() > 1.0

    on_device = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), recording.scans)
    back_m = np.asarray(on_device.position_m, np.float64)[:, 0] + recording.origin_m
    back_s = np.asarray(on_device.time_s, np.float64) + recording.epoch_s
    assert np.abs(back_m - position_m).max() < 1e-3
    assert np.abs(back_s - time_s).max() < 1e-5
    assert (recording.origin_m % 1000.0 == 0.0).all()
    assert recording.epoch_s == UNIX_S
    assert recording.origin_m.dtype == np.float64


def test_a_small_scene_keeps_its_origin_and_a_given_frame_is_used():
    position_m = np.array([[99_999.0, -99_999.0]])
    assert scans_from_arrays([5.0], position_m).origin_m.tolist() == [0.0, 0.0]
    assert scans_from_arrays([5.0], position_m * 2).origin_m.tolist() == [200_000.0, -200_000.0]
    recording = scans_from_arrays(
        [5.0], [[10.0, 20.0]], epoch_s=1.0, origin_m=[4.0, 5.0], axes="north_east"
    )
    assert recording.scans.time_s.tolist() == [4.0]
    assert recording.scans.position_m.tolist() == [[[6.0, 15.0]]]
    assert (recording.epoch_s, recording.axes) == (1.0, "north_east")


def test_equal_times_are_one_look_and_optional_fields_follow():
    covariance_m2 = np.arange(1.0, 4.0)[:, None, None] * np.eye(2)
    scans = scans_from_arrays(
        [0.0, 1.0, 1.0],
        [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]],
        weight=[0.1, 0.2, 0.3],
        covariance_m2=covariance_m2,
        max_detections=3,
    ).scans
    assert scans.mask.tolist() == [[True, False, False], [True, True, False]]
    assert scans.position_m[1].tolist() == [[3.0, 4.0], [5.0, 6.0], [0.0, 0.0]]
    assert scans.weight.tolist() == [[0.1, 0.0, 0.0], [0.2, 0.3, 0.0]]
    np.testing.assert_array_equal(scans.covariance_m2[1, :2], covariance_m2[1:])
    assert not scans.covariance_m2[~scans.mask].any()
    assert scans.valid.all()
    assert scans.delay_s is None
    assert scans.intensity is None


def test_scan_numbers_group_rows_and_delays_are_kept():
    scans = scans_from_arrays(
        [10.5, 10.0, 13.0, 16.0], np.ones((4, 2)), scan=[4, 4, 5, 8], epoch_s=0.0
    ).scans
    # 6 and 7 are looks without detections, at times between their neighbours'.
    assert scans.time_s.tolist() == [10.0, 13.0, 14.0, 15.0, 16.0]
    assert scans.mask.sum(axis=1).tolist() == [2, 1, 0, 0, 1]
    assert scans.delay_s.tolist() == [[0.5, 0.0], [0, 0], [0, 0], [0, 0], [0, 0]]
    assert scans.valid.all()


def test_given_times_of_looks_show_those_without_detections():
    looks_s = [0.0, 1.0, 2.0, 3.0]
    scans = scans_from_arrays([1.0, 1.0], np.ones((2, 2)), scan_time_s=looks_s).scans
    assert scans.time_s.tolist() == looks_s
    assert scans.mask.sum(axis=1).tolist() == [0, 2, 0, 0]
    numbered = scans_from_arrays([1.2, 3.5], np.ones((2, 2)), scan=[1, 3], scan_time_s=looks_s)
    assert numbered.scans.mask.sum(axis=1).tolist() == [0, 1, 0, 1]
    np.testing.assert_allclose(numbered.scans.delay_s[:, 0], [0.0, 0.2, 0.0, 0.5], atol=1e-12)


def test_zero_detections_are_a_result_if_the_looks_are_known():
    recording = scans_from_arrays([], [], scan=[], weight=[], scan_time_s=[7.0, 8.0])
    assert recording.scans.position_m.shape == (2, 1, 2)
    assert recording.scans.weight.shape == (2, 1)
    assert not recording.scans.mask.any()
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(recording.scans))
    with pytest.raises(DataError, match="time_s: got no rows, want at least one"):
        scans_from_arrays([], [])


def test_one_detection_is_one_look():
    scans = scans_from_arrays([UNIX_S], [[1.0, 2.0]]).scans
    assert scans.position_m.tolist() == [[[1.0, 2.0]]]
    assert scans.time_s.tolist() == [0.0]


def test_scans_go_through_a_compiled_loop():
    scans = scans_from_arrays([0.0, 1.0, 1.0], np.ones((3, 2)), scan=[0, 1, 1]).scans

    def step(total, scan):
        return total + jnp.where(scan.mask, scan.position_m[:, 0], 0.0).sum(), scan.time_s

    total, times_s = jax.jit(lambda s: jax.lax.scan(step, jnp.zeros(()), s))(scans)
    assert float(total) == 3.0
    assert times_s.tolist() == [0.0, 1.0]


@settings(deadline=None, max_examples=60)
@given(data=st.data())
def test_rows_come_back_in_order(data):
    counts = data.draw(st.lists(st.integers(0, 4), min_size=1, max_size=8))
    number = np.repeat(np.arange(len(counts)), counts)
    east_m = data.draw(st.floats(-9e6, 9e6))
    size = len(number)
    draw = st.lists(st.floats(-1e4, 1e4), min_size=2 * size, max_size=2 * size)
    position_m = np.array(data.draw(draw)).reshape(size, 2) + east_m
    looks_s = UNIX_S + np.cumsum(
        data.draw(st.lists(st.floats(1e-3, 60.0), min_size=len(counts), max_size=len(counts)))
    )
    recording = scans_from_arrays(looks_s[number], position_m, scan_time_s=looks_s)
    scans = recording.scans

    assert scans.mask.sum(axis=1).tolist() == counts
    assert scans.position_m.shape == (len(counts), max(1, *counts, 1), 2)
    np.testing.assert_allclose(
        scans.position_m[scans.mask] + recording.origin_m, position_m, rtol=0, atol=1e-8
    )
    np.testing.assert_allclose(scans.time_s + recording.epoch_s, looks_s, rtol=0, atol=1e-6)
    assert not scans.position_m[~scans.mask].any()


ONES = np.ones((3, 2))
EYES = np.broadcast_to(np.eye(2), (3, 2, 2))
SINGULAR = np.array([EYES[0], EYES[0], [[1.0, 1.0], [1.0, 1.0]]])
SKEW = np.array([EYES[0], [[1.0, 0.5], [-0.5, 1.0]], EYES[0]])


@pytest.mark.parametrize(
    ("given_values", "words"),
    [
        ({"time_s": [0.0, np.nan, 1.0]}, r"time_s, row 1 .*got nan, want a finite"),
        ({"time_s": [0.0, 1.0, 0.5]}, r"time_s, row 2 .*got 0.5 after 1, want .*not run back"),
        ({"time_s": [1.7e12] * 3}, r"time_s, row 0 .*got 1700000000000, want a finite"),
        ({"position_m": [[0, 0], [1, np.inf], [0, 0]]}, r"position_m\[:, 1\], row 1 .*got inf"),
        ({"position_m": [[0, 0], [1, 0], [1e300, 0]]}, r"position_m\[:, 0\], row 2 .*1e\+300"),
        ({"weight": [0.0, 1.0, 1.5]}, r"weight, row 2 .*got 1.5, want a weight in \[0, 1\]"),
        ({"weight": [0.0, np.nan, 1.0]}, r"weight, row 1 .*got nan"),
        ({"covariance_m2": -EYES}, r"covariance_m2\[:, 0, 0\], row 0 .*got -1, want a variance"),
        ({"covariance_m2": EYES * np.nan}, r"covariance_m2\[:, 0, 0\], row 0 .*got nan"),
        ({"covariance_m2": SINGULAR}, r"covariance_m2\[:, 0, 1\], row 2 .*got 1, want .*smaller"),
        ({"covariance_m2": SKEW}, r"covariance_m2, row 1 .*got 0.5 and -0.5 .*symmetric"),
        ({"scan": [1, 3, 2]}, r"scan, row 2 .*got 2 after 3, want .*not run back"),
        ({"scan": [1, 2, 5000]}, r"scan, row 2 .*got 5000 after 2, want consecutive"),
        ({"scan": [1, 2, 3], "time_s": [0.0, 2.0, 1.0]}, r"time_s, row 2 .*got 1 after 2"),
        ({"scan_time_s": [0.0, 1.0]}, r"time_s, row 2 .*got 2, want exactly one of scan_time_s"),
        ({"scan_time_s": [1.0, 0.0]}, r"scan_time_s, row 1 .*got 0 after 1"),
        ({"scan_time_s": [np.nan]}, r"scan_time_s, row 0 .*got nan"),
        ({"scan_time_s": []}, r"scan_time_s: got no times, want at least one look"),
        ({"scan_time_s": [0.0], "scan": [0, 0, 1]}, r"scan, row 2 .*got 1, want an index .*0 to 0"),
    ],
)
def test_wrong_values_are_named_with_their_row(given_values, words):
    arguments = {"time_s": [0.0, 1.0, 2.0], "position_m": ONES} | given_values
    with pytest.raises(DataError, match=words):
        scans_from_arrays(**arguments)


@pytest.mark.parametrize(
    ("given_values", "kind", "words"),
    [
        (
            {"position_m": np.ones((2, 2))},
            ValueError,
            r"position_m: got shape \[2, 2\], want \[3, 2",
        ),
        ({"position_m": [[1.0], [1.0, 2.0]]}, ValueError, "position_m: got rows of unequal length"),
        ({"time_s": ["a", "b", "c"]}, TypeError, "time_s: got"),
        ({"scan": [0.0, 1.0, 2.0]}, TypeError, "scan: got dtype float64, want integers"),
        ({"weight": [1.0]}, ValueError, r"weight: got shape \[1\], want \[3\]"),
        ({"covariance_m2": np.eye(2)}, ValueError, "covariance_m2: got shape"),
        ({"max_detections": 0}, ValueError, "max_detections: got 0"),
        ({"axes": "east_north"}, ValueError, "axes: got 'east_north', want one of x_y, north_east"),
        ({"epoch_s": float("nan")}, ValueError, "epoch_s: got nan, want a finite"),
        ({"origin_m": [1.0]}, ValueError, r"origin_m: got \[1.0\], want two finite"),
    ],
)
def test_wrong_shapes_and_options_are_named(given_values, kind, words):
    arguments = {"time_s": [0.0, 1.0, 2.0], "position_m": ONES} | given_values
    with pytest.raises(kind, match=words):
        scans_from_arrays(**arguments)


def test_too_narrow_a_width_says_how_wide_it_must_be():
    with pytest.raises(ValueError, match=r"max_detections: got 1, want at least 2.*look at 5 s"):
        scans_from_arrays([4.0, 5.0, 5.0], ONES, max_detections=1)
