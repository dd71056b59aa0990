"""Stages wired together: from lines to tracks, from a recording to tracks."""

from jaxtrack.tracking.initiate import InitiateInfo, InitiateParams, initiate
from jaxtrack.tracking.window import METHODS, WindowInfo, initiate_window

__all__ = [
    "METHODS",
    "InitiateInfo",
    "InitiateParams",
    "WindowInfo",
    "initiate",
    "initiate_window",
]
