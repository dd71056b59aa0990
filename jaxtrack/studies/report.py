"""The report of a study from a file: one HTML page that can be put on a desk."""

import collections
import datetime
import itertools
import math
import pathlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxtrack.studies import chunks, needed, page, page_atlas, summary
from jaxtrack.studies.design import Design, Part, axes_of
from jaxtrack.studies.needed import Known, trials_for
from jaxtrack.studies.page import Html, Section, joined, tag
from jaxtrack.studies.page_curves import MOST_CURVES, Panel, Point, key, panels
from jaxtrack.studies.run import Outcome
from jaxtrack.studies.tables import duration, number, plus_minus

FILE = "report.html"
_MOST_PANELS = 12
_REACH = 2.0  # standard errors that error bars show to either side
_OPEN_ROWS = 40  # tables of more rows are opened by a click


def write_report(outcome: Outcome, folder: pathlib.Path) -> str:
    """Write FOLDER/report.html, of a study that is not complete too.

    Args:
        outcome: where the study stands.
        folder: its.

    Returns:
        The file's name and size.

    Raises:
        OSError: it cannot be written.
    """
    return page.write(folder / FILE, report_of(outcome, folder))


def report_of(outcome: Outcome, folder: pathlib.Path) -> str:
    """Return the page."""
    design, found = outcome.design, outcome.found
    sections, script = [], ""
    if found is not None:
        rows = list(summary.rows(design, found))
        sections.append(Section("results", "Results", _results(rows, found.trials)))
        figures = _figures(design, found)
        if figures:
            sections.append(Section("figures", "Figures", figures))
        maps = _maps(design, found)
        if maps:
            sections.append(Section("atlas", "Atlas", page_atlas.atlas(maps)))
            script += page_atlas.SCRIPT.read_text(encoding="utf-8")
        runs = _runs(design, rows, found.trials, rate_of(outcome.store))
        sections.append(Section("runs", "How many runs do I need", runs))
        script += pathlib.Path(__file__).with_name("page_runs.js").read_text(encoding="utf-8")
    sections.append(Section("file", "The study's file", page.code(design.text, "The study's file")))
    sections.append(Section("made", "How it was made", _made(outcome)))
    sections.append(Section("again", "How to run it again", _again(outcome, folder)))
    return page.document(f"Study {folder.resolve().name}", _lead(outcome, folder), sections, script)


def table_of(rows: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[str]], int]:
    """Return the study's table: heads, the fields first, cells, and how many fields there are."""
    heads = list(dict.fromkeys(key for row in rows for key in row))
    first = lambda head: next(row[head] for row in rows if head in row)
    fields = [head for head in heads if not isinstance(first(head), tuple)]
    heads.sort(key=lambda head: head not in fields)
    return heads, [[_cell(row.get(head)) for head in heads] for row in rows], len(fields)


def _cell(value: Any) -> str:
    if value is None:
        return ""
    return plus_minus(*value) if isinstance(value, tuple) else str(value)


def _lead(outcome: Outcome, folder: pathlib.Path) -> Html:
    design, found = outcome.design, outcome.found
    trials = 0 if found is None else found.trials
    rule = ""
    if design.until is not None:
        rule = f", or until the standard errors of {design.until.metric} are {design.until.se:g}"
    parts = [tag("p", f"{trials} of {design.trials} trials{rule}, seed {design.seed}.")]
    if not outcome.complete:
        resume = tag("code", f"jaxtrack study resume {folder}")
        parts.append(
            tag("p", tag("strong", "Not complete."), " To go on: ", resume, class_="note")
        )
    if outcome.damaged:
        numbers = ", ".join(map(str, outcome.damaged))
        parts.append(
            tag("p", f"Damaged, computed again when resumed: chunk {numbers}.", class_="note")
        )
    return joined(parts)


def _results(rows: Sequence[Mapping[str, Any]], trials: int) -> Html:
    heads, cells, fields = table_of(rows)
    caption = f"Means over {trials} trials ± standard errors"
    words = None
    if any(" - " in head for head in heads[fields:]):
        words = tag(
            "p",
            "A column with a minus is a paired difference: what the method has more than the first "
            "one, on the same draws. Its error is that of the pairs.",
        )
    shown = page.table("table", caption, heads, cells, fields=fields)
    return joined([words, _folded(shown, len(cells))])


