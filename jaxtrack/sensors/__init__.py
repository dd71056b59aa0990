"""Simulated and recorded sensors, and the scenes they look at.

A radar that reports positions, a multi-beam sonar that reports ranges, a mechanically scanned sonar
that hears echoes ping by ping, and a sensor that sees several echoes of each of two targets that
meet.
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
from jaxtrack.sensors.echoes import Echo, echo_amplitudes, reverberate
from jaxtrack.sensors.fading import Fade, drop, fade
from jaxtrack.sensors.mounting import (
    Mounting,
    Sightings,
    mounting_by_triangle,
    mounting_of_sightings,
)
from jaxtrack.sensors.ping_cloud import cloud_of_pings
from jaxtrack.sensors.pings import Cylinders, Dike, beam_pattern, observe_pings
from jaxtrack.sensors.radar import Radar, clutter_per_scan, move, observe
from jaxtrack.sensors.scanning_scenes import (
    MOTIONS,
    SURROUNDINGS,
    DraggedBucket,
    PingRun,
    beam_crossing,
    dragged_bucket,
    meeting_pings,
)
from jaxtrack.sensors.scanning_sonar import (
    IMAGENEX_881L,
    SUPER_SEAKING_HIGH,
    SUPER_SEAKING_LOW,
    PingSizes,
    ScanningPreset,
    ScanningSonar,
    drifting_pose,
    sweeps,
)
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
    "IMAGENEX_881L",
    "MOTIONS",
    "SITUATIONS",
    "SUPER_SEAKING_HIGH",
    "SUPER_SEAKING_LOW",
    "SURROUNDINGS",
    "TRUTHS",
    "Cylinders",
    "Dike",
    "DraggedBucket",
    "Echo",
    "EchoLooks",
    "EchoSensor",
    "Fade",
    "Meeting",
    "Mounting",
    "PingRun",
    "PingSizes",
    "Radar",
    "ScanningPreset",
    "ScanningSonar",
    "Scene",
    "SceneLimits",
    "Sightings",
    "Situation",
    "SonarScene",
    "SonarSceneLimits",
    "beam_crossing",
    "beam_pattern",
    "cloud_of_pings",
    "clutter_per_scan",
    "crossing_targets",
    "dragged_bucket",
    "drifting_pose",
    "drop",
    "echo_amplitudes",
    "fade",
    "in_sight",
    "in_view",
    "meeting_pings",
    "meeting_targets",
    "motion_elements_scene",
    "mounting_by_triangle",
    "mounting_of_sightings",
    "move",
    "observe",
    "observe_beams",
    "observe_echoes",
    "observe_known_beams",
    "observe_pings",
    "radar_measurements",
    "random_sonar_scene",
    "random_targets",
    "reverberate",
    "scan_of_beams",
    "situations",
    "sweeps",
    "tracking_scene",
]
