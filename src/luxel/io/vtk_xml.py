"""VTK XML files of points: .vtp and .vtu, in ASCII, base64 or raw binary, compressed or not, with or without cells.

Read here rather than by the vtk package: that is 140 MB, and it ends the process on some damaged files.
The format: https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html.
"""

from __future__ import annotations

import base64
import lzma
import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from luxel.errors import FormatError
from luxel.io.columns import Columns
from luxel.io.frame import Frame
from luxel.io.stream import Stream, guard
from luxel.io.vtk_arrays import to_frame, words_to_numbers

__all__ = ["VtkXmlReader"]

_KINDS = ("PolyData", "UnstructuredGrid")
_TYPE = re.compile(rb"<VTKFile[^>]*\btype\s*=\s*[\"']([^\"']*)[\"']")
_APPENDED = re.compile(rb"<AppendedData\b([^>]*)>\s*_")
_DTYPES = {
    f"{kind}{bits}": f"{code}{bits // 8}"
    for kind, code in (("Int", "i"), ("UInt", "u"))
    for bits in (8, 16, 32, 64)
}
_DTYPES |= {"Float32": "f4", "Float64": "f8"}

_MOST_FIELD_BYTES = 1 << 20


@dataclass(frozen=True)
class VtkXmlReader:
    """VTK XML files with points (.vtp, .vtu), one time step a file, with or without cells.

    What becomes of the arrays is as for :class:`luxel.io.vtk_legacy.VtkLegacyReader`. Several pieces make one set.
    """

    name: str = "vtk xml"
    suffixes: tuple[str, ...] = (".vtp", ".vtu")

    def sniff(self, head: bytes, path: Path) -> bool | None:
        """Recognise the root element."""
        return b"<VTKFile" in head

    def open(self, path: Path) -> VtkXmlSource:
        """Read the root element only."""
        stream = Stream(path)
        found = _TYPE.search(stream.head())
        kind = found[1].decode("utf-8", "replace") if found else ""
        if kind not in _KINDS:
            raise FormatError(
                path,
                f"a VTK file of type {kind!r}, expected PolyData or UnstructuredGrid",
                remedy="save the points as .vtp or .vtu",
            )
        return VtkXmlSource(stream)


class VtkXmlSource:
    """One XML file."""

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
        path = self._stream.path
        data = self._stream.read()
        appended = _APPENDED.search(data)
        payload, raw = b"", False
        if appended:  # may hold any byte, so it is cut off before the XML is parsed
            end = data.rfind(b"</AppendedData>")
            payload = data[appended.end() : end if end >= 0 else None]
            raw = b"raw" in appended[1]
            data = data[: appended.start()] + b"</VTKFile>"
        with guard(path, what="is not valid XML"):
            root = ElementTree.fromstring(data)
        decoder = _Decoder.of(root, payload, raw)
        body = next((root.find(kind) for kind in _KINDS if root.find(kind) is not None), None)
        if body is None:
            raise FormatError(path, "no PolyData or UnstructuredGrid in it", remedy="the file may be damaged")
        fields: Columns = {}
        for element in body.iterfind("FieldData/DataArray"):
            if element.get("Name") in {"TIME", "TimeValue", "Time", "time"}:
                with guard(path, f"field {element.get('Name')}"):
                    fields[element.get("Name", "")] = decoder.array(element, None)
        pieces = [self._piece(piece, decoder) for piece in body.iterfind("Piece")]
        if not pieces:
            return to_frame(np.zeros((0, 3)), {}, fields)
        positions = np.concatenate([points for points, _ in pieces])
        full = [arrays for points, arrays in pieces if len(points)] or [arrays for _, arrays in pieces]
        arrays = {
            name: np.concatenate([each[name] for each in full])
            for name in full[0]
            if all(name in each for each in full)
        }
        return to_frame(positions, arrays, fields)

    def _piece(self, piece: ElementTree.Element, decoder: _Decoder) -> tuple[NDArray[Any], Columns]:
        path = self._stream.path
        with guard(path, "NumberOfPoints"):
            count = int(piece.get("NumberOfPoints", "0"))
            if count < 0:
                raise ValueError(f"{count} points")
        points = piece.find("Points/DataArray")
        if points is None:
            if count:
                raise FormatError(
                    path, f"{count} points without coordinates", remedy="the file may be damaged"
                )
            return np.zeros((0, 3)), {}
        with guard(path, "the points"):
            positions = decoder.array(points, count).reshape(count, 3)
        arrays: Columns = {}
        for number, element in enumerate(piece.iterfind("PointData/DataArray")):
            name = element.get("Name") or f"array{number}"
            if element.get("type") not in _DTYPES:  # text
                continue
            with guard(path, f"array {name}"):
                arrays[name] = decoder.array(element, count)
        return positions, arrays


