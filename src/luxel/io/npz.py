"""NumPy files: .npz with named arrays, .npy with positions alone."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxel.errors import FormatError
from luxel.io.columns import Columns, find_positions, find_radii, tidy
from luxel.io.frame import Frame
from luxel.io.stream import Stream, guard

__all__ = ["NpzReader"]

_NPY_MAGIC = b"\x93NUMPY"
_POSITIONS = ("position", "positions", "points", "pos", "xyz", "coordinates")


@dataclass(frozen=True)
class NpzReader:
    """NumPy archives, one time step a file.

    ``position`` (or positions, points, pos, xyz, coordinates) of shape (N, 3), or x, y and z of shape (N,), hold the
    positions; radius, radii, rad or diameter the radii; a single number ``time`` the time. Every other array whose first
    axis is N becomes a scalar, text as codes with labels; the rest is ignored. A .npy file holds positions (N, 3).
    Pickled objects are never loaded.
    """

    name: str = "npz"
    suffixes: tuple[str, ...] = (".npz", ".npy")

    def sniff(self, head: bytes, path: Path) -> bool | None:
        """Recognise an array file, or a zip archive that is called .npz or starts with an array."""
        if head.startswith(_NPY_MAGIC):
            return True
        if head.startswith(b"PK\x03\x04"):
            return b".npy" in head[:256] or path.suffix.lower() == ".npz"
        return False if path.suffix.lower() not in self.suffixes else None

    def open(self, path: Path) -> NpzSource:
        """Open an archive without reading it."""
        return NpzSource(Stream(path))


class NpzSource:
    """One archive."""

    frame_count = 1
    times: Sequence[float | None] = (None,)

    def __init__(self, stream: Stream) -> None:
        self._stream = stream

    def particle_count(self, frame: int) -> int | None:
        """Return None: only reading the archive tells."""
        return None

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def read(self, frame: int) -> Frame:
        """Read the arrays."""
        path = self._stream.path
        if self._stream.head(8).startswith(_NPY_MAGIC):
            arrays = {"position": self._array("position", self._stream.read())}
        else:
            arrays = self._archive()
        positions = self._positions(arrays)
        count = len(positions)
        time = arrays.pop("time", None)
        columns: Columns = {}
        for name, values in arrays.items():
            if values.ndim and len(values) == count and values.dtype.kind in "fiubUS":
                columns[name] = values if values.ndim < 3 else values.reshape(count, -1)
        for name in ("radius", "radii", "diameter"):
            if name in arrays and name not in columns:
                if arrays[name].size != 1 or arrays[name].dtype.kind not in "fiu":
                    raise FormatError(
                        path,
                        f"shape {arrays[name].shape} does not fit {count} particles",
                        place=f"array {name}",
                        remedy="give one radius a particle, or a single one",
                    )
                columns[name] = np.full(count, arrays[name].reshape(()))
        radii, source = find_radii(columns) or (None, None)
        scalars, categories = tidy(columns)
        single = (
            None
            if time is None or time.size != 1 or time.dtype.kind not in "fiu"
            else float(time.reshape(()))
        )
        return Frame(positions, scalars, radii, source, categories, None, single)

    def _archive(self) -> dict[str, NDArray[Any]]:
        arrays = {}
        with zipfile.ZipFile(io.BytesIO(self._stream.read())) as archive:
            for name in archive.namelist():
                if name.endswith(".npy"):
                    with guard(self._stream.path, f"array {name[:-4]}"):
                        arrays[name[:-4]] = self._array(name[:-4], archive.read(name))
        return arrays

    def _array(self, name: str, data: bytes) -> NDArray[Any]:
        """Decode one .npy; its header is checked against the bytes that are there before memory is taken."""
        file = io.BytesIO(data)
        version = np.lib.format.read_magic(file)
        if version == (1, 0):
            shape, fortran, dtype = np.lib.format.read_array_header_1_0(file)
        elif version == (2, 0):
            shape, fortran, dtype = np.lib.format.read_array_header_2_0(file)
        else:
            raise ValueError(f".npy version {version} is not known")
        if dtype.hasobject:
            return np.empty(0)  # pickled objects may run code: never loaded, never a scalar
        count = 1
        for size in shape:
            count *= size
        have = len(data) - file.tell()
        if min(shape, default=0) < 0 or count * dtype.itemsize != have:
            raise FormatError(
                self._stream.path,
                f"{have} bytes where shape {shape} of {dtype} needs {count * dtype.itemsize}",
                place=f"array {name}",
                remedy="the file is truncated or damaged",
            )
        if have == 0:
            return np.empty(shape, dtype)
        flat = np.frombuffer(data, dtype, offset=file.tell())
        array = flat.reshape(shape, order="F" if fortran else "C")
        # Big-endian files become native.
        return array.astype(dtype.newbyteorder("="), copy=False) if dtype.kind in "fiu" else array

    def _positions(self, arrays: dict[str, NDArray[Any]]) -> NDArray[Any]:
        for name in _POSITIONS:
            if name in arrays:
                positions = arrays.pop(name)
                if positions.ndim != 2 or positions.shape[1] != 3:
                    raise FormatError(
                        self._stream.path,
                        f"shape {positions.shape}, expected (N, 3)",
                        place=f"array {name}",
                        remedy="save positions with one row of x, y, z a particle",
                    )
                return positions
        names = find_positions(list(arrays))
        if names is None:
            raise FormatError(
                self._stream.path,
                f"no array 'position', nor x, y, z; the arrays are {', '.join(arrays)[:200] or 'none'}",
                remedy="save positions as an array 'position' of shape (N, 3)",
            )
        parts = [arrays.pop(name) for name in names]
        if any(part.ndim != 1 or len(part) != len(parts[0]) for part in parts):
            raise FormatError(
                self._stream.path,
                f"shapes {', '.join(str(part.shape) for part in parts)}, expected three times (N,)",
                place=f"arrays {' '.join(names)}",
                remedy="save x, y, z with one number a particle",
            )
        return np.stack(parts, axis=1)
