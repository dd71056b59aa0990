"""Static sizes, field and clutter of a recording, counted on the host in NumPy."""

import math
from typing import NamedTuple

import numpy as np

from jaxtrack.hough.grid import Sizes
from jaxtrack.hough.joint import JointSizes
from jaxtrack.hough.pairs import SpeedGate
from jaxtrack.types import Scan

MOST_PAIRS = 1 << 16  # of one interval
MOST_PREDECESSORS = 1 << 10
MOST_HYPOTHESES = 1 << 16
MOST_CELLS = 2048  # along ρ

# Width along ρ at a noise of 10 m (it grows with it), width along θ, smoothing in cells.
_CELLS = {"standard": (5.0, 1e-3, 2), "pairs": (50.0, 30e-3, 1)}


class Field(NamedTuple):
    """Where a recording's detections lie, and how many there are."""

    corners_m: tuple[np.ndarray, np.ndarray]  # low and high, each [2]
    centre_m: np.ndarray  # [2]
    rho_max_m: float
    detections_per_look: float
    clutter_per_m2: float  # the same a square metre
    most_detections: int  # what a look has to hold


def field_of(scans: Scan, sigma_m: float) -> Field:
    """Return the bounding box of all detections, no narrower than ten sigma, and their density.

    Example:
        >>> scans = Scan(np.zeros(1), np.ones(1, bool), np.array([[[0.0, 0.0], [200.0, 500.0]]]),
        ...              np.ones((1, 2), bool))
        >>> field_of(scans, 10.0).clutter_per_m2
        2e-05
    """
    counts = np.asarray(scans.mask) & np.asarray(scans.valid)[:, None]
    position_m = np.asarray(scans.position_m, np.float64)[counts]
    if len(position_m) == 0:
        position_m = np.zeros((1, 2))
    low, high = position_m.min(axis=0), position_m.max(axis=0)
    centre = (low + high) / 2
    half = np.maximum(high - low, 10.0 * sigma_m) / 2
    mean = float(counts.sum()) / max(int(np.sum(scans.valid)), 1)
    # Poisson counts stay below this beyond notice.
    most = max(counts.shape[1], math.ceil(mean + 5.0 * math.sqrt(mean)) + 1)
    return Field(
        corners_m=(centre - half, centre + half),
        centre_m=centre,
        rho_max_m=float(np.hypot(*half)),
        detections_per_look=mean,
        clutter_per_m2=mean / float(np.prod(2 * half)),
        most_detections=most,
    )


