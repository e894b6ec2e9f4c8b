"""Tables in text: CSV and its kin with a header line, or bare ``x y z`` points."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from luxel.errors import FormatError
from luxel.io.columns import find_positions, find_radii, tidy
from luxel.io.frame import Frame
from luxel.io.stream import Stream
from luxel.io.table import parse_table

__all__ = ["CsvReader"]

_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|[-+]?(nan|inf|infinity)", re.IGNORECASE)


@dataclass(frozen=True)
class CsvReader:
    """Text tables, one time step a file.

    The delimiter is a comma, semicolon, tab or blanks, found in the header line; lines that start with ``#`` above
    the table are comments, except that the last of them may be the header. Columns x, y, z (or Points:0 …,
    position_x … as ParaView and others write) are the position; radius, rad, r or diameter the radius; vx, vy, vz
    become the vector ``velocity``; text columns become codes with labels; all others are scalars by their own name.
    A file of three bare columns of numbers is x, y, z, under a line with their count if there is one.
    """

    name: str = "csv"
    suffixes: tuple[str, ...] = (".csv", ".tsv", ".txt", ".dat", ".pts", ".xyz", ".asc")

    def sniff(self, head: bytes, path: Path) -> bool | None:
        """Recognise a header line with positions; other text may be a table."""
        if b"\0" in head:
            return False
        try:
            header = _find_header(head, path)
        except FormatError:
            return None
        return find_positions(header.names) is not None or None

    def open(self, path: Path) -> CsvSource:
        """Open a table without reading it."""
        return CsvSource(Stream(path))


class CsvSource:
    """One table."""

    frame_count = 1
    times: Sequence[float | None] = (None,)

    def __init__(self, stream: Stream) -> None:
        self._stream = stream

    def particle_count(self, frame: int) -> int | None:
        """Return None: only reading the table tells."""
        return None

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def read(self, frame: int) -> Frame:
        """Read the table."""
        path = self._stream.path
        data = self._stream.read()
        if b"\0" in data[:4096]:
            raise FormatError(
                path, "holds binary data, not a table in text", remedy="name the format with --format"
            )
        header = _find_header(data, path)
        position = find_positions(header.names)
        if position is None:
            raise FormatError(
                path,
                f"no columns x, y, z; the columns are {', '.join(header.names)[:200]}",
                place=f"line {header.line}",
                remedy="name the position columns x, y, z in the header line",
            )
        twice = {name for name in header.names if header.names.count(name) > 1}
        if twice:
            raise FormatError(
                path,
                f"column {min(twice)!r} appears twice",
                place=f"line {header.line}",
                remedy="give every column its own name",
            )

        def fail(line: int | None, problem: str) -> NoReturn:
            place = "" if line is None else f"line {header.first_row + line}"
            raise FormatError(
                path, problem, place=place, remedy="repair or remove the line; the file may be truncated"
            )

        body = data[header.stop :]
        arrays = parse_table(body, header.names, fail, delimiter=header.delimiter)
        columns = dict(zip(header.names, arrays, strict=True))
        if header.count is not None and len(arrays[0]) != header.count:
            fail(None, f"{len(arrays[0])} rows where the first line promises {header.count}")
        for name in position:
            if columns[name].dtype.kind != "f":
                fail(0, f"column {name} is a position but holds text: {str(columns[name][0])[:40]!r}")
        positions = np.stack([columns.pop(name) for name in position], axis=1)
        radii, source = find_radii(columns) or (None, None)
        scalars, categories = tidy(columns)
        return Frame(positions, scalars, radii, source, categories)


@dataclass(frozen=True)
class _Header:
    names: list[str]
    delimiter: str | None
    line: int  # the header's own line, from 1
    first_row: int  # the first line of the table
    stop: int  # offset of that line
    count: int | None = None


def _find_header(data: bytes, path: Path) -> _Header:
    """Find column names: in the first line, in the comment above the numbers, or x y z for bare points."""
    offset, line = 0, 0
    comment: tuple[str, int] | None = None
    while offset < len(data):
        end = data.find(b"\n", offset)
        stop = len(data) if end < 0 else end + 1
        text = data[offset:stop].decode("utf-8-sig" if offset == 0 else "utf-8", "replace").strip()
        line += 1
        if text.startswith(("#", "%", "//")):
            comment = (text.lstrip("#%/ \t"), line)
        elif text:
            names, delimiter = _split(text)
            if not all(_NUMBER.fullmatch(name) for name in names):
                return _Header(names, delimiter, line, line + 1, stop)
            if comment is not None:
                above, _ = _split(comment[0])
                if len(above) == len(names) and find_positions(above):
                    return _Header(above, delimiter, comment[1], line, offset)
            if len(names) == 3:
                return _Header(["x", "y", "z"], delimiter, line, line, offset)
            if len(names) == 1 and names[0].isdecimal() and len(names[0]) < 16:
                following = data[stop : stop + 4096].split(b"\n", 1)[0].decode("utf-8", "replace").strip()
                fields, delimiter = _split(following)
                if len(fields) == 3 and all(_NUMBER.fullmatch(field) for field in fields):
                    return _Header(["x", "y", "z"], delimiter, line + 1, line + 1, stop, int(names[0]))
            raise FormatError(
                path,
                f"{len(names)} columns of numbers without names",
                place=f"line {line}",
                remedy="put a header line such as 'x,y,z,radius' first",
            )
        offset = stop
    raise FormatError(path, "no table: the file holds no data", remedy="a header line with x,y,z comes first")


def _split(text: str) -> tuple[list[str], str | None]:
    """Split a header line; marks within quotes belong to a name."""
    bare = re.sub(r'"[^"]*"', "", text)
    delimiter = next((mark for mark in ",;\t" if mark in bare), None)
    if '"' in text:
        fields = next(csv.reader([text], delimiter=delimiter or " ", skipinitialspace=True), [])
    else:
        fields = text.split(delimiter)
    names = [field.strip().strip("\"'").strip() for field in fields]
    return [name or f"column{k}" for k, name in enumerate(names, 1)], delimiter
