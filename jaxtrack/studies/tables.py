"""Tables of results beside what a paper says, and verdicts on marks that were fixed beforehand.

A figure fails when its whole 95 % interval lies on the wrong side of its mark. Below twenty trials
there is no verdict: such a run only shows that everything works ("smoke").
"""

import math
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from rich.table import Table

from jaxtrack.montecarlo import interval_of_mean, proportion_interval

SMOKE_BELOW = 20
PASS, FAILS, SMOKE, NONE = "pass", "fails", "smoke", ""
_COLOURS = {PASS: "green", FAILS: "bold red", SMOKE: "yellow", NONE: ""}


class Figure(NamedTuple):
    """A number with its 95 % interval and the trials behind it."""

    value: float
    lower: float
    upper: float
    trials: int
    unit: str = ""


class Mark(NamedTuple):
    """What a figure has to reach, fixed before it was seen."""

    bound: float
    at_least: bool = True  # False: at most


class Row(NamedTuple):
    """One line of a table of marks."""

    what: str
    ours: Figure
    paper: str = ""  # the paper's words or number
    mark: Mark | None = None


def rate(successes: Any, trials: int) -> Figure:
    """Return a share of trials with Wilson's interval.

    Example:
        >>> rate(90, 100).lower < 0.9 < rate(90, 100).upper
        True
    """
    interval = proportion_interval(successes, trials)
    return Figure(successes / trials, float(interval.lower), float(interval.upper), trials)


def mean(value: float, standard_error: float, trials: int, unit: str = "") -> Figure:
    """Return a mean over trials with its normal interval."""
    interval = interval_of_mean(value, standard_error)
    return Figure(value, float(interval.lower), float(interval.upper), trials, unit)


def standard_error(values: np.ndarray) -> float:
    """Return that of the mean of independent values; infinite of fewer than two.

    Example:
        >>> standard_error(np.array([1.0, 3.0])), standard_error(np.array([1.0]))
        (1.0, inf)
    """
    return float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else np.inf


def mean_of(values: np.ndarray, unit: str = "") -> Figure:
    """Return the mean of independent values with its normal interval.

    Example:
        >>> mean_of(np.array([1.0, 3.0])).value
        2.0
    """
    return mean(float(values.mean()), standard_error(values), len(values), unit)


def root_mean_square(
    squares: np.ndarray, counts: np.ndarray, trials: int, unit: str = ""
) -> Figure:
    """Return sqrt(Σ squares / Σ counts) with the interval of the ratio, trials being independent.

    Args:
        squares: [trials] sum of a trial's squared errors.
        counts: [trials] how many errors it had.
        trials: how many.
        unit: of the root.

    Example:
        >>> root_mean_square(np.array([4.0, 4.0]), np.array([1, 1]), 2).value
        2.0
    """
    total = counts.sum()
    if total == 0:
        return Figure(np.nan, np.nan, np.nan, trials, unit)
    square = squares.sum() / total
    error = np.sqrt(((squares - square * counts) ** 2).sum()) / total
    lower, upper = interval_of_mean(square, error)
    return Figure(
        float(np.sqrt(square)), float(np.sqrt(max(lower, 0.0))), float(np.sqrt(upper)), trials, unit
    )


def quotient(ours: np.ndarray, theirs: np.ndarray) -> Figure:
    """Return Σ ours / Σ theirs over the same trials, with the interval of the paired ratio.

    Example:
        >>> quotient(np.array([2.0, 4.0]), np.array([1.0, 2.0])).value
        2.0
    """
    total = theirs.sum()
    if len(ours) == 0 or total == 0:
        return Figure(np.nan, np.nan, np.nan, len(ours))
    ratio = ours.sum() / total
    error = np.sqrt(((ours - ratio * theirs) ** 2).sum()) / total
    lower, upper = interval_of_mean(ratio, error)
    return Figure(float(ratio), float(lower), float(upper), len(ours))


def verdict(figure: Figure, mark: Mark | None) -> str:
    """Return "pass", "fails", "smoke" (too few trials to say), or "" without a mark.

    Example:
        >>> verdict(rate(90, 100), Mark(0.93)), verdict(rate(80, 100), Mark(0.93))
        ('pass', 'fails')
    """
    if mark is None:
        return NONE
    if figure.trials < SMOKE_BELOW:
        return SMOKE
    reached = figure.upper >= mark.bound if mark.at_least else figure.lower <= mark.bound
    return PASS if reached else FAILS  # NaN reaches nothing


def marks_table(title: str, rows: Sequence[Row]) -> Table:
    """Return a table of ours, the paper's words, the mark and the verdict."""
    table = Table(title=title, title_justify="left")
    for heading in ("", "ours", "95 %", "trials", "paper", "mark", "verdict"):
        side = "left" if heading in ("", "paper") else "right"
        table.add_column(heading, justify=side, overflow="fold")
    for row in rows:
        word = verdict(row.ours, row.mark)
        table.add_row(
            row.what,
            number(row.ours.value, row.ours.unit),
            f"{number(row.ours.lower)} … {number(row.ours.upper)}",
            str(row.ours.trials),
            row.paper,
            "" if row.mark is None else f"{'≥' if row.mark.at_least else '≤'} {row.mark.bound:g}",
            f"[{_COLOURS[word]}]{word}[/]" if word else "",
        )
    return table


