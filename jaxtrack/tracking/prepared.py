"""A recording's looks on the device, with what they tell about sensor, clutter and sizes."""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxtrack.hough.joint import JointSizes
from jaxtrack.hough.pairs import SpeedGate, check_speeds
from jaxtrack.models import BEAMS, POSITION, BeamSensor, BeamSonar, PositionSensor
from jaxtrack.models.observation import Observation
from jaxtrack.models.sonar import check_sonar
from jaxtrack.numerics.checks import (
    check_beam_scans,
    check_known,
    check_positive,
    check_scans,
)
from jaxtrack.sensors.sonar import scan_of_beams
from jaxtrack.tracking.window_sizes import MOST_HYPOTHESES, field_of, fitting, most_pairs
from jaxtrack.types import BeamScan, Scan

MOST_TRACKS = 1000  # that can be asked for

_LEAST_CLUTTER_PER_M2 = 1e-12


class Prepared(NamedTuple):
    """A recording on the device, with the sensor that it comes from."""

    looks: Any  # Scan or BeamScan
    positions: Scan  # the same in the earth frame
    sensor: Any  # the observation's
    observation: Observation
    area_m2: float  # that detections lie in
    detections_per_look: float
    clutter_per_m2: float  # the same a square metre
    sigma_m: float  # of the sonar where there is one
    p_detect: float  # likewise


def prepare(
    scans: Scan | BeamScan,
    sonar: BeamSonar | None,
    speed: SpeedGate,
    *,
    sigma_m: float,
    p_detect: float,
    false_per_window: float,
) -> Prepared:
    """Return a recording and its sensor, ready for an estimator; not for `jit`.

    Args:
        scans: T looks stacked, of positions or of a sonar's beams.
        sonar: of looks at beams, in place of `sigma_m` and `p_detect`.
        speed: slowest and fastest target, m/s.
        sigma_m: noise of a detection, metres.
        p_detect: probability that a target is detected in a look, in (0, 1).
        false_per_window: wanted mean number of false tracks.

    Raises:
        ValueError: an option is out of range, a position is not finite, or times run back.

    Example:
        >>> scans = Scan(np.zeros(2), np.ones(2, bool), np.array([[[0.0, 0.0]], [[300.0, 200.0]]]),
        ...              np.ones((2, 1), bool))
        >>> ready = prepare(scans, None, SpeedGate(), sigma_m=5.0, p_detect=0.9,
        ...                 false_per_window=0.1)
        >>> print(round(ready.area_m2), ready.sensor.p_detect)
        60000 0.9
    """
    check_speeds(speed)
    for name, value in (("sigma_m", sigma_m), ("false_per_window", false_per_window)):
        check_positive(name, value, jnp.result_type(float))
    check_known("p_detect", p_detect, lambda p: (p > 0) & (p < 1), "a probability between 0 and 1")
    if not isinstance(scans, BeamScan):
        if sonar is not None:
            raise ValueError("sonar: got one with looks at positions, want None")
        looks = on_device(check_scans(scans))
        field = field_of(looks, sigma_m)
        low, high = field.corners_m
        clutter_per_m2 = max(field.clutter_per_m2, _LEAST_CLUTTER_PER_M2)
        return Prepared(
            looks,
            looks,
            PositionSensor(p_detect, clutter_per_m2, sigma_m),
            POSITION,
            float(np.prod(high - low)),
            field.detections_per_look,
            clutter_per_m2,
            sigma_m,
            p_detect,
        )
    if sonar is None:
        raise ValueError("sonar: got None, want the sonar that the beams belong to")
    check_sonar(sonar)
    looks = on_device(check_beam_scans(scans))
    positions = jax.vmap(scan_of_beams, (0, None))(looks, sonar)
    sigma_m, p_detect = float(sonar.sigma_m), 1 - float(sonar.p_miss)
    number = field_of(positions, sigma_m).detections_per_look
    area_m2 = float(sonar.range_max_m) ** 2 * float(sonar.sector_rad) / 2
    clutter_per_m2 = max(number / area_m2, _LEAST_CLUTTER_PER_M2)
    sensor = BeamSensor(sonar)
    return Prepared(
        looks, positions, sensor, BEAMS, area_m2, number, clutter_per_m2, sigma_m, p_detect
    )


def joint_sizes(
    scans: Scan, speed: SpeedGate, *, window: int, tracks: int
) -> tuple[JointSizes, tuple[str, ...]]:
    """Return sizes that hold the pairs of every window of a recording, and what did not fit.

    Args:
        scans: T looks stacked.
        speed: slowest and fastest target, m/s.
        window: looks of a window.
        tracks: that are looked for in one.

    Example:
        >>> scans = Scan(np.arange(3.0), np.ones(3, bool), np.zeros((3, 1, 2)),
        ...              np.ones((3, 1), bool))
        >>> joint_sizes(scans, SpeedGate(), window=3, tracks=2)[0].hypotheses
        1024
    """
    gap = max(1, min(3, window - 1))
    host = jax.tree.map(np.asarray, scans)
    most = most_pairs(host, speed, gap=gap, window=window)
    what = "pairs of distant looks in a window"
    hypotheses, notes = fitting(most, 1024, MOST_HYPOTHESES, what)
    survivors = 4096 if hypotheses > 4096 else None
    sizes = JointSizes(tracks, hypotheses, 1024, gap=gap, survivors=survivors, samples=256)
    return sizes, notes


def confirming_evidence(ready: Prepared, false_per_window: float) -> float:
    """Return log(A/f): clutter alone has so much evidence at most f times a window, on average.

    Evidence is a likelihood ratio, whose mean over clutter is one, for a track in one square metre.

    Example:
        >>> scans = Scan(np.zeros(2), np.ones(2, bool), np.array([[[0.0, 0.0]], [[300.0, 200.0]]]),
        ...              np.ones((2, 1), bool))
        >>> options = {"sigma_m": 5.0, "p_detect": 0.9, "false_per_window": 0.1}
        >>> round(confirming_evidence(prepare(scans, None, SpeedGate(), **options), 0.1), 2)
        13.3
    """
    return max(math.log(ready.area_m2 / false_per_window), 1.0)


def on_device(scans: Any) -> Any:
    """Return scans with JAX's default float, float32 unless the user chose otherwise.

    Example:
        >>> on_device(np.zeros(2, np.float16)).dtype == jnp.result_type(float)
        True
    """
    dtype = jnp.result_type(float)
    cast = lambda x: jnp.asarray(x, bool if np.asarray(x).dtype == bool else dtype)
    return jax.tree.map(cast, scans)
