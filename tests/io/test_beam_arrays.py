import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.io import DataError, beam_scans_from_arrays
from jaxtrack.types import BeamScan

NAN = np.nan
RANGES_M = np.array([[NAN, 80.0, NAN], [NAN, 79.0, 31.5], [NAN, NAN, NAN]])
GOOD = {
    "range_m": RANGES_M,
    "time_s": [5.0, 5.5, 6.0],
    "heading_rad": [0.1, 0.2, 0.3],
    "position_m": [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]],
}


def test_looks_come_as_they_are_given():
    recording = beam_scans_from_arrays(**GOOD)
    scans = recording.scans
    assert isinstance(scans, BeamScan)
    assert scans.range_m.tolist() == [[0, 80, 0], [0, 79, 31.5], [0, 0, 0]]
    assert scans.mask.tolist() == (~np.isnan(RANGES_M)).tolist()
    assert scans.time_s.tolist() == [0.0, 0.5, 1.0]
    assert scans.pose.position_m.tolist() == GOOD["position_m"]
    assert scans.pose.heading_rad.tolist() == GOOD["heading_rad"]
    assert scans.valid.all()
    assert (scans.weight, scans.intensity) == (None, None)
    assert (recording.epoch_s, recording.axes) == (5.0, "north_east")
    assert recording.origin_m.tolist() == [0.0, 0.0]


def test_optional_fields_follow_and_what_stands_in_silent_beams_does_not_matter():
    weight = [[NAN, 0.5, -3.0], [7.0, 0.25, 1.0], [NAN, NAN, np.inf]]
    scans = beam_scans_from_arrays(**GOOD, weight=weight, intensity=np.asarray(weight) * 4).scans
    assert scans.weight.tolist() == [[0, 0.5, 0], [0, 0.25, 1.0], [0, 0, 0]]
    assert scans.intensity.tolist() == [[0, 2.0, 0], [0, 1.0, 4.0], [0, 0, 0]]


def test_unix_time_and_utm_survive_float32():
    time_s = 1.7e9 + 0.1 * np.arange(3)
    place_m = np.array([5_934_567.8, 565_432.1]) + np.arange(6.0).reshape(3, 2)
    recording = beam_scans_from_arrays(
        **{**GOOD, "time_s": time_s, "position_m": place_m}, axes="x_y"
    )
    near = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), recording.scans)
    back_m = np.asarray(near.pose.position_m, np.float64) + recording.origin_m
    np.testing.assert_allclose(back_m, place_m, rtol=0, atol=1e-3)
    back_s = np.asarray(near.time_s, np.float64) + recording.epoch_s
    np.testing.assert_allclose(back_s, time_s, rtol=0, atol=1e-5)
    assert recording.origin_m.tolist() == [5_935_000.0, 565_000.0]
    assert recording.axes == "x_y"
    given = beam_scans_from_arrays(**GOOD, epoch_s=4.0, origin_m=[1.0, 1.0])
    assert given.scans.time_s.tolist() == [1.0, 1.5, 2.0]
    assert given.scans.pose.position_m[0].tolist() == [0.0, 1.0]


def changed(name, index, value):
    array = np.array(GOOD[name])
    array[index] = value
    return {name: array}


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        (changed("range_m", (1, 2), np.inf), DataError, "range_m, look 1, beam 2 .*got inf, want"),
        (changed("range_m", (1, 2), 0.0), DataError, "look 1, beam 2 .*got 0, want a positive"),
        (changed("range_m", (0, 1), -3.0), DataError, "look 0, beam 1 .*got -3, .* or NaN for a"),
        (changed("time_s", 2, 5.2), DataError, "time_s, look 2 .*got 5.2 after 5.5"),
        (changed("time_s", 1, NAN), DataError, "time_s, look 1 .*got nan"),
        (changed("heading_rad", 2, np.inf), DataError, "heading_rad, look 2 .*got inf"),
        (changed("position_m", (1, 1), NAN), DataError, r"position_m\[:, 1\], look 1 .*got nan"),
        ({"weight": np.full((3, 3), 1.5)}, DataError, "weight, look 0, beam 1 .*got 1.5, want a w"),
        ({"intensity": np.full((3, 3), NAN)}, DataError, "intensity, look 0, beam 1 .*got nan"),
        ({"range_m": [1.0, 2.0]}, ValueError, r"range_m: got shape \[2\], want \[T, B\]"),
        ({"range_m": np.zeros((3, 0))}, ValueError, "range_m: got no beams"),
        ({"time_s": [1.0]}, ValueError, r"time_s: got shape \[1\], want \[3\]"),
        ({"heading_rad": 0.0}, ValueError, r"heading_rad: got shape \[\], want \[3\]"),
        ({"position_m": np.zeros((2, 2))}, ValueError, r"position_m: got shape .*want \[3, 2\]"),
        ({"weight": np.ones((3, 2))}, ValueError, r"weight: got shape \[3, 2\], want \[3, 3\]"),
        ({"range_m": [["a"] * 3] * 3}, TypeError, "range_m: "),
        ({"axes": "map"}, ValueError, "axes: got 'map'"),
        ({"origin_m": [NAN, 0.0]}, ValueError, "origin_m: got"),
        ({"epoch_s": np.inf}, ValueError, "epoch_s: got inf"),
    ],
)
def test_wrong_values_are_named_with_their_place(given, error, words):
    with pytest.raises(error, match=words):
        beam_scans_from_arrays(**{**GOOD, **given})


def test_no_look_at_all_is_an_error():
    with pytest.raises(DataError, match="time_s: got no looks, want at least one"):
        beam_scans_from_arrays(np.zeros((0, 3)), [], [], np.zeros((0, 2)))
