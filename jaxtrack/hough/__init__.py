"""Hough track initiators: one file a method, all of the form `estimate(scans, params, *, sizes)`.

`standard` (every detection votes along its sinusoid), `modified` (every pair of successive looks
votes once), `improved` (pairs of admissible speed only), `neutrosophic` (pairs vote as far as the
interval before speaks for them), `joint` (a likelihood over whole trajectories).
"""

from jaxtrack.hough import improved, joint, modified, neutrosophic, standard
from jaxtrack.hough.gate import gate_for_false_rate
from jaxtrack.hough.grid import Grid, Sizes
from jaxtrack.hough.pairs import SpeedGate
from jaxtrack.hough.peaks import HoughInfo, Peaks

__all__ = [
    "Grid",
    "HoughInfo",
    "Peaks",
    "Sizes",
    "SpeedGate",
    "gate_for_false_rate",
    "improved",
    "joint",
    "modified",
    "neutrosophic",
    "standard",
]
