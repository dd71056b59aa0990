"""The figures of the study `csht_tracking`, in the manner of the paper's, under their numbers."""

import functools
import pathlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import xarray as xr

from jaxtrack.studies.csht.paper import RATES, SIGMAS_M
from jaxtrack.studies.tracking import paper as tracking_paper
from jaxtrack.studies.tracking.report import MEASURES
from jaxtrack.studies.tracking.trackers import FLOOR, TRACKERS

_NUMBERS = {"cardinality": (23, 26), "localization": (24, 27), "distance": (25, 28)}


def draw(
    out: pathlib.Path,
    tables: Mapping[str, xr.Dataset],
    shown: Any,
    progress: Callable[[int, int], None],
) -> None:
    """Draw all figures into `out`.

    Args:
        out: folder.
        tables: by model of false alarms, [cell, trial, truth, tracker, look].
        shown: the run of figures 20 and 21.
        progress: (done, total).
    """
    from jaxtrack import plots

    title = "One run, P_M = P_F = 0.5, σ = 3 m"
    jobs: dict[str, Callable[[], Any]] = {
        "figure_20_positions": lambda: plots.positions_over_time(
            shown.truth, shown.tracks, title=title
        ),
        "figure_21_maps": lambda: plots.maps(shown.truth, shown.tracks, title=title),
    }
    for variant, table in tables.items():
        name = variant.replace(" ", "_")
        jobs[f"figure_22_over_time_{name}"] = functools.partial(_over_time, table, variant)
        for measure, (by_rates, by_sigma) in _NUMBERS.items():
            # A smoke run has too few cells for curves.
            if table.sizes["cell"] > len(RATES):
                jobs[f"figure_{by_rates}_{measure}_{name}"] = functools.partial(
                    _by_rates, table, measure, variant
                )
                jobs[f"figure_{by_sigma}_{measure}_{name}"] = functools.partial(
                    _by_sigma, table, measure, variant
                )
    for done, (name, job) in enumerate(sorted(jobs.items()), start=1):
        plots.save(job(), out / f"{name}.png")
        progress(done, len(jobs))


def _over_time(table: xr.Dataset, variant: str) -> Any:
    from jaxtrack import plots

    cell = int(np.flatnonzero(_at(table, p_miss=0.5, p_false=0.5, sigma_m=3.0))[0])
    here = table.isel(cell=cell).sel(truth="visible").mean("trial")
    panels = {
        words: {name: here[measure].sel(tracker=name).values for name in (*TRACKERS, FLOOR)}
        for measure, words in MEASURES.items()
    }
    time_s = 1.0 + 0.5 * np.arange(table.sizes["look"])
    title = f"Means over {table.sizes['trial']} runs, P_M = P_F = 0.5; false alarms: {variant}"
    return plots.errors_over_time(time_s, panels, title=title)


def _by_rates(table: xr.Dataset, measure: str, variant: str) -> Any:
    from jaxtrack import plots

    words = MEASURES[measure]
    printed = tracking_paper.BY_RATES[measure]
    panels, paper = {}, {}
    for row, p_miss in enumerate(RATES):
        name = f"P_M = {p_miss:g}"
        chosen = table.isel(cell=np.flatnonzero(_at(table, p_miss=p_miss, sigma_m=3.0)))
        panels[name] = _curves(chosen, measure, "p_false")
        paper[name] = {who: (RATES, values[row]) for who, values in printed.items()}
    return plots.error_curves(
        panels,
        x_label="P_F",
        y_label=f"{words}, m",
        paper=paper,
        title=f"False alarms: {variant}; σ = 3 m",
    )


def _by_sigma(table: xr.Dataset, measure: str, variant: str) -> Any:
    from jaxtrack import plots

    words = MEASURES[measure]
    chosen = table.isel(cell=np.flatnonzero(_at(table, p_miss=0.3, p_false=0.3)))
    printed = tracking_paper.BY_SIGMA[measure]
    name = "P_M = P_F = 0.3"
    return plots.error_curves(
        {name: _curves(chosen.sortby("sigma_m"), measure, "sigma_m")},
        x_label="σ, m",
        y_label=f"{words}, m",
        paper={name: {who: (SIGMAS_M, values) for who, values in printed.items()}},
        title=f"False alarms: {variant}",
    )


def _curves(cells: xr.Dataset, measure: str, condition: str) -> dict[str, tuple[Any, Any, Any]]:
    each = cells[measure].sel(truth="visible").mean("look")
    trials = cells.sizes["trial"]
    error = each.std("trial", ddof=1 if trials > 1 else 0) / np.sqrt(trials)
    centre = each.mean("trial")
    return {
        name: (
            cells[condition].values,
            centre.sel(tracker=name).values,
            error.sel(tracker=name).values,
        )
        for name in (*TRACKERS, FLOOR)
    }


def _at(table: xr.Dataset, **rates: float) -> np.ndarray:
    found = np.ones(table.sizes["cell"], bool)
    for name, value in rates.items():
        found &= np.isclose(table[name].values, value)
    return found
