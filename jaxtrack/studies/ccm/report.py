"""The tables and marks of the study `ccm`."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from rich.table import Table

from jaxtrack.studies.tables import (
    Figure,
    Mark,
    Row,
    grid_table,
    mean_of,
    number,
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
RIVALS = ("nearest", "optimal", "jpda")
_PER_RUN = ("swap", "loss", "squared_m2")
# What the paper says of its single run of crossing targets.
_SAID = {"nearest": "a track is lost", "jpda": "the wrong target", "cloud": "both are tracked"}


class Claim(NamedTuple):
    """That the cloud model fails more seldom than a rival, or is nearer, and what we see of it."""

    cell: str
    rival: str
    what: str  # "failures": swapped or lost, a share; "distance": root mean square, in m
    cloud: float
    theirs: float
    verdict: str  # "holds", "contrary" or "alike", at 95 %, over the same runs

    def entry(self) -> dict[str, Any]:
        """Return it as JSON can hold it."""
        return self._asdict()


def tables(
    scores: xr.Dataset,
    named: Sequence[str],
    pinged: Sequence[str],
    assumed: Mapping[str, Mapping[str, float]],
) -> list[Table]:
    """Return swaps, losses and errors, what looks held, and where the paper's claim holds.

    Args:
        scores: [cell, trial, associator].
        named: the situations; their figures stand beside the prototype's.
        pinged: the cells that a sonar looks at.
        assumed: β₀ by cell, of each situation that has several.
    """
    compared = [*named, *pinged]
    said = "Swapped % / lost %, and the distance in m"
    claim = "Where the paper's claim holds: the cloud model against others on the same runs, 95 %"
    return [
        _situations(scores, named, f"{said}; below it a prototype's 1 000 runs", PROTOTYPE),
        _situations(scores, pinged, f"{said}, on pings of the paper's sonar", {}),
        _looks(scores, compared),
        _sweeps(scores, compared),
        _claims(scores, compared, claim),
        _at_best(scores, assumed, said),
        _claims(at_best(scores, assumed)[0], list(assumed), f"{claim}; each at its best β₀"),
    ]


def at_best(
    scores: xr.Dataset, assumed: Mapping[str, Mapping[str, float]]
) -> tuple[xr.Dataset, dict[str, dict[str, float]]]:
    """Return the runs of each situation with each associator at its best β₀, and those β₀.

    The best has the least root mean square distance over these same runs: it flatters those on
    whom β₀ works, which the cloud model and the nearest neighbours are not.

    Args:
        scores: [cell, trial, associator]; looks of a situation are the same in all of its cells.
        assumed: β₀ by cell, of each situation.
    """
    found, least = [], {}
    for name, cells in assumed.items():
        here = scores[list(_PER_RUN)].sel(cell=list(cells))
        place = here.squared_m2.mean("trial").argmin("cell")  # the first, where all are equal
        found.append(here.isel(cell=place).drop_vars("cell"))
        values = np.array(list(cells.values()))[place.values]
        least[name] = dict(zip(map(str, scores.associator.values), values.tolist(), strict=True))
    together: Any = xr.concat(found, xr.IndexVariable("cell", list(assumed)))
    return together, least


def claims(scores: xr.Dataset, cells: Sequence[str]) -> list[Claim]:
    """Return the paper's claim cell by cell and rival by rival, in failures and in distance."""
    found = []
    for cell in cells:
        failed = {name: _failed(scores, cell, name).astype(float) for name in ("cloud", *RIVALS)}
        squared = {name: _squared(scores, cell, name) for name in ("cloud", *RIVALS)}
        for rival in RIVALS:
            for what, each, read in (("failures", failed, float), ("distance", squared, np.sqrt)):
                ours, theirs = each["cloud"], each[rival]
                value = lambda x, read=read: float(read(x.mean()))
                word = _word(mean_of(theirs - ours))
                found.append(Claim(cell, rival, what, value(ours), value(theirs), word))
    return found


def _situations(
    scores: xr.Dataset, cells: Sequence[str], title: str, prototype: dict[str, str]
) -> Table:
    names, lines = [], []
    for method in map(str, scores.associator.values):
        names.append(method.replace("_", " "))
        lines.append([_cell(scores, cell, method) for cell in cells])
        if method in prototype:
            names.append("prototype")
            lines.append([cell.replace(" ", "\n") for cell in prototype[method].split(", ")])
    columns = [cell.replace(", ", ",\n") for cell in cells]
    return grid_table(title, names, columns, lines, trials=scores.sizes["trial"])


def _at_best(scores: xr.Dataset, assumed: Mapping[str, Mapping[str, float]], said: str) -> Table:
    best, least = at_best(scores, assumed)
    methods = list(map(str, scores.associator.values))
    lines = [
        [f"{_cell(best, name, method)}\nβ₀ {least[name][method]:g}" for name in assumed]
        for method in methods
    ]
    names = [method.replace("_", " ") for method in methods]
    title = f"{said}, each at its best β₀"
    return grid_table(title, names, list(assumed), lines, trials=scores.sizes["trial"])