def _folded(table: Html, rows: int) -> Html:
    return table if rows <= _OPEN_ROWS else page.details(f"Table of {rows} rows", table)


def _figures(design: Design, found: summary.Moments) -> Html | None:
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
    left_out = len(frames) - len(chosen)
    for method in methods[:MOST_CURVES]:
        own = {f"{method.name}.{k}": v for k, v in method.grid.items()}
        cells = _cells({k: v for k, v in own.items() if k != field})
        left_out += len(cells) - len(_some(cells, each))
        for words, at in _some(cells, each):
            name = ", ".join(filter(None, [method.name, words.replace(f"{method.name}.", "")]))
            curves[name] = f"{method.name}.{metric}", at
    shown = []
    for title, here in chosen:
        drawn = {}
        for name, (variable, own) in curves.items():
            mean, error = (data[variable].isel(here | own) for data in (found.mean, errors))
            spots = range(len(values))
            take = lambda data, n: float(data.isel({field: n}) if field in data.dims else data)
            drawn[name] = [Point(n, take(mean, n), _REACH * take(error, n)) for n in spots]
        shown.append(Panel(title, drawn))
    caption = f"{metric} over {field}. Bars reach {_REACH:.0f} standard errors to either side."
    if left_out:
        caption += " Some cells are left out here; the table has all."
    labels = [str(value) for value in values]
    return tag(
        "figure",
        key(list(curves)),
        panels(shown, list(curves), labels, field, metric),
        tag("figcaption", caption),
    )


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


def _maps(design: Design, found: summary.Moments) -> list[page_atlas.Map]:
    errors = summary.standard_errors(found)
    first, *others = design.methods
    labels = {k: v for method in design.methods for k, v in axes_of(design, method).items()}
    variables = [(method.name, method.name, False) for method in design.methods]
    variables += [(f"{o.name} − {first.name}", f"{o.name} - {first.name}", True) for o in others]
    maps = []
    for metric in design.metrics:
        for what, name, signed in variables:
            mean = found.mean[f"{name}.{metric.name}"]
            if mean.ndim < 2:
                continue
            error = errors[f"{name}.{metric.name}"]
            flat = zip(mean.values.ravel(), error.values.ravel(), strict=True)
            text = np.array([plus_minus(float(m), float(e)) for m, e in flat]).reshape(mean.shape)
            axes = {str(dim): [str(value) for value in labels[str(dim)]] for dim in mean.dims}
            maps.append(page_atlas.Map(metric.name, what, axes, mean.values, text, signed))
    return maps


def _runs(
    design: Design, rows: Sequence[Mapping[str, Any]], trials: int, rate: float | None
) -> Html:
    parts = [
        tag(
            "p",
            f"A standard error falls with the square root of the trials: the {trials} so far halve "
            f"theirs at {_count(4 * trials)}, and have a tenth of it at {_count(100 * trials)}. "
            "What follows is reckoned from the spread that these trials have.",
        )
    ]
    for metric in design.metrics:
        known = needed.means(design, rows, metric.name, trials)
        wanted = _wanted(design, metric.name, known)
        lines = [_line(one, wanted, rate) for one in known]
        name = page.slug("runs", metric.name)
        table = page.table(
            name,
            f"{metric.name}: trials for a standard error, in the cell known least",
            ["method", "cell", "mean", "spread of one trial", "10 % of the mean", "1 % of the mean"]
            + ["the wanted", "time for it"],
            lines,
            fields=2,
        )
        box = tag(
            "input",
            type="number",
            min="0",
            step="any",
            value=f"{wanted:.2g}",
            data_runs=name,
            data_rate=None if rate is None else f"{rate:.6g}",
            data_spreads=" ".join(f"{one.spread:.6g}" for one in known),
        )
        field = tag("label", f"Standard error of {metric.name} wanted", box)
        parts += [tag("h3", metric.name), tag("p", field, class_="controls"), table]
        apart = needed.differences(design, rows, metric.name, trials)
        if apart:
            shown = page.table(
                page.slug("apart", metric.name),
                f"{metric.name}: trials until the paired difference from {design.methods[0].name} "
                "is two of its standard errors from zero",
                ["method", "cell", "difference", "errors from zero", "trials", "time for them"],
                [_apart(one, trials, rate) for one in apart],
                fields=2,
            )
            parts.append(_folded(shown, len(apart)))
    words = "A difference that is within its error says little of how many trials it needs."
    return joined([*parts, tag("p", words, class_="soft")])


