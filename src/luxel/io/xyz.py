"""XYZ files, plain and extended.

Extended XYZ: https://github.com/libAtoms/extxyz.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from luxel.errors import FormatError
from luxel.io.columns import find_radii, tidy
from luxel.io.frame import Frame
from luxel.io.stream import Stream
from luxel.io.table import Fail, parse_table
from luxel.particles import Cell

__all__ = ["XyzReader"]

_PAIR = re.compile(r"""([^\s=]+)(?:\s*=\s*("(?:[^"\\]|\\.)*"|'[^']*'|\{[^}]*\}|\[[^\]]*\]|[^\s]*))?""")
_PLAIN = (("species", "S", 1), ("pos", "R", 3))
_POSITIONS = ("pos", "position", "positions", "coord", "coords")
_TRUE, _FALSE = {"t", "true"}, {"f", "false"}
_MAX_HEADER_BYTES = 1 << 20  # a count line and a comment are shorter
_MAX_COLUMNS = 10_000

Property = tuple[str, str, int]


@dataclass(frozen=True)
class XyzReader:
    """XYZ and extended XYZ, any number of time steps.

    ``Properties=`` names the columns, ``Lattice=`` and ``pbc=`` the cell, ``Time=`` the time. Text columns such as species become
    codes with labels; logical ones 0 and 1. Without Properties the columns are species, x, y, z, and
    further numbers are named column5, column6 …
    """

    name: str = "xyz"
    suffixes: tuple[str, ...] = (".xyz", ".extxyz", ".exyz")

    def sniff(self, head: bytes, path: Path) -> bool | None:
        """Recognise a count line, and below the comment a species with three numbers."""
        lines = head.split(b"\n", 3)
        if b"\0" in head or len(lines) < 2:
            return False
        if not lines[0].strip().isdigit():
            # A bare table of points is often called .xyz too.
            return False if len(lines[0].split()) > 1 else None
        if b"Properties=" in lines[1]:
            return True
        fields = lines[2].split() if len(lines) > 2 else []
        if len(fields) < 4:
            return None
        return all(_is_float(field) for field in fields[1:4]) or None

    def open(self, path: Path) -> XyzSource:
        """Find where the time steps start."""
        return XyzSource(Stream(path))


@dataclass(frozen=True)
class _Step:
    start: int  # byte offsets; the count line comes first
    stop: int
    line: int  # the count line's number, from 1
    count: int


class XyzSource:
    """The time steps of an XYZ file."""

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._steps = _index(stream)
        self.times: Sequence[float | None] = [None] * len(self._steps)

    @property
    def frame_count(self) -> int:
        """The number of time steps."""
        return len(self._steps)

    def particle_count(self, frame: int) -> int | None:
        """Return the count line."""
        return self._steps[frame].count

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def read(self, frame: int) -> Frame:
        """Decode a step."""
        step = self._steps[frame]
        _, comment, body = (*self._stream.read(step.start, step.stop).split(b"\n", 2), b"", b"")[:3]

        def fail(line: int | None, problem: str) -> NoReturn:
            place = f"frame {frame}" + ("" if line is None else f", line {step.line + 2 + line}")
            raise FormatError(
                self._stream.path,
                problem,
                place=place,
                remedy="the file may be truncated or edited; check it",
            )

        keys = _parse_comment(comment.decode("utf-8", "replace"))
        properties = _properties(keys, body, fail)
        fields = [
            name if width == 1 else f"{name}[{k}]" for name, _, width in properties for k in range(width)
        ]
        kinds = [kind for _, kind, width in properties for _ in range(width)]
        text = {field for field, kind in zip(fields, kinds, strict=True) if kind in "SL"}
        arrays = parse_table(body, fields, fail, text=text)
        rows = len(arrays[0])
        if rows != step.count:
            fail(None, f"{rows} lines of particles where the count line promises {step.count}: truncated")
        columns: dict[str, NDArray[Any]] = {}
        at = 0
        for prop in properties:
            name, _, width = prop
            if name in columns:
                fail(-1, f"Properties names {name!r} twice")
            columns[name] = _column(prop, arrays[at : at + width], fail)
            at += width
        positions = _take_positions(columns, fail)
        radii, source = find_radii(columns) or (None, None)
        scalars, categories = tidy(columns)
        return Frame(positions, scalars, radii, source, categories, _cell(keys, fail), _time(keys))


def _index(stream: Stream) -> list[_Step]:
    """Find the steps by counting lines in one pass."""
    steps: list[_Step] = []
    head = b""  # the beginning of a count line, at the end of a chunk
    size, line = 0, 0
    skip = 0  # lines of the current step still to come
    start, count = 0, 0

    def begin(text: bytes) -> None:
        nonlocal count, skip
        text = text.strip()
        if not text.isdigit() or len(text) > 15:
            shown = text[:40].decode("utf-8", "replace")
            raise FormatError(
                stream.path,
                f"the number of particles is expected, got {shown!r}",
                place=f"line {line}",
                remedy="check the count line of the time step above it",
            )
        count = int(text)
        skip = count + 1
        steps.append(_Step(start, start, line, count))

    for chunk in stream.chunks():
        ends = np.flatnonzero(np.frombuffer(chunk, dtype=np.uint8) == 10)
        at, k = 0, 0  # byte and line within the chunk
        while k < len(ends):
            if skip:
                taken = min(skip, len(ends) - k)
                skip, k, line = skip - taken, k + taken, line + taken
                at = int(ends[k - 1]) + 1
                if not skip:
                    steps[-1] = _Step(start, size + at, steps[-1].line, count)
                continue
            text = head + chunk[at : int(ends[k])]
            start = size + at - len(head)
            head = b""
            line, k, at = line + 1, k + 1, int(ends[k]) + 1
            if text.strip():  # empty lines between steps are harmless
                begin(text)
        if not skip:
            head += chunk[at:]
            if len(head) > _MAX_HEADER_BYTES:
                raise FormatError(stream.path, "no line end in a megabyte", place=f"line {line + 1}")
        size += len(chunk)
    if skip:  # the last line may lack its end, or the step is truncated: reading it will tell
        steps[-1] = _Step(start, size, steps[-1].line, count)
    elif head.strip():
        start, line = size - len(head), line + 1
        begin(head)
        steps[-1] = _Step(start, size, line, count)
    if not steps:
        raise FormatError(
            stream.path, "no time steps", remedy="an XYZ file starts with the number of particles"
        )
    return steps