def failed_table(title: str, rows: Sequence[Row]) -> Table | str:
    """Return a table of the marks that are not reached; its title, alone if none, counts them."""
    words = [verdict(row.ours, row.mark) for row in rows]
    marked = [word for word in words if word != NONE]
    title = f"{title}: {marked.count(PASS)} of {len(marked)} pass"
    if SMOKE in marked:
        title += f", {marked.count(SMOKE)} smoke (too few trials to say)"
    failed = [row for row, word in zip(rows, words, strict=True) if word == FAILS]
    return marks_table(f"{title}; what does not:", failed) if failed else f"{title}."


def entry(row: Row) -> dict[str, Any]:
    """Return a row as JSON can hold it, with its verdict."""
    result = {"what": row.what, **row.ours._asdict(), "paper": row.paper}
    if row.mark is not None:
        result[">=" if row.mark.at_least else "<="] = row.mark.bound
    return {**result, "verdict": verdict(row.ours, row.mark)}


def grid_table(
    title: str,
    rows: Sequence[str],
    columns: Sequence[str],
    cells: Sequence[Sequence[str]],
    *,
    trials: int,
) -> Table:
    """Return a plain table of prepared cells [rows][columns], its trials in the title.

    Example:
        >>> grid_table("Found", ["HT"], ["I"], [["1"]], trials=4).title
        'Found, 4 trials: smoke'
    """
    title = f"{title}, {trials} trials" + (f": {SMOKE}" if trials < SMOKE_BELOW else "")
    table = Table(title=title, title_justify="left")
    table.add_column("", overflow="fold")
    for column in columns:
        table.add_column(column, justify="right", overflow="fold")
    for name, line in zip(rows, cells, strict=True):
        table.add_row(name, *line)
    return table


def beneath(
    heads: Sequence[str], rows: Sequence[Sequence[str]], *, fields: int, width: int | None
) -> list[Table]:
    """Return a table without frames; columns that do not fit go into further ones, with the fields.

    Args:
        heads: of the columns, fields first.
        rows: cells.
        fields: how many columns name a row; they stand in every table.
        width: of a line; None: as wide as it gets.

    Example:
        >>> rows = [["joint", "1.25 ± .03", "2.50 ± .04"]]
        >>> tables = beneath(["method", "error_m", "false"], rows, fields=1, width=20)
        >>> [[str(column.header) for column in table.columns] for table in tables]
        [['method', 'error_m'], ['method', 'false']]
    """
    gap = 2
    sizes = [max(map(len, column)) + gap for column in zip(heads, *rows, strict=True)]
    parts: list[list[int]] = [[]]
    for column in range(fields, len(heads)):
        wanted = sum(sizes[n] for n in (*range(fields), *parts[-1], column)) - gap
        if parts[-1] and width is not None and wanted > width:
            parts.append([])
        parts[-1].append(column)
    tables = []
    for part in parts:
        table = Table(box=None, pad_edge=False)
        chosen = (*range(fields), *part)
        for column in chosen:
            least = None if width is not None else sizes[column] - gap
            side = "right" if column else "left"
            table.add_column(heads[column], justify=side, overflow="fold", min_width=least)
        for row in rows:
            if any(row[column] for column in part):
                table.add_row(*(row[column] for column in chosen))
        tables.append(table)
    return tables


def number(value: float, unit: str = "") -> str:
    """Return a number in three digits, in two if it is tiny, a dash where there is none.

    Example:
        >>> number(0.9754), number(float("nan")), number(7.84, "m"), number(0.000028)
        ('.975', '–', '7.84 m', '2.8e-05')
    """
    if not np.isfinite(value):
        return "–"
    small = 0 < abs(value) < 5e-4
    form = ".2g" if small else ".3f" if abs(value) < 1 else ".3g" if abs(value) < 1000 else ".0f"
    text = f"{value:{form}}"
    if text.startswith(("0.", "-0.")) and abs(value) < 1:
        text = text.replace("0.", ".", 1)
    if unit == "rad":
        text = f"{value:.4f}"
    return f"{text} {unit}".strip()


def plus_minus(value: float, error: float) -> str:
    """Return a mean with its standard error, in three digits, or down to the error's first one.

    Example:
        >>> plus_minus(1.25, 0.031), plus_minus(0.20814, 0.00012), plus_minus(1000.24, 0.31)
        ('1.25 ± .031', '.2081 ± .0001', '1000.2 ± .3')
    """
    shown = number(value), number(error)
    if not (np.isfinite(value) and error > 0 and np.isfinite(error)):
        return " ± ".join(shown)
    places = -math.floor(math.log10(error))
    if places > 3 or (abs(value) >= 10 ** (3 - places) and places > 0):
        shown = (f"{x:.{places}f}" for x in (value, error))
        shown = (re.sub(r"^(-?)0\.", r"\1.", x) for x in shown)
    return " ± ".join(shown)


def duration(seconds: float) -> str:
    """Return seconds in words, days at most.

    Example:
        >>> duration(5000.0)
        '83 minutes'
    """
    for least, unit, name in (
        (48 * 3600, 86400, "days"),
        (7200, 3600, "hours"),
        (120, 60, "minutes"),
    ):
        if seconds >= least:
            return f"{seconds / unit:.0f} {name}"
    return f"{seconds:.0f} s"
