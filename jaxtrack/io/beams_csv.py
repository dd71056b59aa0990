"""A CSV file of a multi-beam sonar's detections, one a row, to its scans.

The header names the columns; their order, capitals and spaces do not matter.

    =============  ==============================================================================
    columns        meaning
    =============  ==============================================================================
    time_s         seconds, never running back; rows of equal time are one look
    beam           number of the beam, from 0 at the port side to B − 1; each once a look
    range_m        from the sonar
    heading_deg    of the carrier, clockwise from north
    x_m, y_m       of the carrier, x north and y east; these and the heading alike in all rows of
                   one look
    weight         in [0, 1]: how much the detection counts; may be left out
    intensity      of the echo; may be left out
    =============  ==============================================================================

A row whose beam and range are left empty tells of a look, and adds no detection: this is how a look
without detections is written. Any other column is an error.
"""

import os
from typing import Any

import numpy as np

from jaxtrack.io.beam_arrays import RANGE_WANTED, beam_scans_from_arrays
from jaxtrack.io.csv_table import (
    check_columns,
    check_once,
    filled,
    numbers_in,
    one_a_look,
    read_table,
    where_in,
    whole_numbers,
)
from jaxtrack.io.errors import Where, check_numbers, check_weights
from jaxtrack.io.recording import Recording, looks_of_rows
from jaxtrack.numerics.checks import check_size
from jaxtrack.types import BeamScan

_POSE = ("heading_deg", "x_m", "y_m")
_REQUIRED = ("time_s", "beam", "range_m", *_POSE)
_OPTIONAL = ("weight", "intensity")


def read_beams(
    path: str | os.PathLike[str],
    *,
    beams: int,
    epoch_s: float | None = None,
    origin_m: tuple[float, float] | np.ndarray | None = None,
) -> Recording[BeamScan]:
    r"""Read a multi-beam sonar's detections from a CSV file; the module's table tells the columns.

    Separated by commas, semicolons or tabs (the header decides), decimal points, UTF-8 with or
    without a byte-order mark, any line ends.

    Args:
        path: the file.
        beams: how many the sonar has, silent ones included.
        epoch_s: what to subtract from times; None: the first look's time.
        origin_m: what to subtract from the carrier's positions, [2]; None: (0, 0) if no coordinate
            exceeds 100 km in size, else the centroid in whole kilometres.

    Returns:
        A `Recording` of `BeamScan`s, axes north and east, as `beam_scans_from_arrays` makes it.

    Raises:
        DataError: the file holds something wrong; the message has file, row and column.
        OSError: the file cannot be opened.
        ValueError: an option is wrong.

    Example:
        >>> import pathlib, tempfile
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "beams.csv"
        >>> _ = path.write_text(
        ...     "time_s,beam,range_m,heading_deg,x_m,y_m\n10,2,80,45,0,0\n10.5,,,45,0.2,0.2\n")
        >>> recording = read_beams(path, beams=4)
        >>> recording.scans.range_m.tolist()
        [[0.0, 0.0, 80.0, 0.0], [0.0, 0.0, 0.0, 0.0]]
        >>> recording.scans.time_s.tolist(), recording.axes
        ([0.0, 0.5], 'north_east')
    """
    beams = check_size("beams", beams)
    table = read_table(path)
    check_columns(table, _REQUIRED, (*_REQUIRED, *_OPTIONAL))
    every = np.arange(len(table.line))
    where = where_in(table)
    time_s = numbers_in(table, "time_s", every)
    look, look_time_s = looks_of_rows(time_s, None, where)
    _, first = np.unique(look, return_index=True)
    heading_deg, x_m, y_m = (
        one_a_look(table, name, look, first, want="one pose a look") for name in _POSE
    )

    shown = every[filled(table, "beam", "range_m")]

    def where_shown(row: int, column: str) -> str:
        return where(int(shown[row]), column)

    beam = _beams(numbers_in(table, "beam", shown), look[shown], beams, where_shown)
    values = {name: numbers_in(table, name, shown) for name in table.cells if name in _OPTIONAL}
    values["range_m"] = numbers_in(table, "range_m", shown)
    want = f"{RANGE_WANTED} (leave beam and range_m empty for a look without detections)"
    low = np.finfo(np.float64).tiny
    check_numbers(values["range_m"], "range_m", where_shown, low=low, want=want)
    if "weight" in values:
        check_weights(values["weight"], "weight", where_shown)

    fields: dict[str, Any] = {}
    for name, column in values.items():
        fields[name] = np.full((len(first), beams), np.nan)
        fields[name][look[shown], beam] = column
    return beam_scans_from_arrays(
        time_s=look_time_s,
        heading_rad=np.deg2rad(heading_deg),
        position_m=np.stack([x_m, y_m], axis=-1),
        epoch_s=epoch_s,
        origin_m=origin_m,
        **fields,
    )


def _beams(values: np.ndarray, look: np.ndarray, beams: int, where: Where) -> np.ndarray:
    """Return the beams' numbers, [D] int, each in range and once a look."""
    last = beams - 1
    check_numbers(values, "beam", where, low=0, high=last, want=f"a beam's number, 0 to {last}")
    beam = whole_numbers(values, "beam", where)
    cell = look * beams + beam
    check_once(cell, beam, "beam", where, want="at most one range a beam")
    return beam
