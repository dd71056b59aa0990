"""Cells of the vote in velocity and initial position that suit a recording's field and speeds."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxtrack.hough import clustering_statistic
from jaxtrack.hough.clustering_params import ClusteringParams, ClusteringSizes
from jaxtrack.hough.slope_intercept import LineGrid, LineSizes
from jaxtrack.tracking.prepared import Prepared

CELL_VOTES: dict[str, Callable[..., Any]] = {
    "csht": clustering_statistic.estimate,
    "sht": clustering_statistic.threshold_estimate,
}
"""The clustering-statistic Hough transform, and the vote by threshold alone."""

# The vote's own defaults, for windows of 9.5 s and a noise of 3 m, in units of window and noise.
_CELL_SIGMAS = 2.2  # width of a cell of positions
_FINER = 0.3  # of a cell: what one step of velocity moves a line over the whole window
_USUAL_S = 9.5
_MOST_CELLS = 256
_MOST_VELOCITIES = 512  # of one sign; that many cells never ask for more


def cells_of(
    ready: Prepared, fastest_m_s: float, lasts_s: float, *, tracks: int
) -> tuple[ClusteringParams, ClusteringSizes, tuple[str, ...]]:
    """Return grids and sizes of the vote over windows of a recording, and what did not fit.

    Args:
        ready: the recording; its field and noise count.
        fastest_m_s: of the targets.
        lasts_s: a window, in seconds.
        tracks: that are looked for in one.

    Example:
        >>> from jaxtrack.hough import SpeedGate
        >>> from jaxtrack.tracking.prepared import prepare
        >>> from jaxtrack.types import Scan
        >>> scans = Scan(np.zeros(2), np.ones(2, bool), np.array([[[0.0, 0.0]], [[300.0, 200.0]]]),
        ...              np.ones((2, 1), bool))
        >>> options = {"sigma_m": 5.0, "p_detect": 0.9, "false_per_window": 0.1}
        >>> ready = prepare(scans, None, SpeedGate(), **options)
        >>> _, sizes, notes = cells_of(ready, 10.0, 10.0, tracks=4)
        >>> print(sizes.lines.positions, sizes.lines.velocities, notes)
        46 63 ()
    """
    scans, sigma_m = ready.positions, ready.sigma_m
    counts = np.asarray(scans.mask) & np.asarray(scans.valid)[:, None]
    places = np.asarray(scans.position_m, np.float64)[counts]
    if len(places) == 0 or lasts_s == 0.0:
        places, lasts_s = np.zeros((1, 2)), max(lasts_s, 1.0)
    reach_m = fastest_m_s * lasts_s
    cell_m, notes = _CELL_SIGMAS * sigma_m, ()
    low, high = places.min(0) - reach_m, places.max(0) + reach_m
    number = math.ceil(float((high - low).max()) / cell_m)
    if number > _MOST_CELLS:
        number, cell_m = _MOST_CELLS, float((high - low).max()) / _MOST_CELLS
        notes = (f"the field is wide: cells are {cell_m:.0f} m instead of 2.2 sigma_m",)
    step = _FINER * cell_m / lasts_s
    half = min(math.ceil(fastest_m_s / step), _MOST_VELOCITIES)
    step = fastest_m_s / half
    grids = [LineGrid(-fastest_m_s, step, float(x), cell_m) for x in low]
    usual, slower = ClusteringParams(), lasts_s / _USUAL_S
    params = usual._replace(
        x=grids[0],
        y=grids[1],
        velocity_scale_s=float(usual.velocity_scale_s) * slower,
        cluster_time_s=float(usual.cluster_time_s) * slower,
        sigma_m=sigma_m,
    )
    sizes = ClusteringSizes(
        lines=LineSizes(velocities=2 * half + 1, positions=number),
        patterns=tracks,
        start=min(tracks, 3),
    )
    return params, sizes, notes
