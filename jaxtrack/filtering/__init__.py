"""Recursive filters of one target: the Kalman family, and least squares.

`kalman`, `extended` and `unscented` are filters, each as two steps on arrays and as an estimator;
`interacting` runs several motions beside each other, `smoother` looks back over any of the first
three, and `gaussian` is what they share. `rls` smooths initialised tracks.
"""

from jaxtrack.filtering import (
    extended,
    gaussian,
    interacting,
    kalman,
    polar,
    rls,
    smoother,
    unscented,
)

__all__ = [
    "extended",
    "gaussian",
    "interacting",
    "kalman",
    "polar",
    "rls",
    "smoother",
    "unscented",
]
