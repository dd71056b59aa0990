"""The tables that the study `nht` prints beside its marks."""

import itertools
from collections.abc import Sequence

import numpy as np
import xarray as xr
from rich.table import Table

from jaxtrack.metrics import MAX_DISCRIMINATION
from jaxtrack.studies.nht.trial import FORMS
from jaxtrack.studies.tables import SMOKE_BELOW, grid_table, number

COMPARED = ("HT", "MHT", "IHT", "NHT")
WORDS = {
    "I": {
        "discrimination": ("high", "high", "high", "high"),
        "divergence": ("slight", "none", "none", "slight"),
        "decline": ("none", "slight", "slight", "slight"),
    },
    "II": {
        "discrimination": ("high", "low", "low", "high"),
        "divergence": ("slight", "medium", "medium", "slight"),
        "decline": ("slight", "serious", "serious", "slight"),
    },
    "III": {
        "discrimination": ("low", "high", "high", "high"),
        "divergence": ("slight", "slight", "slight", "slight"),
        "decline": ("slight", "slight", "slight", "slight"),
    },
    "IV": {
        "discrimination": ("low", "low", "low", "high"),
        "divergence": ("medium", "serious", "serious", "slight"),
        "decline": ("medium", "serious", "serious", "slight"),
    },
}
"""The paper's table 2, method by method as in `COMPARED`."""

_RANK = {"none": 0, "slight": 1, "medium": 2, "serious": 3, "low": 0, "high": 1}
_UNITS = {"discrimination": "", "divergence": " cells", "decline": ""}


def table_2(simulated: xr.Dataset, situations: dict[str, str]) -> Table:
    """Return table 2 as numbers beside the paper's words.

    Args:
        simulated: scores at the matches.
        situations: the paper's situation → ours.
    """
    names, cells = [], []
    for situation, ours in situations.items():
        for what, words in WORDS[situation].items():
            values = word_numbers(simulated, ours, what)
            agree, against = agreement(values, words)
            total = agree + len(against)
            names.append(f"{ours} {what}")
            verdict = f"{agree} of {total}" if total else "–"
            if int(simulated.trials.min()) < SMOKE_BELOW:
                verdict, against = "smoke", []
            cells.append(
                [f"{_short(v)}{_UNITS[what]}, {w}" for v, w in zip(values, words, strict=True)]
                + [verdict, "; ".join(against)]
            )
    columns = [*COMPARED, "orders agree", "not"]
    trials = int(simulated.trials.min())
    return grid_table("Table 2: ours, the paper's word", names, columns, cells, trials=trials)


def word_numbers(simulated: xr.Dataset, situation: str, what: str) -> list[float]:
    """Return one row of table 2 as numbers: raw peaks, discrimination at a match of 100 m."""
    here = simulated[what].sel(situation=situation)
    if what == "discrimination":
        here = here.sel(match=100.0, peaks="raw")
    return [float(here.sel(estimator=method)) for method in COMPARED]


def agreement(values: Sequence[float], words: Sequence[str]) -> tuple[int, list[str]]:
    """Count pairs of methods that the paper's words and our numbers put in the same order.

    Returns:
        How many agree, and those that do not, as the paper has them.

    Example:
        >>> agreement([1.0, 5.0, 5.0, 4.0], ("slight", "serious", "serious", "slight"))
        (4, [])
        >>> agreement([6.0, 5.0, 5.0, 4.0], ("slight", "serious", "serious", "slight"))
        (2, ['HT < MHT', 'HT < IHT'])
    """
    agree, against = 0, []
    for a, b in itertools.combinations(range(len(words)), 2):
        wanted = np.sign(_RANK[words[a]] - _RANK[words[b]])
        if wanted == 0:
            continue
        if np.sign(values[a] - values[b]) == wanted:
            agree += 1
        else:
            against.append(f"{COMPARED[a]} {'<' if wanted < 0 else '>'} {COMPARED[b]}")
    return agree, against


def shares(scores: xr.Dataset, title: str, *, count: str, match_m: float) -> Table:
    """Return the share of trials that `count` counts, by method, form and situation."""
    situations = [str(name) for name in scores.situation.values]
    names, cells = [], []
    for method, forms in FORMS.items():
        for form in forms:
            cell = scores.sel(match=match_m, estimator=method, peaks=form)
            names.append(f"{method} {form}" if len(forms) > 1 else method)
            cells.append([number(float(x)) for x in (cell[count] / cell.trials).values])
    trials = int(scores.trials.min())
    return grid_table(title, names, situations, cells, trials=trials)


def means(scores: xr.Dataset, title: str, *, match_m: float) -> Table:
    """Return found, false and redundant lines a run and errors, by method and situation."""
    situations = [str(name) for name in scores.situation.values]
    names, cells = [], []
    for method, forms in FORMS.items():
        cell = scores.sel(match=match_m, estimator=method, peaks=forms[0])
        names.append(method)
        line = []
        for situation in situations:
            at = cell.sel(situation=situation)
            counts = "/".join(f"{float(at[k]):.2f}" for k in ("found", "false", "redundant"))
            known = np.isfinite(float(at["found"]))
            rho_m, theta_rad = float(at.rho_rmse_m), float(at.theta_rmse_rad)
            errors = f"{rho_m:.1f} m {theta_rad:.4f}" if np.isfinite(rho_m) else "none matched"
            line.append(f"{counts}\n{errors}" if known else "–")
        cells.append(line)
    return grid_table(title, names, situations, cells, trials=int(scores.trials.min()))


def gates(table: xr.Dataset) -> Table:
    """Return the gates that were derived from scenes without targets."""
    names, cells = [], []
    for method, forms in FORMS.items():
        for form in forms:
            here = table.gate.sel(estimator=method, peaks=form)
            names.append(f"{method} {form}" if len(forms) > 1 else method)
            cells.append([number(float(x)) for x in here.values])
    title = (
        f"Gates from scenes without targets, for at most {table.attrs['false_per_run']} false "
        f"lines a run (joint: {table.attrs['false_per_run_joint']})"
    )
    columns = [f"clutter {name}" for name in table.clutter.values]
    return grid_table(title, names, columns, cells, trials=int(table.attrs["scenes"]))


def run_times(times: xr.Dataset) -> Table:
    """Return milliseconds a run by clutter, and on the real data beside the paper's."""
    columns = [f"{c:.0f} a look" for c in times.clutter.values]
    columns += ["real data", "paper, real data", "paper / ours"]
    names = [str(name) for name in times.estimator.values]
    cells = []
    for method in names:
        here = times.sel(estimator=method)
        ours, paper = float(here.real_seconds), float(here.paper_seconds)
        line = [f"{1e3 * s:.2f} ms" for s in here.seconds.values]
        known = np.isfinite(paper)
        line += [f"{1e3 * ours:.2f} ms", f"{1e3 * paper:.1f} ms" if known else "–"]
        cells.append([*line, f"{paper / ours:.0f} ×" if known else "–"])
    runs = int(times.attrs["runs"])
    return grid_table("Time of a run, one core", names, columns, cells, trials=runs)


def _short(value: float) -> str:
    return "no rival" if value >= 0.99 * MAX_DISCRIMINATION else number(value)
