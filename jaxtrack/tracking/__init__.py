"""Stages wired together: pings to detections, lines and recordings to tracks, look to look."""

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
from jaxtrack.tracking.lives import Lives, hard_lives, soft_lives
from jaxtrack.tracking.moment_tracker import (
    MomentParams,
    MomentTrackerInfo,
    MomentTrackerState,
    moment_template,
    moment_tracker,
)
from jaxtrack.tracking.motion_elements import ESTIMATORS, MotionElements, motion_elements
from jaxtrack.tracking.ping_detection import PingDetection, PingDetectionInfo, detect_in_pings
from jaxtrack.tracking.range_bearing_filter import range_bearing_filter
from jaxtrack.tracking.shape_tracker import (
    ShapeParams,
    ShapeTemplate,
    ShapeTrackerInfo,
    ShapeTrackerState,
    shape_template,
    shape_tracker,
)
from jaxtrack.tracking.sliding import SlidingInfo, sliding
from jaxtrack.tracking.soft_lifecycle import Softness
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
    "Lives",
    "Models",
    "MomentParams",
    "MomentTrackerInfo",
    "MomentTrackerState",
    "MotionElements",
    "PingDetection",
    "PingDetectionInfo",
    "ShapeParams",
    "ShapeTemplate",
    "ShapeTrackerInfo",
    "ShapeTrackerState",
    "SlidingInfo",
    "Softness",
    "TrackInfo",
    "TrackTable",
    "WindowInfo",
    "admit",
    "detect_in_pings",
    "empty_table",
    "grade",
    "hard_lives",
    "hough_tracker",
    "initiate",
    "initiate_window",
    "interacting_filter",
    "kalman_paper",
    "kalman_tracker",
    "moment_template",
    "moment_tracker",
    "motion_elements",
    "position_filter",
    "range_bearing_filter",
    "shape_template",
    "shape_tracker",
    "sliding",
    "soft_lives",
    "straight_filter",
    "track",
]
