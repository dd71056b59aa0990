"""Tuning by gradient: losses of one realization, and the one loop that trains on thousands of them.

    params  ──►  loss(params, key)  ──►  mean over realizations  ──►  gradient  ──►  params

`fit` is the loop, and `mean_loss` what it evaluates. For losses there are `ospa` and `gospa`, whose
gradient is that of the assignment at hand; `sinkhorn_ospa` and `sinkhorn_gospa`, smooth where those
have kinks; `candidate_softmax` for votes; `negative_log_likelihood` for filters; `false_track_loss`
for gates: all of them in `tuning.objectives`. `clip_each` keeps single realizations of a loss from
dominating its gradient. `falsify` goes the other way, up the loss in what makes a scene, and finds
scenes that break a tracker. Data come out; `jaxtrack.plots` draws them.
"""

from jaxtrack.tuning.clipping import clip_each
from jaxtrack.tuning.falsify import Falsified, falsify, uniform_scene
from jaxtrack.tuning.fit import FitHistory, FitResult, fit
from jaxtrack.tuning.objectives import (
    SinkhornDistance,
    candidate_softmax,
    false_track_loss,
    gospa,
    mean_loss,
    negative_log_likelihood,
    ospa,
    sinkhorn_gospa,
    sinkhorn_ospa,
)
from jaxtrack.tuning.regression_scenes import read_regression_scenes, write_regression_scenes

__all__ = [
    "Falsified",
    "FitHistory",
    "FitResult",
    "SinkhornDistance",
    "candidate_softmax",
    "clip_each",
    "false_track_loss",
    "falsify",
    "fit",
    "gospa",
    "mean_loss",
    "negative_log_likelihood",
    "ospa",
    "read_regression_scenes",
    "sinkhorn_gospa",
    "sinkhorn_ospa",
    "uniform_scene",
    "write_regression_scenes",
]