def _wanted(design: Design, metric: str, known: Sequence[Known]) -> float:
    """Return the standard error that the study asks for, or half of what it has."""
    if design.until is not None and design.until.metric == metric:
        return design.until.se
    errors = [one.error for one in known if math.isfinite(one.error) and one.error > 0]
    return max(errors) / 2 if errors else 0.01


def _line(one: Known, wanted: float, rate: float | None) -> list[str]:
    shares = [_count(trials_for(one.spread, share * abs(one.mean))) for share in (0.1, 0.01)]
    last = trials_for(one.spread, wanted)
    mean = plus_minus(one.mean, one.error)
    return [one.method, one.cell, mean, number(one.spread), *shares, _count(last), _time(last, rate)]


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
    gaps = gaps[gaps <= 10 * np.quantile(gaps, 0.75)]
    seconds = float(gaps.sum())
    return gaps.size * store.chunk / seconds if seconds > 1e-3 * gaps.size else None


def _made(outcome: Outcome) -> Html:
    design, store = outcome.design, outcome.store
    made, about = store.attributes.get("made_with", {}), store.attributes.get("about", {})
    devices = collections.Counter(about.get("devices", []))
    times = chunks.commit_times(store).values()
    rate = rate_of(store)
    known = ("jaxtrack", "jax", "jaxlib", "numpy", "xarray", "zarr")
    versions = ", ".join(f"{name} {about[name]}" for name in known if name in about)
    return page.facts(
        {
            "trials stored": f"{min(len(times) * design.chunk, design.trials)}, by {design.chunk}",
            "first stored": _when(min(times)) if times else None,
            "last stored": _when(max(times)) if times else None,
            "speed": None
            if rate is None
            else f"{rate:.3g} trials a second, each in all cells; from the times of the files",
            "seed": str(design.seed),
            "micro-batch": str(design.micro_batch),
            "numbers": made.get("dtype"),
            "devices": ", ".join(f"{count} × {kind}" for kind, count in devices.items()),
            "processor": f"{about.get('processor')}, {about.get('cores')} cores",
            "versions": f"{versions}, Python {about.get('python')}",
            "settings": ", ".join(f"{k} {v}" for k, v in made.get("settings", {}).items()),
            "flags of XLA": made.get("xla_flags"),
            "git": ", ".join(f"{f}: {rev}" for f, rev in about.get("git", {}).items() if rev),
        }
    )


def _when(seconds: float) -> str:
    return f"{datetime.datetime.fromtimestamp(seconds, datetime.UTC):%Y-%m-%d %H:%M:%S} UTC"


def _again(outcome: Outcome, folder: pathlib.Path) -> Html:
    store = outcome.store
    made, about = store.attributes.get("made_with", {}), store.attributes.get("about", {})
    setting = "JAX_ENABLE_X64=1 " if made.get("dtype") == "float64" else ""
    if made.get("xla_flags"):
        setting += f"XLA_FLAGS='{made['xla_flags']}' "
    versions = " ".join(f"{k}=={about[k]}" for k in ("jax", "jaxlib", "numpy") if k in about)
    name = f"{folder.resolve().name}.toml"
    commands = (
        f"pip install 'jaxtrack[studies]=={about.get('jaxtrack')}' {versions}\n"
        f"{setting}jaxtrack study run {name} --out another_folder"
    )
    own = [part.where for part in _parts(outcome.design) if ":" in _function(outcome.design, part)]
    words = f"Save the study's file as {name}"
    if own:
        words += f", beside the modules of its own functions ({', '.join(own)}), which stood in "
        words += f"{store.attributes.get('folder')}"
    same = (
        "The results are the same bit for bit with these versions, this seed and micro-batch on a "
        "processor with the same instruction sets, whatever the number of devices."
    )
    return joined([tag("p", f"{words}."), page.code(commands, "Commands"), tag("p", same)])


def _parts(design: Design) -> tuple[Part, ...]:
    return (design.scene, *design.methods, *design.metrics)


def _function(design: Design, part: Part) -> str:
    table = design.config
    for word in part.where.split("."):
        table = table[word]
    return table["function"]
