"""Legacy VTK files, ASCII and binary.

Read here rather than by the vtk package: that is 140 MB, and it ends the process on some damaged files.
The format: https://docs.vtk.org/en/latest/vtk_file_formats/vtk_legacy_file_format.html.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from luxel.errors import FormatError
from luxel.io.columns import Columns
from luxel.io.frame import Frame
from luxel.io.stream import Stream
from luxel.io.vtk_arrays import to_frame, words_to_numbers

__all__ = ["VtkLegacyReader"]

_DTYPES = {
    "char": "i1",
    "signed_char": "i1",
    "unsigned_char": "u1",
    "short": "i2",
    "unsigned_short": "u2",
    "int": "i4",
    "unsigned_int": "u4",
    "long": "i8",
    "unsigned_long": "u8",
    "long_long": "i8",
    "unsigned_long_long": "u8",
    "vtkidtype": "i4",  # so it is written, whatever its size in memory
    "vtktypeint64": "i8",
    "vtktypeuint64": "u8",
    "float": "f4",
    "double": "f8",
}
_CELLS = {"VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS", "CELLS"}
_VECTORS = {"VECTORS": 3, "NORMALS": 3, "TENSORS": 9, "TENSORS6": 6, "GLOBAL_IDS": 1, "PEDIGREE_IDS": 1}
_BLANKS = re.compile(rb"\s*")


@dataclass(frozen=True)
class VtkLegacyReader:
    """Legacy VTK files with points (POLYDATA or UNSTRUCTURED_GRID), one time step a file.

    Point arrays are scalars by their own names; one called radius or diameter (in any case) is the radius, with several
    components (ellipsoids) the mean of them. A field TIME or TimeValue is the time. Cells are not looked at.
    """

    name: str = "vtk legacy"
    suffixes: tuple[str, ...] = (".vtk",)

    def sniff(self, head: bytes, path: Path) -> bool | None:
        """Recognise the version line."""
        return head.startswith(b"# vtk DataFile")

    def open(self, path: Path) -> VtkLegacySource:
        """Open a file without reading it."""
        return VtkLegacySource(Stream(path))


class VtkLegacySource:
    """One legacy file."""

    frame_count = 1
    times: Sequence[float | None] = (None,)

    def __init__(self, stream: Stream) -> None:
        self._stream = stream

    def particle_count(self, frame: int) -> int | None:
        """Return None: only reading the file tells."""
        return None

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def read(self, frame: int) -> Frame:
        """Read points and point arrays."""
        return _Parser(self._stream.path, self._stream.read()).frame()


class _Parser:
    """Walks through the sections; knows where it stands, for messages."""

    def __init__(self, path: Path, data: bytes) -> None:
        self._path = path
        self._data = data
        self._at = 0
        self._positions: NDArray[Any] | None = None
        self._points: Columns = {}
        self._fields: Columns = {}
        # Where attributes go: those of cells are read past.
        self._home: Columns = self._fields
        self._count = 0

    def frame(self) -> Frame:
        self._header()
        while (words := self._line()) is not None:
            self._section(words)
        if self._positions is None:
            self._fail("no POINTS")
        for name, values in self._points.items():
            if len(values) != len(self._positions):
                self._fail(f"array {name} has {len(values)} values for {len(self._positions)} points")
        return to_frame(self._positions, self._points, self._fields)

    def _header(self) -> None:
        lines = self._data.split(b"\n", 3)
        if len(lines) < 4 or not lines[0].startswith(b"# vtk DataFile"):
            self._fail(
                "the header ends early; '# vtk DataFile Version …', a title, ASCII or BINARY are expected"
            )
        self._at = sum(len(line) + 1 for line in lines[:3])
        kind = lines[2].strip().upper()
        if kind not in {b"ASCII", b"BINARY"}:
            self._fail(f"line 3 must be ASCII or BINARY, got {lines[2][:40].decode('latin-1')!r}")
        self._binary = kind == b"BINARY"

    def _section(self, words: list[str]) -> None:
        keyword = words[0].upper()
        if keyword == "DATASET":
            if self._word(words, 1).upper() not in {"POLYDATA", "UNSTRUCTURED_GRID"}:
                self._fail(f"holds {self._word(words, 1)}, expected points in POLYDATA or UNSTRUCTURED_GRID")
        elif keyword == "POINTS":
            count = self._number(words, 1)
            self._positions = self._values(count * 3, self._word(words, 2)).reshape(count, 3)
        elif keyword in _CELLS:
            self._cells(self._number(words, 1), self._number(words, 2))
        elif keyword == "CELL_TYPES":
            self._values(self._number(words, 1), "int")
        elif keyword in {"POINT_DATA", "CELL_DATA"}:
            self._count = self._number(words, 1)
            self._home = self._points if keyword == "POINT_DATA" else {}
        elif keyword == "METADATA":
            while self._raw_line().strip():
                pass
        elif keyword == "FIELD":
            self._field(self._number(words, 2))
        elif keyword in _VECTORS:
            self._store(words, _VECTORS[keyword], self._word(words, 2))
        elif keyword == "SCALARS":
            width = self._number(words, 3) if len(words) > 3 else 1
            before = self._at
            table = self._line()
            if table is None or table[0].upper() != "LOOKUP_TABLE":  # the line may be left out
                self._at = before
            self._store(words, width, self._word(words, 2))
        elif keyword == "LOOKUP_TABLE":
            self._values(4 * self._number(words, 2), "unsigned_char" if self._binary else "float")
        elif keyword == "COLOR_SCALARS":
            self._store(words, self._number(words, 2), "unsigned_char" if self._binary else "float")
        elif keyword == "TEXTURE_COORDINATES":
            self._store(words, self._number(words, 2), self._word(words, 3))
        else:
            self._fail(f"unknown keyword {words[0][:40]!r}, or more values than were announced")

    def _cells(self, count: int, size: int) -> None:
        before = self._at
        words = self._line()
        if words is not None and words[0].upper() == "OFFSETS":  # since version 5
            self._values(count, self._word(words, 1))
            words = self._line() or [""]
            if words[0].upper() != "CONNECTIVITY":
                self._fail(f"CONNECTIVITY is expected after OFFSETS, got {words[0][:40]!r}")
            self._values(size, self._word(words, 1))
        else:
            self._at = before
            self._values(size, "int")

    def _field(self, count: int) -> None:
        for _ in range(count):
            words = self._line()
            while words is not None and words[0].upper() == "METADATA":
                self._section(words)
                words = self._line()
            if words is None:
                self._fail(f"a FIELD of {count} arrays ends early")
            width, rows, kind = self._number(words, 1), self._number(words, 2), self._word(words, 3)
            if kind.lower() == "string":
                self._skip_strings(width * rows)
                continue
            values = self._values(width * rows, kind)
            self._home[unquote(words[0])] = values if width == 1 else values.reshape(rows, width)

    def _skip_strings(self, count: int) -> None:
        if self._binary:
            self._fail("text arrays in a BINARY file are not read")
        for _ in range(count):
            if self._at >= len(self._data):
                self._fail("an array of text ends early")
            self._raw_line()

    def _store(self, words: list[str], width: int, kind: str) -> None:
        values = self._values(self._count * width, kind)
        self._home[unquote(self._word(words, 1))] = (
            values if width == 1 else values.reshape(self._count, width)
        )

    def _values(self, count: int, kind: str) -> NDArray[Any]:
        """Take `count` numbers; refuses a count that the rest of the file cannot hold."""
        kind = kind.lower()
        bits = kind == "bit"
        if not bits and kind not in _DTYPES:
            self._fail(f"unknown type {kind[:40]!r}")
        dtype = np.dtype("u1" if bits else _DTYPES[kind]).newbyteorder(">")
        if not self._binary:
            if count > len(self._data) - self._at:
                self._fail(f"{count} values are announced, {len(self._data) - self._at} bytes are left")
            words = self._data[self._at :].split(None, count)
            if len(words) < count:
                self._fail(f"{count} values are announced, {len(words)} are there: truncated")
            rest = words.pop() if len(words) > count else b""
            try:
                values = words_to_numbers(words, dtype.newbyteorder("="))
            except (ValueError, OverflowError) as error:
                self._fail(f"{error}; {count} numbers of type {kind} are expected")
            self._at = len(self._data) - len(rest)
            return values
        need = (count + 7) // 8 if bits else count * dtype.itemsize
        if need > len(self._data) - self._at:
            self._fail(f"{count} values need {need} bytes, {len(self._data) - self._at} are left: truncated")
        values = np.frombuffer(self._data, dtype, need // dtype.itemsize, self._at)
        self._at += need
        return np.unpackbits(values)[:count] if bits else values.astype(dtype.newbyteorder("="))

    def _line(self) -> list[str] | None:
        """Take the words of the next line that is not empty."""
        match = _BLANKS.match(self._data, self._at)
        self._at = match.end() if match else self._at
        if self._at >= len(self._data):
            return None
        return self._raw_line().decode("utf-8", "replace").split() or ["�"]

    def _raw_line(self) -> bytes:
        end = self._data.find(b"\n", self._at)
        end = len(self._data) if end < 0 else end
        line = self._data[self._at : end]
        self._at = min(end + 1, len(self._data))
        return line

    def _word(self, words: list[str], k: int) -> str:
        if len(words) <= k:
            self._fail(f"{' '.join(words)[:60]!r} needs {k} words after the keyword")
        return words[k]

    def _number(self, words: list[str], k: int) -> int:
        word = self._word(words, k)
        if not (word.isascii() and word.isdigit() and len(word) < 16):
            self._fail(f"{' '.join(words)[:60]!r}: {word[:40]!r} is not a count")
        return int(word)

    def _fail(self, problem: str) -> NoReturn:
        raise FormatError(
            self._path,
            problem,
            place=f"before byte {self._at}",
            remedy="the file may be truncated or damaged; check its source",
        )
