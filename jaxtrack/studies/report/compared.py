"""A study's results beside what its file compares them with, and whether what is wanted is reached.

A bound is missed when the whole 95 % interval lies on its wrong side; of a bound that is a variable
of the study, the interval is that of the paired difference. See `tables.verdict`.
"""

import math
import re
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

from jaxtrack.studies import summary
from jaxtrack.studies.comparisons import Comparison
from jaxtrack.studies.design import Design
from jaxtrack.studies.report import html_page
from jaxtrack.studies.report.html_page import Html, joined, tag
from jaxtrack.studies.tables import (
    FAILS,
    NONE,
    PASS,
    SMOKE,
    SMOKE_BELOW,
    Figure,
    Mark,
    mean,
    number,
    plus_minus,
    rate,
    verdict,
)

_SIGNS = {"at_least": "≥", "at_most": "≤"}


class Beside(NamedTuple):
    """A figure beside ours."""

    name: str  # of its column
    text: str
    verdict: str


class Line(NamedTuple):
    """A metric of a method in a cell, and all that stands beside it."""

    method: str
    fields: dict[str, Any]
    ours: tuple[float, float]  # mean and standard error
    interval: Figure
    beside: tuple[Beside, ...]


def compared(
    design: Design, found: summary.Moments, shares: Collection[str]
) -> dict[str, list[Line]]:
    """Return what is compared with something, by metric.

    Args:
        design: of the study.
        found: its moments.
        shares: variables that are true or false, whose intervals are those of shares.
    """
    errors = summary.standard_errors(found)
    lines: dict[str, list[Line]] = {}
    for metric in design.metrics:
        mine = [one for one in design.compare if metric.name in one.metrics]
        for cell in summary.cells(design) if mine else ():
            name = f"{cell.method}.{metric.name}"
            known = lambda variable, cell=cell: summary.known(found, errors, variable, cell)
            ours = known(name)
            interval = _interval(*ours, found.trials, share=name in shares)
            beside = []
            for one in mine:
                figure = one.at(cell.fields) if cell.method in one.methods else None
                if figure is not None:
                    against, text = interval, _text(figure)
                    if one.variable is not None:
                        against = mean(*known(summary.difference(name, figure)), found.trials)
                        figure, text = 0.0, plus_minus(*known(figure))
                    beside.append(_beside(one, figure, text, against))
            if beside:
                line = Line(cell.method, cell.fields, ours, interval, tuple(beside))
                lines.setdefault(metric.name, []).append(line)
    return lines


def _text(figure: Any) -> str:
    """Return a figure as it was printed, without a leading zero, as all tables have it."""
    return figure if isinstance(figure, str) else re.sub(r"^(-?)0\.", r"\1.", str(figure))


def _interval(value: float, error: float, trials: int, *, share: bool) -> Figure:
    if share:
        return rate(round(value * trials), trials)
    return mean(value, error if math.isfinite(error) else math.nan, trials)


def _beside(one: Comparison, figure: Any, text: str, against: Figure) -> Beside:
    if one.kind == "value":
        return Beside(one.name, text, NONE)
    word = verdict(against, Mark(figure, one.kind == "at_least"))
    return Beside(one.name, f"{_SIGNS[one.kind]} {text}", word)


def count(lines: Mapping[str, Sequence[Line]]) -> str:
    """Return in words how much of what is wanted is reached; nothing, if nothing is.

    Example:
        >>> count({})
        ''
    """
    words = [one.verdict for these in lines.values() for line in these for one in line.beside]
    told = {PASS: "reached", FAILS: "missed", SMOKE: f"open (fewer than {SMOKE_BELOW} trials)"}
    parts = [f"{words.count(word)} {name}" for word, name in told.items() if word in words]
    return f"of what is wanted: {', '.join(parts)}" if parts else ""


def section(design: Design, lines: Mapping[str, Sequence[Line]]) -> Html:
    """Return a table a metric, what is missed first."""
    parts = [
        tag(
            "p",
            "Ours beside what the study's file compares it with. What is wanted is missed (fails) "
            "when the whole 95 % interval lies on its wrong side; against another variable of the "
            "study, the interval is that of the difference on the same draws. Each cell is judged "
            "by itself: where the truth lies on the bound, one in forty is missed by chance.",
        )
    ]
    for place, (metric, these) in enumerate(lines.items()):
        missed = [line for line in these if any(one.verdict == FAILS for one in line.beside)]
        mine = [one for one in design.compare if metric in one.metrics]
        names = list(dict.fromkeys(one.name for one in mine))
        parts.append(tag("h3", metric))
        if 0 < len(missed) < len(these):
            parts.append(_table(f"missed-{place}", f"{metric}: missed", missed, names))
        whole = _table(f"compared-{place}", f"{metric}: ours and others", these, names)
        parts.append(html_page.folded(f"{metric}, ours and others", whole, len(these)))
        sources = dict.fromkeys(f"{one.name}: {one.source}" for one in mine if one.source)
        told = "; ".join(sources)
        parts.append(tag("p", told or None, class_="soft"))
    return joined(parts)


def _table(name: str, caption: str, lines: Sequence[Line], names: Sequence[str]) -> Html:
    fields = list(dict.fromkeys(field for line in lines for field in line.fields))
    judged = {one.name for line in lines for one in line.beside if one.verdict}
    heads = ["method", *fields, "ours", "95 %"]
    for other in names:
        heads += [other, "verdict"] if other in judged else [other]
    rows = []
    for line in lines:
        row = [line.method, *(str(line.fields.get(field, "")) for field in fields)]
        row.append(plus_minus(*line.ours))
        row.append(f"{number(line.interval.lower)} … {number(line.interval.upper)}")
        for other in names:
            mine = [one for one in line.beside if one.name == other]
            row.append("\n".join(one.text for one in mine))
            if other in judged:
                row.append("\n".join(one.verdict for one in mine if one.verdict))
        rows.append(row)
    return html_page.table(name, caption, heads, rows, fields=1 + len(fields))
