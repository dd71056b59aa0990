"""The figures of the study `ccm`, in the manner of the paper's, under their numbers."""

import pathlib
from collections.abc import Callable, Mapping

import jax
import numpy as np
import xarray as xr

from jaxtrack.sensors import sweeps
from jaxtrack.sensors.crossings import MEETING_LOOK
from jaxtrack.studies.ccm_looks import PRESET, Looks
from jaxtrack.studies.ccm_trial import SHOWN
from jaxtrack.types import Array, Pings, Pose, Scan

PATHS = {
    "A": "08_paths_A",
    "A3": "09_paths_A3",
    "B": "10_paths_B",
    "D": "11_paths_D",
    "A, pings": "08_pings_A",
    "B, pings": "10_pings_B",
}
_OVER_TIME = ("A3", "B", "D", "B, pings")
_ON_SONAR = {"B, pings": "10_sonar_B"}
_PAPERS = ("nearest", "jpda", "cloud")
_MARGIN_M, _AROUND_M = 4.0, 16.0


def draw(
    out: pathlib.Path,
    looks: Mapping[str, Looks],
    paths_m: Mapping[str, Mapping[str, np.ndarray]],
    scores: xr.Dataset,
    progress: Callable[[int, int], None],
) -> None:
    """Draw all figures into `out`: one run's paths a situation, pings, and errors over the looks.

    Args:
        out: folder.
        looks: of one run of each situation.
        paths_m: [T, 2, 2] tracks in it by associator.
        scores: [cell, trial, associator].
        progress: (done, total).
    """
    from jaxtrack import plots

    trials = scores.sizes["trial"]
    total, done = len(PATHS) + len(_ON_SONAR) + 1, 0
    for name, number in PATHS.items():
        seen = looks[name]
        title = f"Situation {name}, a run"
        figure = plots.meetings(_near(seen), seen.truth, paths_m[name], title=title)
        plots.save(figure, out / f"figure_{number}.png")
        progress(done := done + 1, total)
    for name, number in _ON_SONAR.items():
        paths = {method: paths_m[name][method] for method in _PAPERS}
        figure = plots.pings_map(
            _loudest(looks[name]),
            PRESET.sonar,
            truth=jax.tree.map(lambda x: x[MEETING_LOOK : MEETING_LOOK + 1], looks[name].truth),
            paths_m=paths,
            around_m=_AROUND_M,
            title=f"Situation {name}: all sweeps, the truth where they meet",
            axes="x_y",
        )
        plots.save(figure, out / f"figure_{number}.png")
        progress(done := done + 1, total)
    panels = {}
    for name in _OVER_TIME:
        here = scores.squared_by_look_m2.sel(cell=name)
        at = np.arange(here.sizes["look"], dtype=float)
        nothing = np.zeros_like(at)
        panels[name] = {
            method: (at, np.sqrt(here.sel(associator=method).values), nothing)
            for method in (*SHOWN, "known")
        }
    title = f"Root mean square distance over {trials} runs"
    figure = plots.error_curves(panels, x_label="look", y_label="distance, m", title=title)
    plots.save(figure, out / "figure_12_errors_over_time.png")
    progress(total, total)


def _near(looks: Looks) -> Scan:
    """Return the scans with what is near the targets' paths alone."""
    real = np.asarray(looks.truth.state)[..., :2]
    place = np.asarray(looks.scans.position_m)
    low, high = real.min((0, 1)) - _MARGIN_M, real.max((0, 1)) + _MARGIN_M
    return looks.scans._replace(mask=looks.scans.mask & ((place > low) & (place < high)).all(-1))


def _loudest(looks: Looks) -> Pings:
    """Return a sweep that holds every cell's loudest echo in all sweeps."""
    time_s, bearing_rad = sweeps(PRESET.sonar, frames=1, pings=PRESET.sizes.pings)
    still = lambda x: np.repeat(np.asarray(x)[:1], PRESET.sizes.pings, axis=0)
    pose: Pose = jax.tree.map(still, looks.pose)
    intensity: Array = looks.loudest
    return Pings(time_s[0], bearing_rad[0], intensity, time_s[0] >= 0, pose)
