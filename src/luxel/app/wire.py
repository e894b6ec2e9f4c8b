"""Bytes of a message: binary, free of input and output, and distrustful of what it is given.

A message is a header of eight bytes (kind, three bytes of padding, length of the JSON that follows), a JSON object padded to
a multiple of four bytes, and the raw little-endian arrays that its ``"arrays"`` entry lists, each padded to four bytes.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxel.errors import ProtocolError

__all__ = ["pack", "unpack"]

_HEADER = struct.Struct("<B3xI")
_HEAD_BYTES_MAX = 1 << 20
_DTYPES: dict[str, np.dtype[Any]] = {
    "u1": np.dtype("u1"),
    "i1": np.dtype("i1"),
    "u2": np.dtype("<u2"),
    "i2": np.dtype("<i2"),
    "i4": np.dtype("<i4"),
    "f2": np.dtype("<f2"),
    "f4": np.dtype("<f4"),
}
_CODES = {(dtype.kind, dtype.itemsize): code for code, dtype in _DTYPES.items()}


def pack(kind: int, head: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Return one message as bytes; arrays may be of 8- or 16-bit whole numbers, int32, float16 or float32."""
    listed = {}
    parts = []
    for name, array in arrays.items():
        listed[name] = [_CODES[array.dtype.kind, array.dtype.itemsize], list(array.shape)]
        raw = np.ascontiguousarray(array).astype(array.dtype.newbyteorder("<"), copy=False).tobytes()
        parts += [raw, bytes(-len(raw) % 4)]
    text = json.dumps({**head, "arrays": listed}, allow_nan=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    return b"".join([_HEADER.pack(kind, len(text)), text, *parts])


def unpack(data: bytes) -> tuple[int, dict[str, Any], dict[str, NDArray[Any]]]:
    """Take a message apart into kind, JSON fields and arrays (read-only views of `data`).

    Raises
    ------
    ProtocolError
        Unless every length fits and every byte is accounted for.
    """
    if len(data) < _HEADER.size:
        raise ProtocolError(f"message of {len(data)} bytes is shorter than its header")
    kind, length = _HEADER.unpack_from(data)
    if length > _HEAD_BYTES_MAX or length > len(data) - _HEADER.size:
        raise ProtocolError(f"message announces {length} bytes of JSON")
    offset = _HEADER.size + length
    try:
        head = json.loads(data[_HEADER.size : offset].decode(), parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise ProtocolError(f"message is not JSON: {type(error).__name__}") from None
    if not isinstance(head, dict):
        raise ProtocolError("the JSON of a message must be an object")
    listed = head.pop("arrays", {})
    if not isinstance(listed, dict) or len(listed) > 16:
        raise ProtocolError("'arrays' of a message must be an object of at most 16 entries")
    arrays = {}
    for name, spec in listed.items():
        dtype, shape = _array_spec(name, spec)
        size = math.prod(shape) * dtype.itemsize
        if size > len(data) - offset:
            raise ProtocolError(f"array {name[:40]!r} of shape {shape} is longer than its message")
        arrays[name] = np.frombuffer(data, dtype, math.prod(shape), offset).reshape(shape)
        offset += size + -size % 4
    if offset != len(data):
        raise ProtocolError(f"message has {len(data)} bytes, its parts {offset}")
    return kind, head, arrays


def _array_spec(name: str, spec: object) -> tuple[np.dtype[Any], tuple[int, ...]]:
    pair: list[Any] = spec if isinstance(spec, list) and len(spec) == 2 else ["", None]
    code, shape = pair
    listed = isinstance(code, str) and code in _DTYPES and isinstance(shape, list) and len(shape) <= 3
    if listed and all(type(extent) is int and 0 <= extent < 1 << 31 for extent in shape):
        return _DTYPES[code], tuple(shape)
    raise ProtocolError(f"array {name[:40]!r} must be [type, shape] with type {', '.join(_DTYPES)}")


def _refuse_constant(name: str) -> float:
    raise ValueError(name)
