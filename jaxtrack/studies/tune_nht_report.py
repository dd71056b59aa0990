"""Tables, marks and figures of the study `tune_nht`."""

import pathlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import xarray as xr
from rich.table import Table

from jaxtrack.studies.tables import Figure, Mark, Row, grid_table, mean_of, number, rate

ABOVE_PAPER = {"corner": Mark(0.50), "centre": Mark(0.65)}
WITHIN = Mark(1.15, at_least=False)  # the largest of the three starts' ends over the smallest
AS_GOOD = Mark(0.0)  # share of scenes that the gradient has over TPE
SECONDS = Mark(120.0, at_least=False)
_HAND = {"paper": "the paper's ε, the default", "wide": "study nht's wide ε"}


def table(scores: xr.Dataset, origin: str) -> Table:
    """Return every setting's tolerances, top 3 with its standard error, and what it cost."""
    here = scores.sel(origin=origin)
    trials = here.sizes["trial"]
    budget = int(scores.realizations.values[-1])
    names, lines = [], []
    for setting in map(str, here.setting.values):
        eps = here.eps.sel(setting=setting).values
        line = [f"{eps[0]:.3g} m", f"{eps[1]:.2g} rad"]
        for match in here.match.values:
            hits = here.top_3.sel(setting=setting, match=match).values
            share = hits.mean()
            error = np.sqrt(share * (1 - share) / max(trials - 1, 1))
            line.append(f"{number(float(share))} ± {number(float(error))}")
        method, _, start = setting.partition(", ")
        if start:
            seconds = float(here.seconds.sel(tuner=method, start=start))
            line += [str(budget), number(seconds, "s")]
        names.append(_HAND.get(setting, setting))
        lines.append([*line, *[""] * (6 - len(line))])
    columns = ["ε_ρ", "ε_θ", "top 3\n50 m", "top 3\n100 m", "realizations", "time"]
    title = f"ρ from the {origin}, situation IV with 10 clutter a scan, held-out scenes"
    return grid_table(title, names, columns, lines, trials=trials)


def marks(scores: xr.Dataset) -> list[Row]:
    """Return every figure that has a mark."""
    rows = []
    trials = scores.sizes["trial"]
    starts = [str(start) for start in scores.start.values]
    ends = scores.eps_on_the_way.isel(evaluation=-1).sel(tuner="gradient")
    exact = lambda value, unit="": Figure(value, value, value, trials, unit)
    for origin in map(str, scores.origin.values):
        for name, symbol in (("eps_rho_m", "ε_ρ"), ("eps_theta_rad", "ε_θ")):
            three = ends.sel(origin=origin, parameter=name).values
            spread = exact(float(three.max() / three.min()))
            rows.append(Row(f"{origin}: {symbol}, largest / smallest end", spread, mark=WITHIN))
        for start in starts:
            gain = _difference(scores, origin, [f"gradient, {start}"], ["paper"])
            what = f"{origin}: top 3 above the paper's ε, from {start}"
            rows.append(Row(what, gain, mark=ABOVE_PAPER[origin]))
        for method in map(str, scores.tuner.values):
            if method != "gradient":
                ours = [f"gradient, {start}" for start in starts]
                theirs = [f"{method}, {start}" for start in starts]
                what = f"{origin}: top 3 above {method}, mean of the starts"
                rows.append(Row(what, _difference(scores, origin, ours, theirs), mark=AS_GOOD))
    seconds = scores.seconds.sel(tuner="gradient").values
    if np.isfinite(seconds).any():  # what was interrupted has no time
        slowest = exact(float(np.nanmax(seconds)), "s")
        rows.append(Row("slowest tuning, compilation included", slowest, mark=SECONDS))
    full = float(scores.overflow.values.sum())
    rows.append(Row("scenes in which a table overflowed", rate(full, scores.overflow.size)))
    return rows


def _difference(scores: xr.Dataset, origin: str, ours: list[str], theirs: list[str]) -> Figure:
    """Return the mean gain in top 3 at the closest match, over the same scenes."""
    here = scores.top_3.isel(match=0).sel(origin=origin)
    share = lambda names: here.sel(setting=names).values.astype(np.float64).mean(-1)
    return mean_of(share(ours) - share(theirs))


def draw(
    out: pathlib.Path,
    scores: xr.Dataset,
    maps: xr.Dataset,
    ways: Mapping[tuple[str, str, str], Any],
    fits: Mapping[tuple[str, str], Any],
    progress: Callable[[int, int], None],
) -> None:
    """Draw the maps with the ways, a fit's history, and top 3 against realizations, into `out`."""
    from jaxtrack import plots

    origins = [str(origin) for origin in scores.origin.values]
    starts = [str(start) for start in scores.start.values]
    total = 2 * len(origins) + 1
    for done, origin in enumerate(origins):
        eps = scores.eps.sel(origin=origin)
        figure = plots.loss_map(
            maps.eps_rho_m.values,
            maps.eps_theta_rad.values,
            maps.loss.sel(origin=origin).values,
            {f"gradient, {start}": ways[origin, "gradient", start].steps for start in starts},
            x_label=r"$\varepsilon_\rho$, m",
            y_label=r"$\varepsilon_\theta$, rad",
            points={
                setting: tuple(eps.sel(setting=setting).values)
                for setting in map(str, eps.setting.values)
                if setting.startswith("TPE, ")
            },
            title=f"Candidate softmax with ρ from the {origin}, and the gradient's ways",
        )
        figure.savefig(out / f"map_{origin}.png", dpi=150)
        progress(2 * done + 1, total)
        figure = plots.fit_history(
            fits[origin, starts[0]], title=f"ρ from the {origin}, from {starts[0]} ε"
        )
        figure.savefig(out / f"fit_{origin}.png", dpi=150)
        progress(2 * done + 2, total)
    plain = scores.realizations.values.astype(float)
    panels = {}
    for origin in origins:
        on_the_way = scores.top_3_on_the_way.sel(origin=origin)
        panels[f"ρ from the {origin}"] = {
            str(method): (
                plain,
                1 - on_the_way.sel(tuner=method).mean("start").values,
                on_the_way.sel(tuner=method).std("start", ddof=1).values / np.sqrt(len(starts)),
            )
            for method in scores.tuner.values
        }
    figure = plots.error_curves(
        panels,
        x_label="realizations simulated",
        y_label="1 − top 3 at 50 m, held out",
        title="Mean of the three starts, with two standard errors over them",
    )
    figure.savefig(out / "top_3_by_realizations.png", dpi=150)
    progress(total, total)
