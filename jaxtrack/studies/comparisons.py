"""What a study's file says that its results are compared with: a paper's figures, floors, bounds.

    [[compare]]
    name = "paper"                                  # heads its column
    source = "table 4"
    metric = "error_m"                              # or several: ["error_m", …]
    method = "trimmed"                              # likewise; all, if it is left out
    cells = { sigma_m = [1.0, 2.0], trimmed.share = 0.1 }
    value = [1.3, 2.1]

A field of `cells` has one value or several; over those with several, `value` is a list, nested in
their order. `nan` is for no figure. Where fields are left out, all their values are meant.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from jaxtrack.studies.study_file import StudyFile

_KINDS = ("value", "at_least", "at_most")
_KEYS = ("name", "source", "metric", "method", "cells", *_KINDS)
Axes = Mapping[str, Mapping[str, tuple[Any, ...]]]  # of each method


class Comparison(NamedTuple):
    """A table `[[compare]]`."""

    name: str
    source: str
    metrics: tuple[str, ...]
    methods: tuple[str, ...]
    cells: dict[str, Any]  # a value, or a tuple of several
    kind: str  # "value", "at_least", "at_most"; the last two are wanted
    figure: Any  # a number, words, a variable "method.metric", or lists of numbers and words

    @property
    def variable(self) -> str | None:
        """The study's own variable that is the bound, in the same cell and on the same draws."""
        return self.figure if self.kind != "value" and isinstance(self.figure, str) else None

    def at(self, fields: Mapping[str, Any]) -> Any:
        """Return the figure in a cell; None where there is none.

        Example:
            >>> of = ("error_m",), ("mean",), {"sigma_m": (1.0, 2.0), "count": 8}
            >>> one = Comparison("paper", "table 4", *of, "value", [1.3, 2.1])
            >>> one.at({"sigma_m": 2.0, "count": 8}), one.at({"sigma_m": 2.0, "count": 9})
            (2.1, None)
        """
        found = self.figure
        for field, values in self.cells.items():
            several = isinstance(values, tuple)
            if fields[field] not in (values if several else (values,)):
                return None
            if several and isinstance(found, list):
                found = found[values.index(fields[field])]
        return None if isinstance(found, float) and math.isnan(found) else found


def read_comparisons(
    file: StudyFile, tables: Any, axes: Axes, metrics: Sequence[str]
) -> tuple[Comparison, ...]:
    """Return the comparisons of a study's file.

    Args:
        file: for messages.
        tables: of `[[compare]]`.
        axes: the grid of each method.
        metrics: names.

    Raises:
        StudyError: what is wrong, with line and key.
    """
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        file.fail(("compare",), "want tables, each under [[compare]]")
    return tuple(
        _comparison(file, table, ("compare", str(number)), axes, metrics)
        for number, table in enumerate(tables, start=1)
    )


def _comparison(
    file: StudyFile,
    table: dict[str, Any],
    path: tuple[str, ...],
    axes: Axes,
    metrics: Sequence[str],
) -> Comparison:
    for key in table:
        if key not in _KEYS:
            file.fail((*path, key), f"unknown key, want one of {', '.join(_KEYS)}")
    read: Any = table.get
    name, source = read("name"), read("source", "")
    for key, value in (("name", name), ("source", source)):
        if not isinstance(value, str):
            file.fail((*path, key), f"got {value!r}, want text")
    chosen = _names(file, read("metric"), (*path, "metric"), metrics)
    methods = _names(file, read("method", list(axes)), (*path, "method"), list(axes))
    kinds = [kind for kind in _KINDS if kind in table]
    if len(kinds) != 1:
        got = " and ".join(kinds) or "none of them"
        file.fail(path, f"got {got}, want one of {', '.join(_KINDS)}")
    kind = kinds[0]
    figure, at = table[kind], (*path, kind)
    if kind != "value" and isinstance(figure, str):
        methods = _beside(file, figure, at, methods, chosen, axes, metrics)
    cells, methods = _cells(file, table.get("cells", {}), (*path, "cells"), methods, axes)
    sizes = [len(values) for values in cells.values() if isinstance(values, tuple)]
    if kind == "value" or not isinstance(figure, str):
        _figures(file, figure, at, sizes if isinstance(figure, list) else [], words=kind == "value")
    return Comparison(name, source, tuple(chosen), tuple(methods), cells, kind, figure)


def _names(file: StudyFile, value: Any, path: tuple[str, ...], known: Sequence[str]) -> list[str]:
    """Return one or several of the names that there are."""
    names = value if isinstance(value, list) else [value]
    if not names or any(name not in known for name in names):
        file.fail(path, f"got {value!r}, want one or several of {', '.join(known)}")
    return names


def _beside(
    file: StudyFile,
    variable: str,
    path: tuple[str, ...],
    methods: Sequence[str],
    chosen: Sequence[str],
    axes: Axes,
    metrics: Sequence[str],
) -> list[str]:
    """Return the methods that have a value of the variable in each of their cells."""
    known = {f"{method}.{name}": method for method in axes for name in metrics}
    if variable not in known:
        want = f"a number, a list, or a variable as {next(iter(known))}"
        file.fail(path, f"got {variable!r}, want {want}")
    inside = lambda method: axes[known[variable]].keys() <= axes[method].keys()
    itself = lambda method: variable in [f"{method}.{metric}" for metric in chosen]
    found = [name for name in methods if inside(name) and not itself(name)]
    if not found:
        grid = ", ".join(axes[known[variable]])
        file.fail(path, f"got {variable}, want another one, whose grid ({grid}) is the method's")
    return found


def _cells(
    file: StudyFile, table: Any, path: tuple[str, ...], methods: Sequence[str], axes: Axes
) -> tuple[dict[str, Any], list[str]]:
    """Return the cells, and the methods that have them."""
    if not isinstance(table, dict):
        file.fail(path, f"got {table!r}, want {{ field = value or [value, …], … }}")
    cells: dict[str, Any] = {}
    for key, value in table.items():  # method.field = … is a table in a table
        inner = value if isinstance(value, dict) else {"": value}
        for field, values in inner.items():
            name = f"{key}.{field}" if field else key
            cells[name] = tuple(values) if isinstance(values, list) else values
    found = [method for method in methods if cells.keys() <= axes[method].keys()]
    known = {field: values for method in methods for field, values in axes[method].items()}
    for field, values in cells.items():
        if field not in known or not found:
            file.fail((*path, field), f"no field with a grid, want of {', '.join(known) or 'none'}")
        several = values if isinstance(values, tuple) else (values,)
        if not several or any(value not in known[field] for value in several):
            want = ", ".join(map(str, known[field]))
            file.fail((*path, field), f"got {values!r}, want of the grid's values {want}")
    return cells, found


def _figures(
    file: StudyFile, figure: Any, path: tuple[str, ...], sizes: Sequence[int], *, words: bool
) -> None:
    """Check that lists are as long as those in `cells`, and hold figures."""
    if sizes:
        if not isinstance(figure, list) or len(figure) != sizes[0]:
            file.fail(path, f"got {figure!r}, want a list of {sizes[0]}, as in cells")
        for entry in figure:
            _figures(file, entry, path, sizes[1:], words=words)
    elif isinstance(figure, bool) or not isinstance(figure, (int, float, str)[: 2 + words]):
        file.fail(path, f"got {figure!r}, want a number{' or text' if words else ''}")
