"""LAMMPS dump files in text form.

The format: https://docs.lammps.org/dump.html, boxes: https://docs.lammps.org/Howto_triclinic.html.
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
from luxel.io.table import parse_table
from luxel.particles import Cell

__all__ = ["LammpsReader"]

_MARK = re.compile(rb"ITEM:[ \t]+(TIMESTEP|TIME|NUMBER OF ATOMS)[ \t\r]*\n[ \t]*([^\s]*)[^\n]*\n")
_MARK_BYTES = 512  # longer than any mark, to find those across two chunks
# Wrapped before unwrapped, plain before scaled.
_POSITIONS = (("x", "y", "z"), ("xu", "yu", "zu"), ("xs", "ys", "zs"), ("xsu", "ysu", "zsu"))


@dataclass(frozen=True)
class LammpsReader:
    """LAMMPS ``dump custom`` and ``dump atom`` text files with any number of time steps.

    Atoms are sorted by id where there is one, so that they keep their index through time. Scaled positions become
    plain ones. ``vx vy vz``, ``fx fy fz``, ``omegax …``, ``mux …`` and ``c_S[1] … c_S[n]`` become vectors. The time is the dump's
    TIME, or else the number of the time step.
    """

    name: str = "lammps dump"
    suffixes: tuple[str, ...] = (".dump", ".lammpstrj", ".lammpsdump")

    def sniff(self, head: bytes, path: Path) -> bool | None:
        """Recognise the first ITEM line."""
        return head.lstrip().startswith(b"ITEM:")

    def open(self, path: Path) -> LammpsSource:
        """Find where the time steps start."""
        return LammpsSource(Stream(path))


@dataclass(frozen=True)
class _Step:
    start: int  # byte offsets
    stop: int
    count: int | None
    time: float | None


class LammpsSource:
    """The time steps of a dump."""

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._steps = _index(stream)
        self.times: Sequence[float | None] = [step.time for step in self._steps]

    @property
    def frame_count(self) -> int:
        """The number of time steps."""
        return len(self._steps)

    def particle_count(self, frame: int) -> int | None:
        """Return NUMBER OF ATOMS."""
        return self._steps[frame].count

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def read(self, frame: int) -> Frame:
        """Decode a step."""
        step = self._steps[frame]
        return _Parser(self._stream, frame, step).frame()


def _index(stream: Stream) -> list[_Step]:
    """Find the steps in one pass, without parsing their atoms."""
    marks: list[tuple[int, bytes, bytes]] = []
    tail, offset, size = b"", 0, 0
    for chunk in stream.chunks():
        size += len(chunk)
        text = tail + chunk
        kept = max(0, len(text) - _MARK_BYTES)
        for match in _MARK.finditer(text):
            kept = max(kept, match.end())  # not to be found again
            marks.append((offset + match.start(), match[1], match[2]))
        tail, offset = text[kept:], offset + kept
    # A last step that is cut short may end inside a mark, or without a newline after it.
    marks += [(offset + match.start(), match[1], match[2]) for match in _MARK.finditer(tail + b"\n")]

    starts: list[int] = []
    counts: list[int | None] = []
    times: list[float | None] = []
    time: float | None = None
    begin: int | None = None
    for where, item, value in marks:
        if item == b"TIME":  # stands before its TIMESTEP
            time, begin = _number(value), where
        elif item == b"TIMESTEP":
            starts.append(where if begin is None else begin)
            times.append(_number(value) if time is None else time)
            counts.append(None)
            time = begin = None
        elif counts and counts[-1] is None and value.isdigit() and len(value) < 16:
            counts[-1] = int(value)
    if not starts:
        raise FormatError(
            stream.path,
            "no 'ITEM: TIMESTEP' line",
            remedy="the file is no LAMMPS dump, or it is truncated; check its source",
        )
    stops = [*starts[1:], size]
    return [_Step(*values) for values in zip(starts, stops, counts, times, strict=True)]


class _Parser:
    """Parses one step; knows where it stands, for messages."""

    def __init__(self, stream: Stream, index: int, step: _Step) -> None:
        self._stream = stream
        self._index = index
        self._step = step
        self._data = stream.read(step.start, step.stop)
        self._line = 0  # lines of the step already read
        self._at = 0

    def frame(self) -> Frame:
        count, cell, names = self._header()
        end = self._data.find(
            b"ITEM:", self._at
        )  # items ahead of the next step's TIMESTEP, perhaps cut short
        body = self._data[self._at : end if end >= 0 else None]
        first = self._line

        def fail(line: int | None, problem: str) -> NoReturn:
            self._fail(problem, None if line is None else first + line)

        arrays = parse_table(body, names, fail)
        rows = len(arrays[0]) if arrays else 0
        if rows != count:
            self._fail(f"{rows} atoms where NUMBER OF ATOMS promises {count}", None)
        columns = dict(zip(names, arrays, strict=True))
        positions = self._positions(columns, cell)
        radii, source = find_radii(columns) or (None, None)
        scalars, categories = tidy(columns)
        frame = Frame(positions, scalars, radii, source, categories, cell, self._step.time)
        return _sort_by_id(frame)

    def _header(self) -> tuple[int, Cell | None, list[str]]:  # noqa: RET503  _fail raises
        count: int | None = None
        cell: Cell | None = None
        while (text := self._next()) is not None:
            item, _, rest = text.partition(":")
            words = rest.split()
            if not text:
                continue
            if item != "ITEM":
                self._fail(f"an 'ITEM:' line is expected, got {text[:60]!r}", self._line - 1)
            if words[:1] == ["ATOMS"]:
                if count is None:
                    self._fail("ATOMS come before NUMBER OF ATOMS", self._line - 1)
                if not words[1:]:
                    self._fail("the ATOMS line names no columns", self._line - 1)
                twice = {word for word in words if words.count(word) > 1}
                if twice:
                    self._fail(f"column {min(twice)!r} appears twice", self._line - 1)
                return count, cell, words[1:]
            if words == ["NUMBER", "OF", "ATOMS"]:
                value = self._next() or ""
                if not (value.isascii() and value.isdigit() and len(value) < 16):
                    self._fail(f"the number of atoms is {value[:40]!r}", self._line - 1)
                count = int(value)
            elif words[:2] == ["BOX", "BOUNDS"]:
                cell = self._box(words[2:])
            else:  # TIMESTEP, TIME, UNITS and whatever comes next: one line each
                self._next()
        self._fail("the step ends before its 'ITEM: ATOMS' line", None)

    def _box(self, words: Sequence[str]) -> Cell:
        general = words[:2] == ["abc", "origin"]
        tilted = words[:3] == ["xy", "xz", "yz"]
        flags = words[2:] if general else words[3:] if tilted else words
        width = 4 if general else 3 if tilted else 2
        rows = []
        for _ in range(3):
            fields = (self._next() or "").split()
            try:
                row = [float(field) for field in fields]
            except ValueError:
                row = []
            # An upright box may be written with zero tilts.
            if len(row) != width and not (width == 2 and len(row) == 3 and row[2] == 0):
                self._fail(
                    f"a line of BOX BOUNDS needs {width} numbers, got {' '.join(fields)[:80]!r}",
                    self._line - 1,
                )
            rows.append(row[:width])
        box = np.array(rows)
        if not np.isfinite(box).all():
            self._fail("the box is not finite", self._line - 1)
        if len(flags) == 3:
            periodic = tuple(flag.startswith("p") for flag in flags)
        else:
            periodic = (True, True, True)
        if general:
            return Cell(box[:, :3], box[:, 3], periodic)  # type: ignore[arg-type]
        xy, xz, yz = box[:, 2] if tilted else (0.0, 0.0, 0.0)
        # The file holds the bounding box of the tilted cell.
        low = box[:, 0] - [min(0.0, xy, xz, xy + xz), min(0.0, yz), 0.0]
        high = box[:, 1] - [max(0.0, xy, xz, xy + xz), max(0.0, yz), 0.0]
        size = high - low
        if (size < 0).any():
            self._fail("the box has a negative size", self._line - 1)
        vectors = np.array([[size[0], 0, 0], [xy, size[1], 0], [xz, yz, size[2]]])
        return Cell(vectors, low, periodic)  # type: ignore[arg-type]

    def _positions(self, columns: dict[str, NDArray[Any]], cell: Cell | None) -> NDArray[Any]:  # noqa: RET503
        for names in _POSITIONS:
            if not all(name in columns for name in names):
                continue
            values = [columns.pop(name) for name in names]
            for name, column in zip(names, values, strict=True):
                if column.dtype.kind != "f":
                    self._fail(f"column {name} is a position but holds text", None)
            positions = np.stack(values, axis=1)
            if names[0] not in {"xs", "xsu"}:
                return positions
            if cell is None:
                self._fail(f"positions {' '.join(names)} are scaled, but the step has no box", None)
            return positions @ cell.vectors + cell.origin
        self._fail(f"no positions (x y z, or xu, xs, xsu …); the columns are {' '.join(columns)[:200]}", None)

    def _next(self) -> str | None:
        if self._at >= len(self._data):
            return None
        end = self._data.find(b"\n", self._at)
        end = len(self._data) if end < 0 else end
        text = self._data[self._at : end].decode("utf-8", "replace").strip()
        self._at = end + 1
        self._line += 1
        return text

    def _fail(self, problem: str, line: int | None) -> NoReturn:
        place = f"frame {self._index}"
        if line is not None:
            place += f", line {self._stream.line_number(self._step.start) + line}"
        raise FormatError(
            self._stream.path,
            problem,
            place=place,
            remedy="the file may be truncated or edited; check its source",
        )


def _sort_by_id(frame: Frame) -> Frame:
    ids = frame.scalars.get("id")
    if ids is None or ids.ndim != 1 or (np.diff(ids) > 0).all():
        return frame
    order = np.argsort(ids, kind="stable")
    return Frame(
        frame.positions[order],
        {name: values[order] for name, values in frame.scalars.items()},
        None if frame.radii is None else frame.radii[order],
        frame.radii_source,
        frame.categories,
        frame.cell,
        frame.time,
    )


def _number(text: bytes) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None
