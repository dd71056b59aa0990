"""Simulated and recorded sensors, and the scenes they look at.

A radar that reports positions, a multi-beam sonar that reports ranges, and a sensor that sees
several echoes of each of two targets that meet.
"""

from jaxtrack.sensors.crossings import (
    EchoLooks,
    EchoSensor,
    Meeting,
    Situation,
    meeting_targets,
    observe_echoes,
    situations,
)
from jaxtrack.sensors.echoes import Echo, echo_amplitudes
from jaxtrack.sensors.radar import Radar, clutter_per_scan, move, observe
from jaxtrack.sensors.scenes import (
    SITUATIONS,
    Scene,
    SceneLimits,
    crossing_targets,
    radar_measurements,
    random_targets,
)
from jaxtrack.sensors.sonar import (
    FALSE_ALARMS,
    in_sight,
    in_view,
    observe_beams,
    observe_known_beams,
    scan_of_beams,
)
from jaxtrack.sensors.sonar_scenes import (
    TRUTHS,
    SonarScene,
    SonarSceneLimits,
    motion_elements_scene,
    random_sonar_scene,
    tracking_scene,
)

__all__ = [
    "FALSE_ALARMS",
    "SITUATIONS",
    "TRUTHS",
    "Echo",
    "EchoLooks",
    "EchoSensor",
    "Meeting",
    "Radar",
    "Scene",
    "SceneLimits",
    "Situation",
    "SonarScene",
    "SonarSceneLimits",
    "clutter_per_scan",
    "crossing_targets",
    "echo_amplitudes",
    "in_sight",
    "in_view",
    "meeting_targets",
    "motion_elements_scene",
    "move",
    "observe",
    "observe_beams",
    "observe_echoes",
    "observe_known_beams",
    "radar_measurements",
    "random_sonar_scene",
    "random_targets",
    "scan_of_beams",
    "situations",
    "tracking_scene",
]
