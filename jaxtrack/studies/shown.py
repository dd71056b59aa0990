"""What a study shows while it runs, kept beside its results for the report.

shown.json    the tables and lines that went to the console, how long it took, how it was called
"""

import contextlib
import datetime
import json
import pathlib
from collections.abc import Iterator
from typing import Any

from rich.console import Console, ConsoleRenderable, RenderHook
from rich.table import Table
from rich.text import Text

FILE = "shown.json"


class _Recorder(RenderHook):
    def __init__(self) -> None:
        self.shown: list[ConsoleRenderable] = []

    def process_renderables(self, renderables: list[ConsoleRenderable]) -> list[ConsoleRenderable]:
        self.shown += renderables
        return renderables


@contextlib.contextmanager
def recorded(console: Console) -> Iterator[list[ConsoleRenderable]]:
    """Keep what is printed on a console meanwhile.

    Example:
        >>> import io
        >>> console = Console(file=io.StringIO())
        >>> with recorded(console) as shown:
        ...     console.print("3 of 3 pass.")
        >>> plain(shown)
        ['3 of 3 pass.']
    """
    recorder = _Recorder()
    console.push_render_hook(recorder)
    try:
        yield recorder.shown
    finally:
        console.pop_render_hook()


def plain(shown: list[ConsoleRenderable]) -> list[Any]:
    """Return tables as title, heads and rows of text, and lines as text.

    Example:
        >>> table = Table("", "ours", title="Marks")
        >>> table.add_row("joint", "[green]pass[/]")
        >>> plain([table])[0]["rows"]
        [['joint', 'pass']]
    """
    found: list[Any] = []
    for thing in shown:
        if isinstance(thing, Table):
            columns = [[_text(cell) for cell in column.cells] for column in thing.columns]
            found.append(
                {
                    "title": _text(thing.title),
                    "heads": [_text(column.header) for column in thing.columns],
                    "left": [n for n, c in enumerate(thing.columns) if c.justify == "left"],
                    "rows": [list(row) for row in zip(*columns, strict=True)],
                }
            )
        elif isinstance(thing, Text):
            found.append(thing.plain)
    return found


def save(
    out: pathlib.Path, shown: list[ConsoleRenderable], about: dict[str, Any], seconds: float
) -> None:
    """Write what was shown into a study's folder.

    Args:
        out: the folder.
        shown: by the study.
        about: the run, as JSON can hold it.
        seconds: that it took.
    """
    now = f"{datetime.datetime.now(datetime.UTC):%Y-%m-%d %H:%M} UTC"
    entries = {**about, "seconds": seconds, "ended": now, "shown": plain(shown)}
    text = json.dumps(entries, indent=1, ensure_ascii=False)
    (out / FILE).write_text(text + "\n", encoding="utf-8")


def load(out: pathlib.Path) -> dict[str, Any] | None:
    """Read what `save` wrote; None of a folder without."""
    try:
        return json.loads((out / FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def _text(value: Any) -> str:
    return Text.from_markup(value).plain if isinstance(value, str) else str(value or "")
