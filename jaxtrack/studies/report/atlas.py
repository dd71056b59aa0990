"""The atlas of a study: maps of a metric over two fields of the grid, sliders for the others.

A map is a table whose cells have colours, so it reads aloud and prints. The first one stands in the
page; a script shows the others from the numbers that come along.
"""

import json
import pathlib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxtrack.studies.report.html_page import Html, joined, tag

SCRIPT = pathlib.Path(__file__).with_name("atlas.js")
_DENSE = 14  # columns from which cells are colours alone
_STRONG, _STRONG_MINUS = 0.65, 0.8  # from here on white is read better than black on the shade


class Map(NamedTuple):
    """A metric of a method, or of what it has more than another, over the method's grid."""

    metric: str
    what: str  # the method, or "b − a"
    labels: Mapping[str, Sequence[str]]  # of each axis
    mean: np.ndarray  # [axes …]
    text: np.ndarray  # the same, as cells show it
    signed: bool  # around zero


def atlas(maps: Sequence[Map]) -> Html:
    """Return the controls, the first map and all numbers.

    Args:
        maps: each of at least two axes; at least one.
    """
    first = maps[0]
    down, across, *others = first.labels
    at = (slice(None), slice(None), *(0 for _ in others))
    looks = _looks(first)
    text, shade, kind = first.text[at], looks.shade[at], looks.kind[at]
    rest = ", ".join(f"{axis} = {first.labels[axis][0]}" for axis in others)
    caption = f"{first.metric}, {first.what}: {down} down, {across} across" + (
        f"; {rest}" if rest else ""
    )
    rows = (
        tag(
            "tr",
            tag("th", label, scope="row"),
            *(_cell(str(t), s, str(k)) for t, s, k in zip(*row, strict=True)),
        )
        for label, *row in zip(first.labels[down], text, shade, kind, strict=True)
    )
    heads = (tag("th", label, scope="col") for label in first.labels[across])
    shown = tag(
        "table",
        tag("caption", tag("span", caption), id="atlas-caption"),
        tag("thead", tag("tr", tag("td"), *heads)),
        tag("tbody", *rows),
        id="atlas-map",
        class_="map dense" if len(first.labels[across]) >= _DENSE else "map",
    )
    box = {"class_": "scroll", "tabindex": "0", "role": "region"}
    return joined(
        [
            tag("noscript", tag("p", "Without JavaScript only the first map is shown.")),
            tag("form", class_="controls", id="atlas-controls", aria_label="What the map shows"),
            tag("div", shown, aria_labelledby="atlas-caption", **box),
            tag("p", _scale(first), id="atlas-scale", class_="soft"),
            tag("p", "", id="atlas-said", role="status", class_="unseen"),
            tag("script", Html(_data(maps)), type="application/json", id="atlas-data"),
        ]
    )


class _Looks(NamedTuple):
    """How cells look."""

    shade: np.ndarray  # from 0 to 1
    kind: np.ndarray  # the cell's classes


def _cell(text: str, shade: float, kind: str) -> Html:
    return tag("td", text, class_=kind or None, style=f"--at:{shade:.3f}", title=text)


def _looks(one: Map) -> _Looks:
    low, high = _ends(one)
    with np.errstate(invalid="ignore"):
        shade = np.abs(one.mean) / (high or 1.0)
        if not one.signed:
            shade = (one.mean - low) / ((high - low) or 1.0)
    known, minus = np.isfinite(one.mean), one.signed & (one.mean < 0)
    strong = shade > np.where(minus, _STRONG_MINUS, _STRONG)
    kind = np.where(strong, np.where(minus, "strong minus", "strong"), np.where(minus, "minus", ""))
    return _Looks(np.where(known, shade, 0.0).round(3), np.where(known, kind, "none"))


def _ends(one: Map) -> tuple[float, float]:
    known = one.mean[np.isfinite(one.mean)]
    if not known.size:
        return 0.0, 0.0
    most = float(np.abs(known).max())
    return (-most, most) if one.signed else (float(known.min()), float(known.max()))


def _scale(one: Map) -> str:
    low, high = _ends(one)
    if one.signed:
        return f"Blue is more, red is less, by up to {high:.3g}; white is no difference."
    return f"From {low:.3g} (light) to {high:.3g} (dark) over all cells."


def _data(maps: Sequence[Map]) -> str:
    entries: list[dict[str, Any]] = [
        {
            "metric": one.metric,
            "what": one.what,
            "axes": list(one.labels),
            "labels": [list(labels) for labels in one.labels.values()],
            "text": one.text.ravel().tolist(),
            **{name: x.ravel().tolist() for name, x in _looks(one)._asdict().items()},
            "scale": _scale(one),
        }
        for one in maps
    ]
    data = {"dense": _DENSE, "maps": entries}
    return json.dumps(data, ensure_ascii=False).replace("<", "\\u003c")