def _parse_comment(text: str) -> dict[str, str]:
    """Split ``key=value key="a b" flag`` into a mapping."""
    return {match[1]: (match[2] or "T").strip("\"'") for match in _PAIR.finditer(text)}


def _properties(keys: dict[str, str], body: bytes, fail: Fail) -> list[Property]:
    text = keys.get("Properties", keys.get("properties"))
    if text is None:
        width = len(body.lstrip().split(b"\n", 1)[0].split())
        if body.strip() and width < 4:
            fail(0, f"{width} fields where species, x, y, z are expected")
        return [*_PLAIN, *((f"column{k}", "R", 1) for k in range(5, width + 1))]
    parts = text.split(":")
    found: list[Property] = []
    for name, kind, width_text in zip(parts[::3], parts[1::3], parts[2::3], strict=False):
        valid = name and kind in {"S", "R", "I", "L"} and width_text.isdecimal() and len(width_text) < 6
        if not valid or int(width_text) < 1:
            fail(-1, f"Properties has {name}:{kind}:{width_text}, expected name:S|R|I|L:width")
        found.append((name, kind, int(width_text)))
    if len(parts) % 3 or not found or sum(width for _, _, width in found) > _MAX_COLUMNS:
        fail(-1, f"Properties must be name:type:width …, got {text[:80]!r}")
    return found


def _column(prop: Property, arrays: Sequence[NDArray[Any]], fail: Fail) -> NDArray[Any]:
    name, kind, width = prop
    parts = []
    for array in arrays:
        if kind == "S":
            parts.append(array if array.dtype.kind == "U" else array.astype(str))  # a step without particles
        elif kind == "L":
            parts.append(_logical(name, array, fail))
        elif array.dtype.kind != "f":
            fail(0, f"{str(array[0])[:40]!r} in column {name} is not a number")
        elif kind == "I":
            bad = ~(np.isfinite(array) & (array == np.rint(array)) & (np.abs(array) < 2.0**53))
            if bad.any():
                row = int(np.argmax(bad))
                fail(row, f"{array[row]:g} in column {name} is not a whole number")
            parts.append(array.astype(np.int64))
        else:
            parts.append(array)
    if width == 1:
        return parts[0]
    if kind == "S":  # several words make one label
        joined = parts[0]
        for part in parts[1:]:
            joined = np.char.add(np.char.add(joined, " "), part)
        return joined
    return np.stack(parts, axis=1)


def _logical(name: str, array: NDArray[Any], fail: Fail) -> NDArray[np.uint8]:
    words = {word: word.lower() for word in set(array.tolist())}
    wrong = [word for word, lower in words.items() if lower not in _TRUE | _FALSE]
    if wrong:
        row = int(np.argmax(np.isin(array, wrong)))
        fail(row, f"{str(array[row])[:40]!r} in column {name} is not T or F")
    return np.isin(array, [word for word, lower in words.items() if lower in _TRUE]).astype(np.uint8)


def _take_positions(columns: dict[str, NDArray[Any]], fail: Fail) -> NDArray[Any]:  # noqa: RET503  fail raises
    for name in _POSITIONS:
        if name in columns:
            positions = columns.pop(name)
            if positions.ndim != 2 or positions.shape[1] != 3 or positions.dtype.kind not in "fiu":
                fail(-1, f"the positions {name!r} must be three real numbers: {name}:R:3")
            return positions
    fail(-1, f"Properties has no positions (pos:R:3); it names {', '.join(columns)[:200]}")


def _cell(keys: dict[str, str], fail: Fail) -> Cell | None:
    text = keys.get("Lattice", keys.get("lattice"))
    if text is None:
        return None
    numbers = _floats(text)
    if numbers is None or len(numbers) not in {3, 9} or not np.isfinite(numbers).all():
        fail(-1, f"Lattice must be nine finite numbers, got {text[:80]!r}")
    vectors = np.diag(numbers) if len(numbers) == 3 else np.reshape(numbers, (3, 3))
    flags = keys.get("pbc", "T T T").replace(",", " ").strip("[]{}").split()
    origin = _floats(keys.get("Origin", keys.get("origin", "0 0 0")))
    if origin is None or len(origin) != 3:
        fail(-1, "Origin must be three numbers")
    periodic = (
        tuple(flag.lower() in _TRUE or flag == "1" for flag in flags)
        if len(flags) == 3
        else (True, True, True)
    )
    return Cell(vectors, np.array(origin), periodic)  # type: ignore[arg-type]


def _time(keys: dict[str, str]) -> float | None:
    for key in ("Time", "time"):
        values = _floats(keys.get(key, ""))
        if values and len(values) == 1 and np.isfinite(values[0]):
            return values[0]
    return None


def _floats(text: str) -> list[float] | None:
    try:
        return [float(word) for word in text.replace(",", " ").strip("[]{} ").split()]
    except ValueError:
        return None


def _is_float(text: bytes) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
