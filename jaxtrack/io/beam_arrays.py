"""NumPy arrays, one look a row and one beam a column, to the scans of a multi-beam sonar."""

from typing import Any

import numpy as np

from jaxtrack.io.arrays import float_array
from jaxtrack.io.errors import DataError, check_numbers, check_rising, check_weights
from jaxtrack.io.recording import Recording, frame_of
from jaxtrack.types import BeamScan, Pose

RANGE_WANTED = "a positive range, at most 1e12"


def beam_scans_from_arrays(
    range_m: Any,
    time_s: Any,
    heading_rad: Any,
    position_m: Any,
    *,
    weight: Any = None,
    intensity: Any = None,
    epoch_s: float | None = None,
    origin_m: Any = None,
    axes: str = "north_east",
) -> Recording[BeamScan]:
    """Take the looks of a multi-beam sonar as they are: at most one range a beam.

    Args:
        range_m: metres, NaN where a beam is silent, [T, B]; beam 0 is the port-most.
        time_s: of each look, seconds, never running back, [T].
        heading_rad: of the carrier, from the first axis towards the second, [T]: clockwise from
            north where the axes are north and east. Where x is east and y north, exchange the two
            coordinates first, for starboard is on the second axis' side.
        position_m: of the carrier, [T, 2].
        weight: how much each detection counts, in [0, 1], [T, B].
        intensity: of each detection, [T, B].
        epoch_s: what to subtract from times; None: the first look's time.
        origin_m: what to subtract from the carrier's positions, [2]; None: (0, 0) if no coordinate
            exceeds 100 km in size, else the centroid in whole kilometres.
        axes: `"north_east"`, or `"x_y"`, the user's own.

    Returns:
        A `Recording` of `BeamScan`s. Silent beams hold zero, their mask is False, and what stands
        in weight and intensity there is not looked at. Every look is valid.

    Raises:
        DataError: a value is wrong (inf, a range of zero, time running back, …), with its place.
        ValueError: a shape or an option is wrong.
        TypeError: a dtype is wrong.

    Example:
        >>> recording = beam_scans_from_arrays(
        ...     range_m=[[np.nan, 80.0, np.nan], [np.nan, 79.0, 31.5]],
        ...     time_s=[1.7e9, 1.7e9 + 0.5],
        ...     heading_rad=[0.8, 0.8],
        ...     position_m=[[5934020.0, 565010.0], [5934020.4, 565010.4]],
        ... )
        >>> recording.epoch_s, recording.origin_m.tolist()
        (1700000000.0, [5934000.0, 565000.0])
        >>> recording.scans.range_m.tolist()
        [[0.0, 80.0, 0.0], [0.0, 79.0, 31.5]]
        >>> recording.scans.pose.position_m[0].tolist()
        [20.0, 10.0]
    """
    ranges_m = float_array("range_m", range_m, ("T", "B"))
    looks, beams = ranges_m.shape
    if beams == 0:
        raise ValueError("range_m: got no beams, want [T, B] with at least one")
    times_s = float_array("time_s", time_s, (looks,))
    headings_rad = float_array("heading_rad", heading_rad, (looks,))
    positions_m = float_array("position_m", position_m, (looks, 2))
    given = {
        name: float_array(name, value, (looks, beams))
        for name, value in (("weight", weight), ("intensity", intensity))
        if value is not None
    }
    if looks == 0:
        raise DataError("time_s: got no looks, want at least one")

    check_numbers(times_s, "time_s", _look)
    check_rising(times_s, "time_s", _look)
    check_numbers(headings_rad, "heading_rad", _look)
    for axis in (0, 1):
        check_numbers(positions_m[:, axis], f"position_m[:, {axis}]", _look)
    mask = ~np.isnan(ranges_m)
    look, beam = np.nonzero(mask)

    def where(row: int, column: str) -> str:
        return f"{column}, look {look[row]}, beam {beam[row]} (the first are 0)"

    want = f"{RANGE_WANTED}, or NaN for a silent beam"
    check_numbers(ranges_m[mask], "range_m", where, low=np.finfo(np.float64).tiny, want=want)
    for name, values in given.items():
        check = check_weights if name == "weight" else check_numbers
        check(values[mask], name, where)

    epoch, origin = frame_of(times_s, positions_m, epoch_s, origin_m, axes)
    pose: list[Any] = [positions_m - origin, headings_rad]
    fields: dict[str, Any] = {
        "time_s": times_s - epoch,
        "valid": np.ones(looks, bool),
        "range_m": np.where(mask, ranges_m, 0.0),
        "mask": mask,
        "pose": Pose(*pose),
    }
    for name, values in given.items():
        fields[name] = np.where(mask, values, 0.0)
    return Recording(BeamScan(**fields), epoch, origin, axes)


def _look(row: int, column: str) -> str:
    return f"{column}, look {row} (the first is 0)"
