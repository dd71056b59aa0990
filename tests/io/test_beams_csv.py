import jax
import numpy as np
import pytest

from jaxtrack.io import DataError, beam_scans_from_arrays, read_beams
from jaxtrack.models import BeamSonar
from jaxtrack.sensors import motion_elements_scene, observe_beams, scan_of_beams

HEADER = "time_s,beam,range_m,heading_deg,x_m,y_m"


def written(tmp_path, text):
    path = tmp_path / "beams.csv"
    path.write_text(text)
    return path


def test_rows_become_beams_and_an_empty_row_a_look(tmp_path):
    text = f"{HEADER}\n10,2,80,90,1,2\n10,0,5.5,90,1,2\n10.5,,,91,3,4\n11,3,7,92,5,6\n"
    recording = read_beams(written(tmp_path, text), beams=4)
    scans = recording.scans
    assert scans.range_m.tolist() == [[5.5, 0, 80, 0], [0, 0, 0, 0], [0, 0, 0, 7]]
    assert scans.mask.tolist() == (scans.range_m > 0).tolist()
    assert scans.time_s.tolist() == [0.0, 0.5, 1.0]
    assert scans.pose.position_m.tolist() == [[1, 2], [3, 4], [5, 6]]
    np.testing.assert_allclose(scans.pose.heading_rad, np.deg2rad([90, 91, 92]), rtol=1e-15)
    assert (scans.weight, scans.intensity) == (None, None)
    assert (recording.epoch_s, recording.axes) == (10.0, "north_east")
    # Beam 2 of 4 in a sector of 4° stands 0.5° to starboard of east: a little south.
    scan = scan_of_beams(jax.tree.map(lambda x: x[0], scans), BeamSonar(sector_rad=np.deg2rad(4)))
    place = [1 - 80 * np.sin(np.deg2rad(0.5)), 2 + 80 * np.cos(np.deg2rad(0.5))]
    np.testing.assert_allclose(scan.position_m[2], place, rtol=1e-12)


def test_a_simulated_recording_comes_back(tmp_path):
    scene = motion_elements_scene()
    scans = jax.jit(observe_beams)(jax.random.key(0), scene.truth, scene.pose, scene.sonar)
    scans = jax.tree.map(np.asarray, scans)
    weight = np.random.default_rng(0).uniform(size=scans.mask.shape)
    lines = [f"{HEADER};weight;Intensity".replace(",", ";")]
    for k, b in zip(*np.nonzero(scans.mask), strict=True):
        pose = np.rad2deg(scans.pose.heading_rad[k]), *scans.pose.position_m[k]
        cells = (1.7e9 + scans.time_s[k], b, scans.range_m[k, b], *pose, weight[k, b], k)
        lines.append(";".join(str(cell.item()) for cell in map(np.asarray, cells)))
    recording = read_beams(written(tmp_path, "\n".join(lines)), beams=90, origin_m=(-10, -10))
    expected = beam_scans_from_arrays(
        np.where(scans.mask, scans.range_m, np.nan),
        1.7e9 + scans.time_s,
        scans.pose.heading_rad,
        scans.pose.position_m,
        weight=weight,
        intensity=np.arange(20.0)[:, None] * np.ones(90),
        origin_m=(-10, -10),
    )
    assert recording.epoch_s == expected.epoch_s == 1.7e9
    got, wanted = jax.tree.leaves(recording.scans), jax.tree.leaves(expected.scans)
    for x, y in zip(got, wanted, strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-14)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ": got an empty file"),
        ("time_s,beam,range_m,heading_deg,x_m\n0,1,2,3,4\n", ": got columns .*want column y_m"),
        (f"{HEADER},wieght\n0,1,2,3,4,5,1\n", "column 'wieght': got an unknown column"),
        (f"{HEADER},bearing_deg\n0,1,2,3,4,5,1\n", "column 'bearing_deg': got an unknown column"),
        (f"{HEADER}\n0,4,2,3,4,5\n", "row 2, column beam: got 4, want a beam's number, 0 to 3"),
        (f"{HEADER}\n0,-1,2,3,4,5\n", "row 2, column beam: got -1, want a beam's number"),
        (f"{HEADER}\n0,1.5,2,3,4,5\n", "row 2, column beam: got 1.5, want a whole number"),
        (f"{HEADER}\n0,,,3,4,5\n1,1,2,3,4,5\n1,1,9,3,4,5\n", "row 4, column beam: got 1 twice"),
        (f"{HEADER}\n0,1,2,3,4,5\n0,2,2,3.5,4,5\n", "row 3, column heading_deg: got 3.5 after 3"),
        (f"{HEADER}\n0,1,2,3,4,5\n0,,,3,4,6\n", "row 3, column y_m: got 6 after 5 at the same t"),
        (f"{HEADER}\n0,,,3,4,5\n1,1,0,3,4,5\n", "row 3, column range_m: got 0, want a positive"),
        (f"{HEADER}\n0,1,,3,4,5\n", "row 2, column range_m: got an empty cell, want a number"),
        (f"{HEADER}\n0,,2,3,4,5\n", "row 2, column beam: got an empty cell, want a number"),
        (f"{HEADER}\n0,1,x,3,4,5\n", "row 2, column range_m: got 'x', want a number"),
        (f"{HEADER}\n0,1,2,,4,5\n", "row 2, column heading_deg: got an empty cell"),
        (f"{HEADER}\n1,1,2,3,4,5\n\n0,1,2,3,4,5\n", "row 4, column time_s: got 0 after 1"),
        (f"{HEADER},weight\n0,,,3,4,5,\n1,1,2,3,4,5,2\n", "row 3, column weight: got 2, want a w"),
        (f"{HEADER},intensity\n0,1,2,3,4,5,nan\n", "row 2, column intensity: got nan"),
    ],
)
def test_wrong_files_are_named_with_row_and_column(tmp_path, text, words):
    path = written(tmp_path, text)
    with pytest.raises(DataError, match=words) as caught:
        read_beams(path, beams=4)
    assert str(caught.value).startswith(str(path))


def test_a_file_without_detections_is_a_result(tmp_path):
    path = written(tmp_path, f"{HEADER},weight\n0,,,3,4,5,\n")
    scans = read_beams(path, beams=4).scans
    assert scans.mask.tolist() == [[False] * 4]
    assert scans.weight.tolist() == [[0.0] * 4]
    with pytest.raises(ValueError, match="beams: got 0"):
        read_beams(path, beams=0)
