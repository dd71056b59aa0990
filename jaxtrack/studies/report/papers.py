"""The report of the papers' studies: one HTML page of all that a folder of results holds."""

import json
import pathlib
import struct
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from jaxtrack.studies import shown
from jaxtrack.studies.registry import Study
from jaxtrack.studies.report import html_page
from jaxtrack.studies.report.html_page import Html, Section, joined, tag
from jaxtrack.studies.store import SUMMARY
from jaxtrack.studies.tables import FAILS, PASS, SMOKE, duration, number

FILE = "report.html"


class Found(NamedTuple):
    """A study's results in its folder."""

    study: Study
    folder: pathlib.Path
    about: Mapping[str, Any]  # of `shown.json`
    marks: Sequence[Mapping[str, Any]]  # of `summary.json`


def write_page(out: pathlib.Path, studies: Mapping[str, Study]) -> str:
    """Write OUT/report.html over the studies that have run there, and return its name and size.

    Raises:
        OSError: it cannot be written.
    """
    return html_page.write(out / FILE, page_of(found_in(out, studies)))


def found_in(out: pathlib.Path, studies: Mapping[str, Study]) -> list[Found]:
    """Return the studies that have left what they showed, in the order of the registry."""
    found = []
    for study in studies.values():
        about = shown.load(out / study.name)
        if about is None:
            continue
        try:
            summary = json.loads((out / study.name / SUMMARY).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            summary = {}
        found.append(Found(study, out / study.name, about, summary.get("marks", [])))
    return found


def page_of(found: Sequence[Found]) -> str:
    """Return the page."""
    overview = Section("overview", "Studies and marks", _overview(found))
    sections = [Section(one.study.name, one.study.name, _study(one)) for one in found]
    lead = tag(
        "p",
        "The papers' experiments, run again: ours beside what the paper says, and verdicts on "
        "marks that were fixed beforehand. A mark is missed when the whole 95 % interval lies on "
        "its wrong side; below twenty trials there is no verdict (smoke).",
    )
    return html_page.document("jaxtrack: results", lead, [overview, *sections])


def _overview(found: Sequence[Found]) -> Html:
    count = lambda one, word: str(sum(mark["verdict"] == word for mark in one.marks))
    rows = [
        (
            html_page.link(one.study.name, one.study.name),
            one.study.title,
            str(one.about["trials"]),
            _time(one.about),
            *(count(one, word) for word in (PASS, FAILS, SMOKE)),
            one.about["ended"],
        )
        for one in found
    ]
    heads = ("study", "what", "trials", "time", "reached", "missed", "smoke", "ended")
    parts = [html_page.table("studies", "Studies in this folder", heads, rows, left=(1,))]
    for word, title in ((FAILS, "Marks missed"), (PASS, "Marks reached")):
        lines = [_mark(one, mark) for one in found for mark in one.marks if mark["verdict"] == word]
        if not lines:
            parts.append(tag("p", f"{title}: none."))
            continue
        heads = ("mark", "study", "ours", "95 %", "wanted", "paper")
        title = f"{title}: {len(lines)}"
        listed = html_page.table(f"marks-{word}", title, heads, lines, left=(1, 5))
        parts.append(listed if word == FAILS else html_page.details(title, listed))
    return joined(parts)


def _mark(one: Found, mark: Mapping[str, Any]) -> tuple[str, ...]:
    unit = mark.get("unit", "")
    told = lambda name: number(float("nan") if mark[name] is None else mark[name], unit)
    way = next(sign for sign in (">=", "<=") if sign in mark)
    return (
        html_page.link(_place(one, mark["what"]), mark["what"]),
        one.study.name,
        told("value"),
        f"{told('lower')} … {told('upper')}",
        f"{'≥' if way == '>=' else '≤'} {mark[way]:g}",
        mark["paper"],
    )


def _place(one: Found, what: str) -> str:
    """Return where a mark stands: its row, or its study where no table has it."""
    for name, table in _tables(one):
        for place, row in enumerate(table["rows"]):
            if row[0] == what and row[-1] in (PASS, FAILS, SMOKE):
                return f"{name}-{place}"
    return one.study.name


def _tables(one: Found) -> Iterator[tuple[str, Mapping[str, Any]]]:
    for place, thing in enumerate(one.about["shown"], start=1):
        if not isinstance(thing, str):
            yield f"{one.study.name}-table-{place}", thing


def _study(one: Found) -> Html:
    about, name = one.about, one.study.name
    facts = html_page.facts(
        {
            "source": one.study.source,
            "trials": f"{about['trials']} a cell; in full {one.study.trials_full}",
            "seed": str(about["seed"]),
            "time": f"{_time(about)}, compilation included; ended {about['ended']}",
            "versions": about["versions"],
            "devices": about["devices"],
            "to run it again": about["command"],
            "numbers": f"{one.folder}/results.zarr and {one.folder}/{SUMMARY}",
        }
    )
    parts: list[str] = [tag("p", one.study.title), facts, tag("h3", "Tables")]
    tables = dict(_tables(one))
    for place, thing in enumerate(about["shown"], start=1):
        if isinstance(thing, str):
            parts.append(tag("p", thing))
            continue
        at = f"{name}-table-{place}"
        table = tables[at]
        title = table["title"] or f"Table {place}"
        parts.append(html_page.table(at, title, table["heads"], table["rows"], left=table["left"]))
    files = sorted(one.folder.glob("*.png"))
    if files:
        parts += [tag("h3", "Figures"), tag("div", *map(_picture, files), class_="gallery")]
    return joined(parts)


def _time(about: Mapping[str, Any]) -> str:
    """Return how long a run took; of one that was resumed only the last session is known."""
    rest = " since it was resumed" if about.get("resumed") else ""
    return f"{duration(about['seconds'])}{rest}"


def _picture(file: pathlib.Path) -> Html:
    png = file.read_bytes()
    words = texts_in(png)
    plain = file.stem.replace("_", " ")
    title = words.get("Title", plain)
    return html_page.picture(png, words.get("Description", plain), f"{title} ({file.name})")


def texts_in(png: bytes) -> dict[str, str]:
    """Return the texts that a PNG carries: its title, its description.

    Example:
        >>> body = b"Title" + bytes([0]) + b"Votes"
        >>> chunk = len(body).to_bytes(4, "big") + b"tEXt" + body + bytes(4)
        >>> texts_in(bytes(8) + chunk)
        {'Title': 'Votes'}
    """
    found, at = {}, 8
    while at + 8 <= len(png):
        size, kind = struct.unpack(">I4s", png[at : at + 8])
        key, _, rest = png[at + 8 : at + 8 + size].partition(b"\0")
        if kind == b"tEXt":
            found[key.decode("latin-1")] = rest.decode("latin-1")
        elif kind == b"iTXt" and rest[:1] == b"\0":  # not compressed
            found[key.decode("latin-1")] = rest[2:].split(b"\0", 2)[2].decode("utf-8")
        at += size + 12
    return found
