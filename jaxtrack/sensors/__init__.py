"""Simulated and recorded sensors: a radar that reports positions, and the scenes it looks at."""

from jaxtrack.sensors.radar import Radar, clutter_per_scan, move, observe
from jaxtrack.sensors.scenes import (
    SITUATIONS,
    Scene,
    SceneLimits,
    crossing_targets,
    radar_measurements,
    random_targets,
)

__all__ = [
    "SITUATIONS",
    "Radar",
    "Scene",
    "SceneLimits",
    "clutter_per_scan",
    "crossing_targets",
    "move",
    "observe",
    "radar_measurements",
    "random_targets",
]
