"""Scenes, methods and metrics that a study's file calls by name: a radar's looks at targets."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxtrack import hough, metrics, sensors
from jaxtrack.hough.joint import JointParams, JointSizes, lines_of
from jaxtrack.models import PositionSensor
from jaxtrack.types import Array, Key, Lines, Scan, Tracks, Truth


class Looks(NamedTuple):
    """What a scene gives to methods and metrics."""

    scans: Scan  # stacked
    truth: Truth
    radar: sensors.Radar


def crossing_targets(
    key: Key,
    *,
    sigma_m: Any = 10.0,
    clutter_per_scan: Any = 10.0,
    p_detect: Any = 0.99,
    detections: int = 32,
) -> Looks:
    """Return seven looks at `sensors.crossing_targets`, `detections` being static.

    Example:
        >>> crossing_targets(jax.random.key(0)).scans.position_m.shape
        (7, 32, 2)
    """
    radar = sensors.Radar(p_detect, sigma_m, clutter_per_scan)
    truth = sensors.crossing_targets().truth
    return Looks(sensors.observe(key, truth, radar, detections=detections), truth, radar)


def random_targets(
    key: Key,
    *,
    targets: int = 3,
    looks: int = 7,
    dt_s: Any = 2.0,
    sigma_m: Any = 10.0,
    clutter_per_scan: Any = 10.0,
    p_detect: Any = 0.99,
    detections: int = 32,
) -> Looks:
    """Return looks at `sensors.random_targets`, new ones each trial; static are what counts things.

    Example:
        >>> random_targets(jax.random.key(0), targets=2).truth.state.shape
        (7, 2, 4)
    """
    where, seen = jax.random.split(key)
    radar = sensors.Radar(p_detect, sigma_m, clutter_per_scan)
    limits = sensors.SceneLimits()
    truth, _ = sensors.random_targets(where, radar, limits, targets=targets, looks=looks, dt_s=dt_s)
    return Looks(sensors.observe(seen, truth, radar, detections=detections), truth, radar)


def _voting(estimate: Callable[..., Any], params: Callable[..., Any]) -> Callable[..., Lines]:
    """Return the method that a Hough transform is."""

    def lines(
        looks: Looks,
        *,
        gate: Any,
        lines: int = 8,
        pairs: int = 2048,
        predecessors: int = 48,
        rho: int = 1600,
        theta: int = 3142,
    ) -> Lines:
        """Return the lines of at least `gate` votes; all but the gate are static."""
        sizes = hough.Sizes(lines, pairs, predecessors, rho=rho, theta=theta)
        return estimate(looks.scans, params(peaks=hough.Peaks(gate=gate)), sizes=sizes)[0]

    return lines


def joint(looks: Looks, *, gate: Any, tracks: int = 6, hypotheses: int = 4096) -> Tracks:
    """Return the tracks of `hough.joint`, which knows the radar; all but the gate are static."""
    radar = looks.radar
    low, high = jnp.asarray(radar.field_low_m), jnp.asarray(radar.field_high_m)
    clutter_per_m2 = radar.clutter_per_scan / (high - low).prod()
    sensor = PositionSensor(radar.p_detect, clutter_per_m2, radar.sigma_m)
    sizes = JointSizes(tracks=tracks, hypotheses=hypotheses)
    return hough.joint.estimate(looks.scans, JointParams(sensor, gate=gate), sizes=sizes)[0]


def targets_found(looks: Looks, estimate: Lines | Tracks, *, match_m: Any = 100.0) -> Array:
    """Return how many targets have a line within `match_m`; see `metrics.initiation_scores`."""
    return _scores(looks, estimate, match_m).found


def false_lines(looks: Looks, estimate: Lines | Tracks, *, match_m: Any = 100.0) -> Array:
    """Return how many lines match no target."""
    return _scores(looks, estimate, match_m).false


def perfect(looks: Looks, estimate: Lines | Tracks, *, match_m: Any = 100.0) -> Array:
    """Return whether all targets are found, nothing false and nothing twice."""
    return _scores(looks, estimate, match_m).perfect


def ospa(looks: Looks, estimate: Tracks, *, cutoff_m: Any = 100.0, order: Any = 1.0) -> Array:
    """Return the OSPA distance of the tracks' positions from the targets' at the last look."""
    return metrics.ospa(
        estimate.mean[:, :2],
        estimate.mask,
        looks.truth.state[-1, :, :2],
        looks.truth.mask[-1],
        cutoff=cutoff_m,
        order=order,
    ).distance


def _scores(looks: Looks, estimate: Lines | Tracks, match_m: Any) -> metrics.InitiationScores:
    lines = lines_of(estimate) if isinstance(estimate, Tracks) else estimate
    place = jnp.moveaxis(looks.truth.state[..., :2], 0, 1)
    there = looks.truth.mask.all(0)
    # What is below the method's own gate is masked already.
    return metrics.initiation_scores(lines, place, there, match_m=match_m, gate=-jnp.inf)


SCENES: dict[str, Callable[..., Any]] = {
    function.__name__: function for function in (crossing_targets, random_targets)
}
METHODS: dict[str, Callable[..., Any]] = {
    "standard": _voting(hough.standard.estimate, hough.standard.StandardParams),
    "modified": _voting(hough.modified.estimate, hough.modified.ModifiedParams),
    "improved": _voting(hough.improved.estimate, hough.improved.ImprovedParams),
    "neutrosophic": _voting(hough.neutrosophic.estimate, hough.neutrosophic.NeutrosophicParams),
    "joint": joint,
}
METRICS: dict[str, Callable[..., Any]] = {
    function.__name__: function for function in (targets_found, false_lines, perfect, ospa)
}
