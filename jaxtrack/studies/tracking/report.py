"""The tables and marks of the study `csht_tracking`."""

from collections.abc import Mapping

import numpy as np
import xarray as xr
from rich.table import Table

from jaxtrack.studies.csht.paper import RATES, SIGMAS_M
from jaxtrack.studies.csht.report import cell_name
from jaxtrack.studies.tables import (
    Figure,
    Mark,
    Row,
    grid_table,
    mean,
    mean_of,
    number,
    quotient,
    rate,
    standard_error,
)
from jaxtrack.studies.tracking import paper as tracking_paper
from jaxtrack.studies.tracking.trackers import FLOOR, TRACKERS

MEASURES = {
    "cardinality": "cardinality error",
    "localization": "localization error",
    "distance": "OSPA distance",
}
COMBINED = "combined"
_JOINT = "hough joint"
_KALMAN = ("kalman paper", "kalman LBP")


def tables(table: xr.Dataset, variant: str) -> list[Table]:
    """Return a table a truth and measure: ours, the floor and the paper's figures.

    Args:
        table: [cell, trial, truth, tracker, look].
        variant: the model of false alarms.
    """
    found = []
    names = [_name(table, cell) for cell in range(table.sizes["cell"])]
    for truth in map(str, table.truth.values):
        for measure, words in {**MEASURES, COMBINED: "√(card² + loc²)"}.items():
            lines = []
            for cell in range(len(names)):
                ours = [_mean(table, cell, truth, name, measure) for name in (*TRACKERS, FLOOR)]
                paper = [paper_figure(table, cell, measure, who) for who in ("CSHT", "Kalman")]
                lines.append([_spread(x) for x in ours] + [number(x) for x in paper])
            columns = [*TRACKERS, FLOOR, "paper CSHT", "paper Kalman"]
            title = f"False alarms: {variant}; truth: {truth}; {words} in m, 1 to 100 s"
            found.append(grid_table(title, names, columns, lines, trials=table.sizes["trial"]))
    return found


def generated(table: xr.Dataset) -> Table:
    """Return the errors on generated scenes, of births, deaths, crossings and 1 to 8 targets."""
    lines = [
        [_spread(_mean(table, 0, "visible", name, measure)) for name in (*TRACKERS, FLOOR)]
        for measure in MEASURES
    ]
    names = list(MEASURES.values())
    title = f"Generated scenes, {_name(table, 0)}, in m"
    return grid_table(title, names, [*TRACKERS, FLOOR], lines, trials=table.sizes["trial"])


def overflow(table: xr.Dataset) -> str:
    """Return in a sentence how often the joint vote's tables were too small."""
    share = table.overflow.mean(("trial", "look")).values
    worst = int(share.argmax())
    return (
        f"Windows with more pairs than the joint vote's table holds: {100 * share.mean():.1f} %, "
        f"at most {100 * share[worst]:.1f} % ({_name(table, worst)})."
    )


def full(table: xr.Dataset) -> str:
    """Return in a sentence how often the tables of tracks turned somebody away, by tracker."""
    said = []
    for name in TRACKERS:
        share = table.full.sel(tracker=name).mean(("trial", "look")).values
        worst = int(share.argmax())
        at = f" (at most {100 * share[worst]:.1f} %, {_name(table, worst)})" if share[worst] else ""
        said.append(f"{name} {100 * share.mean():.1f} %{at}")
    return f"Looks at which a table of tracks was full: {', '.join(said)}."


def consistency(table: xr.Dataset, variant: str) -> Table:
    """Return NEES of the tracks that are a target's most of their life, and how many are not."""
    lines = []
    for cell in range(table.sizes["cell"]):
        here = table.isel(cell=cell)
        line = []
        for name in (*TRACKERS, FLOOR):
            one = here.sel(tracker=name)
            own, strays = float(one.own.sum()), float(one.strays.sum())
            if own == 0:
                line.append("no track")
                continue
            left_out = 100 * strays / (own + strays)
            nees = float(one.nees.sum()) / own
            shown = f"{nees:.1f}" if nees < 1e4 else "> 10⁴"
            line.append(f"{shown}\n{left_out:.1f} % left out")
        lines.append(line)
    names = [_name(table, cell) for cell in range(len(lines))]
    title = f"False alarms: {variant}; NEES of four states, and reports of no target's track"
    columns = [*TRACKERS, FLOOR]
    return grid_table(title, names, columns, lines, trials=table.sizes["trial"])


def times(seconds: Mapping[str, float]) -> Table:
    """Return the time a look beside the paper's."""
    lines = [[f"{1000 * x:.1f} ms"] for x in seconds.values()]
    names = list(seconds)
    for name, printed in tracking_paper.SECONDS_A_LOOK.items():
        names.append(f"paper, {name}")
        lines.append([f"{1000 * printed:.1f} ms"])
    title = "Time a look, compiled, one run at a time; P_M = P_F = .5"
    return grid_table(title, names, ["time"], lines, trials=1)


