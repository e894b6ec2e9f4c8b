"""One page that watches a session: what it has been told, and what it gets next."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from luxel.app import baked, protocol
from luxel.app.download import Download
from luxel.app.feed import Feed
from luxel.errors import ProtocolError
from luxel.scene.view import View

__all__ = ["Page"]

_WAITING_MAX = 64  # messages that are not sent yet, of those that a page may ask for any number of
_COARSE_COUNT = 8192  # records in one message: 96 kB
# Keys of messages that say nothing any more once another data set is shown.
_OF_DATA = {"scene", "light", "beside", "status", "geometry", "scalar", "codec", "frame"}


class Page:
    """One connected browser tab; belongs to the event loop.

    A newer message of the same kind replaces an unsent older one, and big ones are made only when they are sent, so
    that a page which stalls costs almost no memory.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.feed = Feed()
        self.coarse = Feed(_COARSE_COUNT, once=True)
        self.parts = baked.PartFeed()
        self.beside = Feed()  # tiles of the light that is compared with
        self.compares = False
        self.download = Download()
        self.greeted = False
        self.streamed = False  # whether the server draws for it
        self.epoch = 0  # of the particles that it has been sent
        self.held = 0  # how many of them it has, or will have
        self.view: View | None = None  # how the page looks at it, if it said so
        self.wake = asyncio.Event()
        self._outbox: dict[object, Callable[[], protocol.Message]] = {}

    def post(self, key: object, make: Callable[[], protocol.Message]) -> None:
        """Send what `make` returns, unless another message with the same `key` takes its place before that."""
        self._outbox.pop(key, None)
        self._outbox[key] = make
        self.wake.set()

    def bear(self) -> None:
        """Check that the page takes in what it asks for.

        Raises
        ------
        ProtocolError
            If too much waits for it already.
        """
        if len(self._outbox) >= _WAITING_MAX:
            raise ProtocolError("a page must take in what it has asked for before it asks for more")

    def reset(self, count: int) -> None:
        """Forget what it wants and has: another light, or another data set of `count` particles."""
        self.feed.reset(count)
        self.beside.reset(count)
        self.coarse.reset(count)
        self.parts.reset()

    def clear(self) -> None:
        """Drop what has not been sent and is about another data set; answers and errors are waited for nonetheless."""
        for key in [
            each for each in self._outbox if (each[0] if isinstance(each, tuple) else each) in _OF_DATA
        ]:
            del self._outbox[key]

    def next_posted(self) -> protocol.Message | None:
        """Return the next message, oldest first."""
        if not self._outbox:
            return None
        return self._outbox.pop(next(iter(self._outbox)))()
