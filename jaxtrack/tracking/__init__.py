"""Stages wired together: from lines to tracks, from a recording to tracks, from look to look."""

from jaxtrack.tracking.initiate import InitiateInfo, InitiateParams, initiate
from jaxtrack.tracking.sliding import SlidingInfo, sliding
from jaxtrack.tracking.window import METHODS, WindowInfo, initiate_window

__all__ = [
    "METHODS",
    "InitiateInfo",
    "InitiateParams",
    "SlidingInfo",
    "WindowInfo",
    "initiate",
    "initiate_window",
    "sliding",
]
