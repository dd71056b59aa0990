"""The tables and marks of the study `ccm`."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from rich.table import Table

from jaxtrack.studies.tables import (
    Figure,
    Mark,
    Row,
    grid_table,
    mean_of,
    quotient,
    rate,
    root_mean_square,
)

# Swap %, loss % and RMSE in metres that an independent prototype saw in 1 000 runs a situation.
PROTOTYPE = {
    "nearest": "0/0 .550, 20.6/18.6 1.451, 0/3.1 .830, 0/9.7 1.463, .2/21.4 1.536, .3/32.2 1.954",
    "optimal": "0/0 .550, 20.4/15.4 1.384, 0/2.7 .793, 0/9.0 1.438, .4/17.6 1.527, 7.9/17.2 2.003",
    "jpda": "0/0 .328, 31.7/18.1 1.427, 0/2.9 .699, 0/2.4 .680, 0/16.5 .869, .3/2.5 .871",
    "jpda_echoes": "0/0 .329, 25.9/8.3 .970, 0/.2 .380, 0/.1 .405, 0/5.8 .607, .3/2.5 .871",
    "cloud": "0/0 .294, .9/0 .321, .2/.1 .439, .7/1.6 .753, 14.5/4.6 1.317, 11.2/35.4 2.237",
    "pmht": "0/0 .292, 2.4/0 .353, 0/0 .305, 0/.3 .372, .2/.7 .485, .7/9.0 1.267",
    "known": "0/0 .289, 0/0 .289, 0/0 .295, 0/0 .299, 0/0 .299, 0/0 .488",
}
SWEPT = ("nearest", "optimal", "jpda", "cloud", "pmht", "known")
_BETTER = ("failures", "distance")  # in what the paper's claim is tried


def tables(scores: xr.Dataset, named: Sequence[str]) -> list[Table]:
    """Return swaps, losses and errors: of the situations beside the prototype's, and of the sweeps.

    Args:
        scores: [cell, trial, associator].
        named: the situations.
    """
    return [_situations(scores, named), _sweeps(scores, named), _claim(scores, named)]


def _situations(scores: xr.Dataset, named: Sequence[str]) -> Table:
    names, lines = [], []
    for method in map(str, scores.associator.values):
        names.append(method.replace("_", " "))
        lines.append([_cell(scores, cell, method) for cell in named])
        if method in PROTOTYPE:
            names.append("prototype")
            lines.append([cell.replace(" ", "\n") for cell in PROTOTYPE[method].split(", ")])
    title = "Swapped % / lost %, and the distance in m; below it a prototype's 1 000 runs"
    return grid_table(title, names, named, lines, trials=scores.sizes["trial"])


def _sweeps(scores: xr.Dataset, named: Sequence[str]) -> Table:
    others = [str(name) for name in scores.cell.values if str(name) not in named]
    failed = lambda *at: f"{100 * _failed(scores, *at).mean():.0f}"
    lines = [
        [f"{failed(cell, name)}  {rmse(scores, cell, name).value:.2f}" for name in SWEPT]
        for cell in others
    ]
    title = "Sweeps, of C where nothing else is said: swapped or lost %, and the distance in m"
    return grid_table(title, others, SWEPT, lines, trials=scores.sizes["trial"])


def _claim(scores: xr.Dataset, named: Sequence[str]) -> Table:
    lines = []
    for cell in named:
        line = []
        for rival in ("nearest", "optimal", "jpda"):
            failures = [_failed(scores, cell, name).astype(float) for name in ("cloud", rival)]
            fewer = _difference(*failures)
            nearer = _difference(*(_squared(scores, cell, name) for name in ("cloud", rival)))
            line += [_word(fewer), _word(nearer)]
        lines.append(line)
    columns = [f"{what}\n{rival}" for rival in ("nearest", "optimal", "jpda") for what in _BETTER]
    title = "Where the paper's claim holds: the cloud model against others on the same runs, 95 %"
    return grid_table(title, named, columns, lines, trials=scores.sizes["trial"])


def marks(scores: xr.Dataset) -> list[Row]:
    """Return every figure that has a mark."""
    at_most = lambda bound: Mark(bound, at_least=False)
    swaps = scores.swap.sel(cell="A", associator="cloud").values
    rows = [
        Row("A: cloud, swaps", rate(float(swaps.sum()), len(swaps)), mark=at_most(0.0)),
        Row("A: cloud / jpda, RMSE", ratio(scores, "A", "cloud", "jpda"), mark=at_most(0.93)),
        Row("A: cloud / nearest, RMSE", ratio(scores, "A", "cloud", "nearest"), mark=at_most(0.60)),
    ]
    for cell, method, mark in (
        ("A3", "cloud", at_most(0.03)),
        ("A3", "jpda", Mark(0.20)),
        ("B", "cloud", at_most(0.015)),
        ("D", "pmht", at_most(0.025)),
    ):
        failed = _failed(scores, cell, method)
        share = rate(float(failed.sum()), len(failed))
        rows.append(Row(f"{cell}: {method}, swapped or lost", share, mark=mark))
    return rows


def rmse(scores: xr.Dataset, cell: str, method: str) -> Figure:
    """Return the root mean square distance over all runs, with its 95 % interval."""
    squared = _squared(scores, cell, method)
    return root_mean_square(squared, np.ones_like(squared), len(squared), "m")


def ratio(scores: xr.Dataset, cell: str, ours: str, theirs: str) -> Figure:
    """Return the quotient of two root mean squares over the same runs, with its interval."""
    square = quotient(*(_squared(scores, cell, name) for name in (ours, theirs)))
    root = lambda x: float(np.sqrt(max(x, 0.0)))
    return Figure(root(square.value), root(square.lower), root(square.upper), square.trials)


def _squared(scores: xr.Dataset, cell: str, method: str) -> np.ndarray:
    return scores.squared_m2.sel(cell=cell, associator=method).values


def _failed(scores: xr.Dataset, cell: str, method: str) -> np.ndarray:
    here = scores.sel(cell=cell, associator=method)
    return (here.swap | here.loss).values


def _difference(ours: np.ndarray, theirs: np.ndarray) -> Figure:
    """Return the mean of what we have less than they, over the same runs, with its interval."""
    return mean_of(theirs - ours)


def _word(less: Figure) -> str:
    return "holds" if less.lower > 0 else "contrary" if less.upper < 0 else "alike"


def _cell(scores: xr.Dataset, cell: str, method: str) -> str:
    here = scores.sel(cell=cell, associator=method)
    shares = "/".join(f"{100 * float(x.mean()):.1f}" for x in (here.swap, here.loss))
    return f"{shares}\n{rmse(scores, cell, method).value:.3f}"
