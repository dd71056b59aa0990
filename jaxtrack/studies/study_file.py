"""Messages on a study's file that say where: TOML's reader tells no line of what it has read."""

import tomllib
from collections.abc import Mapping
from typing import Any, NamedTuple, NoReturn


class StudyError(ValueError):
    """What is wrong with a study, its file or its folder, in one line."""


class StudyFile(NamedTuple):
    """A file that is being read, for messages that say where."""

    name: str
    text: str

    def fail(self, path: tuple[str, ...], message: str) -> NoReturn:
        """Complain of a key, with its line."""
        raise StudyError(f"{self.name}:{line_of(self.text, path)}: {'.'.join(path)}: {message}")


def line_of(text: str, path: tuple[str, ...]) -> int:
    r"""Return the line in which a key of a TOML text stands, or the nearest table around it.

    Example:
        >>> line_of("[a]\nb = 1\nc = [\n2]", ("a", "c"))
        3
    """
    lines, before = text.split("\n"), 0
    for number in range(1, len(lines) + 1):
        try:
            known: Any = tomllib.loads("\n".join(lines[:number]))
        except tomllib.TOMLDecodeError:  # in the middle of a value
            continue
        for key in path:
            if isinstance(known, list):
                known = dict(enumerate(known, start=1))
                key = int(key) if key.isdecimal() else key
            known = known.get(key) if isinstance(known, Mapping) else None
        if known is not None:
            return before + 1
        before = number
    return line_of(text, path[:-1]) if len(path) > 1 else 1
