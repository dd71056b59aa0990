"""The figures of the study `ccm`: a run like each of the paper's, under their numbers, and more.

Figures 8 to 11 are of targets side by side (A), 12 to 15 of targets that cross (B): maps, tracks
target by target, and the errors of the first and of the second target in x and in y.
"""

import pathlib
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import jax
import numpy as np
import xarray as xr

from jaxtrack.sensors import sweeps
from jaxtrack.sensors.crossings import MEETING_LOOK
from jaxtrack.studies.ccm.looks import PRESET, Looks
from jaxtrack.studies.ccm.trial import SHOWN
from jaxtrack.types import Array, Pings, Pose, Scan

# Numbers of the paper's: maps, tracks by target, errors of either target.
_APART, _CROSSING = (8, 9, 10, 11), (12, 13, 14, 15)
_NUMBERED = {"A": _APART, "A, pings": _APART, "B": _CROSSING, "B, pings": _CROSSING}
_OTHERS = ("A3", "D")  # situations that the paper does not have
SHOWN_CELLS = (*_NUMBERED, *_OTHERS)
_OVER_TIME = ("A3", "B", "D", "B, pings")
_ON_SONAR = "B, pings"
_PAPERS = ("nearest", "jpda", "cloud")
_MARGIN_M, _AROUND_M = 4.0, 16.0


def draw(
    out: pathlib.Path,
    looks: Mapping[str, Looks],
    paths_m: Mapping[str, Mapping[str, np.ndarray]],
    scores: xr.Dataset,
    progress: Callable[[int, int], None],
) -> None:
    """Draw all figures into `out`: a run like the paper's, a sonar's map, errors over the looks.

    Args:
        out: folder.
        looks: of one run of each of `SHOWN_CELLS`.
        paths_m: [T, 2, 2] tracks in it by associator.
        scores: [cell, trial, associator].
        progress: (done, total).
    """
    from jaxtrack import plots

    figures = {**_of_runs(looks, paths_m), **_over_all(looks, paths_m, scores)}
    for done, (name, build) in enumerate(figures.items()):
        progress(done, len(figures))
        plots.save(build(), out / f"figure_{name}.png")
    progress(len(figures), len(figures))


def _of_runs(
    looks: Mapping[str, Looks], paths_m: Mapping[str, Mapping[str, np.ndarray]]
) -> dict[str, Callable[[], Any]]:
    """Return how to draw a run of each situation: maps of all, the rest of the paper's methods."""
    from jaxtrack import plots

    figures = {}
    for name in SHOWN_CELLS:
        place, title = name.replace(", ", "_"), f"Situation {name}, a run"
        truth, every = looks[name].truth, paths_m[name]
        draw = lambda plot, *args, title=title, **more: partial(plot, *args, title=title, **more)
        maps = draw(plots.meetings, _near(looks[name]), truth, every)
        if name not in _NUMBERED:
            figures[f"maps_{place}"] = maps
            continue
        papers = {method: every[method] for method in _PAPERS}
        first, second, *errors = _NUMBERED[name]
        figures[f"{first:02d}_maps_{place}"] = maps
        figures[f"{second:02d}_targets_{place}"] = draw(plots.meeting_tracks, truth, papers)
        for target, number in enumerate(errors):
            figures[f"{number}_errors_of_target_{target + 1}_{place}"] = draw(
                plots.meeting_errors,
                truth,
                papers,
                target=target,
                title=f"{title}: target {target + 1}",
            )
    return figures


def _over_all(
    looks: Mapping[str, Looks],
    paths_m: Mapping[str, Mapping[str, np.ndarray]],
    scores: xr.Dataset,
) -> dict[str, Callable[[], Any]]:
    """Return how to draw what the paper does not: the sonar's map, and errors over all runs."""
    from jaxtrack import plots

    seen, at = looks[_ON_SONAR], slice(MEETING_LOOK, MEETING_LOOK + 1)
    panels = {}
    for name in _OVER_TIME:
        here = scores.sel(cell=name)
        look = np.arange(here.sizes["look"], dtype=float)
        panels[name] = {}
        for method in (*SHOWN, "known"):
            one = here.sel(associator=method)
            root = np.sqrt(one.squared_by_look_m2.values)
            panels[name][method] = look, root, one.squared_by_look_se_m2.values / (2 * root)
    return {
        "sonar_map_B_pings": partial(
            plots.pings_map,
            _loudest(seen),
            PRESET.sonar,
            truth=jax.tree.map(lambda x: x[at], seen.truth),
            paths_m={method: paths_m[_ON_SONAR][method] for method in _PAPERS},
            around_m=_AROUND_M,
            title=f"Situation {_ON_SONAR}: all sweeps, the truth where they meet",
            axes="x_y",
        ),
        "errors_over_looks": partial(
            plots.error_curves,
            panels,
            x_label="look",
            y_label="root mean square distance, m",
            title=f"Distance over {scores.sizes['trial']} runs",
        ),
    }


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
