"""Means over trials, their standard errors and paired differences, chunk after chunk.

With n trials, mean m and S = Σᵢ (xᵢ − m)², two parts a and b make a whole by

    m = m_a + δ n_b / n,   S = S_a + S_b + δ² n_a n_b / n,   δ = m_b − m_a

so no more than one chunk is in memory, and the order of the chunks decides the last bits.
"""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from jaxtrack.studies.design import Design, axes_of

LEAST_TRIALS = 8
"""Fewer say too little of their own spread for a study to end."""


class Moments(NamedTuple):
    """Of every variable, cell by cell."""

    trials: int
    mean: xr.Dataset
    square: xr.Dataset  # Σ (x − mean)²


def moments(design: Design, values: Mapping[str, np.ndarray]) -> Moments:
    """Return the moments of a chunk, of variables and of paired differences.

    Every method is compared with the first, on the same draws: `b - a.metric` is what method b has
    more than method a, in every cell of both their grids. What `[[compare]]` bounds by a variable
    has its paired difference from that too, `b.metric - a.metric`.

    Args:
        design: of the study.
        values: `[grid …, trials]` of each variable.
    """
    data = xr.Dataset(
        {
            f"{method.name}.{metric.name}": (
                (*axes_of(design, method), "trial"),
                values[f"{method.name}.{metric.name}"].astype(np.float64),
            )
            for method in design.methods
            for metric in design.metrics
        }
    )
    first, *others = (method.name for method in design.methods)
    pairs = {
        f"{other} - {first}.{metric.name}": (f"{other}.{metric.name}", f"{first}.{metric.name}")
        for other in others
        for metric in design.metrics
    }
    pairs |= {
        difference(f"{method}.{metric}", one.variable): (f"{method}.{metric}", one.variable)
        for one in design.compare
        if one.variable is not None
        for method in one.methods
        for metric in one.metrics
    }
    with np.errstate(invalid="ignore", over="ignore"):  # a trial of NaN or inf speaks for itself
        data = data.assign({name: data[b] - data[a] for name, (b, a) in pairs.items()})
        mean = data.mean("trial", skipna=False)
        square = ((data - mean) ** 2).sum("trial", skipna=False)
    return Moments(data.sizes["trial"], mean, square)


def difference(variable: str, other: str) -> str:
    """Return what the paired difference of two variables is called."""
    return f"{variable} - {other}"


def merged(a: Moments | None, b: Moments) -> Moments:
    """Return the moments of two parts together."""
    if a is None:
        return b
    trials = a.trials + b.trials
    with np.errstate(invalid="ignore", over="ignore"):
        delta = b.mean - a.mean
        mean = a.mean + delta * (b.trials / trials)
        square = a.square + b.square + delta**2 * (a.trials * b.trials / trials)
    return Moments(trials, mean, square)


def standard_errors(found: Moments) -> xr.Dataset:
    """Return the standard errors of the means; infinite of a single trial."""
    if found.trials == 1:
        return xr.full_like(found.mean, np.inf)
    return (found.square / (found.trials * (found.trials - 1.0))) ** 0.5


def widest(design: Design, found: Moments, metric: str) -> tuple[str, float, float]:
    """Return the variable, mean and standard error where a metric is known least.

    A NaN is known least of all.
    """
    errors = standard_errors(found)
    names = [f"{method.name}.{metric}" for method in design.methods]
    flat = {name: errors[name].values.ravel() for name in names}
    certain = lambda x: np.where(np.isnan(x), np.inf, x)
    name = max(names, key=lambda name: certain(flat[name]).max())
    cell = int(certain(flat[name]).argmax())
    return name, float(found.mean[name].values.ravel()[cell]), float(flat[name][cell])


def enough(design: Design, found: Moments) -> bool:
    """Return whether the study's own rule lets it stop after these trials."""
    if design.until is None:
        return False
    error = widest(design, found, design.until.metric)[2]
    # So few, or all alike, can be luck; NaN never is enough.
    return found.trials >= LEAST_TRIALS and 0 < error <= design.until.se


class Cell(NamedTuple):
    """A method in one cell of its grid."""

    method: str
    fields: dict[str, Any]  # values
    places: dict[str, int]  # along the axes


def cells(design: Design) -> Iterable[Cell]:
    """Return each method in each cell of its grid."""
    for method in design.methods:
        axes = axes_of(design, method)
        for place in np.ndindex(*(len(values) for values in axes.values())):
            at = dict(zip(axes, place, strict=True))
            yield Cell(method.name, {name: axes[name][n] for name, n in at.items()}, at)


def rows(design: Design, found: Moments) -> Iterable[dict[str, Any]]:
    """Return a row for each method and cell: its fields, and each metric's (mean, error).

    A metric's paired difference from the first method is under `metric - first`.
    """
    errors = standard_errors(found)
    first = design.methods[0].name
    for cell in cells(design):
        row: dict[str, Any] = {"method": cell.method, **cell.fields}
        for metric in design.metrics:
            row[metric.name] = known(found, errors, f"{cell.method}.{metric.name}", cell)
            pair = f"{cell.method} - {first}.{metric.name}"
            if pair in found.mean and set(found.mean[pair].dims) == set(cell.places):
                row[f"{metric.name} - {first}"] = known(found, errors, pair, cell)
        yield row


def known(found: Moments, errors: xr.Dataset, name: str, cell: Cell) -> tuple[float, float]:
    """Return mean and standard error of a variable in a cell, of which it may lack some fields."""
    at = lambda data: float(data[name].isel(cell.places, missing_dims="ignore"))
    return at(found.mean), at(errors)
