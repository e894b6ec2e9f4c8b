"""What all messages between server and page have in common, and the fields of a message that may be anything at all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from luxel.app.wire import pack
from luxel.errors import ProtocolError

__all__ = ["KEY_MAX", "NAME_MAX", "Given", "Message", "PageMessage", "drawer"]

#: Longest light key, and name of a scalar, in characters.
KEY_MAX = 128
NAME_MAX = 500
_LIST_MAX = 64


@dataclass(frozen=True, eq=False)
class Message:
    """Base of all messages: fields that are arrays travel raw, the others as JSON."""

    kind: ClassVar[int]

    def encode(self) -> bytes:
        """Return the message as bytes."""
        head: dict[str, Any] = {}
        arrays: dict[str, NDArray[Any]] = {}
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                arrays[field.name] = value
            else:
                head[field.name] = value
        return pack(self.kind, head, arrays)


@dataclass(frozen=True, eq=False)
class PageMessage(Message):
    """Base of what a page says."""

    @classmethod
    def read(cls, given: Given) -> Self:
        """Make the message of fields that may be anything.

        Raises
        ------
        ProtocolError
            If they make no sense.
        """
        return cls()


class Given:
    """The fields of a message from a page; each method returns one, or raises a :class:`ProtocolError`."""

    def __init__(self, head: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
        self._head = head
        self._arrays = arrays

    def has(self, name: str) -> bool:
        """Whether the field is there, and not null."""
        return self._head.get(name) is not None

    def number(self, name: str) -> float:
        """A finite number below 1e30."""
        return _number(self._head.get(name), name)

    def numbers(self, name: str, count: int) -> tuple[float, ...]:
        """A list of `count` numbers."""
        values = self._head.get(name)
        if not isinstance(values, list) or len(values) != count:
            raise ProtocolError(f"{name!r} must be {count} numbers")
        return tuple(_number(value, name) for value in values)

    def whole(self, name: str, least: int = 0, most: int = (1 << 53) - 1) -> int:
        """A whole number from `least` to `most`."""
        value = self._head.get(name)
        if type(value) is not int or not least <= value <= most:
            limit = f" and <= {most}" if most < 1 << 52 else ""
            raise ProtocolError(f"{name!r} must be a whole number >= {least}{limit}")
        return value

    def truth(self, name: str) -> bool:
        """True or false."""
        value = self._head.get(name)
        if not isinstance(value, bool):
            raise ProtocolError(f"{name!r} must be true or false")
        return value

    def text(self, name: str, length_max: int) -> str:
        """A text of at most `length_max` characters."""
        value = self._head.get(name)
        if not isinstance(value, str) or len(value) > length_max:
            raise ProtocolError(f"{name!r} must be a text of at most {length_max} characters")
        return value

    def object(self, name: str) -> dict[str, Any]:
        """A JSON object."""
        value = self._head.get(name)
        if not isinstance(value, dict):
            raise ProtocolError(f"{name!r} must be a JSON object")
        return value

    def list(self, name: str) -> list[Any]:
        """A short list."""
        value = self._head.get(name)
        if not isinstance(value, list) or len(value) > _LIST_MAX:
            raise ProtocolError(f"{name!r} must be a list of at most {_LIST_MAX}")
        return value

    def ids(self) -> NDArray[np.int32]:
        """The array ``ids``, flat, int32."""
        ids = self._arrays.get("ids")
        if ids is None or ids.dtype != np.int32 or ids.ndim != 1:
            raise ProtocolError("'ids' must be a flat array of int32")
        return ids


def _number(value: object, name: str) -> float:
    # Whole numbers of hundreds of digits do not fit a float; a page has no use for large ones.
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e30:
        raise ProtocolError(f"{name!r} must be a number")
    return float(value)


def drawer(given: Given) -> str:
    """The field ``by``: who draws."""
    by = given.text("by", 16)
    if by not in ("browser", "server"):
        raise ProtocolError("'by' must be browser or server")
    return by
