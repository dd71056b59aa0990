"""A CSV file of a mechanically scanned sonar's echoes, one range bin a row, to its sweeps of pings.

The header names the columns; their order, capitals and spaces do not matter.

    =============  ==============================================================================
    columns        meaning
    =============  ==============================================================================
    time_s         seconds, never running back; rows of equal time are one ping
    bearing_deg    of the beam from the sonar's own ahead, positive to starboard
    range_m        of the bin's middle from the sonar; each bin once a ping
    intensity      of the echo, an amplitude of at least 0
    heading_deg    of the carrier, clockwise from north
    x_m, y_m       of the carrier, x north and y east; these, heading and bearing alike in all rows
                   of one ping
    =============  ==============================================================================

Bins that a file leaves out are silent. A row whose range and intensity are left empty tells of a
ping, and adds no echo. Any other column is an error.
"""

import os
from typing import Any

import numpy as np

from jaxtrack.io.csv_table import (
    check_columns,
    check_once,
    filled,
    numbers_in,
    one_a_look,
    read_table,
    where_in,
)
from jaxtrack.io.errors import check_degrees, check_numbers
from jaxtrack.io.recording import Recording, frame_of, looks_of_rows
from jaxtrack.numerics.checks import check_known, check_size
from jaxtrack.types import Pings, Pose

_JITTER, _LEAP = 0.1, 10.0  # of the usual step
_OF_PING = ("bearing_deg", "heading_deg", "x_m", "y_m")
_COLUMNS = ("time_s", "bearing_deg", "range_m", "intensity", "heading_deg", "x_m", "y_m")


def read_pings(
    path: str | os.PathLike[str],
    *,
    bins: int,
    range_max_m: float,
    epoch_s: float | None = None,
    origin_m: tuple[float, float] | np.ndarray | None = None,
) -> Recording[Pings]:
    r"""Read a mechanically scanned sonar's pings from a CSV file; the module's table tells columns.

    Separated by commas, semicolons or tabs (the header decides), decimal points, UTF-8 with or
    without a byte-order mark, any line ends. A new sweep begins where the beam turns back, stands
    still, leaps by over ten of its usual steps, or has turned once around.

    Args:
        path: the file.
        bins: how many divide the scope evenly.
        range_max_m: the sonar's scope.
        epoch_s: what to subtract from times; None: the first ping's time.
        origin_m: what to subtract from the carrier's positions, [2]; None: (0, 0) if no coordinate
            exceeds 100 km in size, else the centroid in whole kilometres.

    Returns:
        A `Recording` of T sweeps, axes north and east: `Pings` of [T, Q], Q those of the longest.
        Shorter ones are padded: there the mask is False, the time, bearing and pose those of the
        sweep's last ping, and the intensity zero.

    Raises:
        DataError: the file holds something wrong; the message has file, row and column.
        OSError: the file cannot be opened.
        ValueError: an option is wrong.

    Example:
        >>> import pathlib, tempfile
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "pings.csv"
        >>> _ = path.write_text("time_s,bearing_deg,range_m,intensity,heading_deg,x_m,y_m\n"
        ...                     "10,-1,0.5,7,90,0,0\n10,-1,2.5,9,90,0,0\n10.1,0,,,90,0,0.1\n"
        ...                     "10.2,1,1.5,8,90,0,0.2\n10.3,0,,,90,0,0.3\n")
        >>> recording = read_pings(path, bins=3, range_max_m=3.0)
        >>> print(recording.scans.mask.tolist(), recording.scans.intensity[0].tolist())
        [[True, True, True], [True, False, False]] [[7.0, 0.0, 9.0], [0.0, 0.0, 0.0], [0.0, 8.0, 0.0]]
    """  # noqa: E501
    bins = check_size("bins", bins)
    positive = lambda x: (x > 0) & np.isfinite(x)
    check_known("range_max_m", range_max_m, positive, "a positive, finite number")
    table = read_table(path)
    check_columns(table, _COLUMNS, _COLUMNS)
    every = np.arange(len(table.line))
    where = where_in(table)
    ping, time_s = looks_of_rows(numbers_in(table, "time_s", every), None, where)
    _, first = np.unique(ping, return_index=True)
    bearing_deg, heading_deg, x_m, y_m = (
        one_a_look(table, name, ping, first, want="one value a ping") for name in _OF_PING
    )

    def where_ping(row: int, column: str) -> str:
        return where(int(first[row]), column)

    angles = {"bearing_deg": bearing_deg, "heading_deg": heading_deg}
    for name, angle in angles.items():
        check_degrees(angle, name, where_ping)
    shown = every[filled(table, "range_m", "intensity")]

    def where_shown(row: int, column: str) -> str:
        return where(int(shown[row]), column)

    range_m = numbers_in(table, "range_m", shown)
    echo = numbers_in(table, "intensity", shown)
    want = f"a range from 0 to below {range_max_m:g}, or range and intensity empty"
    high = np.nextafter(range_max_m, 0.0)
    check_numbers(range_m, "range_m", where_shown, low=0.0, high=high, want=want)
    check_numbers(echo, "intensity", where_shown, low=0.0, want="an amplitude of at least 0")
    # Some files name a bin by where it begins: rounding must not push it into the one before.
    place = np.floor(range_m * bins / range_max_m + 1e-6).astype(np.int64).clip(0, bins - 1)
    cell = ping[shown] * bins + place
    check_once(cell, range_m, "range_m", where_shown, want="at most one intensity a bin")
    intensity = np.zeros((len(first), bins))
    intensity.ravel()[cell] = echo

    position_m = np.stack([x_m, y_m], axis=-1)
    epoch, origin = frame_of(time_s, position_m, epoch_s, origin_m, "north_east")
    rows, mask = _rows_of_sweeps(bearing_deg)
    # NumPy's arrays, as in every recording.
    pose: list[Any] = [(position_m - origin)[rows], np.deg2rad(heading_deg)[rows]]
    fields: dict[str, Any] = {
        "time_s": (time_s - epoch)[rows],
        "bearing_rad": np.deg2rad(bearing_deg)[rows],
        "intensity": np.where(mask[..., None], intensity[rows], 0.0),
        "mask": mask,
        "pose": Pose(*pose),
    }
    return Recording(Pings(**fields), epoch, origin, "north_east")


def _rows_of_sweeps(bearing_deg: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return which ping stands in each place of the sweeps, and which places hold one, [T, Q].

    Bearings count modulo a turn. A tenth of the usual step is jitter, and turns nothing.
    """
    turns = (np.diff(bearing_deg) + 180.0) % 360.0 - 180.0
    moving = np.abs(turns[turns != 0])
    step = float(np.median(moving)) if len(moving) else 0.0
    starts, way, turned = [0], 0.0, 0.0
    for row, turn in enumerate(turns, start=1):
        if turn != 0 and abs(turn) < _JITTER * step:
            continue
        leaps = turn == 0 or abs(turn) > _LEAP * step
        turned += turn
        if leaps or (way != 0 and np.sign(turn) != way) or abs(turned) > 360.0 - step / 2:
            starts.append(row)
            way, turned = 0.0, 0.0
        else:
            way = np.sign(turn)
    ends = np.array([*starts[1:], len(bearing_deg)])
    place = np.array(starts)[:, None] + np.arange((ends - starts).max())
    return np.minimum(place, ends[:, None] - 1), place < ends[:, None]
