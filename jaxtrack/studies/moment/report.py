"""The tables, claims and marks of the study `moment_tracking`.

S of a run is the mean distance of the estimates from where the target was when the beam crossed it;
a run is lost if its last five are farther than 3 m on average. Trackers that follow the side of the
bucket that echoes are .29 m short of its middle: S beside it counts from there, for all alike.
"""

import functools

import jax.numpy as jnp
import numpy as np
import xarray as xr
from rich.table import Table

from jaxtrack.studies.moment.paper import TABLES
from jaxtrack.studies.moment.trial import OPTIMISED, OURS, astray, mean_gap_m
from jaxtrack.studies.tables import (
    Figure,
    Mark,
    Row,
    grid_table,
    mean_of,
    number,
    rate,
)

_DRAWS = 1000  # of the bootstrap
_HU, _ZERNIKE, _LOW = "hu", "zernike", "low_zernike"
CLEAN, NEAR = "clean", "two_objects"
MOTIONS = ("static", "hovering", "following")


def cell_name(motion: str, surroundings: str) -> str:
    """Return how tables call a scene.

    Example:
        >>> cell_name("static", "two_objects")
        'static, two objects'
    """
    return f"{motion}, {surroundings.replace('_', ' ')}"


def tables(scores: xr.Dataset, sweeps: xr.Dataset | None = None) -> list[Table]:
    """Return distances and losses, deviations beside the paper's, the sweeps, and its claims.

    Args:
        scores: of the scenes, [cell, trial, tracker], see `moment.dataset`.
        sweeps: likewise; None: not made.
    """
    return [
        *_distances(scores, "Scenes"),
        _deviations(scores),
        *(_distances(sweeps, "Sweeps") if sweeps is not None else []),
        _claims(scores),
    ]


def _distances(scores: xr.Dataset, what: str) -> list[Table]:
    """Return a table a measure."""
    cells = [str(name) for name in scores.cell.values]
    measures = {
        "median S, m": lambda *at: median(s_m(scores, *at)),
        "median S from the side, m": lambda *at: median(s_m(scores, *at, side=True)),
        "mean S, m": lambda *at: mean_of(s_m(scores, *at)),
        "share lost": lambda *at: _lost(scores, *at),
    }
    methods = [str(name) for name in scores.tracker.values]
    return [
        grid_table(
            f"{what}: {name}, ± standard error",
            methods,
            cells,
            [[_spread(of(cell, method)) for cell in cells] for method in methods],
            trials=scores.sizes["trial"],
        )
        for name, of in measures.items()
    ]


def _deviations(scores: xr.Dataset) -> Table:
    """Return means over runs of mean and variance in X and Y; the paper's tables 4, 6 and 8."""
    names, lines = [], []
    for motion in MOTIONS:
        cell = cell_name(motion, CLEAN)
        for method, printed in TABLES[motion].items():
            error_m = scores.error_m.sel(cell=cell, tracker=method)
            centre, square = (f("look").values for f in (error_m.mean, error_m.var))
            line = []
            for axis in range(2):
                for values in (centre[:, axis], square[:, axis]):
                    line.append(_spread(mean_of(values)))
            names += [f"{motion}: {method}", "  paper"]
            lines.append([*line, _spread(mean_of(s_m(scores, cell, method)))])
            lines.append([number(value) for value in printed])
    columns = ("mean X, m", "variance X, m²", "mean Y, m", "variance Y, m²", "mean S, m")
    title = "Deviations in clean scenes, means over runs ± standard error, and tables 4, 6 and 8"
    return grid_table(title, names, columns, lines, trials=scores.sizes["trial"])


def claims(scores: xr.Dataset) -> dict[str, dict[str, tuple[str, Figure]]]:
    """Return where what the paper says holds, by claim and scene, and the share of runs it is of.

    Distances count from the bucket's middle and from the side that its trackers follow: a tracker
    that runs ahead of that side is nearer to the middle and no better.
    """
    cells = [cell_name(motion, around) for around in (CLEAN, NEAR) for motion in MOTIONS]
    best = _ZERNIKE + OPTIMISED
    side_m = functools.partial(s_m, side=True)
    compared = {
        "Zernike has a lower S than Hu, both optimised": (best, _HU + OPTIMISED, s_m),
        "… from the side": (best, _HU + OPTIMISED, side_m),
        "… and a lower variance in X": (best, _HU + OPTIMISED, _variance_x),
        "… and in Y": (best, _HU + OPTIMISED, _variance_y),
        "the optimised transition lowers S of Zernike": (best, _ZERNIKE, s_m),
        "… of Zernike from the side": (best, _ZERNIKE, side_m),
        "… of Hu": (_HU + OPTIMISED, _HU, s_m),
        "… of Hu from the side": (_HU + OPTIMISED, _HU, side_m),
    }
    found = {
        claim: {cell: _wins(*(of(scores, cell, name) for name in pair)) for cell in cells}
        for claim, (*pair, of) in compared.items()
    }
    lost = lambda name, *rule, **more: {
        cell: _verdict(_lost(scores, cell, name), *rule, **more) for cell in cells
    }
    found["Hu without it soon fails to track"] = lost(_HU, 0.5, above=True)
    found["Zernike tracks stably without it"] = lost(_ZERNIKE, 0.05, above=False)
    return found


