"""The figures of a study's report: curves over each field of the grid, and the atlas's maps."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxtrack.studies import summary
from jaxtrack.studies.design import Design, Part, axes_of
from jaxtrack.studies.report import atlas
from jaxtrack.studies.report.curves import MOST_CURVES, Panel, Point, key, panels
from jaxtrack.studies.report.html_page import Html, joined, tag
from jaxtrack.studies.tables import plus_minus

_MOST_PANELS = 12
_REACH = 2.0  # standard errors that error bars show to either side


def figures(design: Design, found: summary.Moments) -> Html | None:
    """Return each metric over each field of the grid."""
    parts, first = [], design.methods[0]
    for metric in design.metrics:
        drawn = []
        for field, values in design.scene.grid.items():
            if len(values) > 1:
                drawn.append(_over(design, found, metric.name, field, values, design.methods))
        for method in design.methods:
            for field, values in method.grid.items():
                if len(values) > 1:
                    name = f"{method.name}.{field}"
                    of = (method,) if first.grid else (first, method)  # to compare with
                    drawn.append(_over(design, found, metric.name, name, values, of))
        if drawn:
            parts += [tag("h3", metric.name), *drawn]
    return joined(parts) if parts else None


def _over(
    design: Design,
    found: summary.Moments,
    metric: str,
    field: str,
    values: Sequence[Any],
    methods: Sequence[Part],
) -> Html:
    """Return a metric over a field: a frame a cell of the scene's other fields."""
    errors = summary.standard_errors(found)
    frames = _cells({k: v for k, v in design.scene.grid.items() if k != field})
    chosen = _some(frames, _MOST_PANELS)
    each = max(MOST_CURVES // len(methods), 1)
    curves: dict[str, tuple[str, dict[str, int]]] = {}
    left_out = len(frames) - len(chosen) + max(len(methods) - MOST_CURVES, 0)
    for method in methods[:MOST_CURVES]:
        own = {f"{method.name}.{k}": v for k, v in method.grid.items()}
        cells = _cells({k: v for k, v in own.items() if k != field})
        left_out += len(cells) - len(_some(cells, each))
        for words, at in _some(cells, each):
            name = ", ".join(filter(None, [method.name, words.replace(f"{method.name}.", "")]))
            curves[name] = f"{method.name}.{metric}", at
    shown, whose = [], set()
    for title, here in chosen:
        drawn, others = {}, {}
        for name, (variable, own) in curves.items():
            mean, error = (data[variable].isel(here | own) for data in (found.mean, errors))
            spots = range(len(values))
            take = lambda data, n: float(data.isel({field: n}) if field in data.dims else data)
            drawn[name] = [Point(n, take(mean, n), _REACH * take(error, n)) for n in spots]
            printed = _printed(design, metric, variable.partition(".")[0], here | own, field)
            whose |= {one for one, _ in printed}
            others[name] = [point for _, point in printed]
        shown.append(Panel(title, drawn, others))
    caption = f"{metric} over {field}. Bars reach {_REACH:.0f} standard errors to either side."
    if whose:
        caption += f" Hollow: {', '.join(sorted(whose))}."
    if left_out:
        caption += " Some cells are left out here; the table has all."
    labels = [str(value) for value in values]
    return tag(
        "figure",
        key(list(curves)),
        panels(shown, list(curves), labels, field, metric),
        tag("figcaption", caption),
    )


def _printed(
    design: Design, metric: str, name: str, at: Mapping[str, int], field: str
) -> list[tuple[str, Point]]:
    """Return what the file puts beside a curve, and whose it is."""
    (method,) = (method for method in design.methods if method.name == name)
    axes = axes_of(design, method)
    found = []
    for place in range(len(axes.get(field, ()))):
        fields = {axis: axes[axis][n] for axis, n in {**at, field: place}.items()}
        for one in design.compare:
            if metric in one.metrics and name in one.methods and one.kind == "value":
                figure = one.at(fields)
                if isinstance(figure, (int, float)):
                    found.append((one.name, Point(place, figure, 0.0)))
    return found


def _cells(axes: Mapping[str, Sequence[Any]]) -> list[tuple[str, dict[str, int]]]:
    """Return the cells of a grid, in words and as places along the axes."""
    places = itertools.product(*(range(len(values)) for values in axes.values()))
    found = []
    for place in places:
        at = dict(zip(axes, place, strict=True))
        words = ", ".join(f"{k} {axes[k][n]}" for k, n in at.items() if len(axes[k]) > 1)
        found.append((words, at))
    return found


def _some(cells: list[Any], most: int) -> list[Any]:
    """Return at most so many, spread over all."""
    if len(cells) <= most:
        return cells
    return [cells[n] for n in np.linspace(0, len(cells) - 1, most).round().astype(int)]


def maps(design: Design, found: summary.Moments) -> list[atlas.Map]:
    """Return each metric of each method, and of what it has more than the first, of two axes on."""
    errors = summary.standard_errors(found)
    first, *others = design.methods
    labels = {k: v for method in design.methods for k, v in axes_of(design, method).items()}
    variables = [(method.name, method.name, False) for method in design.methods]
    variables += [(f"{o.name} − {first.name}", f"{o.name} - {first.name}", True) for o in others]
    drawn = []
    for metric in design.metrics:
        for what, name, signed in variables:
            mean = found.mean[f"{name}.{metric.name}"]
            if mean.ndim < 2:
                continue
            error = errors[f"{name}.{metric.name}"]
            flat = zip(mean.values.ravel(), error.values.ravel(), strict=True)
            text = np.array([plus_minus(float(m), float(e)) for m, e in flat]).reshape(mean.shape)
            axes = {str(dim): [str(value) for value in labels[str(dim)]] for dim in mean.dims}
            drawn.append(atlas.Map(metric.name, what, axes, mean.values, text, signed))
    return drawn
