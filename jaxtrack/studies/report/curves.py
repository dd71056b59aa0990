"""Curves with error bars as SVG inside a page: sharp on paper, without a library of figures."""

import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from jaxtrack.studies.report.html_page import Html, tag

MOST_CURVES = 8  # so many colours has the style
# Outlines around a point; the last ones repeat, in other colours.
_MARKS = (
    "M-3.2 0a3.2 3.2 0 1 0 6.4 0a3.2 3.2 0 1 0 -6.4 0",
    "M-3 -3h6v6h-6z",
    "M0 -4l3.8 7h-7.6z",
    "M0 -4l4 4l-4 4l-4 -4z",
    "M0 4l3.8 -7h-7.6z",
)
_WIDTH, _HEIGHT = 320, 210
_LEFT, _RIGHT, _TOP, _BOTTOM = 48, 12, 24, 38
_LOG_FROM = 20.0  # a span of positive values, last by first, that asks for a logarithmic axis


class Point(NamedTuple):
    """One value of a curve."""

    at: int  # place on the axis
    mean: float
    reach: float  # of the error bar, to either side


class Panel(NamedTuple):
    """Curves in one frame."""

    title: str
    curves: Mapping[str, Sequence[Point]]  # by a name in the key
    others: Mapping[str, Sequence[Point]]  # what others found of the same, hollow


def key(names: Sequence[str]) -> Html:
    """Return which curve is whose."""
    swatch = lambda n: tag("svg", _stroke([(-12, 0), (12, 0)], n), _mark(0, 0, n), **_SWATCH)
    return tag("ul", *(tag("li", swatch(n), f" {x}") for n, x in enumerate(names)), class_="key")


def panels(
    shown: Sequence[Panel], names: Sequence[str], labels: Sequence[str], x_title: str, y_title: str
) -> Html:
    """Return frames side by side with one scale.

    Args:
        shown: the frames.
        names: of all curves, in the order of colours.
        labels: of the axis, one a place; numbers stand at their distances.
        x_title: what runs along the axis.
        y_title: what is measured.
    """
    drawn = [curves for panel in shown for curves in (panel.curves, panel.others)]
    points = [p for curves in drawn for curve in curves.values() for p in curve]
    known = [p for p in points if math.isfinite(p.mean)]
    reach = lambda p: p.reach if math.isfinite(p.reach) else 0.0
    low = min((p.mean - reach(p) for p in known), default=0.0)
    high = max((p.mean + reach(p) for p in known), default=1.0)
    ticks = steps(low, high)
    places, numeric = _places(labels)
    frame = lambda panel: _frame(panel, names, ticks, places, labels, x_title, y_title, numeric)
    return tag("div", *(frame(panel) for panel in shown), class_="panels")


def steps(low: float, high: float) -> list[float]:
    """Return round numbers that span an interval, some four of them.

    Example:
        >>> steps(0.13, 0.71)
        [0.0, 0.2, 0.4, 0.6, 0.8]
    """
    if not high > low:
        low, high = low - (abs(low) or 1.0) / 2, high + (abs(high) or 1.0) / 2
    rough = (high - low) / 4
    power = 10.0 ** math.floor(math.log10(rough))
    step = min((1, 2, 5, 10), key=lambda m: abs(math.log(m * power / rough))) * power
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return [float(f"{n * step:.10g}") for n in range(first, last + 1)]


def _places(labels: Sequence[str]) -> tuple[list[float], bool]:
    """Return where labels stand, from 0 to 1, and whether they are numbers."""
    count = len(labels)
    try:
        values = [float(label) for label in labels]
    except ValueError:
        return [(n + 0.5) / count for n in range(count)], False
    if not all(map(math.isfinite, values)) or count == 1:
        return [(n + 0.5) / count for n in range(count)], count == 1
    if min(values) > 0 and max(values) / min(values) >= _LOG_FROM:
        values = [math.log(value) for value in values]
    low, high = min(values), max(values)
    return [0.04 + 0.92 * (value - low) / (high - low) for value in values], True


