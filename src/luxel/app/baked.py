"""Baked textures for pages: how a stored frame becomes messages, and which parts of it a page still has to get."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from luxel.app import protocol
from luxel.app.order import Order
from luxel.textures.store.reader import BakedFrame
from luxel.textures.textures import decoding_table

__all__ = ["PartFeed", "codec_state", "fits_page", "part_size", "payload"]

_PAYLOAD_BYTES_MAX = 256 << 20  # that a page takes whole; of larger bakes it gets the tiles that it sees
_SHARED_BYTES_MAX = 32 << 20
_PART_BYTES = 1 << 20
_PARTS_MAX = 1024  # the page keeps which of them it has in a column of a texture
_PART_STEP = 2048  # particles: rows of the page's textures
_IN_FLIGHT_MAX = 4  # messages that may await confirmation


def fits_page(frame: BakedFrame) -> bool:
    """Whether a page gets all textures of a stored frame at once, and then needs no server for light."""
    return frame.count * frame.payload_bytes <= _PAYLOAD_BYTES_MAX and frame.shared_bytes <= _SHARED_BYTES_MAX


def part_size(count: int, payload_bytes: int) -> int:
    """Records in one message."""
    steps = max(1, _PART_BYTES // (payload_bytes * _PART_STEP), -(-count // (_PARTS_MAX * _PART_STEP)))
    return steps * _PART_STEP


def codec_state(frame: BakedFrame) -> protocol.CodecState:
    """Describe how the textures of a stored frame are to be decoded."""
    codec = frame.codec
    return protocol.CodecState(
        frame.key,
        codec.describe(),
        frame.count,
        codec.payload_bytes,
        part_size(frame.count, codec.payload_bytes),
        decoding_table(frame.scale, frame.encoding),
        **codec.shared,
    )


def payload(frame: BakedFrame, part: int, order: Order | None) -> protocol.Payload:
    """Return part number `part` of a frame's textures, in the order that pages have them in."""
    size = part_size(frame.count, frame.payload_bytes)
    which = slice(part * size, (part + 1) * size)
    return protocol.Payload(
        frame.key, part * size, frame.payload[which if order is None else order.to_file[which]]
    )


class PartFeed:
    """Parts of a stored frame for one page, those with most visible particles first, never too many at once.

    Not thread-safe; belongs to the event loop.
    """

    def __init__(self) -> None:
        self._size = 1
        self._rest: list[int] = []
        self._sent = 0
        self._confirmed = 0

    def reset(self, count: int = 0, size: int = 1) -> None:
        """Begin with a frame of `count` particles in parts of `size`; what is on its way still counts."""
        self._size = size
        self._rest = list(range(-(-count // size)))

    def want(self, ids: NDArray[np.int32]) -> None:
        """Send parts that hold most of these particles first."""
        if self._rest:
            visible = np.bincount(ids // self._size, minlength=max(self._rest) + 1)
            self._rest.sort(key=lambda part: (-int(visible[part]), part))

    def take(self, held: int | None = None) -> int | None:
        """Return the part to send now; None when all are sent or the page has to catch up first.

        `held` is how many particles the page has asked for, if not all: beyond, it needs no textures.
        """
        if self._sent - self._confirmed >= _IN_FLIGHT_MAX:
            return None
        found = next((part for part in self._rest if held is None or part * self._size < held), None)
        if found is not None:
            self._sent += 1
            self._rest.remove(found)
        return found

    def confirm(self, parts: int) -> None:
        """Take the page's word that it has `parts` messages in all."""
        self._confirmed = min(max(self._confirmed, parts), self._sent)
