"""One trial of the study `nht`: a scene is simulated once, and every method looks at the same scans.

All methods that share static sizes form one compiled program; noise, clutter, truth, grid and
tolerances are traced, so that situations, target-free scenes and real data need no other.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack.hough import Grid, Peaks, Sizes, improved, joint, modified, neutrosophic, standard
from jaxtrack.models.observation import PositionSensor
from jaxtrack.sensors import Radar, observe
from jaxtrack.studies.nht_words import target_votes
from jaxtrack.types import Array, Key, Lines, Scan, Truth

LINES = 8
SMOOTH = 2  # cells
TARGETS = 3
# Methods whose votes land in cells come with raw and with smoothed peaks; the others in one form.
VARIANTS = (
    ("HT", "raw"),
    ("HT", "smoothed"),
    ("MHT", "raw"),
    ("MHT", "smoothed"),
    ("IHT", "raw"),
    ("IHT", "smoothed"),
    ("NHT", "raw"),
    ("NHT", "smoothed"),
    ("NHT spread", "raw"),
    ("NHT wide", "raw"),
    ("NHT cov", "raw"),
    ("joint", "raw"),
)
METHODS = tuple(dict.fromkeys(method for method, _ in VARIANTS))
PEAKS = ("raw", "smoothed")
DENSE = ("HT",)  # traverses the whole parameter space
PAIRED = METHODS[1:]


class Shape(NamedTuple):
    """Static sizes of a table of programs, far above the largest seen in 100 runs."""

    name: str
    detections: int  # a look
    pairs: int  # all pairs of an interval
    gated_pairs: int  # those of admissible speed
    predecessors: int
    hypotheses: int
    rho: int = 1600  # cells of 5 m
    candidates: int = 128  # parameter points whose votes are counted


class Inputs(NamedTuple):
    """What is traced."""

    truth: Truth
    radar: Radar
    grid: Grid
    peaks: Peaks
    sensor: PositionSensor  # what the joint vote assumes
    joint_gate: Array | float
    wide_m: Array | float  # ε_ρ of "NHT wide"
    wide_rad: Array | float  # its ε_θ


SHAPES = {
    "10": Shape("10", 32, 1024, 192, 24, 4096),
    "56": Shape("56", 96, 7168, 1536, 48, 32768),
    "real": Shape("real", 32, 1024, 192, 24, 4096, rho=6800),
}


class Outcome(NamedTuple):
    """What one trial of some methods gives."""

    lines: dict[str, Lines]  # "method peaks" → [LINES], ungated but for the joint vote
    overflow: dict[str, Array]
    words: dict[str, dict[str, Array]]  # divergence and decline [TARGETS] by method


@functools.cache
def trial(shape: Shape, methods: tuple[str, ...]) -> Callable[[Key, Inputs], Outcome]:
    """Return the function of one trial; the same object for the same arguments."""

    def run(key: Key, inputs: Inputs) -> Outcome:
        scans = observe(key, inputs.truth, inputs.radar, detections=shape.detections)
        outcome = Outcome({}, {}, {})
        for method in methods:
            for label, (lines, overflow) in detect(method, scans, inputs, shape).items():
                outcome.lines[label] = lines
                outcome.overflow[label] = overflow
        if "NHT" in methods:
            outcome.words.update(target_votes(scans, inputs.truth, _neutrosophic(inputs), _sizes(shape)))
        return outcome

    return run


def detect(
    method: str, scans: Scan, inputs: Inputs, shape: Shape
) -> dict[str, tuple[Lines, Array]]:
    """Return the lines of one method, for each of its forms of peaks, and whether it overflowed."""
    if method == "joint":
        params = joint.JointParams(inputs.sensor, gate=inputs.joint_gate)
        sizes = joint.JointSizes(hypotheses=shape.hypotheses)
        tracks, info = joint.estimate(scans, params, sizes=sizes)
        return {"joint raw": (_padded(joint.lines_of(tracks)), info.overflow)}
    forms = [peaks for name, peaks in VARIANTS if name == method]
    result = {}
    for form in forms:
        sizes = _sizes(shape, SMOOTH if form == "smoothed" else 0)
        lines, info = estimator(method, inputs, sizes)(scans)
        result[f"{method} {form}"] = (lines, info.overflow)
    return result


def estimator(method: str, inputs: Inputs, sizes: Sizes) -> Callable[[Scan], tuple[Lines, Any]]:
    """Return one of the voting methods, ready for scans."""
    grid, peaks = inputs.grid, inputs.peaks
    if method == "HT":
        return lambda scans: standard.estimate(
            scans, standard.StandardParams(grid, peaks), sizes=sizes
        )
    if method == "MHT":
        return lambda scans: modified.estimate(
            scans, modified.ModifiedParams(grid, peaks), sizes=sizes
        )
    gated = sizes._replace(pairs=sizes.pairs if method == "MHT" else sizes.pairs)
    return lambda scans: improved.estimate(scans, improved.ImprovedParams(grid, peaks), sizes=gated)
