"""The report of a study from a file: one HTML page that can be put on a desk."""

import collections
import datetime
import pathlib
import shlex
from collections.abc import Mapping, Sequence
from typing import Any

from jaxtrack.studies import chunks, summary
from jaxtrack.studies.design import Design, Part
from jaxtrack.studies.report import atlas, html_page
from jaxtrack.studies.report import compared as report_compared
from jaxtrack.studies.report import figures as report_figures
from jaxtrack.studies.report import runs as report_runs
from jaxtrack.studies.report.html_page import Html, Section, joined, tag
from jaxtrack.studies.run import Outcome
from jaxtrack.studies.study_file import StudyError
from jaxtrack.studies.tables import plus_minus

FILE = "report.html"


def write_report(outcome: Outcome, folder: pathlib.Path, out: pathlib.Path | None = None) -> str:
    """Write FOLDER/report.html, of a study that is not complete too.

    Args:
        outcome: where the study stands.
        folder: its.
        out: another folder for the page, where the study's cannot be written.

    Returns:
        The file's name and size.

    Raises:
        StudyError: it cannot be written.
    """
    file = (out or folder) / FILE
    try:
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
        return html_page.write(file, report_of(outcome, folder))
    except OSError as error:
        why = error.strerror or error
        raise StudyError(f"{file}: cannot be written: {why}; --out names another folder") from error


def report_of(outcome: Outcome, folder: pathlib.Path) -> str:
    """Return the page."""
    design, found = outcome.design, outcome.found
    sections, script = [], ""
    if found is not None:
        rows = list(summary.rows(design, found))
        sections.append(Section("results", "Results", _results(rows, found.trials)))
        others = compared(outcome)
        if others:
            body = report_compared.section(design, others)
            sections.append(Section("compared", "Beside other figures", body))
        figures = report_figures.figures(design, found)
        if figures:
            sections.append(Section("figures", "Figures", figures))
        maps = report_figures.maps(design, found)
        if maps:
            sections.append(Section("atlas", "Atlas", atlas.atlas(maps)))
            script = atlas.SCRIPT.read_text(encoding="utf-8")
        runs = report_runs.runs(design, rows, found.trials, report_runs.rate_of(outcome.store))
        sections.append(Section("runs", "How many runs do I need", runs))
    title = "The study's file"
    sections.append(Section("file", title, html_page.code(design.file.text.strip(), title)))
    sections.append(Section("made", "How it was made", _made(outcome)))
    sections.append(Section("again", "How to run it again", _again(outcome, folder)))
    title = f"Study {folder.resolve().name}"
    return html_page.document(title, _lead(outcome, folder), sections, script)


def compared(outcome: Outcome) -> dict[str, list[report_compared.Line]]:
    """Return the results beside what the study's file compares them with, by metric."""
    if outcome.found is None:
        return {}
    shares = [name for name, known in outcome.store.variables.items() if known.dtype == "bool"]
    return report_compared.compared(outcome.design, outcome.found, shares)


def table_of(rows: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[str]], int]:
    """Return the study's table: heads, the fields first, cells, and how many fields there are."""
    heads = list(dict.fromkeys(key for row in rows for key in row))
    first = lambda head: next(row[head] for row in rows if head in row)
    fields = [head for head in heads if not isinstance(first(head), tuple)]
    heads.sort(key=lambda head: head not in fields)
    return heads, [[_cell(row.get(head)) for head in heads] for row in rows], len(fields)


def spans(numbers: Sequence[int]) -> str:
    """Return rising numbers in words.

    Example:
        >>> spans([0, 1, 2, 5, 7, 8])
        '0 to 2, 5, 7 to 8'
    """
    known = set(numbers)
    starts = [n for n in numbers if n - 1 not in known]
    ends = [n for n in numbers if n + 1 not in known]
    pairs = zip(starts, ends, strict=True)
    return ", ".join(f"{a}" if a == b else f"{a} to {b}" for a, b in pairs)


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
    verdicts = report_compared.count(compared(outcome))
    if verdicts:
        more = html_page.link("compared", "beside other figures")
        parts.append(tag("p", f"{verdicts[0].upper()}{verdicts[1:]}: ", more, "."))
    if not outcome.complete:
        resume = tag("code", f"jaxtrack study resume {shlex.quote(str(folder))}")
        parts.append(tag("p", tag("strong", "Not complete."), " To go on: ", resume, class_="note"))
    if outcome.damaged:
        words = f"Damaged, computed again when resumed: chunk {spans(outcome.damaged)}."
        parts.append(tag("p", words, class_="note"))
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
    shown = html_page.table("table", caption, heads, cells, fields=fields)
    return joined(
        [words, html_page.folded("Means and paired differences", shown, len(cells), is_open=True)]
    )


def _made(outcome: Outcome) -> Html:
    design, store = outcome.design, outcome.store
    made, about = store.attributes.get("made_with", {}), store.attributes.get("about", {})
    devices = collections.Counter(about.get("devices", []))
    times = chunks.commit_times(store).values()
    rate = report_runs.rate_of(store)
    known = ("jaxtrack", "jax", "jaxlib", "numpy", "xarray", "zarr")
    versions = ", ".join(f"{name} {about[name]}" for name in known if name in about)
    return html_page.facts(
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
        f"pip install '.[studies]' {versions}    # in jaxtrack's source, {about.get('jaxtrack')}\n"
        f"{setting}jaxtrack study run {shlex.quote(name)} --out another_folder"
    )
    own = [part.where for part in _parts(outcome.design) if ":" in part.function]
    words = f"Save the study's file as {name}"
    if own:
        words += f", beside the modules of its own functions ({', '.join(own)}), which stood in "
        words += f"{store.attributes.get('folder')}"
    same = (
        "The results are the same bit for bit with these versions, this seed and micro-batch on a "
        "processor with the same instruction sets, whatever the number of devices."
    )
    return joined([tag("p", f"{words}."), html_page.code(commands, "Commands"), tag("p", same)])


def _parts(design: Design) -> tuple[Part, ...]:
    return (design.scene, *design.methods, *design.metrics)
