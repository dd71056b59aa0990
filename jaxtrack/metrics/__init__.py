"""Scores of estimates against the truth: distances between sets of targets, track initiation.

`ospa` and `gospa` compare a set of estimated states with a set of true ones and carry gradients;
`ospa_over_time` does so look by look, `ospa2` and `trajectory_gospa` compare whole tracks, which
`trajectories` lays out by identity, and `swap_and_loss` judges two tracks that met. `nees`, `nis`
and `consistency` ask whether errors are as large as a filter says, and `cramer_rao` bounds them.
`initiation_scores` compares detected lines with true straight trajectories, and `divergence` and
`decline` describe the peaks that the lines came from. `known_posterior_mean` is the floor of an
estimator that knows which detections are a target's.
"""

from jaxtrack.metrics.consistency import (
    ConsistencyTest,
    NormalizedError,
    chi_squared_quantile,
    consistency,
    nees,
    nis,
)
from jaxtrack.metrics.cramer_rao import CramerRao, cramer_rao, measurement_information
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
from jaxtrack.metrics.swap_loss import SwapLoss, swap_and_loss
from jaxtrack.metrics.trajectories import Trajectories, trajectories
from jaxtrack.metrics.trajectory_gospa import TrajectoryGospa, trajectory_gospa

__all__ = [
    "MAX_DISCRIMINATION",
    "ConsistencyTest",
    "CramerRao",
    "Gospa",
    "InitiationScores",
    "KnownDetections",
    "LeastSquares",
    "NormalizedError",
    "Ospa",
    "OspaOverTime",
    "PosteriorMean",
    "SwapLoss",
    "Trajectories",
    "TrajectoryGospa",
    "all_pass_at_truth",
    "chi_squared_quantile",
    "consistency",
    "cramer_rao",
    "decline",
    "divergence",
    "gospa",
    "initiation_scores",
    "known_least_squares",
    "known_posterior_mean",
    "least_squares_line",
    "line_distance",
    "measurement_information",
    "nees",
    "nis",
    "ospa",
    "ospa2",
    "ospa2_over_time",
    "ospa_over_time",
    "swap_and_loss",
    "trajectories",
    "trajectory_gospa",
]
