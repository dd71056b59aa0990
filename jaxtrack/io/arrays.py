"""NumPy arrays, one detection a row, to padded scans."""

from typing import Any

import numpy as np

from jaxtrack.io.errors import (
    DataError,
    check_covariances,
    check_numbers,
    check_rising,
    check_weights,
    number,
)
from jaxtrack.io.recording import Recording, Rows, looks_of_rows, record
from jaxtrack.numerics.checks import check_array
from jaxtrack.types import Scan


def scans_from_arrays(
    time_s: Any,
    position_m: Any,
    *,
    scan: Any = None,
    weight: Any = None,
    covariance_m2: Any = None,
    scan_time_s: Any = None,
    epoch_s: float | None = None,
    origin_m: Any = None,
    max_detections: int | None = None,
    axes: str = "x_y",
) -> Recording[Scan]:
    """Group detections into looks and pad the looks to one width.

    Rows are in the order of their looks: times (or scan numbers, where given) never run back.
    Without `scan`, detections of equal time are one look. With it, those of equal number are; the
    look's time is its earliest detection's, and `delay_s` holds each detection's time after it. A
    number missing between two others is a look without detections, at a time between its
    neighbours'. Looks that no number can show (before the first, after the last) need
    `scan_time_s`.

    Args:
        time_s: when each detection was made, seconds, [D].
        position_m: where, metres, [D, 2].
        scan: the number of each detection's look, int, [D].
        weight: how much each detection counts, in [0, 1], [D].
        covariance_m2: of each position, positive definite, [D, 2, 2].
        scan_time_s: the times of all looks, those without detections included, rising, [T]. `scan`
            then counts into it from 0; without `scan` every time is exactly one of these.
        epoch_s: what to subtract from times; None: the first look's time.
        origin_m: what to subtract from positions, [2]; None: (0, 0) if no coordinate exceeds
            100 km in size, else the centroid in whole kilometres.
        max_detections: the width to pad to, so that recordings share one shape; None: the fullest
            look's count, at least 1.
        axes: `"x_y"`, the user's own, or `"north_east"`, x north and y east, as
            `position_from_polar` yields them for compass bearings.

    Returns:
        A `Recording`. Padding is zero, its mask False. Every look is valid.

    Raises:
        DataError: a value is wrong (NaN, time running back, no look at all, …), with its row.
        ValueError: a shape or an option is wrong.
        TypeError: a dtype is wrong.

    Example:
        >>> recording = scans_from_arrays(
        ...     time_s=[1.7e9, 1.7e9, 1.7e9 + 2.0],
        ...     position_m=[[565010.0, 5934020.0], [565011.0, 5934050.0], [565013.0, 5934020.0]],
        ... )
        >>> recording.epoch_s, recording.origin_m.tolist()
        (1700000000.0, [565000.0, 5934000.0])
        >>> recording.scans.time_s.tolist(), recording.scans.mask.tolist()
        ([0.0, 2.0], [[True, True], [True, False]])
    """
    times_s = float_array("time_s", time_s, ("D",))
    size = len(times_s)
    positions_m = float_array("position_m", position_m, (size, 2))
    scans = None if scan is None else _integers("scan", scan, size)
    weights = None if weight is None else float_array("weight", weight, (size,))
    covariances_m2 = (
        None if covariance_m2 is None else float_array("covariance_m2", covariance_m2, (size, 2, 2))
    )

    check_numbers(times_s, "time_s", _row)
    for axis in (0, 1):
        check_numbers(positions_m[:, axis], f"position_m[:, {axis}]", _row)
    if weights is not None:
        check_weights(weights, "weight", _row)
    if covariances_m2 is not None:
        xx, xy, yy = (f"covariance_m2[:, {i}, {j}]" for i, j in ((0, 0), (0, 1), (1, 1)))
        check_covariances(covariances_m2, (xx, xy, yy), _row)
        _check_symmetric(covariances_m2)

    if scan_time_s is None:
        if size == 0:
            raise DataError(
                "time_s: got no rows, want at least one, or scan_time_s: when it looked"
            )
        look, look_time_s = looks_of_rows(times_s, scans, _row)
    else:
        look_time_s = float_array("scan_time_s", scan_time_s, ("T",))
        look = _looks_among(times_s, scans, look_time_s)
    rows = Rows(times_s, scans, np.ones(size, bool), positions_m, weights, covariances_m2)
    return record(
        rows,
        look,
        look_time_s,
        epoch_s=epoch_s,
        origin_m=origin_m,
        max_detections=max_detections,
        axes=axes,
    )


def _row(row: int, column: str) -> str:
    return f"{column}, row {row} (the first is 0)"


def float_array(name: str, value: Any, shape: tuple[Any, ...]) -> np.ndarray:
    """Return an argument as a float64 array, its shape checked as `check_array` does.

    Raises:
        ValueError: a shape differs.
        TypeError: not numbers.
    """
    array = _array(name, value)
    if array.shape == (0,) and shape[0] == 0:
        array = np.zeros(shape)  # an empty list knows only one of its axes
    check_array(name, array, shape=shape)
    return array.astype(np.float64)


def _integers(name: str, value: Any, size: int) -> np.ndarray:
    array = _array(name, value)
    if array.size and not np.issubdtype(array.dtype, np.integer):
        raise TypeError(f"{name}: got dtype {array.dtype}, want integers")
    array = array.astype(np.int64)
    check_array(name, array, shape=(size,))
    return array


def _array(name: str, value: Any) -> np.ndarray:
    try:
        return np.asarray(value)
    except ValueError as error:
        raise ValueError(f"{name}: got rows of unequal length, want a regular array") from error


def _check_symmetric(covariance_m2: np.ndarray) -> None:
    # Rounding, in float32 too, may part the two by far less than this.
    allowed_m2 = 1e-5 * (covariance_m2[:, 0, 0] + covariance_m2[:, 1, 1])
    wrong = ~(np.abs(covariance_m2[:, 1, 0] - covariance_m2[:, 0, 1]) <= allowed_m2)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise DataError(
            f"{_row(row, 'covariance_m2')}: got {number(covariance_m2[row, 0, 1])} and "
            f"{number(covariance_m2[row, 1, 0])} off the diagonal, want a symmetric matrix"
        )


def _looks_among(
    time_s: np.ndarray, scan: np.ndarray | None, look_time_s: np.ndarray
) -> np.ndarray:
    """Return the index of each row's look, [R], where the looks' times [T] are given."""
    if len(look_time_s) == 0:
        raise DataError("scan_time_s: got no times, want at least one look")
    check_numbers(look_time_s, "scan_time_s", _row)
    check_rising(look_time_s, "scan_time_s", _row)
    last = len(look_time_s) - 1
    if scan is not None:
        check_rising(scan, "scan", _row)
        want = f"an index into scan_time_s, 0 to {last}"
        check_numbers(scan, "scan", _row, low=0, high=last, want=want)
        return scan
    check_rising(time_s, "time_s", _row)
    look = np.minimum(np.searchsorted(look_time_s, time_s), last)
    foreign = look_time_s[look] != time_s
    if foreign.any():
        row = int(np.argmax(foreign))
        raise DataError(
            f"{_row(row, 'time_s')}: got {number(time_s[row])}, "
            "want exactly one of scan_time_s (or give scan, if times within a look differ)"
        )
    return look
