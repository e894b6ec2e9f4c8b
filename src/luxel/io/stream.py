"""Bytes of a file, compressed or not, addressed by their decompressed offset."""

from __future__ import annotations

import bz2
import contextlib
import gzip
import lzma
import os
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO, cast

from luxel.errors import FormatError, InputError, LuxelError

__all__ = ["COMPRESSED_SUFFIXES", "Stream", "bare_suffix", "guard"]

COMPRESSED_SUFFIXES = (".gz", ".bz2", ".xz")
_CHUNK_BYTES = 4 << 20

_OPENERS: tuple[tuple[bytes, Callable[[Path], BinaryIO]], ...] = (
    (b"\x1f\x8b", lambda path: cast("BinaryIO", gzip.open(path, "rb"))),  # noqa: SIM115
    (b"BZh", lambda path: cast("BinaryIO", bz2.open(path, "rb"))),  # noqa: SIM115
    (b"\xfd7zXZ\x00", lambda path: cast("BinaryIO", lzma.open(path, "rb"))),  # noqa: SIM115
)

# What decoders raise when their input is damaged. Programming errors other than these stay visible.
_DECODE_ERRORS = (
    ArithmeticError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    SyntaxError,  # xml.etree.ElementTree.ParseError is one
    ValueError,
    lzma.LZMAError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)


@contextlib.contextmanager
def guard(path: str | os.PathLike[str], place: str = "", what: str = "cannot be read") -> Iterator[None]:
    """Turn whatever a decoder raises on damaged input into a FormatError that names `path` and `place`."""
    try:
        yield
    except InputError as error:  # from a value built from the file, such as its cell
        raise FormatError(path, str(error), place=place) from error
    except LuxelError:
        raise
    except _DECODE_ERRORS as error:
        if isinstance(error, OSError) and error.strerror:
            cause = error.strerror
        else:
            cause = str(error) or type(error).__name__
        raise FormatError(
            path,
            f"{what}: {cause}",
            place=place,
            remedy="the file may be truncated or damaged; check its source",
        ) from error


def bare_suffix(path: str | os.PathLike[str]) -> str:
    """Return the suffix in lower case, looking through a compression suffix: ``.dump`` for ``a.dump.gz``."""
    path = Path(path)
    if path.suffix.lower() in COMPRESSED_SUFFIXES:
        path = path.with_suffix("")
    return path.suffix.lower()


class Stream:
    """A file's bytes, decompressed on the way; compression is recognised by content.

    Reading forward in a compressed file costs one pass in all; reading backward starts that pass again. Only a
    compressed file stays open between reads.

    Parameters
    ----------
    path
        An existing file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file: BinaryIO | None = None
        with guard(path), path.open("rb") as file:
            magic = file.read(8)
        self._opener = next((opener for start, opener in _OPENERS if magic.startswith(start)), None)

    @property
    def compressed(self) -> bool:
        """Whether offsets are not the file's own."""
        return self._opener is not None

    def head(self, size: int = 4096) -> bytes:
        """Return the first `size` bytes, or fewer when the file is shorter."""
        return self.read(0, size)

    def read(self, start: int = 0, stop: int | None = None) -> bytes:
        """Return the bytes in [start, stop), or up to the end of the file."""
        with guard(self.path), self._opened() as file:
            file.seek(start)
            return file.read() if stop is None else file.read(stop - start)

    def chunks(self) -> Iterator[bytes]:
        """Yield the whole file in pieces of a few megabytes."""
        with guard(self.path), self._opened() as file:
            file.seek(0)
            while chunk := file.read(_CHUNK_BYTES):
                yield chunk

    def line_number(self, offset: int) -> int:
        """Count the lines up to `offset`, the first line being 1; for messages only."""
        line, seen = 1, 0
        for chunk in self.chunks():
            line += chunk.count(b"\n", 0, max(0, offset - seen))
            seen += len(chunk)
            if seen >= offset:
                break
        return line

    @contextlib.contextmanager
    def plain_path(self) -> Iterator[Path]:
        """Give a path whose file is not compressed, for libraries that open files themselves."""
        if not self.compressed:
            yield self.path
            return
        with tempfile.TemporaryDirectory(prefix="luxel-") as folder:
            plain = Path(folder) / f"plain{bare_suffix(self.path)}"
            with plain.open("wb") as file:
                for chunk in self.chunks():
                    file.write(chunk)
            yield plain

    def close(self) -> None:
        """Close the file; a later read opens it again."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def __del__(self) -> None:
        if getattr(self, "_file", None) is not None:
            self.close()

    @contextlib.contextmanager
    def _opened(self) -> Iterator[BinaryIO]:
        if self._opener is None:
            with self.path.open("rb") as file:
                yield file
            return
        if self._file is None:
            self._file = self._opener(self.path)
        try:
            yield self._file
        except BaseException:
            self.close()  # a decompressor that failed is of no further use
            raise