@dataclass(frozen=True)
class _Decoder:
    """Decodes DataArray elements; raises ValueError and the like for damaged ones."""

    order: str
    header: np.dtype[Any]
    compressor: str
    payload: bytes
    raw: bool

    @classmethod
    def of(cls, root: ElementTree.Element, payload: bytes, raw: bool) -> _Decoder:
        order = ">" if root.get("byte_order") == "BigEndian" else "<"
        header = np.dtype(order + ("u8" if root.get("header_type") == "UInt64" else "u4"))
        return cls(order, header, root.get("compressor", ""), payload, raw)

    def array(self, element: ElementTree.Element, count: int | None) -> NDArray[Any]:
        """Decode (count,) or (count, k) numbers; count None takes what is there."""
        code = _DTYPES.get(element.get("type", ""))
        if code is None:
            raise ValueError(f"type {element.get('type')!r} is not known")
        width = int(element.get("NumberOfComponents", "1"))
        if not 0 < width < 1000:
            raise ValueError(f"{width} components")
        dtype = np.dtype(self.order + code)
        need = None if count is None else count * width
        form = element.get("format", "ascii")
        if form == "ascii":
            values = words_to_numbers((element.text or "").split(), dtype.newbyteorder("="))
        else:
            if form == "appended":
                offset = int(element.get("offset", "0"))
                if not 0 <= offset <= len(self.payload):
                    raise ValueError(f"offset {offset} lies outside the {len(self.payload)} appended bytes")
                source, raw = memoryview(self.payload)[offset:], self.raw
            else:
                source, raw = memoryview("".join((element.text or "").split()).encode("ascii")), False
            need_bytes = None if need is None else need * dtype.itemsize
            data = self._unpack(source, raw, need_bytes) if len(source) or need else b""
            values = np.frombuffer(data, dtype).astype(dtype.newbyteorder("="))
        if need is not None and len(values) != need:
            raise ValueError(f"{len(values)} numbers where {count} points need {need}")
        return values if width == 1 else values.reshape(-1, width)

    def _unpack(self, source: memoryview, raw: bool, need: int | None) -> bytes:
        """Undo base64 and compression. Sizes are checked before memory is taken for them."""
        size = self.header.itemsize
        if not self.compressor:
            # The length may be encoded by itself, with padding, or in one go with the data.
            alone = not raw and bytes(source[: _coded(size)]).endswith(b"=")
            length = int(self._header(source, raw, 1)[0])
            self._agree(length, need)
            if raw:
                return self._exact(bytes(source[size : size + length]), length)
            if alone:
                return self._exact(_decode(source[_coded(size) : _coded(size) + _coded(length)]), length)
            return self._exact(_decode(source[: _coded(size + length)])[size:], length)
        blocks = int(self._header(source, raw, 1)[0])
        if blocks * size > len(source):
            raise ValueError(f"{blocks} compressed blocks in {len(source)} bytes")
        if blocks == 0:
            return b""
        header = [int(value) for value in self._header(source, raw, 3 + blocks)]
        full, last, packed = header[1], header[2], header[3:]
        sizes = [full] * (blocks - 1) + [last or full]
        self._agree(sum(sizes), need)
        at = (3 + blocks) * size if raw else _coded((3 + blocks) * size)
        total = sum(packed)
        data = bytes(source[at : at + total]) if raw else _decode(source[at : at + _coded(total)])
        self._exact(data, total)
        parts, start = [], 0
        for packed_bytes, block_bytes in zip(packed, sizes, strict=True):
            parts.append(self._inflate(data[start : start + packed_bytes], block_bytes))
            start += packed_bytes
        return b"".join(parts)

    def _header(self, source: memoryview, raw: bool, count: int) -> NDArray[Any]:
        need = count * self.header.itemsize
        data = bytes(source[:need]) if raw else _decode(source[: _coded(need)])[:need]
        return np.frombuffer(self._exact(data, need), self.header)

    def _inflate(self, data: bytes, size: int) -> bytes:
        if self.compressor == "vtkZLibDataCompressor":
            return self._exact(zlib.decompressobj().decompress(data, size + 1), size)
        if self.compressor == "vtkLZMADataCompressor":
            return self._exact(lzma.LZMADecompressor(memlimit=1 << 28).decompress(data, size + 1), size)
        raise ValueError(
            f"compressor {self.compressor!r} is not known; save the file with zlib or uncompressed"
        )

    def _agree(self, length: int, need: int | None) -> None:
        if need is None and length > _MOST_FIELD_BYTES:
            raise ValueError(f"{length} bytes in a field that should hold one number")
        if need is not None and length != need:
            raise ValueError(f"{length} bytes where {need} are expected")

    def _exact(self, data: bytes, size: int) -> bytes:
        if len(data) != size:
            raise ValueError(f"{len(data)} bytes where {size} are expected: truncated or damaged")
        return data


def _coded(size: int) -> int:
    """Return how many characters of base64 hold `size` bytes."""
    return (size + 2) // 3 * 4


def _decode(text: memoryview) -> bytes:
    return base64.b64decode(bytes(text), validate=True)
