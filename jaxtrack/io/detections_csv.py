"""A CSV file of detections, one a row, to padded scans.

The header names the columns; their order, capitals and spaces do not matter.

    =========================================  ==================================================
    columns                                    meaning
    =========================================  ==================================================
    time_s                                     seconds, never running back; required
    x_m, y_m                                   position; required, unless range and bearing stand
    range_m, bearing_deg                       position relative to own ship, see `io.polar`
    scan                                       number of the look; without it equal times are one
    weight                                     in [0, 1]: how much the detection counts
    cov_xx_m2, cov_xy_m2, cov_yy_m2            covariance of x_m, y_m
    sigma_m                                    or its one standard deviation in both axes
    sigma_range_m, sigma_bearing_deg           standard deviations of range_m, bearing_deg
    own_x_m, own_y_m                           own ship, x north and y east if bearings are
                                               clockwise from north; without it (0, 0)
    own_heading_deg                            bearings are relative to it; else they are true
    =========================================  ==================================================

A row whose position is left empty tells of a look, and adds no detection: this is how a look
without detections is written, or how a sweep's start is told. A scan number left out between two
others is a look without detections as well. Any other column is an error: a misspelt `weight` must
not pass for no weight.
"""

import os

import numpy as np

from jaxtrack.io.csv_table import (
    Table,
    check_columns,
    filled,
    numbers_in,
    read_table,
    where_in,
    whole_numbers,
)
from jaxtrack.io.errors import (
    DataError,
    Where,
    check_covariances,
    check_degrees,
    check_numbers,
    check_sigmas,
    check_weights,
)
from jaxtrack.io.polar import AXES_OF_BEARING, covariance_from_polar, position_from_polar
from jaxtrack.io.recording import Recording, Rows, looks_of_rows, record
from jaxtrack.numerics.checks import check_choice
from jaxtrack.types import Scan

_ALWAYS = ("time_s", "scan", "weight")
_CARTESIAN = ("x_m", "y_m")
_CARTESIAN_COVARIANCE = ("cov_xx_m2", "cov_xy_m2", "cov_yy_m2")
_POLAR = ("range_m", "bearing_deg")
_POLAR_SIGMA = ("sigma_range_m", "sigma_bearing_deg")
_OWN_POSITION = ("own_x_m", "own_y_m")

_KNOWN_CARTESIAN = (*_ALWAYS, *_CARTESIAN, *_CARTESIAN_COVARIANCE, "sigma_m")
_KNOWN_POLAR = (*_ALWAYS, *_POLAR, *_POLAR_SIGMA, *_OWN_POSITION, "own_heading_deg")
_COME_TOGETHER = (_CARTESIAN_COVARIANCE, _POLAR_SIGMA, _OWN_POSITION)


def read_detections(
    path: str | os.PathLike[str],
    *,
    bearing: str = "clockwise_from_north",
    epoch_s: float | None = None,
    origin_m: tuple[float, float] | np.ndarray | None = None,
    max_detections: int | None = None,
) -> Recording[Scan]:
    r"""Read detections from a CSV file; the module's table tells the columns.

    Separated by commas, semicolons or tabs (the header decides), decimal points, UTF-8 with or
    without a byte-order mark, any line ends.

    Args:
        path: the file.
        bearing: how bearings and headings are counted, `"clockwise_from_north"` or `"math"`; files
            of `x_m, y_m` keep their own axes.
        epoch_s: what to subtract from times; None: the first look's time.
        origin_m: what to subtract from positions, [2]; None: (0, 0) if no coordinate exceeds
            100 km in size, else the centroid in whole kilometres.
        max_detections: the width to pad to; None: the fullest look's count, at least 1.

    Returns:
        A `Recording`; `scans_from_arrays` tells how rows become looks.

    Raises:
        DataError: the file holds something wrong; the message has file, row and column.
        OSError: the file cannot be opened.
        ValueError: an option is wrong.

    Example:
        >>> import pathlib, tempfile
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "detections.csv"
        >>> _ = path.write_text("time_s,range_m,bearing_deg\n0,100,90\n2.5,,\n")
        >>> recording = read_detections(path)
        >>> recording.axes, recording.scans.position_m[0].round(3).tolist()
        ('north_east', [[0.0, 100.0]])
        >>> recording.scans.time_s.tolist(), recording.scans.mask.tolist()
        ([0.0, 2.5], [[True], [False]])
    """
    check_choice("bearing", bearing, tuple(AXES_OF_BEARING))
    table = read_table(path)
    polar = _check_header(table)
    rows, where = _rows(table, polar=polar, bearing=bearing)
    look, look_time_s = looks_of_rows(rows.time_s, rows.scan, where)
    return record(
        rows,
        look,
        look_time_s,
        epoch_s=epoch_s,
        origin_m=origin_m,
        max_detections=max_detections,
        axes=AXES_OF_BEARING[bearing] if polar else "x_y",
    )


