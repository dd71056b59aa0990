import jax
import numpy as np
import pytest

from jaxtrack.io import DataError, read_pings
from jaxtrack.sensors import (
    IMAGENEX_881L,
    PingSizes,
    ScanningPreset,
    cloud_of_pings,
    dragged_bucket,
)

HEADER = "time_s,bearing_deg,range_m,intensity,heading_deg,x_m,y_m"


def written(tmp_path, text):
    path = tmp_path / "pings.csv"
    path.write_text(text)
    return path


def read(tmp_path, *lines, **options):
    text = "\n".join([HEADER, *lines])
    return read_pings(written(tmp_path, text), bins=4, range_max_m=8.0, **options)


def test_rows_become_bins_and_empty_rows_pings(tmp_path):
    recording = read(
        tmp_path,
        "10,-1.2,1.0,7,90,1,2", "10,-1.2,7.0,8.5,90,1,2", "10.06,0,,,91,3,4",
        "10.12,1.2,3,0,92,5,6", "10.12,1.2,5,9,92,5,6",
    )  # fmt: skip
    pings = recording.scans
    assert pings.intensity.tolist() == [[[7, 0, 0, 8.5], [0, 0, 0, 0], [0, 0, 9, 0]]]
    assert pings.mask.tolist() == [[True] * 3]
    np.testing.assert_allclose(pings.time_s, [[0.0, 0.06, 0.12]], atol=1e-9)
    np.testing.assert_allclose(pings.bearing_rad, np.deg2rad([[-1.2, 0.0, 1.2]]), rtol=1e-15)
    np.testing.assert_allclose(pings.pose.heading_rad, np.deg2rad([[90, 91, 92]]), rtol=1e-15)
    assert pings.pose.position_m.tolist() == [[[1, 2], [3, 4], [5, 6]]]
    assert (recording.epoch_s, recording.axes) == (10.0, "north_east")
    assert recording.origin_m.tolist() == [0, 0]
    # Bins that are named by where they begin are the same ones, the last too.
    begins = read(tmp_path, "10,0,0,1,0,0,0", "10,0,2,2,0,0,0", "10,0,6,3,0,0,0")
    assert begins.scans.intensity.tolist() == [[[1, 2, 0, 3]]]
    thirds = "\n".join([HEADER, *(f"1,0,{r * 0.1},{r + 1},0,0,0" for r in range(100))])
    path = written(tmp_path, thirds)
    found = read_pings(path, bins=100, range_max_m=10.0).scans.intensity
    np.testing.assert_array_equal(found[0, 0], np.arange(1, 101))


@pytest.mark.parametrize(
    ("bearings", "lengths"),
    [
        ([0, 1, 2, 1, 0, 1], [3, 2, 1]),  # to and fro
        ([0, 1, 2, 2, 1, 0, 0, 1, 2], [3, 3, 3]),  # with a ping twice at the ends
        ([0, 1, 2, 0, 1, 2, 0], [3, 3, 1]),  # always to starboard
        ([358, 359, 0, 1, 0, 359], [4, 2]),  # through ahead
        ([178, 179, -180, -179], [4]),  # through astern
        ([*range(0, 360, 90), *range(0, 180, 90)], [4, 2]),  # around and on
        ([0, 1, 2, 40, 41, 42], [3, 3]),  # leaps on
        ([0, 1, 1.98, 1.95, 3], [5]),  # trembles
        ([5], [1]),
    ],
)
def test_sweeps_begin_where_the_beam_turns_back_or_leaps_back(tmp_path, bearings, lengths):
    lines = [f"{k},{bearing},1,{k + 1},0,{k},0" for k, bearing in enumerate(bearings)]
    pings = read(tmp_path, *lines).scans
    assert pings.mask.sum(axis=1).tolist() == lengths
    assert pings.mask.shape == (len(lengths), max(lengths))
    order = np.arange(len(bearings))
    np.testing.assert_array_equal(pings.time_s[pings.mask], order)
    np.testing.assert_array_equal(pings.intensity[pings.mask][:, 0], order + 1)
    assert not pings.intensity[~pings.mask].any()
    # What is padded stands where the sweep ended.
    for t, length in enumerate(lengths):
        assert (pings.time_s[t, length:] == pings.time_s[t, length - 1]).all()
        assert (pings.pose.position_m[t, length:] == pings.pose.position_m[t, length - 1]).all()


