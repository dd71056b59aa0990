"""What the study `nht` is run with: the paper's crossing targets, and its real radar data."""

from typing import NamedTuple

import numpy as np

from jaxtrack.hough import Grid, Peaks
from jaxtrack.models import PositionSensor
from jaxtrack.sensors import Radar, Scene, crossing_targets, radar_measurements
from jaxtrack.types import Array, Truth

# What the joint vote assumes of the real data: the 21 dots miss their constant-velocity fits by
# 56 m in each coordinate (the tracks bend), which covers the 10 m of added noise.
REAL_SIGMA_M = 60.0
REAL_GRID = Grid(origin_m=(-12500.0, 21000.0), rho_max_m=17000.0)
P_DETECT, SIGMA_M = 0.99, 10.0  # assumed everywhere else, also where there is no noise
WIDE, REAL_WIDE = (77.0, 0.075), (150.0, 0.03)  # ε of "NHT wide"


class Inputs(NamedTuple):
    """What one program is run with. Traced."""

    truth: Truth
    radar: Radar
    grid: Grid
    peaks: Peaks
    sensor: PositionSensor  # what the joint vote assumes
    joint_gate: Array | float
    wide_m: Array | float  # ε_ρ of "NHT wide"
    wide_rad: Array | float  # its ε_θ


def simulated_inputs(
    situation: str, clutter: float, expected: float, joint_gate: float = 0.0
) -> Inputs:
    """Return what a situation of the paper is run with, by methods that expect so much clutter."""
    scene = crossing_targets(situation, clutter)
    return _inputs(scene, expected, Grid(), SIGMA_M, WIDE, joint_gate)


def real_inputs(sigma_m: float, joint_gate: float = 0.0) -> Inputs:
    """Return what the real data are run with, noise of `sigma_m` and 10 clutter a scan added."""
    scene = radar_measurements(sigma_m, 10.0)
    return _inputs(scene, 10.0, REAL_GRID, REAL_SIGMA_M, REAL_WIDE, joint_gate)


def _inputs(
    scene: Scene,
    expected: float,
    grid: Grid,
    sigma_m: float,
    wide: tuple[float, float],
    joint_gate: float,
) -> Inputs:
    low, high = np.asarray(scene.radar.field_low_m), np.asarray(scene.radar.field_high_m)
    density = max(expected, 1.0) / float((high - low).prod())  # a likelihood needs some clutter
    sensor = PositionSensor(P_DETECT, density, sigma_m)
    return Inputs(scene.truth, scene.radar, grid, Peaks(), sensor, joint_gate, *wide)
