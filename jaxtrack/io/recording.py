"""From checked rows, one detection each, to looks of one common width.

A recording keeps what the estimators must not see: the float64 epoch and origin. float32 resolves
128 s of Unix time and half a metre of a UTM northing, so both are subtracted before anything is
cast, and put back when tracks are written.
"""

from typing import Any, Generic, NamedTuple

import numpy as np

from jaxtrack.io.errors import DataError, Where, check_rising, number
from jaxtrack.numerics.checks import check_choice, check_size
from jaxtrack.types import Scan, ScanT

AXES = ("x_y", "north_east")
"""What the two position axes are: the user's own x and y, or x north and y east."""

SMALL_SCENE_M = 1e5
"""Up to here float32 resolves 8 mm, and subtracting an origin would only surprise."""

LONGEST_GAP = 1000
"""More missing scan numbers in a row than this are a slip in the numbering, not silence."""


class Recording(NamedTuple, Generic[ScanT]):
    """Looks at a scene, and what leads back to the user's own time and coordinates."""

    scans: ScanT  # NumPy float64, every field with a leading [T]; relative to epoch and origin
    epoch_s: float  # the user's time at which scans.time_s is zero
    origin_m: np.ndarray  # [2] float64, the user's position at which the scans' positions are zero
    axes: str  # one of `AXES`


class Rows(NamedTuple):
    """Rows whose values are checked, in the order of their looks; R rows, D ≤ R detections."""

    time_s: np.ndarray  # [R]
    scan: np.ndarray | None  # [R] int
    detected: np.ndarray  # [R] bool; False: the row only says that there was a look
    position_m: np.ndarray  # [D, 2]
    weight: np.ndarray | None = None  # [D]
    covariance_m2: np.ndarray | None = None  # [D, 2, 2]


def looks_of_rows(
    time_s: np.ndarray, scan: np.ndarray | None, where: Where
) -> tuple[np.ndarray, np.ndarray]:
    """Group rows into looks: by scan number if there is one, else by equal time.

    A look's time is its earliest row's. A number missing between two others is a look without
    detections; its time is interpolated between its neighbours'.

    Args:
        time_s: [R], R ≥ 1.
        scan: [R] int, or None.
        where: words the place of a wrong value.

    Returns:
        The index of each row's look, [R], and the looks' times, [T].

    Raises:
        DataError: times or scan numbers run back, or the numbers leap.

    Example:
        >>> time_s, scan = np.array([0.0, 0.0, 2.0]), np.array([7, 7, 9])
        >>> look, look_time_s = looks_of_rows(time_s, scan, lambda row, column: column)
        >>> look.tolist(), look_time_s.tolist()
        ([0, 0, 2], [0.0, 1.0, 2.0])
    """
    if scan is None:
        check_rising(time_s, "time_s", where)
        look_time_s, look = np.unique(time_s, return_inverse=True)
        return look, look_time_s
    check_rising(scan, "scan", where)
    numbers, starts = np.unique(scan, return_index=True)
    leaps = np.diff(numbers) > LONGEST_GAP
    if leaps.any():
        after = int(np.argmax(leaps))
        raise DataError(
            f"{where(int(starts[after + 1]), 'scan')}: got {numbers[after + 1]} after "
            f"{numbers[after]}, want consecutive numbers; one left out is a look without "
            f"detections, and at most {LONGEST_GAP} may be left out in a row"
        )
    first_time_s = np.minimum.reduceat(time_s, starts)
    check_rising(first_time_s, "time_s", lambda row, column: where(int(starts[row]), column))
    shown = numbers - numbers[0]
    return scan - numbers[0], np.interp(np.arange(shown[-1] + 1), shown, first_time_s)


def automatic_origin_m(position_m: np.ndarray) -> np.ndarray:
    """Return (0, 0) for a small scene, else the centroid in whole kilometres.

    Args:
        position_m: [D, 2]; small means that no coordinate exceeds 100 km in size.

    Example:
        >>> automatic_origin_m(np.array([[565_300.0, 5_933_700.0]])).tolist()
        [565000.0, 5934000.0]
    """
    if not (np.abs(position_m) > SMALL_SCENE_M).any():
        return np.zeros(2)
    return np.round(position_m.mean(axis=0) / 1000.0) * 1000.0


def frame_of(
    look_time_s: np.ndarray, position_m: np.ndarray, epoch_s: float | None, origin_m: Any, axes: str
) -> tuple[float, np.ndarray]:
    """Return a recording's epoch and origin, [2], its axes checked.

    Args:
        look_time_s: [T].
        position_m: [D, 2], what stands around the origin.
        epoch_s: None: the time of the first look.
        origin_m: [2], or None: as `automatic_origin_m` finds it.
        axes: one of `AXES`.

    Raises:
        ValueError: an argument is wrong.
    """
    check_choice("axes", axes, AXES)
    epoch = float(look_time_s[0]) if epoch_s is None else float(epoch_s)
    origin = automatic_origin_m(position_m) if origin_m is None else np.asarray(origin_m)
    if not np.isfinite(epoch):
        raise ValueError(f"epoch_s: got {number(epoch)}, want a finite number of seconds")
    if origin.shape != (2,) or not np.isfinite(origin).all():
        raise ValueError(f"origin_m: got {origin.tolist()}, want two finite numbers")
    return epoch, origin.astype(np.float64)


def record(
    rows: Rows,
    look: np.ndarray,
    look_time_s: np.ndarray,
    *,
    epoch_s: float | None,
    origin_m: Any,
    max_detections: int | None,
    axes: str,
) -> Recording[Scan]:
    """Pad the detections of every look to one width and make times and positions relative.

    Args:
        rows: the checked rows.
        look: the index of each row's look, never falling, [R].
        look_time_s: [T].
        epoch_s: None: the time of the first look.
        origin_m: [2], or None: as `automatic_origin_m` finds it.
        max_detections: the width; None: that of the fullest look, at least 1.
        axes: one of `AXES`.

    Raises:
        ValueError: a look holds more than `max_detections`, or an argument is wrong.
    """
    epoch, origin = frame_of(look_time_s, rows.position_m, epoch_s, origin_m, axes)
    shown = look[rows.detected]
    count = np.bincount(shown, minlength=len(look_time_s))
    fullest = int(count.max())
    width = max(1, fullest)
    if max_detections is not None:
        width = check_size("max_detections", max_detections)
        if width < fullest:
            at_s = number(look_time_s[count.argmax()])
            raise ValueError(
                f"max_detections: got {width}, want at least {fullest}, "
                f"as many as the look at {at_s} s holds"
            )
    slot = np.arange(len(shown)) - (np.cumsum(count) - count)[shown]

    def padded(values: np.ndarray) -> np.ndarray:
        table = np.zeros((len(look_time_s), width, *values.shape[1:]), values.dtype)
        table[shown, slot] = values
        return table

    fields: dict[str, Any] = {
        "time_s": look_time_s - epoch,
        "valid": np.ones(len(look_time_s), bool),
        "position_m": padded(rows.position_m - origin),
        "mask": padded(np.ones(len(shown), bool)),
    }
    for name, values in (("weight", rows.weight), ("covariance_m2", rows.covariance_m2)):
        if values is not None:
            fields[name] = padded(values)
    if rows.scan is not None:
        fields["delay_s"] = padded((rows.time_s - look_time_s[look])[rows.detected])
    return Recording(Scan(**fields), epoch, origin, axes)
