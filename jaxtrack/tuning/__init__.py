"""Tuning by gradient: losses of one realization, and the one loop that trains on thousands of them.

    params  ──►  loss(params, key)  ──►  mean over realizations  ──►  gradient  ──►  params

`fit` is the loop, and `mean_loss` what it evaluates. For losses there are `metrics.ospa` and
`metrics.gospa`, whose gradient is that of the assignment at hand; `sinkhorn_ospa`, smooth where
that one has kinks; `candidate_softmax` for votes; `negative_log_likelihood` for filters;
`false_track_loss` for gates. Data come out; `jaxtrack.plots` draws them.
"""

from jaxtrack.tuning.fit import FitHistory, FitResult, fit
from jaxtrack.tuning.objectives import (
    candidate_softmax,
    false_track_loss,
    negative_log_likelihood,
)
from jaxtrack.tuning.realizations import mean_loss
from jaxtrack.tuning.sinkhorn import SinkhornOspa, sinkhorn_ospa

__all__ = [
    "FitHistory",
    "FitResult",
    "SinkhornOspa",
    "candidate_softmax",
    "false_track_loss",
    "fit",
    "mean_loss",
    "negative_log_likelihood",
    "sinkhorn_ospa",
]