def _frame(
    panel: Panel,
    names: Sequence[str],
    ticks: Sequence[float],
    places: Sequence[float],
    labels: Sequence[str],
    x_title: str,
    y_title: str,
    numeric: bool,
) -> Html:
    wide, high = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM
    x = lambda place: _LEFT + wide * place
    y = lambda value: _TOP + high * (1 - (value - ticks[0]) / (ticks[-1] - ticks[0]))
    parts, rows = [], 1
    for tick in ticks:
        parts.append(_line(_LEFT, y(tick), _WIDTH - _RIGHT, y(tick), class_="grid"))
        parts.append(_text(_LEFT - 5, y(tick) + 4, f"{tick:g}", "end"))
    last = -math.inf
    for place, label in sorted(zip(places, labels, strict=True)):
        parts.append(_line(x(place), _TOP + high, x(place), _TOP + high + 4, class_="axis"))
        lines = [label] if numeric else textwrap.wrap(label, max(int(wide / len(labels) / 6.4), 1))
        half = 3.2 * max(map(len, lines))
        if x(place) - half > last:  # labels that would overlap are left out
            for row, line in enumerate(lines):
                parts.append(_text(x(place), _TOP + high + 15 + 12 * row, line, "middle"))
            last = x(place) + half + (4 if numeric else 0)
        rows = max(rows, len(lines))
    deep = _HEIGHT + 12 * (rows - 1)
    parts.append(_line(_LEFT, _TOP + high, _WIDTH - _RIGHT, _TOP + high, class_="axis"))
    parts.append(_text(_LEFT + wide / 2, deep - 5, x_title, "middle"))
    parts.append(_text(_LEFT - 40, 13, panel.title, "start", font_weight="600"))
    told = []
    for name, curve in panel.curves.items():
        number = names.index(name)
        aside = 3.0 * (number - (len(names) - 1) / 2) if len(names) > 1 else 0.0
        known = [p for p in curve if math.isfinite(p.mean)]
        spots = [(x(places[p.at]) + aside, y(p.mean)) for p in known]
        for (left, _), p in zip(spots, known, strict=True):
            if math.isfinite(p.reach):
                ends = y(p.mean - p.reach), y(p.mean + p.reach)
                parts.append(_stroke([(left, ends[0]), (left, ends[1])], number))
        if numeric:
            parts.append(_stroke(sorted(spots), number))
        parts += [_mark(left, top, number) for left, top in spots]
        others = panel.others.get(name, ())
        parts += [_mark(x(places[p.at]) + aside, y(p.mean), number, hollow=True) for p in others]
        say = lambda points: ", ".join(f"{p.mean:.3g} at {labels[p.at]}" for p in points)
        told.append(f"{name}: {say(known) or 'nothing'}")
        if others:
            told.append(f"others of {name}: {say(others)}")
    title = f"{y_title} against {x_title}" + (f", {panel.title}" if panel.title else "")
    return tag(
        "svg",
        *parts,
        viewBox=f"0 0 {_WIDTH} {deep}",
        class_="curves",
        role="img",
        aria_label=f"{title}. {'; '.join(told)}.",
    )


_SWATCH = {"viewBox": "-14 -7 28 14", "aria_hidden": "true"}


def _line(x1: float, y1: float, x2: float, y2: float, class_: str) -> Html:
    return tag("path", d=f"M{x1:.1f} {y1:.1f}L{x2:.1f} {y2:.1f}", class_=class_, fill="none")


def _text(x: float, y: float, text: str, anchor: str, **more: str) -> Html:
    return tag("text", text, x=f"{x:.1f}", y=f"{y:.1f}", text_anchor=anchor, **more)


def _stroke(spots: Sequence[tuple[float, float]], number: int) -> Html | None:
    if len(spots) < 2:
        return None
    way = "L".join(f"{x:.1f} {y:.1f}" for x, y in spots)
    thin = {"fill": "none", "stroke": "currentColor", "stroke_width": "1.4"}
    return tag("path", d=f"M{way}", class_=f"c{number}", **thin)


def _mark(x: float, y: float, number: int, *, hollow: bool = False) -> Html:
    shape = _MARKS[number % len(_MARKS)]
    at = f"translate({x:.1f} {y:.1f})" + (" scale(1.4)" if hollow else "")
    ink = {"fill": "none", "stroke": "currentColor"} if hollow else {"fill": "currentColor"}
    return tag("path", d=shape, transform=at, class_=f"c{number}", **ink)