@pytest.mark.slow
def test_a_simulated_run_comes_back(tmp_path):
    preset = ScanningPreset(IMAGENEX_881L.sonar, PingSizes(11, 40, 4, 2))
    draw = jax.jit(lambda key: dragged_bucket(key, "hovering", frames=3, preset=preset).pings)
    pings = jax.tree.map(np.asarray, draw(jax.random.key(0)))
    lines = [HEADER.replace(",", ";").replace("time", "TIME")]
    for t, q in np.ndindex(3, 11):
        place, heading = pings.pose.position_m[t, q], np.rad2deg(pings.pose.heading_rad[t, q])
        pose = heading, 5.9e6 + place[0], 5.6e5 + place[1]
        for r in np.flatnonzero(pings.intensity[t, q] > 0.5):
            echo = r + 0.5, pings.intensity[t, q, r]
            cells = (1.7e9 + pings.time_s[t, q], np.rad2deg(pings.bearing_rad[t, q]), *echo, *pose)
            lines.append(";".join(repr(float(cell)) for cell in cells))
    path = written(tmp_path, "\n".join(lines))
    recording = read_pings(path, bins=40, range_max_m=40.0)
    assert recording.epoch_s == 1.7e9
    assert recording.origin_m.tolist() == [5.9e6, 5.6e5]
    got = recording.scans
    assert got.mask.all()
    np.testing.assert_array_equal(
        got.intensity, np.where(pings.intensity > 0.5, pings.intensity, 0)
    )
    np.testing.assert_allclose(got.time_s, pings.time_s, atol=1e-6)
    np.testing.assert_allclose(got.bearing_rad, pings.bearing_rad, atol=1e-12)
    np.testing.assert_allclose(got.pose.position_m, pings.pose.position_m, atol=1e-8)
    one = lambda x: jax.tree.map(lambda y: y[0], x)
    near = [cloud_of_pings(one(x), IMAGENEX_881L.sonar, points=64)[0] for x in (got, pings)]
    np.testing.assert_array_equal(near[0].mask, near[1].mask)
    np.testing.assert_allclose(near[0].position_m, near[1].position_m, atol=1e-6)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["10,0,9,1,0,0,0"], "row 2, column range_m: got 9, want a range from 0 to below 8"),
        (["10,0,-1,1,0,0,0"], "row 2, column range_m: got -1, want a range from 0"),
        (["10,0,8,1,0,0,0"], "row 2, column range_m: got 8, want a range from 0 to below 8"),
        (["10,0,1,-1,0,0,0"], "row 2, column intensity: got -1, want an amplitude of at least 0"),
        (["10,0,1,nan,0,0,0"], "row 2, column intensity: got nan, want a finite number"),
        (["10,0,1,,0,0,0"], "row 2, column intensity: got an empty cell, want a number"),
        (["10,0,,1,0,0,0"], "row 2, column range_m: got an empty cell, want a number"),
        (["10,0,1,1,0,0,0", "10,1,3,1,0,0,0"],
         "row 3, column bearing_deg: got 1 after 0 at the same time, want one value a ping"),
        (["10,0,1,1,0,0,0", "10,0,3,1,0,7,0"],
         "row 3, column x_m: got 7 after 0 at the same time, want one value a ping"),
        (["10,0,1,1,0,0,0", "10,0,1.5,1,0,0,0"],
         "row 3, column range_m: got 1.5 twice at the same time, want at most one intensity a bin"),
        (["10,0,1,1,0,0,0", "9,0,1,1,0,0,0"],
         "row 3, column time_s: got 9 after 10, want values that do not run back"),
        (["10,6390,1,1,0,0,0"],
         "row 2, column bearing_deg: got 6390, want degrees from -360 to 360"),
        (["10,0,1,1,1e9,0,0"],
         "row 2, column heading_deg: got 1000000000, want degrees from -360 to 360"),
        (["10,north,1,1,0,0,0"], "row 2, column bearing_deg: got 'north', want a number"),
    ],
)  # fmt: skip
def test_wrong_values_are_named_with_file_row_and_column(tmp_path, lines, message):
    with pytest.raises(DataError) as error:
        read(tmp_path, *lines)
    assert str(error.value).startswith(f"{tmp_path / 'pings.csv'}, {message}")


def test_wrong_columns_and_options_are_named(tmp_path):
    short = written(tmp_path, "time_s,bearing_deg\n1,2\n")
    with pytest.raises(DataError, match="want column range_m"):
        read_pings(short, bins=4, range_max_m=8.0)
    other = written(tmp_path, f"{HEADER},depth_m\n1,0,1,1,0,0,0,3\n")
    with pytest.raises(DataError, match="column 'depth_m': got an unknown column"):
        read_pings(other, bins=4, range_max_m=8.0)
    with pytest.raises(ValueError, match="bins: got 0"):
        read_pings(other, bins=0, range_max_m=8.0)
    with pytest.raises(ValueError, match=r"range_max_m: got 0.0, want a positive"):
        read_pings(other, bins=4, range_max_m=0.0)
    with pytest.raises(ValueError, match="origin_m"):
        read(tmp_path, "10,0,1,1,0,0,0", origin_m=(1.0, float("nan")))
