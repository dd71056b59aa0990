"""Scores of estimates against the truth: distances between sets of targets, track initiation.

`ospa` and `gospa` compare a set of estimated states with a set of true ones and carry gradients;
`initiation_scores` compares detected lines with true straight trajectories, and `divergence` and
`decline` describe the peaks that the lines came from. `known_posterior_mean` is the floor of an
estimator that knows which detections are a target's.
"""

from jaxtrack.metrics.floor import (
    KnownDetections,
    LeastSquares,
    PosteriorMean,
    all_pass_at_truth,
    known_least_squares,
    known_posterior_mean,
)
from jaxtrack.metrics.gospa import Gospa, gospa
from jaxtrack.metrics.initiation import (
    MAX_DISCRIMINATION,
    InitiationScores,
    decline,
    divergence,
    initiation_scores,
)
from jaxtrack.metrics.lines import least_squares_line, line_distance
from jaxtrack.metrics.ospa import Ospa, ospa
from jaxtrack.metrics.ospa2 import ospa2, ospa2_over_time
from jaxtrack.metrics.over_time import OspaOverTime, ospa_over_time
from jaxtrack.metrics.trajectories import Trajectories, trajectories
from jaxtrack.metrics.trajectory_gospa import TrajectoryGospa, trajectory_gospa

__all__ = [
    "MAX_DISCRIMINATION",
    "Gospa",
    "InitiationScores",
    "KnownDetections",
    "LeastSquares",
    "Ospa",
    "OspaOverTime",
    "PosteriorMean",
    "Trajectories",
    "TrajectoryGospa",
    "all_pass_at_truth",
    "decline",
    "divergence",
    "gospa",
    "initiation_scores",
    "known_least_squares",
    "known_posterior_mean",
    "least_squares_line",
    "line_distance",
    "ospa",
    "ospa2",
    "ospa2_over_time",
    "ospa_over_time",
    "trajectories",
    "trajectory_gospa",
]
