"""The cells of a CSV file, and where they stand: encoding, separator and shape, but no meaning."""

import csv
import io
import os
import pathlib
from typing import NamedTuple

from jaxtrack.io.errors import DataError


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
    reader = csv.reader(lines, delimiter=delimiter)
    try:
        # A spreadsheet leaves rows of nothing but separators behind its data.
        records = [(reader.line_num, cells) for cells in reader if any(map(str.strip, cells))]
    except csv.Error as error:
        raise DataError(f"{name}, row {reader.line_num}: {error}") from error
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
