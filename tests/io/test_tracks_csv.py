import csv

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtrack.io import DataError, read_detections, scans_from_arrays, write_tracks
from jaxtrack.types import Stage, Tracks

HEADER = "time_s,identity,stage,x_m,y_m,vx_m_s,vy_m_s,sigma_x_m,sigma_y_m,existence,log_score"


def table(time_s, position_m, *, states=4):
    """Three slots, of which the second is empty and full of NaN."""
    mean = np.zeros((3, states))
    mean[:, :2], mean[:, 2:4] = position_m, [1.5, -0.25]
    covariance = np.stack([np.diag([4.0, 9.0] + [1.0] * (states - 2))] * 3)
    mean[1], covariance[1] = np.nan, np.nan
    return Tracks(
        time_s=jnp.asarray(time_s, jnp.float32),
        mean=jnp.asarray(mean, jnp.float32),
        covariance=jnp.asarray(covariance, jnp.float32),
        mask=jnp.array([True, False, True]),
        identity=jnp.array([5, -1, 6], jnp.int32),
        stage=jnp.array([Stage.CONFIRMED, Stage.EMPTY, Stage.TENTATIVE], jnp.int32),
        existence=jnp.array([0.75, jnp.nan, 0.5], jnp.float32),
        log_score=jnp.array([12.5, jnp.nan, -0.0], jnp.float32),
    )


def rows_of(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_unix_time_and_utm_are_put_back(tmp_path):
    time_s = 1.7e9 + 0.25 * np.arange(4)
    position_m = np.array([565_432.1, 5_934_567.8]) + np.arange(4)[:, None] * [0.375, -0.5]
    recording = scans_from_arrays(time_s, position_m)
    stacked = jax.tree.map(
        lambda *leaves: jnp.stack(leaves),
        *[
            table(t, p[0])
            for t, p in zip(recording.scans.time_s, recording.scans.position_m, strict=True)
        ],
    )
    path = tmp_path / "tracks.csv"
    write_tracks(path, stacked, recording)
    rows = rows_of(path)
    assert ",".join(rows[0]) == HEADER
    assert [row["identity"] for row in rows] == ["5", "6"] * 4
    assert [row["time_s"] for row in rows[:4]] == ["1700000000.000000"] * 2 + [
        "1700000000.250000"
    ] * 2
    got_m = np.array([[float(row["x_m"]), float(row["y_m"])] for row in rows[::2]])
    assert np.abs(got_m - position_m).max() < 1e-3
    assert "e+" not in path.read_text()


def test_a_row_holds_all_there_is_to_say(tmp_path):
    path = tmp_path / "tracks.csv"
    write_tracks(path, table(2.0, [10.0, 20.0], states=6), None)
    assert path.read_text().splitlines() == [
        HEADER,
        "2.000000,5,confirmed,10.000000,20.000000,1.500000,-0.250000,2.000000,3.000000,"
        "0.750000,12.500000",
        "2.000000,6,tentative,10.000000,20.000000,1.500000,-0.250000,2.000000,3.000000,"
        "0.500000,0.000000",
    ]


def test_compass_axes_are_called_by_name(tmp_path):
    source = tmp_path / "detections.csv"
    source.write_text("time_s,range_m,bearing_deg\n0,10,90\n")
    path = tmp_path / "tracks.csv"
    write_tracks(path, table(0.0, [1.0, 2.0]), read_detections(source))
    header = path.read_text().splitlines()[0]
    assert header == (
        "time_s,identity,stage,north_m,east_m,vnorth_m_s,veast_m_s,sigma_north_m,sigma_east_m,"
        "existence,log_score"
    )


def test_no_live_track_is_a_header_alone(tmp_path):
    path = tmp_path / "tracks.csv"
    empty = table(0.0, [1.0, 2.0])._replace(mask=jnp.zeros(3, bool))
    write_tracks(path, empty, None)
    assert path.read_text() == HEADER + "\n"


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("mean", jnp.nan, "look 0, slot 0, column x_m: got nan, want a finite number"),
        ("covariance", -1.0, "look 0, slot 0, column sigma_x_m: got nan"),
        ("log_score", jnp.inf, "look 0, slot 0, column log_score: got inf"),
        ("time_s", jnp.nan, "look 0, slot 0, column time_s: got nan"),
    ],
)
def test_a_broken_live_track_is_named_and_nothing_is_written(tmp_path, field, value, words):
    tracks = table(0.0, [1.0, 2.0])
    broken = tracks._replace(**{field: jnp.full_like(getattr(tracks, field), value)})
    path = tmp_path / "tracks.csv"
    with pytest.raises(DataError, match=words):
        write_tracks(path, broken, None)
    assert not path.exists()


def test_shapes_that_do_not_fit_are_named(tmp_path):
    path = tmp_path / "tracks.csv"
    tracks = table(0.0, [1.0, 2.0])
    with pytest.raises(ValueError, match=r"tracks.mask: got shape \[2\], want \[3\]"):
        write_tracks(path, tracks._replace(mask=jnp.ones(2, bool)), None)
    with pytest.raises(ValueError, match=r"tracks.mean: got 2 states, want at least 4"):
        write_tracks(path, tracks._replace(mean=jnp.zeros((3, 2))), None)
    with pytest.raises(ValueError, match=r"tracks.mean: got shape \[3, 4\], want \[T, M, S\]"):
        write_tracks(path, tracks._replace(time_s=jnp.zeros(2)), None)
