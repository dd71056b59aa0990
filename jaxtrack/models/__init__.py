"""How targets move and how they are seen: straight lines, motion, observation likelihoods."""

from jaxtrack.models.beams import BEAMS, BeamSensor
from jaxtrack.models.frames import earth_to_polar, polar_to_earth
from jaxtrack.models.line import (
    line_covariance,
    line_difference,
    line_through,
    point_line_distance,
    wrap_line,
)
from jaxtrack.models.motion import look_times, propagate, transition_matrix
from jaxtrack.models.observation import (
    POSITION,
    Observation,
    PositionSensor,
    position_log_likelihood_ratio,
    position_responsibility,
    position_scores,
)
from jaxtrack.models.sonar import BeamSonar, beam_bearings

__all__ = [
    "BEAMS",
    "POSITION",
    "BeamSensor",
    "BeamSonar",
    "Observation",
    "PositionSensor",
    "beam_bearings",
    "earth_to_polar",
    "line_covariance",
    "line_difference",
    "line_through",
    "look_times",
    "point_line_distance",
    "polar_to_earth",
    "position_log_likelihood_ratio",
    "position_responsibility",
    "position_scores",
    "propagate",
    "transition_matrix",
    "wrap_line",
]
