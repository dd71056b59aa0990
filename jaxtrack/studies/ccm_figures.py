"""The figures of the study `ccm`, in the manner of the paper's, under their numbers."""

import pathlib
from collections.abc import Callable, Mapping

import numpy as np
import xarray as xr

from jaxtrack.studies.ccm_trial import Run

SHOWN = ("nearest", "optimal", "jpda", "cloud", "cloud_averaged", "pmht")
_PAPER = {"A": "08_paths_A", "A3": "09_paths_A3", "B": "10_paths_B", "D": "11_paths_D"}


def draw(
    out: pathlib.Path,
    runs: Mapping[str, Run],
    scores: xr.Dataset,
    progress: Callable[[int, int], None],
) -> None:
    """Draw all figures into `out`: one run's paths a situation, and errors over the looks.

    Args:
        out: folder.
        runs: one of each situation.
        scores: [cell, trial, associator].
        progress: (done, total).
    """
    from jaxtrack import plots

    trials = scores.sizes["trial"]
    for done, (name, number) in enumerate(_PAPER.items(), start=1):
        run = runs[name]
        paths = {method: np.asarray(run.mean[method])[..., :2] for method in SHOWN}
        figure = plots.meetings(run.looks.scans, run.truth, paths, title=f"Situation {name}, a run")
        figure.savefig(out / f"figure_{number}.png", dpi=150)
        progress(done, len(_PAPER) + 1)
    panels = {}
    for name in ("A3", "B", "D"):
        here = scores.squared_by_look_m2.sel(cell=name)
        looks = np.arange(here.sizes["look"], dtype=float)
        nothing = np.zeros_like(looks)
        panels[name] = {
            method: (looks, np.sqrt(here.sel(associator=method).values), nothing)
            for method in (*SHOWN, "known")
        }
    title = f"Root mean square distance over {trials} runs"
    figure = plots.error_curves(panels, x_label="look", y_label="distance, m", title=title)
    figure.savefig(out / "figure_12_errors_over_time.png", dpi=150)
    progress(len(_PAPER) + 1, len(_PAPER) + 1)
