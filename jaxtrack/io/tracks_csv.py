"""Tracks to a CSV file, in the user's own time, origin and axes."""

import csv
import os
import pathlib

import numpy as np

from jaxtrack.io.errors import DataError, number
from jaxtrack.io.recording import Recording
from jaxtrack.numerics.checks import check_array
from jaxtrack.types import Stage, Tracks

_AXIS_NAMES = {"x_y": ("x", "y"), "north_east": ("north", "east")}
_STAGE_NAMES = {
    Stage.EMPTY: "empty",
    Stage.TENTATIVE: "tentative",
    Stage.CONFIRMED: "confirmed",
    Stage.COASTING: "coasting",
}


def write_tracks(path: str | os.PathLike[str], tracks: Tracks, recording: Recording | None) -> None:
    """Write the live tracks to a CSV file, one row for each track and time.

    The columns are `time_s, identity, stage, x_m, y_m, vx_m_s, vy_m_s, sigma_x_m, sigma_y_m,
    existence, log_score`; for a recording of compass bearings the axes are called `north` and
    `east` (`north_m`, `vnorth_m_s`, …). The epoch and origin are put back in float64. Numbers have
    six decimals: a microsecond, a micrometre. Further states of a track are not written.

    Args:
        path: the file; one that exists is replaced.
        tracks: one table, or tables stacked along a leading [T]; the state begins x, y, vx, vy.
        recording: what the tracks were estimated from: epoch, origin and axes are put back. None:
            the tracks' own times and positions are written, as for a simulation.

    Raises:
        DataError: a live track holds NaN or inf, or a negative variance; nothing is written then.
        ValueError: the tracks' shapes do not fit each other.
        OSError: the file cannot be written.

    Example:
        >>> import pathlib, tempfile
        >>> tracks = Tracks(
        ...     time_s=np.array(2.0),
        ...     mean=np.array([[1.0, 2.0, 0.5, 0.0]]),
        ...     covariance=np.eye(4)[None],
        ...     mask=np.array([True]),
        ...     identity=np.array([7]),
        ...     stage=np.array([Stage.CONFIRMED]),
        ...     existence=np.array([0.9]),
        ...     log_score=np.array([4.0]),
        ... )
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "tracks.csv"
        >>> write_tracks(path, tracks, None)
        >>> print(path.read_text().splitlines()[1][:40])
        2.000000,7,confirmed,1.000000,2.000000,0
    """
    table = _stacked(tracks)
    looks, slots = np.nonzero(table.mask)
    epoch_s = 0.0 if recording is None else recording.epoch_s
    origin_m = np.zeros(2) if recording is None else recording.origin_m
    x, y = _AXIS_NAMES["x_y" if recording is None else recording.axes]

    mean = np.asarray(table.mean, np.float64)[looks, slots, :4]
    mean[:, :2] += origin_m
    covariance = np.asarray(table.covariance, np.float64)[looks, slots]
    variance = np.diagonal(covariance, axis1=-2, axis2=-1)[:, :2]
    # A negative variance becomes NaN here and is reported below.
    sigma = np.sqrt(np.where(variance >= 0.0, variance, np.nan))
    values = {
        "time_s": epoch_s + np.asarray(table.time_s, np.float64)[looks],
        f"{x}_m": mean[:, 0],
        f"{y}_m": mean[:, 1],
        f"v{x}_m_s": mean[:, 2],
        f"v{y}_m_s": mean[:, 3],
        f"sigma_{x}_m": sigma[:, 0],
        f"sigma_{y}_m": sigma[:, 1],
        "existence": np.asarray(table.existence, np.float64)[looks, slots],
        "log_score": np.asarray(table.log_score, np.float64)[looks, slots],
    }
    identity = np.asarray(table.identity)[looks, slots].tolist()
    stage = np.asarray(table.stage)[looks, slots].tolist()
    for name, column in values.items():
        wrong = ~np.isfinite(column)
        if wrong.any():
            row = int(np.argmax(wrong))
            raise DataError(
                f"tracks, look {looks[row]}, slot {slots[row]}, column {name}: "
                f"got {number(column[row])}, want a finite number in a live track"
            )

    time_s, *others = ([_fixed(value) for value in column.tolist()] for column in values.values())
    stages = [_STAGE_NAMES.get(value, str(value)) for value in stage]
    time_name, *other_names = values
    with pathlib.Path(path).open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([time_name, "identity", "stage", *other_names])
        writer.writerows(zip(time_s, identity, stages, *others, strict=True))


def _fixed(value: float) -> str:
    return f"{round(value, 6) + 0.0:.6f}"  # adding zero turns −0 into 0


def _stacked(tracks: Tracks) -> Tracks:
    """Return the tracks as NumPy with a leading [T], their shapes checked."""
    lead = ("T",) if np.ndim(tracks.time_s) else ()
    check_array("tracks.mean", tracks.mean, shape=(*lead, "M", "S"))
    *sizes, states = np.shape(tracks.mean)
    if states < 4:
        raise ValueError(f"tracks.mean: got {states} states, want at least 4: x, y, vx, vy")
    check_array("tracks.time_s", tracks.time_s, shape=tuple(sizes[:-1]))
    check_array("tracks.covariance", tracks.covariance, shape=(*sizes, states, states))
    for name in ("mask", "identity", "stage", "existence", "log_score"):
        check_array(f"tracks.{name}", getattr(tracks, name), shape=tuple(sizes))
    arrays = [np.asarray(field) for field in tracks]
    return Tracks(*(arrays if lead else [array[None] for array in arrays]))  # pyright: ignore[reportArgumentType]
