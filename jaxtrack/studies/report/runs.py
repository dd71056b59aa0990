"""How many runs do I need: from the spread that the trials so far have, and how fast they ran.

The mean of n independent trials of standard deviation σ has the standard error σ / √n, so

    n = (σ / wanted)²      for a standard error,
    n = (2 σ_d / d)²       for a paired difference d (spread σ_d) to be two of its errors off zero.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxtrack.studies import chunks
from jaxtrack.studies.design import Design
from jaxtrack.studies.report import html_page
from jaxtrack.studies.report.html_page import Html, joined, tag
from jaxtrack.studies.tables import duration, number, plus_minus

_HEADS = ("method", "cell", "mean", "spread of\none trial", "for 10 % of\nthe mean", "1 % of\nit")


class Known(NamedTuple):
    """A mean over the trials so far."""

    method: str
    cell: str  # its fields, in words
    mean: float
    error: float  # standard
    spread: float  # standard deviation of one trial


def runs(
    design: Design, rows: Sequence[Mapping[str, Any]], trials: int, rate: float | None
) -> Html:
    """Return the section: for each metric, and for each paired difference."""
    parts = [
        tag(
            "p",
            f"A standard error falls with the square root of the trials: the {trials} so far halve "
            f"theirs at {_count(4 * trials)}, and have a tenth of it at {_count(100 * trials)}. "
            "What follows is reckoned from the spread that these trials have; any other standard "
            "error e needs (spread / e)² trials.",
        )
    ]
    for place, metric in enumerate(design.metrics):
        known = _means(design, rows, metric.name, trials)
        wanted, whose = _wanted(design, metric.name, known)
        table = html_page.table(
            f"runs-{place}",
            f"{metric.name}: trials for a standard error, in the cell known least; "
            f"{wanted:g} is {whose}",
            [*_HEADS, f"for\n{wanted:g}", "time\nfor it"],
            [_line(one, wanted, rate) for one in known],
            fields=2,
        )
        parts += [tag("h3", metric.name), table]
        apart = _differences(design, rows, metric.name, trials)
        if apart:
            shown = html_page.table(
                f"apart-{place}",
                f"{metric.name}: trials until the paired difference from {design.methods[0].name} "
                "is two of its standard errors from zero",
                ["method", "cell", "difference", "errors\nfrom zero", "trials", "time\nfor them"],
                [_apart(one, trials, rate) for one in apart],
                fields=2,
            )
            parts.append(html_page.folded("Trials for paired differences", shown, len(apart)))
    words = "A difference that is within its error says little of how many trials it needs."
    return joined([*parts, tag("p", words, class_="soft")])


def _wanted(design: Design, metric: str, known: Sequence[Known]) -> tuple[float, str]:
    """Return the standard error that the study asks for, or half of what it has, and whose."""
    if design.until is not None and design.until.metric == metric:
        return design.until.se, "what the study asks for"
    errors = [one.error for one in known if math.isfinite(one.error) and one.error > 0]
    if not errors:
        return 0.01, "an example"
    return float(f"{max(errors) / 2:.2g}"), "half of the largest so far"


def _line(one: Known, wanted: float, rate: float | None) -> list[str]:
    shares = [_count(trials_for(one.spread, share * abs(one.mean))) for share in (0.1, 0.01)]
    last = trials_for(one.spread, wanted)
    known = [one.method, one.cell, plus_minus(one.mean, one.error), number(one.spread)]
    return [*known, *shares, _count(last), _time(last, rate)]


def _apart(one: Known, trials: int, rate: float | None) -> list[str]:
    away = abs(one.mean) / one.error if one.error > 0 else math.nan
    want = trials_for(one.spread, abs(one.mean) / 2)
    enough = "enough" if want <= trials else _count(want)
    time = "" if want <= trials else _time(want, rate)
    return [one.method, one.cell, plus_minus(one.mean, one.error), number(away), enough, time]


def _count(trials: float) -> str:
    return f"{trials:,.0f}".replace(",", "\N{NO-BREAK SPACE}") if math.isfinite(trials) else "–"


def _time(trials: float, rate: float | None) -> str:
    if rate is None or not math.isfinite(trials):
        return "–"
    return duration(trials / rate)


def rate_of(store: chunks.Chunks) -> float | None:
    """Return the trials a second while chunks came one after the other, by their records' times.

    None where times cannot tell: of fewer than two chunks, or of files copied without their times.
    """
    times = sorted(chunks.commit_times(store).values())
    gaps = np.diff(times)
    if not gaps.size:
        return None
    # The nights between two sessions are no computing.
    gaps = gaps[gaps <= 10 * np.quantile(gaps, 0.75, method="lower")]
    seconds = float(gaps.sum())
    return gaps.size * store.chunk / seconds if seconds > 1e-3 * gaps.size else None


def _means(
    design: Design, rows: Sequence[Mapping[str, Any]], metric: str, trials: int
) -> list[Known]:
    """Return each method's mean in the cell where the metric is known least.

    Args:
        design: of the study.
        rows: of `summary.rows`.
        metric: which.
        trials: so far.
    """
    of = lambda name: [_known(row, metric, trials) for row in rows if row["method"] == name]
    certain = lambda one: one.error if math.isfinite(one.error) else math.inf
    return [max(of(method.name), key=certain) for method in design.methods]


def _differences(
    design: Design, rows: Sequence[Mapping[str, Any]], metric: str, trials: int
) -> list[Known]:
    """Return the paired differences from the first method, in every cell that has one."""
    head = f"{metric} - {design.methods[0].name}"
    return [_known(row, head, trials) for row in rows if head in row]


def trials_for(spread: float, wanted: float) -> float:
    """Return how many trials a standard error needs; NaN where the trials so far cannot tell.

    Example:
        >>> trials_for(2.0, 0.5)
        16
        >>> trials_for(0.0, 0.5)  # all the same so far
        nan
    """
    if not (math.isfinite(spread) and spread > 0 and wanted > 0):
        return math.nan
    return max(math.ceil((spread / wanted) ** 2 * (1 - 1e-9)), 1)


def _known(row: Mapping[str, Any], head: str, trials: int) -> Known:
    mean, error = row[head]
    fields = {k: v for k, v in row.items() if k != "method" and not isinstance(v, tuple)}
    cell = ", ".join(f"{name} {value}" for name, value in fields.items())
    return Known(row["method"], cell, mean, error, error * math.sqrt(trials))
