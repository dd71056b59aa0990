"""Stages wired together: from lines to tracks, from a recording to tracks, from look to look."""

from jaxtrack.tracking.filters import Filter, position_filter, straight_filter
from jaxtrack.tracking.hough_tracker import (
    HoughTrackerInfo,
    HoughTrackerParams,
    HoughTrackerState,
    hough_tracker,
)
from jaxtrack.tracking.initiate import InitiateInfo, InitiateParams, initiate
from jaxtrack.tracking.interacting_filter import Models, interacting_filter
from jaxtrack.tracking.kalman_paper import KalmanPaperParams, kalman_paper
from jaxtrack.tracking.kalman_tracker import (
    KalmanTrackerInfo,
    KalmanTrackerParams,
    KalmanTrackerState,
    kalman_tracker,
)
from jaxtrack.tracking.lifecycle import (
    Admission,
    Births,
    LifecycleParams,
    TrackTable,
    admit,
    empty_table,
    grade,
)
from jaxtrack.tracking.motion_elements import ESTIMATORS, MotionElements, motion_elements
from jaxtrack.tracking.range_bearing_filter import range_bearing_filter
from jaxtrack.tracking.sliding import SlidingInfo, sliding
from jaxtrack.tracking.track import TRACKERS, TrackInfo, track
from jaxtrack.tracking.window import METHODS, WindowInfo, initiate_window

__all__ = [
    "ESTIMATORS",
    "METHODS",
    "TRACKERS",
    "Admission",
    "Births",
    "Filter",
    "HoughTrackerInfo",
    "HoughTrackerParams",
    "HoughTrackerState",
    "InitiateInfo",
    "InitiateParams",
    "KalmanPaperParams",
    "KalmanTrackerInfo",
    "KalmanTrackerParams",
    "KalmanTrackerState",
    "LifecycleParams",
    "Models",
    "MotionElements",
    "SlidingInfo",
    "TrackInfo",
    "TrackTable",
    "WindowInfo",
    "admit",
    "empty_table",
    "grade",
    "hough_tracker",
    "initiate",
    "initiate_window",
    "interacting_filter",
    "kalman_paper",
    "kalman_tracker",
    "motion_elements",
    "position_filter",
    "range_bearing_filter",
    "sliding",
    "straight_filter",
    "track",
]
