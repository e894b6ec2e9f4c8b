"""Tables of numbers in text: fast where they are regular, exact about the line where they are not."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Collection, Sequence
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

__all__ = ["Fail", "parse_table"]

# Called with a line (0 = the first of the table; None = all of it) and what is wrong there; it raises.
Fail = Callable[[int | None, str], NoReturn]

_NO_DATA = {"", "na", "n/a", "nan", "null", "none", "-nan", "+nan", "-nan(ind)", "nan(ind)"}


def parse_table(
    body: bytes,
    names: Sequence[str],
    fail: Fail,
    *,
    delimiter: str | None = None,
    text: Collection[str] = (),
) -> list[NDArray[Any]]:
    """Parse lines of fields into one array a column: float64 for numbers, str for text.

    Columns not named in `text` are text if their first field is no number. Empty lines are skipped.

    Parameters
    ----------
    body
        The lines.
    names
        The columns; every line must have as many fields.
    fail
        Raises the error for a bad line.
    delimiter
        One character; None means any run of blanks. With a delimiter, an empty field or ``NA`` is "no data" (NaN).
    text
        Columns that are text even where they look like numbers.
    """
    if not body.strip():
        return [np.empty(0) for _ in names]
    quoted = b'"' in body
    try:
        # Its C parser is the fastest in NumPy, refuses ragged lines, and raises on the first bad field.
        numbers = not text and not quoted
        table = np.loadtxt(io.BytesIO(body), delimiter=delimiter, comments=None, ndmin=2) if numbers else None
    except ValueError:
        table = None
    if table is not None and table.shape[1] == len(names):
        return [np.ascontiguousarray(table[:, k]) for k in range(len(names))]
    if delimiter is None and not quoted:
        return _parse_words(body, names, fail, text)
    return _parse_fields(body, names, fail, delimiter, text)


def _parse_words(body: bytes, names: Sequence[str], fail: Fail, text: Collection[str]) -> list[NDArray[Any]]:
    """Parse a blank-separated table with text in it."""
    _check_word_counts(body, names, fail)
    words = body.split()
    columns = []
    for k, name in enumerate(names):
        column = words[k :: len(names)]
        try:
            if name not in text:
                columns.append(np.array(column, dtype=np.float64))
                continue
        except ValueError:
            if _is_number(column[0].decode("latin-1")):
                bad = (row for row, word in enumerate(column) if not _is_number(word.decode("latin-1")))
                row = next(bad, 0)
                fail(_line_of_row(body, row), _not_a_number(name, column[row].decode("utf-8", "replace")))
        columns.append(np.array([word.decode("utf-8", "replace") for word in column]))
    return columns


def _parse_fields(
    body: bytes, names: Sequence[str], fail: Fail, delimiter: str | None, text: Collection[str]
) -> list[NDArray[Any]]:
    """Parse a table with delimiters, quotes, empty fields or text."""
    if delimiter is None:
        body = body.replace(b"\t", b" ")
    file = io.StringIO(body.decode("utf-8", "replace"), newline="")
    reader = csv.reader(file, delimiter=delimiter or " ", skipinitialspace=True)
    rows: list[list[str]] = []
    lines: list[int] = []
    try:
        for row in reader:
            fields = [word.strip() for word in row]
            if delimiter is None:
                fields = [word for word in fields if word]
            if not any(fields):
                continue
            if len(fields) != len(names):
                fail(reader.line_num - 1, _wrong_count(len(fields), names))
            rows.append(fields)
            lines.append(reader.line_num - 1)
    except csv.Error as error:
        fail(reader.line_num - 1, str(error))
    return [
        np.array(column) if name in text else _parse_column(name, column, lines, fail)
        for name, column in zip(names, zip(*rows, strict=True), strict=True)
    ]


def _parse_column(name: str, fields: Sequence[str], lines: Sequence[int], fail: Fail) -> NDArray[Any]:
    first = next((word for word in fields if word.lower() not in _NO_DATA), None)
    if first is not None and not _is_number(first):
        return np.array(fields)
    values = np.empty(len(fields))
    for row, word in enumerate(fields):
        if word.lower() in _NO_DATA:
            values[row] = np.nan
        elif _is_number(word):
            values[row] = float(word)
        else:
            fail(lines[row], _not_a_number(name, word))
    return values


def _check_word_counts(body: bytes, names: Sequence[str], fail: Fail) -> None:
    characters = np.frombuffer(body + b"\n", dtype=np.uint8)
    # The bytes that bytes.split() takes for blanks.
    blank = (characters == 32) | ((characters >= 9) & (characters <= 13))
    starts = np.flatnonzero(np.concatenate([~blank[:1], blank[:-1] & ~blank[1:]]))
    ends = np.flatnonzero(characters == 10)
    counts = np.diff(np.searchsorted(starts, ends), prepend=0)
    bad = (counts != len(names)) & (counts != 0)
    if bad.any():
        line = int(np.argmax(bad))
        fail(line, _wrong_count(int(counts[line]), names))


def _line_of_row(body: bytes, row: int) -> int:
    full = [line for line, text in enumerate(body.split(b"\n")) if text.strip()]
    return full[row]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return text.isascii() and "_" not in text  # which only Python reads as a number


def _wrong_count(found: int, names: Sequence[str]) -> str:
    return f"{found} fields where {len(names)} are expected ({' '.join(names)})"


def _not_a_number(name: str, text: str) -> str:
    return f"{text[:40]!r} in column {name} is not a number"
