"""Hough track initiators: one file a method, all of the form `estimate(scans, params, *, sizes)`.

`standard` (every detection votes along its sinusoid), `modified` (every pair of successive looks
votes once), `improved` (pairs of admissible speed only), `neutrosophic` (pairs vote as far as the
interval before speaks for them), `joint` (a likelihood over whole trajectories),
`clustering_statistic` (positions over time vote by `slope_intercept`; clusters of cells are
targets).
"""

from jaxtrack.hough import (
    clustering_statistic,
    improved,
    joint,
    modified,
    neutrosophic,
    slope_intercept,
    standard,
)
from jaxtrack.hough.gate import gate_for_false_rate
from jaxtrack.hough.grid import Grid, Sizes
from jaxtrack.hough.packing import pack_beams, pack_detections
from jaxtrack.hough.pairs import SpeedGate
from jaxtrack.hough.peaks import HoughInfo, Peaks

__all__ = [
    "Grid",
    "HoughInfo",
    "Peaks",
    "Sizes",
    "SpeedGate",
    "clustering_statistic",
    "gate_for_false_rate",
    "improved",
    "joint",
    "modified",
    "neutrosophic",
    "pack_beams",
    "pack_detections",
    "slope_intercept",
    "standard",
]