def _looks(scores: xr.Dataset, cells: Sequence[str]) -> Table:
    """Return what associators were shown: the sonar's share of what they are told."""
    lines = []
    for cell in cells:
        here = scores.sel(cell=cell)
        spread = np.sqrt(here.echo_squared_m2.mean("trial").values)
        shares = (here.detected, here.echoes, here.false_per_look)
        lines.append([number(float(x)) for x in (*(x.mean() for x in shares), *spread)])
    columns = ["target seen", "echoes of it", "false, a look", "spread in x, m", "in y, m"]
    title = "What the looks held, on the average"
    return grid_table(title, cells, columns, lines, trials=scores.sizes["trial"])


def _sweeps(scores: xr.Dataset, compared: Sequence[str]) -> Table:
    others = [str(name) for name in scores.cell.values if str(name) not in compared]
    failed = lambda *at: f"{100 * _failed(scores, *at).mean():.0f}"
    lines = [
        [f"{failed(cell, name)}  {rmse(scores, cell, name).value:.2f}" for name in SWEPT]
        for cell in others
    ]
    title = "Sweeps, of C where nothing else is said: swapped or lost %, and the distance in m"
    return grid_table(title, others, SWEPT, lines, trials=scores.sizes["trial"])


def _claims(scores: xr.Dataset, cells: Sequence[str], title: str) -> Table:
    lines: dict[str, list[str]] = {cell: [] for cell in cells}
    for claim in claims(scores, cells):
        ours, theirs = claim.cloud, claim.theirs
        seen = (
            f"{100 * ours:.1f} : {100 * theirs:.1f} %"
            if claim.what == "failures"
            else f"{number(ours)} : {number(theirs)} m"
        )
        lines[claim.cell].append(f"{claim.verdict}\n{seen}")
    columns = [f"{what}\n{rival}" for rival in RIVALS for what in ("failures", "distance")]
    return grid_table(title, cells, columns, list(lines.values()), trials=scores.sizes["trial"])


def marks(scores: xr.Dataset, assumed: Mapping[str, Mapping[str, float]]) -> list[Row]:
    """Return every figure that has a mark, and what becomes of the paper's rivals on pings.

    On pings the cloud model has the marks that it has on drawn echoes. Single centroids leave it
    nothing to cluster: they have none. Nor has the comparison of each at its best β₀.

    Args:
        scores: [cell, trial, associator].
        assumed: β₀ by cell, of each situation that has several.
    """
    at_most = lambda bound: Mark(bound, at_least=False)
    failed = lambda cell, method, mark=None, paper="": Row(
        f"{cell}: {method}, swapped or lost", _share(scores, cell, method), paper, mark
    )
    rows = []
    for cell in ("A", "A, pings"):
        swaps = scores.swap.sel(cell=cell, associator="cloud").values
        rows.append(
            Row(f"{cell}: cloud, swaps", rate(float(swaps.sum()), len(swaps)), mark=at_most(0.0))
        )
        for rival, bound in (("jpda", 0.93), ("nearest", 0.60)):
            found = ratio(scores, cell, "cloud", rival)
            rows.append(Row(f"{cell}: cloud / {rival}, RMSE", found, "less", at_most(bound)))
    best = at_best(scores, assumed)[0]
    for rival in ("jpda", "nearest"):
        found = ratio(best, "A", "cloud", rival)
        rows.append(Row(f"A: cloud / {rival}, RMSE, each at its best β₀", found, "less"))
    rows += [failed("A3", "cloud", at_most(0.03)), failed("A3", "jpda", Mark(0.20))]
    for cell in ("B", "B, pings"):
        rows.append(failed(cell, "cloud", at_most(0.015), _SAID["cloud"]))
        rows += [failed(cell, rival, None, _SAID[rival]) for rival in ("nearest", "jpda")]
    return [*rows, failed("D", "pmht", at_most(0.025))]


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


def _share(scores: xr.Dataset, cell: str, method: str) -> Figure:
    failed = _failed(scores, cell, method)
    return rate(float(failed.sum()), len(failed))


def _failed(scores: xr.Dataset, cell: str, method: str) -> np.ndarray:
    here = scores.sel(cell=cell, associator=method)
    return (here.swap | here.loss).values


def _word(less: Figure) -> str:
    return "holds" if less.lower > 0 else "contrary" if less.upper < 0 else "alike"


def _cell(scores: xr.Dataset, cell: str, method: str) -> str:
    here = scores.sel(cell=cell, associator=method)
    shares = "/".join(f"{100 * float(x.mean()):.1f}" for x in (here.swap, here.loss))
    return f"{shares}\n{rmse(scores, cell, method).value:.3f}"