def _check_header(table: Table) -> bool:
    """Check the columns' names; return whether positions are polar."""
    columns = table.cells.keys()
    if "beam" in columns:
        raise DataError(
            f"{table.name}, column 'beam': got a file of a sonar's beams, want one of detections; "
            "io.read_beams reads it, and so do jaxtrack estimate and track with --beams"
        )
    polar = any(name in columns for name in _POLAR)
    if polar and any(name in columns for name in _CARTESIAN):
        raise DataError(
            f"{table.name}: got columns of both x_m, y_m and range_m, bearing_deg, want one pair"
        )
    known = _KNOWN_POLAR if polar else _KNOWN_CARTESIAN
    required = ("time_s", *(_POLAR if polar else _CARTESIAN))
    instead = "" if polar else " (or range_m, bearing_deg)"
    check_columns(table, required, known, instead=instead)
    listed = ", ".join(columns)
    for group in _COME_TOGETHER:
        missing = [name for name in group if name not in columns]
        if 0 < len(missing) < len(group):
            raise DataError(f"{table.name}: got columns {listed}, want {', '.join(missing)} too")
    if "sigma_m" in columns and _CARTESIAN_COVARIANCE[0] in columns:
        raise DataError(
            f"{table.name}, column 'sigma_m': got it beside cov_xx_m2, want one of them"
        )
    return polar


def _rows(table: Table, *, polar: bool, bearing: str) -> tuple[Rows, Where]:
    """Check every cell and make them rows; also return how to word the place of a row."""
    every = np.arange(len(table.line))
    first, second = _POLAR if polar else _CARTESIAN
    detected = filled(table, first, second)
    shown = every[detected]
    where = where_in(table)

    def where_shown(row: int, column: str) -> str:
        return where(int(shown[row]), column)

    time_s = numbers_in(table, "time_s", every)
    scan = None
    if "scan" in table.cells:
        scan = whole_numbers(numbers_in(table, "scan", every), "scan", where)
    others = (name for name in table.cells if name not in ("time_s", "scan"))
    given = {name: numbers_in(table, name, shown) for name in others}
    if "weight" in given:
        check_weights(given["weight"], "weight", where_shown)
    covariance_m2 = None
    if polar:
        position_m, covariance_m2 = _from_polar(given, bearing, where_shown)
    else:
        position_m = np.stack([given["x_m"], given["y_m"]], axis=-1)
        if "sigma_m" in given:
            check_sigmas(given["sigma_m"], "sigma_m", where_shown)
            covariance_m2 = given["sigma_m"][:, None, None] ** 2 * np.eye(2)
        elif "cov_xx_m2" in given:
            xx, xy, yy = (given[name] for name in _CARTESIAN_COVARIANCE)
            covariance_m2 = np.stack([xx, xy, xy, yy], axis=-1).reshape(-1, 2, 2)
            check_covariances(covariance_m2, _CARTESIAN_COVARIANCE, where_shown)
    return Rows(time_s, scan, detected, position_m, given.get("weight"), covariance_m2), where


def _from_polar(
    given: dict[str, np.ndarray], bearing: str, where: Where
) -> tuple[np.ndarray, np.ndarray | None]:
    # A range of zero is how some sensors say "nothing", and has no bearing and no covariance.
    want = "a positive range (leave range_m and bearing_deg empty for a look without detections)"
    range_m = given["range_m"]
    check_numbers(range_m, "range_m", where, low=np.finfo(np.float64).tiny, want=want)
    nothing = np.zeros_like(range_m)
    for name in ("bearing_deg", "own_heading_deg"):
        check_degrees(given.get(name, nothing), name, where)
    bearing_rad = np.deg2rad(given["bearing_deg"])
    heading_rad = np.deg2rad(given.get("own_heading_deg", nothing))
    own_m = np.stack([given.get(name, nothing) for name in _OWN_POSITION], axis=-1)
    position_m = position_from_polar(
        range_m, bearing_rad, bearing=bearing, own_position_m=own_m, own_heading_rad=heading_rad
    )
    if "sigma_range_m" not in given:
        return position_m, None
    for name in _POLAR_SIGMA:
        check_sigmas(given[name], name, where)
    covariance_m2 = covariance_from_polar(
        range_m,
        bearing_rad,
        given["sigma_range_m"],
        np.deg2rad(given["sigma_bearing_deg"]),
        own_heading_rad=heading_rad,
    )
    return position_m, covariance_m2
