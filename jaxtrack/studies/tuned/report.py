"""Tables, marks and figures of the studies of tuning."""

import itertools
import pathlib
from collections.abc import Callable, Mapping
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
    rate,
    standard_error,
)
from jaxtrack.studies.tuned.ways import GRADIENT, TPE, label

NEAR_BEST = Mark(3.0, at_least=False)  # standard errors above the best setting that is known
SECONDS = Mark(120.0, at_least=False)


class Words(NamedTuple):
    """How a study speaks of its cases."""

    titles: Mapping[str, str]  # by case
    symbols: Mapping[str, tuple[str, str]]  # by parameter, with its unit
    hand: Mapping[str, str]  # of the settings by hand
    measures: tuple[str, ...]  # of the score
    unit: str = ""  # of the score
    shares: bool = False  # the table shows 1 − score


def table(scores: xr.Dataset, case: str, words: Words) -> Table:
    """Return every setting with its score, the standard error of that, and what it cost."""
    here = scores.sel(case=case)
    budget = int(scores.realizations.values[-1])
    ways = {
        label(tuner, start): {"tuner": tuner, "start": start}
        for tuner in here.tuner.values
        for start in here.start.values
    }
    names, lines = [], []
    for setting in map(str, here.setting.values):
        values = here.params.sel(setting=setting).values
        line = [
            f"{value:.3g} {unit}".strip()
            for value, (_, unit) in zip(values, words.symbols.values(), strict=True)
        ]
        for found in here.score.sel(setting=setting).values.T:
            mean = 1 - found.mean() if words.shares else found.mean()
            line.append(f"{number(float(mean))} ± {number(standard_error(found))}")
        way = ways.get(setting)
        line += [str(budget), number(float(here.seconds.sel(way)), "s")] if way else ["", ""]
        names.append(words.hand.get(setting, setting))
        lines.append(line)
    symbols = [symbol for symbol, _ in words.symbols.values()]
    columns = [*symbols, *words.measures, "realizations", "time"]
    title = f"{words.titles[case]}, held-out scenes"
    return grid_table(title, names, columns, lines, trials=here.sizes["trial"])


def marks(scores: xr.Dataset, words: Words) -> list[Row]:
    """Return every figure that has a mark where the score is no share, and what was gained."""
    near = [near_best(scores, str(case), words) for case in scores.case.values]
    return [*itertools.chain(*near), *costs(scores)]


def near_best(scores: xr.Dataset, case: str, words: Words) -> list[Row]:
    """Return how near the gradient comes to the best setting known, and what it gains.

    The best is chosen on the very scenes: a little too good, which is to the others' disadvantage.
    """
    here = scores.score.sel(case=case).isel(measure=0).astype(np.float64)
    best = str(here.setting.values[here.mean("trial").values.argmin()])
    default = str(here.setting.values[0])
    tuners, starts = ([str(name) for name in scores[axis].values] for axis in ("tuner", "start"))
    of = lambda setting: here.sel(setting=setting).values
    rows = []
    for start in starts:
        above = of(label(GRADIENT, start)) - of(best)
        error = standard_error(above)
        ratio = above.mean() / error if error > 0 else 0.0
        what = f"{case}: from {start}, standard errors above the best ({best})"
        rows.append(Row(what, exact(float(ratio), len(above)), mark=NEAR_BEST))
    for start in starts:
        gain = of(default) - of(label(GRADIENT, start))
        rows.append(
            Row(f"{case}: from {start}, better than the default by", mean_of(gain, words.unit))
        )
    for tuner in tuners:
        if tuner != GRADIENT:
            mean = lambda name: np.mean([of(label(name, start)) for start in starts], axis=0)
            gain = mean(tuner) - mean(GRADIENT)
            rows.append(Row(f"{case}: gradient better than {tuner} by", mean_of(gain, words.unit)))
    return rows


def costs(scores: xr.Dataset) -> list[Row]:
    """Return the slowest tuning by gradient, and how often a table was too small."""
    rows = []
    seconds = scores.seconds.sel(tuner=GRADIENT).values
    if np.isfinite(seconds).any():  # what was interrupted has no time
        slowest = exact(float(np.nanmax(seconds)), scores.sizes["trial"], "s")
        rows.append(Row("slowest tuning, compilation included", slowest, mark=SECONDS))
    for setting in (str(scores.setting.values[0]), label(GRADIENT, scores.start.values[0])):
        full = scores.overflow.sel(setting=setting).values
        rows.append(
            Row(f"scenes in which a table was full: {setting}", rate(full.sum(), full.size))
        )
    return rows


def exact(value: float, trials: int, unit: str = "") -> Figure:
    """Return a number that is no mean over trials."""
    return Figure(value, value, value, trials, unit)


def draw(
    out: pathlib.Path,
    scores: xr.Dataset,
    maps: Mapping[str, xr.Dataset],
    ways: Mapping[tuple[str, str, str], Any],
    fits: Mapping[tuple[str, str], Any],
    words: Words,
    progress: Callable[[int, int], None],
) -> None:
    """Draw the maps with the ways, a fit's history, and scores against realizations, into `out`."""
    from jaxtrack import plots

    cases, starts = ([str(name) for name in scores[axis].values] for axis in ("case", "start"))
    names = [str(name) for name in scores.parameter.values]
    total = 2 * len(cases) + 1
    axis_label = lambda name: ", ".join(filter(None, words.symbols[name]))
    for done, case in enumerate(cases):
        landscape = maps[f"map, {case}"].loss
        axes = [str(axis) for axis in landscape.dims]
        at = [names.index(axis) for axis in axes]
        params = scores.params.sel(case=case)
        figure = plots.loss_map(
            landscape[axes[0]].values,
            landscape[axes[1]].values,
            landscape.values,
            {f"from {start}": ways[case, GRADIENT, start].steps[:, at] for start in starts},
            x_label=axis_label(axes[0]),
            y_label=axis_label(axes[1]),
            points={
                label(TPE, start): tuple(
                    params.sel(setting=label(TPE, start), parameter=axes).values
                )
                for start in starts
                if TPE in scores.tuner.values
            },
            title=f"{words.titles[case]}: the loss, and the gradient's ways",
        )
        plots.save(figure, out / f"map_{case}.png")
        progress(2 * done + 1, total)
        title = f"{words.titles[case]}, from {starts[0]}"
        figure = plots.fit_history(fits[case, starts[0]], title=title)
        plots.save(figure, out / f"fit_{case}.png")
        progress(2 * done + 2, total)
    plain = scores.realizations.values.astype(float)
    panels = {}
    for case in cases:
        way = scores.score_on_the_way.sel(case=case)
        panels[words.titles[case]] = {
            str(tuner): (
                plain,
                way.sel(tuner=tuner).mean("start").values,
                way.sel(tuner=tuner).std("start", ddof=1).values / np.sqrt(len(starts)),
            )
            for tuner in scores.tuner.values
        }
    measure = ("1 − " if words.shares else "") + words.measures[0].replace("\n", " ")
    figure = plots.error_curves(
        panels,
        x_label="realizations simulated",
        y_label=f"{measure}, held out",
        title="Mean of the starts, with two standard errors over them",
    )
    plots.save(figure, out / "score_by_realizations.png")
    progress(total, total)
