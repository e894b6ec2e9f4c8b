"""Zarr v3 arrays on disk, written one durable chunk at a time and read with every checksum checked.

Writing goes through a store in memory, so that each byte is what Zarr makes it, and then file by file to disk, where
a chunk is either whole or not there (``files.write_file``).
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.codecs import Crc32cCodec, ZstdCodec
from zarr.storage import MemoryStore

from luxel.errors import FormatError, InputError, LuxelError
from luxel.textures.store.files import write_file

__all__ = ["ArrayFiles", "StoredArray", "reading", "write_array", "write_group"]

_COMPRESSION_LEVEL = (
    1  # light is noise to a general compressor: higher levels take longer and gain a few per cent
)
_REMEDY = "it was damaged after luxel wrote it; take another copy, or bake again with --overwrite"


class ArrayFiles:
    """One array below a store's folder, made chunk by chunk along its first axis.

    Parameters
    ----------
    folder
        Of the array; made if it is not there.
    shape, dtype
        Of the whole array.
    chunk
        Rows in a chunk.
    attributes
        Of the array, fit for JSON.
    """

    def __init__(
        self,
        folder: Path,
        shape: tuple[int, ...],
        dtype: Any,
        chunk: int,
        attributes: Mapping[str, Any] | None = None,
    ) -> None:
        self.folder, self.chunk = folder, chunk
        self.count = math.ceil(shape[0] / chunk)
        self._rows = shape[0]
        self._depth = len(shape)
        self._files: dict[str, Any] = {}
        self._array = zarr.create_array(
            MemoryStore(store_dict=self._files),
            shape=shape,
            chunks=(chunk, *(max(1, size) for size in shape[1:])),
            dtype=dtype,
            compressors=[ZstdCodec(level=_COMPRESSION_LEVEL), Crc32cCodec()],
            fill_value=0,
            attributes=dict(attributes or {}),
            # A chunk of nothing but zeros must have a file, too: its file says that it is done.
            config={"write_empty_chunks": True},
        )
        if not (folder / "zarr.json").exists():
            write_file(folder / "zarr.json", self._files["zarr.json"].to_bytes())

    def rows(self, k: int) -> slice:
        """Return which rows chunk `k` holds."""
        return slice(k * self.chunk, min((k + 1) * self.chunk, self._rows))

    def path(self, k: int) -> Path:
        """Return the file of chunk `k`."""
        return self.folder / "c" / "/".join([str(k), *["0"] * (self._depth - 1)])

    def has(self, k: int) -> bool:
        """Whether chunk `k` is done."""
        return self.path(k).exists()

    def write(self, k: int, values: NDArray[Any]) -> None:
        """Write chunk `k`, for good."""
        self._array[self.rows(k)] = values
        name = self.path(k).relative_to(self.folder).as_posix()
        write_file(self.path(k), self._files.pop(name).to_bytes())


def write_array(
    folder: Path, values: NDArray[Any], chunk: int, attributes: Mapping[str, Any] | None = None
) -> None:
    """Write a whole array, chunk by chunk."""
    native = values.astype(values.dtype.newbyteorder("="), copy=False)
    files = ArrayFiles(folder, native.shape, native.dtype, chunk, attributes)
    for k in range(files.count):
        files.write(k, native[files.rows(k)])


def write_group(folder: Path, attributes: Mapping[str, Any] | None = None) -> None:
    """Write or replace the metadata of a group."""
    files: dict[str, Any] = {}
    zarr.create_group(MemoryStore(store_dict=files), attributes=dict(attributes or {}))
    write_file(folder / "zarr.json", files["zarr.json"].to_bytes())


class StoredArray:
    """An array of an open group, whole and checked: every chunk is there, and each is checked as it is read.

    Parameters
    ----------
    group
        Open Zarr group.
    name
        Of the array in it.
    path
        The store's, for messages.

    Raises
    ------
    FormatError
        If the array or any chunk of it is missing.
    """

    def __init__(self, group: Any, name: str, path: str) -> None:
        self._path, self._place = path, f"{group.path}/{name}".lstrip("/")
        with reading(path, self._place):
            self._array = group[name]
            # Zarr takes a chunk that is not there for one of zeros; here it is one that was lost.
            missing = self._array.nchunks - self._array.nchunks_initialized
            count = self._array.nchunks
            self.shape: tuple[int, ...] = tuple(self._array.shape)
            self.chunk: int = self._array.chunks[0]
            self.attributes: dict[str, Any] = dict(self._array.attrs)
        if missing:
            raise FormatError(
                path, f"{missing} of {count} chunks are missing", place=self._place, remedy=_REMEDY
            )

    def __getitem__(self, rows: slice) -> NDArray[Any]:
        """Return some rows; a FormatError names the chunks that are damaged."""
        first, last = rows.indices(self.shape[0])[:2]
        chunks = f"{first // self.chunk} … {max(first, last - 1) // self.chunk}"
        with reading(self._path, f"{self._place}, chunks {chunks}"):
            return np.asarray(self._array[rows])


@contextlib.contextmanager
def reading(path: str, place: str = "") -> Iterator[None]:
    """Turn whatever Zarr raises on damaged files into a FormatError that names the store and the place in it."""
    try:
        yield
    except InputError as error:  # from a value built from the store, such as its spec
        raise FormatError(path, str(error), place=place, remedy=_REMEDY) from error
    except LuxelError:
        raise
    except KeyError as error:
        raise FormatError(path, f"{error} is not there", place=place, remedy=_REMEDY) from error
    except (OSError, RuntimeError, ValueError, TypeError, LookupError, ArithmeticError) as error:
        reason = str(error) or type(error).__name__
        raise FormatError(path, f"cannot be read: {reason}", place=place, remedy=_REMEDY) from error