def to_the_letter(distance_m: np.ndarray) -> str:
    """Return in a sentence what becomes of the paper's Kalman tracker with X₀ = 0 at .3, .3."""
    return (
        f"Kalman tracker of the paper with X₀ = 0 to the letter, P_M = P_F = .3: mean OSPA "
        f"{distance_m.mean():.1f} ± {standard_error(distance_m):.1f} m."
    )


def marks(literal: xr.Dataset, generated: xr.Dataset | None = None) -> list[Row]:
    """Return every figure that has a mark.

    Args:
        literal: [cell, trial, truth, tracker, look], the paper's false alarms.
        generated: likewise, of one cell; None: not made.
    """
    rows: list[Row] = []
    for cell in range(literal.sizes["cell"]):
        name = f"{_name(literal, cell)}: {_JOINT}"
        if float(literal.p_miss[cell]) <= 0.3:
            paper = paper_figure(literal, cell, "distance", "CSHT")
            for measure, words in (("distance", "mean OSPA"), (COMBINED, "√(card² + loc²)")):
                figure = _mean(literal, cell, "visible", _JOINT, measure)
                mark = Mark(float(paper), at_least=False)
                rows.append(Row(f"{name}, {words}", figure, number(paper), mark))
        rows += _against_others(literal, cell, name)
    middle = (literal.p_miss == 0.3) & (literal.p_false == 0.3) & (literal.sigma_m == 3.0)
    cell = int(np.flatnonzero(middle.values)[0])
    rows += _over_time(literal, cell, f"{_name(literal, cell)}: {_JOINT}")
    if generated is not None:
        name = f"generated scenes: {_JOINT}"
        rows += _against_others(generated, 0, name) + _over_time(generated, 0, name)
    return rows


def _against_others(table: xr.Dataset, cell: int, name: str) -> list[Row]:
    """Return that the joint tracker is below the Kalman trackers and not below the floor."""
    ours = _distance(table, cell, _JOINT)
    ratio = lambda other: quotient(ours, _distance(table, cell, other))
    below = Mark(1.0, at_least=False)
    rows = [Row(f"{name} / {rival}, OSPA", ratio(rival), "", below) for rival in _KALMAN]
    return [*rows, Row(f"{name} / {FLOOR}, OSPA", ratio(FLOOR), "", Mark(1.0))]


def _over_time(table: xr.Dataset, cell: int, name: str) -> list[Row]:
    """Return in how many runs the number is right at all quiet looks, and NEES."""
    here = table.isel(cell=cell).sel(tracker=_JOINT)
    wrong = here.cardinality.sel(truth="visible").values != 0
    right = ~(wrong & here.quiet.values).any(1)
    share = rate(float(right.sum()), len(right))
    agreed = quotient(here.nees.values.sum(1), here.own.values.sum(1).astype(float))
    return [
        Row(f"{name}, runs of the right number throughout", share, mark=Mark(0.95)),
        Row(f"{name}, NEES of four states", agreed, mark=Mark(3.0)),
        Row(f"{name}, NEES, no more than", agreed, mark=Mark(5.0, at_least=False)),
    ]


def paper_figure(table: xr.Dataset, cell: int, measure: str, who: str) -> float:
    """Return what the paper prints for a cell; its distance is the combined one."""
    p_miss, p_false, sigma_m = (float(table[k][cell]) for k in ("p_miss", "p_false", "sigma_m"))
    measure = "distance" if measure == COMBINED else measure
    if sigma_m == 3.0:
        printed = tracking_paper.BY_RATES[measure][who]
        return float(printed[RATES.index(round(p_miss, 3)), RATES.index(round(p_false, 3))])
    return float(tracking_paper.BY_SIGMA[measure][who][SIGMAS_M.index(sigma_m)])


def _mean(table: xr.Dataset, cell: int, truth: str, tracker: str, measure: str) -> Figure:
    here = table.isel(cell=cell).sel(truth=truth, tracker=tracker)
    if measure == COMBINED:
        parts = [here[name].mean("look").values.astype(float) for name in list(MEASURES)[:2]]
        card, loc = (x.mean() for x in parts)
        root = float(np.hypot(card, loc))
        # To first order, which is all that a standard error is.
        each = (card * parts[0] + loc * parts[1]) / max(root, 1e-12)
        return mean(root, standard_error(each), len(each), "m")
    each = here[measure].mean("look").values.astype(float)
    return mean_of(each, "m")


def _distance(table: xr.Dataset, cell: int, tracker: str) -> np.ndarray:
    here = table.distance.isel(cell=cell).sel(truth="visible", tracker=tracker)
    return here.mean("look").values.astype(float)


def _spread(figure: Figure) -> str:
    half = (figure.upper - figure.lower) / 2 / 1.96
    return f"{figure.value:.2f}\n± {half:.2f}" if np.isfinite(half) else f"{figure.value:.2f}"


def _name(table: xr.Dataset, cell: int) -> str:
    at = table.isel(cell=cell)
    return cell_name(float(at.p_miss), float(at.p_false), float(at.sigma_m))
