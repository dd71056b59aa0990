"""Recursive filters of one target: the Kalman family, the particle filter, and least squares.

`kalman`, `extended` and `unscented` are filters, each as two steps on arrays and as an estimator;
`interacting` runs several motions beside each other, `smoother` looks back over any of the first
three, and `gaussian` is what they share. `particle` takes any motion and any likelihood, as
functions, in `particle_filter`; `resampling` and `transport` have the ways to resample, all with
one signature. `rls` smooths initialised tracks.
"""

from jaxtrack.filtering import (
    extended,
    gaussian,
    interacting,
    kalman,
    particle,
    polar,
    resampling,
    rls,
    smoother,
    transport,
    unscented,
)
from jaxtrack.filtering.particle import particle_filter

__all__ = [
    "extended",
    "gaussian",
    "interacting",
    "kalman",
    "particle",
    "particle_filter",
    "polar",
    "resampling",
    "rls",
    "smoother",
    "transport",
    "unscented",
]