def choose_sizes(
    scans: Scan, field: Field, speed: SpeedGate, sigma_m: float, *, method: str, tracks: int
) -> tuple[Sizes | JointSizes, tuple[str, ...]]:
    """Return a method's static sizes, and which limits were hit, in sentences.

    Tables hold half as many pairs again as the recording needs, so that scenes like it fit too,
    and are rounded up to powers of two, so that recordings alike share one compiled program.
    """
    looks = int(np.shape(scans.time_s)[0])
    gate = None if method == "modified" else speed
    if method == "joint":
        # From half a window apart on; farther where that makes more pairs than fit.
        gap, pairs = looks, 0
        while gap > max(looks // 2, 1):
            couples = [(k, k + gap - 1) for k in range(looks - gap + 1)]
            more = sum(int(_admissible(scans, k, m, gate).sum()) for k, m in couples)
            if pairs and 3 * (pairs + more) // 2 > MOST_HYPOTHESES:
                break
            gap, pairs = gap - 1, pairs + more
        hypotheses, notes = fitting(pairs, 1024, MOST_HYPOTHESES, "pairs of distant looks")
        return JointSizes(tracks=tracks, hypotheses=hypotheses, gap=gap), notes
    pairs, predecessors = 1, 1
    notes: tuple[str, ...] = ()
    if method != "standard":
        tables = [_admissible(scans, k, k + 1, gate) for k in range(looks - 1)]
        most = max(int(table.sum()) for table in tables)
        pairs, notes = fitting(most, 256, MOST_PAIRS, "pairs of successive looks")
    if method == "neutrosophic":
        most = max(int(table.sum(axis=0).max()) for table in tables)
        predecessors, more = fitting(most, 16, MOST_PREDECESSORS, "pairs ending in a detection")
        notes += more
    # A detection's noise moves its curve by sigma; the line of two near detections is much poorer.
    cell_m, cell_rad, smooth = _CELLS["standard" if method == "standard" else "pairs"]
    cell_m *= sigma_m / 10.0
    rho = math.ceil(2 * field.rho_max_m / cell_m)
    if rho > MOST_CELLS:
        rho, wide_m = MOST_CELLS, 2 * field.rho_max_m / MOST_CELLS
        notes += (f"the field is wide: cells are {wide_m:.0f} m along ρ instead of {cell_m:g} m",)
    sizes = Sizes(
        lines=tracks,
        pairs=pairs,
        predecessors=predecessors,
        rho=rho,
        theta=math.ceil(math.pi / cell_rad),
        smooth=smooth,
    )
    return sizes, notes


def most_pairs(scans: Scan, speed: SpeedGate, *, gap: int, window: int) -> int:
    """Return how many pairs at least `gap` looks apart the fullest window of a recording holds.

    Counted are pairs of detections that one target could have caused, over all runs of `window`
    valid looks.

    Example:
        >>> scans = Scan(np.arange(3.0), np.ones(3, bool), np.zeros((3, 1, 2)) +
        ...              np.arange(0.0, 600.0, 200.0)[:, None, None], np.ones((3, 1), bool))
        >>> most_pairs(scans, SpeedGate(100.0, 400.0), gap=1, window=3)
        3
        >>> most_pairs(scans, SpeedGate(100.0, 400.0), gap=1, window=2)
        1
    """
    valid = np.flatnonzero(np.asarray(scans.valid))
    count: dict[tuple[int, int], int] = {}
    here, most = 0, 0
    for end in range(len(valid)):
        for start in range(max(end - window + 1, 0), end - gap + 1):
            pairs = int(_admissible(scans, valid[start], valid[end], speed).sum())
            count[start, end] = pairs
            here += pairs
        gone = end - window
        here -= sum(count.pop((gone, m), 0) for m in range(gone + gap, end)) if gone >= 0 else 0
        most = max(most, here)
    return most


def fitting(needed: int, least: int, most: int, what: str) -> tuple[int, tuple[str, ...]]:
    """Return the size of a table for half as many again, and a sentence where it holds too few.

    Example:
        >>> fitting(1000, 256, 4096, "pairs"), fitting(5000, 256, 4096, "pairs")
        ((2048, ()), (4096, ('there are 5000 pairs, of which 4096 fit',)))
    """
    size = 1 << (max(needed * 3 // 2, least) - 1).bit_length()
    if size <= most:
        return size, ()
    return most, (f"there are {needed} {what}, of which {most} fit",) if needed > most else ()


def _admissible(scans: Scan, early: int, late: int, speed: SpeedGate | None) -> np.ndarray:
    """Return which pairs of detections of two looks one target could have caused, [N, N]."""
    counts = np.asarray(scans.mask) & np.asarray(scans.valid)[:, None]
    position_m = np.asarray(scans.position_m, np.float64)
    time_s = np.broadcast_to(np.asarray(scans.time_s, np.float64)[:, None], counts.shape)
    if scans.delay_s is not None:
        time_s = time_s + np.where(counts, np.asarray(scans.delay_s, np.float64), 0.0)
    both = counts[early][:, None] & counts[late][None, :]
    dt = time_s[late][None, :] - time_s[early][:, None]
    away = np.where(
        both, np.linalg.norm(position_m[late][None] - position_m[early][:, None], axis=-1), 0.0
    )
    both = both & (dt > 0) & (away > 0)
    if speed is None:
        return both
    return both & (away >= speed.v_min_m_s * dt) & (away <= speed.v_max_m_s * dt)
