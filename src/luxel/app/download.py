"""A file for a page, sent in parts, never too many at once. Free of input and output."""

from __future__ import annotations

import numpy as np

from luxel.app.stream_messages import ScreenshotPart

__all__ = ["Download"]

_PART_BYTES = 1 << 20
_IN_FLIGHT_MAX = 4  # parts that may await confirmation


class Download:
    """Not thread-safe; belongs to the event loop."""

    def __init__(self) -> None:
        self._data = b""
        self._next = 0
        self._sent = 0
        self._confirmed = 0

    def begin(self, data: bytes) -> None:
        """Send this file, and nothing more of an earlier one; parts on their way still count."""
        self._data, self._next = data, 0

    def take(self) -> ScreenshotPart | None:
        """Return the part to send now; None when all are sent or the page has to catch up first."""
        if self._next >= len(self._data) or self._sent - self._confirmed >= _IN_FLIGHT_MAX:
            return None
        start, size = self._next, len(self._data)
        count = min(_PART_BYTES, size - start)
        part = ScreenshotPart(start, size, np.frombuffer(self._data, np.uint8, count, start))
        self._next += count
        self._sent += 1
        if self._next == size:
            self._data, self._next = b"", 0  # the last part keeps it for as long as it must
        return part

    def confirm(self, parts: int) -> None:
        """Take the page's word that it has `parts` messages in all."""
        self._confirmed = min(max(self._confirmed, parts), self._sent)
