"""Figures: data in, a `matplotlib.figure.Figure` out; the caller saves it, `save` with words."""

from jaxtrack.plots.accumulations import accumulations
from jaxtrack.plots.comparisons import means, run_times, scores
from jaxtrack.plots.film import film
from jaxtrack.plots.fitting import fit_history, loss_map
from jaxtrack.plots.meetings import meeting_errors, meeting_tracks, meetings
from jaxtrack.plots.motion_elements import (
    coordinate_over_time,
    error_curves,
    points_and_votes,
    vote_plane,
)
from jaxtrack.plots.particles import (
    deviations,
    pursuit,
    target_paths,
    template_frames,
    turned_steps,
)
from jaxtrack.plots.pings import pings_map
from jaxtrack.plots.saving import save
from jaxtrack.plots.scene import scene
from jaxtrack.plots.sinusoids import sinusoids
from jaxtrack.plots.sonar_frames import sonar_frames
from jaxtrack.plots.style import style
from jaxtrack.plots.tracking import errors_over_time, maps, positions_over_time

__all__ = [
    "accumulations",
    "coordinate_over_time",
    "deviations",
    "error_curves",
    "errors_over_time",
    "film",
    "fit_history",
    "loss_map",
    "maps",
    "means",
    "meeting_errors",
    "meeting_tracks",
    "meetings",
    "pings_map",
    "points_and_votes",
    "positions_over_time",
    "pursuit",
    "run_times",
    "save",
    "scene",
    "scores",
    "sinusoids",
    "sonar_frames",
    "style",
    "target_paths",
    "template_frames",
    "turned_steps",
    "vote_plane",
]
