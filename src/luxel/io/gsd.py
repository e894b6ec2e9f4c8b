"""GSD, the file format of HOOMD-blue, through the gsd package.

The schema: https://gsd.readthedocs.io/en/stable/schema-hoomd.html.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxel.errors import FormatError, MissingExtraError
from luxel.io.columns import Columns
from luxel.io.frame import Frame
from luxel.io.stream import Stream, guard
from luxel.particles import Cell

__all__ = ["GsdReader"]

_MAGIC = b"\xdf\x65\xdf\x65\xdf\x65\xdf\x65"
_SCALARS = (
    "velocity",
    "charge",
    "mass",
    "diameter",
    "body",
    "angmom",
    "moment_inertia",
    "orientation",
    "image",
)
_WIDTHS = {"velocity": 3, "angmom": 4, "moment_inertia": 3, "orientation": 4, "image": 3}
_MAX_CHUNKS_LISTED = 10_000


@dataclass(frozen=True)
class GsdReader:
    """GSD files of the hoomd schema, any number of time steps. Needs the extra ``gsd``.

    The radius is diameter / 2 where the file has diameters. ``typeid`` has its types' names as labels; velocity,
    charge, mass, orientation … and everything logged under ``log/particles/`` are scalars, if the file really
    has them (GSD's own defaults are not shown). The time is the number of the step.
    """

    name: str = "gsd"
    suffixes: tuple[str, ...] = (".gsd",)

    def sniff(self, head: bytes, path: Path) -> bool | None:
        """Recognise the magic number."""
        return head.startswith(_MAGIC)

    def open(self, path: Path) -> GsdSource:
        """Read the file's index."""
        return GsdSource(Stream(path))


class GsdSource:
    """The time steps of a GSD file."""

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._stack = contextlib.ExitStack()
        self._handle: Any = None
        with self._opened() as file:
            if file.schema != "hoomd":
                raise FormatError(
                    stream.path,
                    f"its schema is {file.schema!r}, expected 'hoomd'",
                    remedy="write it with gsd.hoomd",
                )
            self.frame_count = int(file.nframes)
        self.times: Sequence[float | None] = [None] * self.frame_count

    def particle_count(self, frame: int) -> int | None:
        """Return particles/N."""
        with self._opened() as file:
            return self._count(file, frame)

    def close(self) -> None:
        """Close the file."""
        self._handle = None
        self._stack.close()

    def __del__(self) -> None:
        self.close()

    def read(self, frame: int) -> Frame:
        """Decode a step."""
        with self._opened() as file:
            count = self._count(file, frame)
            positions = self._chunk(file, frame, "particles/position", count)
            if positions is None:
                positions = np.zeros((count, 3), np.float32)  # the schema's default
            self._shape("particles/position", positions, 3)
            scalars: Columns = {}
            categories: dict[str, tuple[str, ...]] = {}
            typeid = self._chunk(file, frame, "particles/typeid", count)
            if typeid is not None:
                scalars["typeid"] = typeid.astype(np.int64).astype(np.int32)
                categories["typeid"] = self._types(file, frame)
            for name in _SCALARS:
                values = self._chunk(file, frame, f"particles/{name}", count)
                if values is not None:
                    self._shape(f"particles/{name}", values, _WIDTHS.get(name, 1))
                    scalars[name] = values
            for name in file.find_matching_chunk_names("log/particles/")[:_MAX_CHUNKS_LISTED]:
                values = self._chunk(file, frame, name, count)
                if values is not None and values.dtype.kind in "fiu":
                    scalars[name.removeprefix("log/particles/")] = values
            step = self._chunk(file, frame, "configuration/step", None)
            box = self._chunk(file, frame, "configuration/box", None)
            time = None if step is None or step.size != 1 else float(step.reshape(()))
            diameter = scalars.get("diameter")
            radii = None if diameter is None else diameter / 2
            source = None if diameter is None else "half of particles/diameter"
            return Frame(positions, scalars, radii, source, categories, _cell(box), time)

    @contextlib.contextmanager
    def _opened(self) -> Iterator[Any]:
        try:
            import gsd.fl  # an optional package
        except ImportError as error:
            raise MissingExtraError("reading GSD", "gsd") from error
        with guard(self._stream.path):
            if self._handle is None:
                plain = self._stack.enter_context(self._stream.plain_path())
                self._handle = self._stack.enter_context(gsd.fl.open(name=str(plain), mode="r"))
            yield self._handle

    def _count(self, file: Any, frame: int) -> int:
        values = self._chunk(file, frame, "particles/N", None)
        if values is None:
            values = self._chunk(file, frame, "particles/position", None)
            return 0 if values is None else len(values)
        return int(values.reshape(-1)[0])

    def _chunk(self, file: Any, frame: int, name: str, count: int | None) -> NDArray[Any] | None:
        """Read a chunk: that of the frame, else that of frame 0 if it fits, as the schema says; else None."""
        where = next((k for k in (frame, 0) if file.chunk_exists(frame=k, name=name)), None)
        if where is None:
            return None
        with guard(self._stream.path, f"chunk {name}"):
            values = np.asarray(file.read_chunk(frame=where, name=name))
        if count is not None and len(values) != count:
            if where != frame:
                return None
            raise FormatError(
                self._stream.path,
                f"{len(values)} values for {count} particles",
                place=f"chunk {name}",
                remedy="the file may be damaged; check its source",
            )
        return values

    def _shape(self, name: str, values: NDArray[Any], width: int) -> None:
        if values.shape != ((len(values),) if width == 1 else (len(values), width)):
            raise FormatError(
                self._stream.path,
                f"shape {values.shape}, expected {width} numbers a particle",
                place=f"chunk {name}",
                remedy="the file may be damaged; check its source",
            )

    def _types(self, file: Any, frame: int) -> tuple[str, ...]:
        values = self._chunk(file, frame, "particles/types", None)
        if values is None:
            return ("A",)  # the schema's default
        if values.ndim != 2 or values.dtype.itemsize != 1:
            raise FormatError(self._stream.path, "not a table of characters", place="chunk particles/types")
        rows = values.astype(np.uint8).tolist()
        return tuple(bytes(row).split(b"\0", 1)[0].decode("utf-8", "replace") for row in rows)


def _cell(box: NDArray[Any] | None) -> Cell | None:
    """Build the cell from Lx Ly Lz and tilt factors; it is centred on zero."""
    if box is None or box.size != 6:
        return None
    lx, ly, lz, xy, xz, yz = (float(value) for value in box.reshape(-1))
    if not (lx > 0 and ly > 0 and lz >= 0):
        return None
    vectors = np.array([[lx, 0, 0], [xy * ly, ly, 0], [xz * lz, yz * lz, lz]])
    return Cell(vectors, -0.5 * vectors.sum(axis=0))
