"""The cells of a CSV file, and where they stand: encoding, separator, shape, names and numbers."""

import csv
import io
import os
import pathlib
from typing import NamedTuple

import numpy as np

from jaxtrack.io.errors import DataError, Where, check_numbers, number


class Table(NamedTuple):
    """The cells of a file, stripped, and where they stand."""

    name: str
    line: list[int]  # line in the file of each row, counted from 1
    cells: dict[str, list[str]]  # by column


def read_table(path: str | os.PathLike[str]) -> Table:
    """Read a file's cells.

    UTF-8 with or without a byte-order mark, any line ends; commas, semicolons or tabs, whichever
    the header has most of; blank rows are passed over; columns' names are lower-cased.

    Raises:
        DataError: no text, no header, no rows, a column twice, or a row of another length.
        OSError: the file cannot be opened.
    """
    name = str(path)
    try:
        text = pathlib.Path(path).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        row = error.object.count(b"\n", 0, error.start) + 1
        raise DataError(f"{name}, row {row}: got bytes that are not UTF-8 text") from error
    lines = io.StringIO(text)
    header = next((line for line in lines if line.strip()), None)
    if header is None:
        raise DataError(f"{name}: got an empty file, want a header and rows")
    delimiter = max(",;\t", key=header.count)
    lines.seek(0)
    reader = csv.reader(lines, delimiter=delimiter, strict=True)
    try:
        # A spreadsheet leaves rows of nothing but separators behind its data.
        records = [(reader.line_num, cells) for cells in reader if any(map(str.strip, cells))]
    except csv.Error as error:
        what = str(error).replace("unexpected end of data", "a quotation mark is never closed")
        raise DataError(f"{name}, row {reader.line_num}: {what}") from error
    if not records:
        raise DataError(f"{name}: got nothing but separators, want a header and rows")
    (header_line, titles), *body = records
    columns = [title.strip().lower() for title in titles]
    for column in columns:
        if columns.count(column) > 1:
            raise DataError(
                f"{name}, row {header_line}, column {column!r}: "
                "got it twice in the header, want different names"
            )
    for line, cells in body:
        if len(cells) != len(columns):
            at = columns[min(len(cells), len(columns) - 1)]
            raise DataError(
                f"{name}, row {line}, column {at}: got {len(cells)} cells, "
                f"want {len(columns)} as in the header"
            )
    if not body:
        raise DataError(f"{name}: got a header and no rows, want at least one row: no look at all")
    cells_of = zip(*(cells for _, cells in body), strict=True)
    stripped = ([cell.strip() for cell in cells] for cells in cells_of)
    return Table(name, [line for line, _ in body], dict(zip(columns, stripped, strict=True)))


def where_in(table: Table) -> Where:
    """Return what words the place of a cell, by the row's index and the column's name."""

    def where(row: int, column: str) -> str:
        return f"{table.name}, row {table.line[row]}, column {column}"

    return where


def check_columns(
    table: Table, required: tuple[str, ...], known: tuple[str, ...], *, instead: str = ""
) -> None:
    """Check the columns' names.

    Args:
        table: whose header it is.
        required: what must be there.
        known: what may be there; a misspelt name must not pass for none.
        instead: what could stand for a missing column, for the message.

    Raises:
        DataError: a column is missing, or unknown.
    """
    for name in required:
        if name not in table.cells:
            other = "" if name == "time_s" else instead
            raise DataError(
                f"{table.name}: got columns {', '.join(table.cells)}, want column {name}{other}"
            )
    for name in table.cells:
        if name not in known:
            raise DataError(
                f"{table.name}, column {name!r}: got an unknown column, want {', '.join(known)}"
            )


def filled(table: Table, first: str, second: str) -> np.ndarray:
    """Return the rows that hold a detection, [R] bool: either of two columns is not empty."""
    pairs = zip(table.cells[first], table.cells[second], strict=True)
    return np.array([a != "" or b != "" for a, b in pairs])


def numbers_in(table: Table, column: str, rows: np.ndarray) -> np.ndarray:
    """Return the numbers of a column in some rows, float64.

    Args:
        table: the file's.
        column: its name.
        rows: indices into the table's rows.

    Raises:
        DataError: a cell is empty, or no finite number.
    """
    where = where_in(table)
    cells = table.cells[column]
    values = np.array([_number(cells[row], column, int(row), where) for row in rows], np.float64)
    check_numbers(values, column, lambda row, column: where(int(rows[row]), column))
    return values


def one_a_look(
    table: Table, column: str, look: np.ndarray, first: np.ndarray, *, want: str
) -> np.ndarray:
    """Return a column's value in each look, [T] float64, which all of the look's rows share.

    Args:
        table: the file's.
        column: its name.
        look: [R] the look of each row.
        first: [T] the first row of each look.
        want: what is wanted, for the message.

    Raises:
        DataError: a cell is no number, or differs from the look's first.
    """
    values = numbers_in(table, column, np.arange(len(look)))
    expected = values[first][look]
    differs = values != expected
    if differs.any():
        row = int(np.argmax(differs))
        raise DataError(
            f"{where_in(table)(row, column)}: got {number(values[row])} after "
            f"{number(expected[row])} at the same time, want {want}"
        )
    return values[first]


def check_once(
    cell: np.ndarray, values: np.ndarray, column: str, where: Where, *, want: str
) -> None:
    """Check that no row is of a cell that an earlier one is of.

    Args:
        cell: [R] int, what must not come twice.
        values: [R] what the file calls it, for the message.
        column: the name of the column, for the message.
        where: words the place.
        want: what is wanted, for the message.

    Raises:
        DataError: the first row that repeats a cell.
    """
    _, first, again = np.unique(cell, return_index=True, return_inverse=True)
    repeated = first[again] != np.arange(len(cell))
    if repeated.any():
        row = int(np.argmax(repeated))
        got = number(values[row])
        raise DataError(f"{where(row, column)}: got {got} twice at the same time, want {want}")


def whole_numbers(values: np.ndarray, column: str, where: Where) -> np.ndarray:
    """Return values as integers.

    Raises:
        DataError: the first that is none.
    """
    fractional = values != np.round(values)
    if fractional.any():
        row = int(np.argmax(fractional))
        raise DataError(f"{where(row, column)}: got {values[row]:g}, want a whole number")
    return values.astype(np.int64)


def _number(cell: str, column: str, row: int, where: Where) -> float:
    if cell == "":
        raise DataError(f"{where(row, column)}: got an empty cell, want a number")
    try:
        return float(cell)
    except ValueError:
        raise DataError(
            f"{where(row, column)}: got {cell!r}, want a number with a decimal point"
        ) from None
