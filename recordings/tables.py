"""Comma-separated tables of numbers; every error names its row and column.

A table is a header line and rows of numbers; an empty cell (or `nan`) is missing. The columns come back as
float64 arrays in the file's order, with a function that turns a 0-based row into words ("row 3 (line 4)").
"""

import csv
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from .atomic import atomic_path
from .errors import InputError, about, first_line
from .paths import check_readable

Row = tuple[int, list[str]]  # line number in the file, and the cells


def read_lines(path: str | Path) -> list[str]:
    """Lines of a text file in UTF-8. Raises InputError for another file, OSError as :func:`read_rows`."""
    try:
        return check_readable(path).read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file") from None


def read_rows(path: str | Path) -> list[Row]:
    """All lines that are not blank, each as (line number, cells), cells stripped.

    Raises:
        InputError: an empty file, or one that is not text in UTF-8.
        OSError: a file that cannot be opened, or is no ordinary one.
    """
    rows = [(line, [cell.strip() for cell in cells]) for line, cells in _cells(path) if any(cells)]
    if not rows:
        raise InputError(f"{path}: the file is empty; expected a header line and rows of numbers")
    for line, cells in rows:
        if not all(cell.replace("\t", "").isprintable() for cell in cells):
            raise InputError(f"{path}: not a text table (line {line} holds control characters)")
    return rows


def read_header(path: str | Path) -> list[str]:
    """Cells of the first line, stripped; none of an empty file.

    Raises:
        InputError: a file that is not text in UTF-8.
        OSError: a file that cannot be opened, or is no ordinary one.
    """
    _, cells = next(_cells(path), (0, []))
    return [cell.strip() for cell in cells]


def _cells(path: str | Path) -> Iterator[Row]:
    check_readable(path)
    try:
        with open(path, encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file)
            for cells in reader:
                yield reader.line_num, cells
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: not a text table ({first_line(error)})") from None


def read_numbers(rows: Sequence[Row], columns: Sequence[str]) -> tuple[np.ndarray, Callable[[int], str]]:
    """Turn rows of cells into numbers, (rows, columns), NaN where a cell is empty.

    Raises:
        InputError: no rows, a row of another length, or a cell that is no finite number; the message names it.
    """

    def where(row: int) -> str:
        return f"row {row + 1} (line {rows[row][0]})"

    check_lengths(rows, columns)
    try:
        numbers = np.array([[number_of(cell) for cell in cells] for _, cells in rows])
    except ValueError:
        numbers = np.array([np.inf])
    if np.isinf(numbers).any():  # again, cell by cell, for the place of the wrong one
        for i, (_, cells) in enumerate(rows):
            for column, cell in zip(columns, cells, strict=True):
                _check_cell(cell, f"{where(i)}, column {column!r}")
    return numbers, where


def read_table(path: str | Path) -> tuple[dict[str, np.ndarray], Callable[[int], str]]:
    """Columns by name, and the words for a row. Raises InputError as above, or for a bad header."""
    header, rows = header_and_rows(path)
    with about(path):
        if not all(header):
            raise InputError("the header has a column without a name")
        check_once(header, header)
        numbers, where = read_numbers(rows, header)
    return dict(zip(header, numbers.T, strict=True)), where


def header_and_rows(path: str | Path) -> tuple[list[str], list[Row]]:
    """The first line's cells and the other lines. Raises InputError where they are not separated by commas."""
    (_, header), *rows = read_rows(path)
    with about(path):
        if len(header) == 1 and (mark := next((m for m in ";\t|" if m in header[0]), None)):
            raise InputError(f"columns must be separated by commas, these are by {mark!r}")
        if any("\t" in name for name in header):
            raise InputError("the header has a tab inside a column's name")
    return header, rows


def check_once(header: Sequence[str], names: Sequence[str]) -> None:
    """Raise InputError where the header has one of the names twice."""
    count = Counter(header)
    if twice := sorted(name for name in names if count[name] > 1):
        raise InputError(f"the header has column {twice[0]!r} twice")


def check_lengths(rows: Sequence[Row], columns: Sequence[str]) -> None:
    """Raise InputError unless there are rows, each with a cell for each column."""
    if not rows:
        raise InputError("only a header, no rows; expected one row a frame")
    for i, (line, cells) in enumerate(rows):
        if len(cells) != len(columns):
            raise InputError(f"row {i + 1} (line {line}) has {len(cells)} cells, the header has {len(columns)}")


def write_table(columns: Mapping[str, np.ndarray], path: str | Path) -> None:
    """Write equal-length columns as CSV, NaN as an empty cell, numbers so that they read back exactly.

    Raises OSError when `path` cannot be written; nothing is left half-written.
    """
    rows = np.stack([np.asarray(column, dtype=np.float64) for column in columns.values()], axis=-1).tolist()
    with atomic_path(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        # repr of a float is its shortest exact form; a value differs from itself only when it is NaN
        writer.writerows([repr(v) if v == v else "" for v in row] for row in rows)


def number_of(cell: str) -> float:
    """The number in a cell, NaN where it is empty. Raises ValueError for another text."""
    if "_" in cell:  # Python alone reads 1_5 as 15
        raise ValueError
    return float(cell) if cell else np.nan


def _check_cell(cell: str, where: str) -> None:
    try:
        value = number_of(cell)
    except ValueError:
        raise InputError(f"{where}: {cell[:40]!r} is not a number; leave a missing value empty") from None
    if np.isinf(value):
        raise InputError(f"{where} is infinite; leave a missing value empty")
