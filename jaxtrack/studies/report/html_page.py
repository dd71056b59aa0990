"""One HTML page that needs nothing else: no network, no file beside it.

`tag` escapes whatever is not `Html` already, so text of users can go everywhere.
"""

import base64
import datetime
import html
import importlib.metadata
import pathlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

_HERE = pathlib.Path(__file__)
_EMPTY = ("meta", "img", "input", "br")
# Nothing is loaded from anywhere, and browsers see to it.
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"


_OPEN_ROWS = 40
_WIDE = 12  # columns that paper only takes in small type


class Html(str):
    """Text that is HTML already."""


class Section(NamedTuple):
    """A part of a page, with a heading that others link to."""

    name: str  # in links
    title: str
    body: Html


def tag(name: str, /, *inside: str | None, **attributes: Any) -> Html:
    """Return an element.

    Args:
        name: of the element.
        inside: text, escaped, or HTML; None is left out.
        attributes: `class_` is class, `aria_label` aria-label; True stands alone, None and False
            are left out.

    Example:
        >>> tag("p", "a < b", tag("br"), class_="note", hidden=True, id=None)
        '<p class="note" hidden>a &lt; b<br></p>'
    """
    parts = [name]
    for key, value in attributes.items():
        key = key.rstrip("_").replace("_", "-")
        if value is True:
            parts.append(key)
        elif value is not None and value is not False:
            parts.append(f'{key}="{html.escape(str(value))}"')
    opened = f"<{' '.join(parts)}>"
    return Html(opened if name in _EMPTY else f"{opened}{joined(inside)}</{name}>")


def joined(parts: Iterable[str | None]) -> Html:
    """Return parts after each other, as `tag` takes them.

    Example:
        >>> joined(["a & b", None, tag("b", "c")])
        'a &amp; b<b>c</b>'
    """
    known = [part for part in parts if part is not None]
    return Html("".join(p if isinstance(p, Html) else html.escape(p, quote=False) for p in known))


def link(name: str, text: str) -> Html:
    """Return a link to a place of the same page."""
    return tag("a", text, href=f"#{name}")


def table(
    name: str,
    caption: str,
    heads: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    fields: int = 1,
    left: Sequence[int] = (),
) -> Html:
    """Return a table that scrolls inside its box where the page is narrow.

    Args:
        name: for links; those of rows are `name-0`, `name-1` …
        caption: says what it shows.
        heads: of the columns.
        rows: cells; lines in them are kept.
        fields: how many columns from the left name a row.
        left: further columns of words.

    Example:
        >>> '<th scope="row">joint</th>' in table("t", "Found", ["", "I"], [["joint", "3"]])
        True
    """
    side = lambda column: "words" if column < fields or column in left else None

    def cell(column: int, text: str) -> Html:
        verdict = f"verdict {text}" if text in ("pass", "fails", "smoke") else side(column)
        if column < fields and text:
            return tag("th", _lines(text), scope="row")
        return tag("td", _lines(text), class_=verdict)

    top = joined(
        tag("th", _lines(head), scope="col", class_=side(column)) if head else tag("td")
        for column, head in enumerate(heads)
    )
    body = joined(
        tag("tr", *(cell(column, text) for column, text in enumerate(row)), id=f"{name}-{number}")
        for number, row in enumerate(rows)
    )
    inner = tag(
        "table",
        tag("caption", tag("span", caption), id=f"{name}-caption"),
        tag("thead", tag("tr", top)),
        tag("tbody", body),
        id=name,
        class_="wide" if len(heads) >= _WIDE else None,
    )
    box = {"class_": "scroll", "role": "region", "tabindex": "0"}
    return tag("div", inner, aria_labelledby=f"{name}-caption", **box)


def facts(entries: Mapping[str, str | None]) -> Html:
    """Return names with their values; those without a value are left out."""
    known = [(name, value) for name, value in entries.items() if value]
    return tag("dl", *(tag("div", tag("dt", n), tag("dd", value)) for n, value in known))


def details(title: str, *inside: str) -> Html:
    """Return what is opened by its title; print shows it open."""
    return tag("details", tag("summary", title), *inside)


def folded(title: str, table: Html, rows: int, *, is_open: bool = False) -> Html:
    """Return a table; of many rows, it is opened or closed by a click and printed if open."""
    if rows <= _OPEN_ROWS:
        return table
    summary = tag("summary", f"{title}: {rows} rows (printed if open)")
    return tag("details", summary, table, class_="long", open=is_open)


def code(text: str, label: str) -> Html:
    """Return text as it is, in a box that scrolls."""
    return tag("pre", tag("code", text), tabindex="0", role="region", aria_label=label)


def picture(png: bytes, alt: str, caption: str) -> Html:
    """Return a PNG with what it shows in words."""
    source = f"data:image/png;base64,{base64.b64encode(png).decode()}"
    width, height = (int.from_bytes(png[at : at + 4], "big") or None for at in (16, 20))
    shown = tag("img", src=source, alt=alt, width=width, height=height, decoding="async")
    return tag("figure", shown, tag("figcaption", caption))


def document(title: str, lead: str, sections: Sequence[Section], script: str = "") -> str:
    """Return the whole page.

    Args:
        title: of the page.
        lead: what stands before the sections.
        sections: in order; each gets a heading and a link at the top.
        script: JavaScript, beside that which opens everything for print.

    Example:
        >>> text = document("Middles", "", [Section("table", "Table", tag("p", "1 < 2"))])
        >>> text.startswith("<!doctype html>"), "<p>1 &lt; 2</p>" in text
        (True, True)
    """
    version = importlib.metadata.version("jaxtrack")
    now = datetime.datetime.now(datetime.UTC)
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="Content-Security-Policy", content=_POLICY),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("meta", name="color-scheme", content="light dark"),
        tag("title", title),
        tag("style", Html(_HERE.with_name("html_page.css").read_text(encoding="utf-8"))),
    )
    contents = (tag("li", link(section.name, section.title)) for section in sections)
    parts = (
        tag(
            "section",
            tag("h2", section.title, id=f"{section.name}-title"),
            section.body,
            id=section.name,
            aria_labelledby=f"{section.name}-title",
        )
        for section in sections
    )
    made = f"Made by jaxtrack {version}, {now:%Y-%m-%d %H:%M} UTC."
    own = _HERE.with_name("html_page.js").read_text(encoding="utf-8")
    body = tag(
        "body",
        tag("a", "To the contents", href="#main", class_="skip"),
        tag("header", tag("h1", title), lead),
        tag("nav", tag("ul", *contents), aria_label="Sections"),
        tag("main", *parts, id="main", tabindex="-1"),
        tag("footer", tag("p", made)),
        tag("script", Html(own + script)),
    )
    return f"<!doctype html>\n{tag('html', head, body, lang='en')}\n"


def _lines(text: str) -> Html:
    return Html(joined([text]).replace("\n", "<br>"))


def write(file: pathlib.Path, text: str) -> str:
    """Write a page and return its name and size; a reader never sees half of one.

    Raises:
        OSError: it cannot be written.
    """
    half = file.with_name(f"half_{file.name}")
    half.write_text(text, encoding="utf-8")
    half.replace(file)
    size = file.stat().st_size
    return f"{file} ({size / 1e6:.1f} MB)" if size >= 1e6 else f"{file} ({size / 1e3:.0f} kB)"