def _claims(scores: xr.Dataset) -> Table:
    found = claims(scores)
    cell = lambda word, share: f"{word}\n{_spread(share)}"
    lines = [[cell(*at) for at in verdicts.values()] for verdicts in found.values()]
    title = "Claims of the paper, by the share of runs that agree, or are lost (more than half; at most 5 %)"  # noqa: E501
    columns = list(next(iter(found.values())))
    return grid_table(title, list(found), columns, lines, trials=scores.sizes["trial"])


def marks(scores: xr.Dataset, sweeps: xr.Dataset | None = None) -> list[Row]:
    """Return every figure that has a mark; the sweeps' scenes are none that settings were found on.

    Args:
        scores: of the scenes.
        sweeps: likewise; None: not made.
    """
    at_most = lambda bound: Mark(bound, at_least=False)
    rows, best, low = [], _ZERNIKE + OPTIMISED, _LOW + OPTIMISED
    for motion in MOTIONS:
        cell = cell_name(motion, CLEAN)
        ours, theirs = (s_m(scores, cell, name) for name in (best, _HU + OPTIMISED))
        rows += [
            Row(f"{cell}: {best}, median S", median(ours, "m"), mark=at_most(0.30)),
            Row(f"{cell}: {best} / hu, median S", _ratio(ours, theirs), mark=at_most(0.85)),
            Row(f"{cell}: {low}, median S", median(s_m(scores, cell, low), "m"),
                mark=at_most(0.20)),
        ]  # fmt: skip
        rows += [
            Row(f"{cell}: {name}, lost", _lost(scores, cell, name), mark=at_most(0.15))
            for name in (best, low)
        ]
    cell = cell_name("hovering", NEAR)
    plain, turned = (is_lost(scores, cell, name).astype(float) for name in (_ZERNIKE, best))
    rows.append(Row(f"{cell}: zernike, loss less by the optimised transition",
                    mean_of(plain - turned), mark=Mark(0.15)))  # fmt: skip
    judged = [(scores, cell_name(motion, around), bound)
              for around, bound in ((CLEAN, 0.02), (NEAR, 0.05)) for motion in MOTIONS]  # fmt: skip
    if sweeps is not None:
        clean = lambda cell: cell.startswith("step")
        judged += [(sweeps, cell, 0.02 if clean(cell) else 0.05)
                   for cell in map(str, sweeps.cell.values)]  # fmt: skip
    for table, cell, bound in judged:
        middle = median(s_m(table, cell, OURS), "m")
        rows.append(Row(f"{cell}: {OURS}, lost", _lost(table, cell, OURS), mark=at_most(bound)))
        rows.append(Row(f"{cell}: {OURS}, median S", middle, mark=at_most(0.20)))
    return rows


def s_m(scores: xr.Dataset, cell: str, method: str, *, side: bool = False) -> np.ndarray:
    """Return S of every run, [trial]; `side`: from what faces the vehicle, not from the middle."""
    name = "side_error_m" if side else "error_m"
    error_m = jnp.asarray(scores[name].sel(cell=cell, tracker=method).values)
    return np.asarray(mean_gap_m(error_m, jnp.asarray(scores.crossed.sel(cell=cell).values)))


def is_lost(scores: xr.Dataset, cell: str, method: str) -> np.ndarray:
    """Return which runs are lost, [trial]."""
    return np.asarray(astray(jnp.asarray(scores.error_m.sel(cell=cell, tracker=method).values)))


def median(values: np.ndarray, unit: str = "") -> Figure:
    """Return the median with a 95 % interval by the bootstrap.

    Example:
        >>> median(np.arange(101.0)).value
        50.0
    """
    drawn = np.median(values[_draws(len(values))], axis=1)
    lower, upper = np.quantile(drawn, [0.025, 0.975])
    return Figure(float(np.median(values)), float(lower), float(upper), len(values), unit)


def _ratio(ours: np.ndarray, theirs: np.ndarray) -> Figure:
    """Return the quotient of two medians over the same runs, with its interval."""
    draws = _draws(len(ours))
    drawn = np.median(ours[draws], axis=1) / np.median(theirs[draws], axis=1)
    lower, upper = np.quantile(drawn, [0.025, 0.975])
    value = float(np.median(ours) / np.median(theirs))
    return Figure(value, float(lower), float(upper), len(ours))


def _draws(size: int) -> np.ndarray:
    return np.random.default_rng(0).integers(0, size, (_DRAWS, size))


def _variance_x(scores: xr.Dataset, cell: str, method: str) -> np.ndarray:
    return scores.error_m.sel(cell=cell, tracker=method, axis="x").var("look").values


def _variance_y(scores: xr.Dataset, cell: str, method: str) -> np.ndarray:
    return scores.error_m.sel(cell=cell, tracker=method, axis="y").var("look").values


def _lost(scores: xr.Dataset, cell: str, method: str) -> Figure:
    lost = is_lost(scores, cell, method)
    return rate(float(lost.sum()), len(lost))


def _wins(ours: np.ndarray, theirs: np.ndarray) -> tuple[str, Figure]:
    """Return whether one is lower than the other on more than half of the same runs."""
    return _verdict(rate(float((ours < theirs).sum()), len(ours)), 0.5, above=True)


def _verdict(share: Figure, bound: float, *, above: bool) -> tuple[str, Figure]:
    over, under = share.lower > bound, share.upper < bound
    holds, contrary = (over, under) if above else (under, over)
    return "holds" if holds else "contrary" if contrary else "open", share


def _spread(figure: Figure) -> str:
    return f"{number(figure.value)} ± {number(_half(figure))}"


def _half(figure: Figure) -> float:
    """Return the standard error that a 95 % interval is made of."""
    return (figure.upper - figure.lower) / 2 / 1.96
