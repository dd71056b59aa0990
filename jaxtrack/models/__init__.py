"""How targets move and how they are seen: straight lines, motion and its noise, observation."""

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
from jaxtrack.models.process import (
    Motion,
    constant_velocity,
    coordinated_turn,
    straight,
    turn,
    turn_noise,
    white_noise_acceleration,
)
from jaxtrack.models.range_bearing import PolarScan, range_bearing, range_bearing_residual
from jaxtrack.models.sonar import BeamSonar, beam_bearings

__all__ = [
    "BEAMS",
    "POSITION",
    "BeamSensor",
    "BeamSonar",
    "Motion",
    "Observation",
    "PolarScan",
    "PositionSensor",
    "beam_bearings",
    "constant_velocity",
    "coordinated_turn",
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
    "range_bearing",
    "range_bearing_residual",
    "straight",
    "transition_matrix",
    "turn",
    "turn_noise",
    "white_noise_acceleration",
    "wrap_line",
]
