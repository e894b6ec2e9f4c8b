"""Which finished tiles, or coarse records, one page still has to get. Free of input and output."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

__all__ = ["Feed"]

_BATCH_COUNT = 1024  # tiles in one message: 256 kB
_IN_FLIGHT_MAX = 4  # full messages that may await confirmation
_SMALL_MAX = 16  # and messages of any size


class Feed:
    """Tiles for one page under one light: those it wants, in the order they got ready, never too many at once.

    Small messages do not use the window up. What is ready goes at once while few are on their way; then it waits until it is as
    much as all of these together, or the page has caught up.

    Not thread-safe; belongs to the event loop.

    Parameters
    ----------
    batch_count
        Tiles in one message at most.
    once
        Whether the page keeps all it gets until :meth:`reset`: then nothing is sent a second time.
    """

    def __init__(self, batch_count: int = _BATCH_COUNT, *, once: bool = False) -> None:
        self._batch_count = batch_count
        self._once = once
        self._sent = np.zeros(0, dtype=np.bool_)
        self._estimated = np.zeros(0, dtype=np.bool_)  # what the page has no better of
        self._wanted = np.zeros(0, dtype=np.bool_)
        self._ready: deque[NDArray[np.int32]] = deque()
        self._in_flight: deque[NDArray[np.int32]] = deque()
        self._sizes: deque[int] = deque()  # of the messages in flight
        self._confirmed = 0

    def reset(self, count: int) -> None:
        """Forget what was wanted: another light or another data set of `count` particles."""
        self._wanted = np.zeros(count, dtype=np.bool_)
        self._sent = np.zeros(count if self._once else 0, dtype=np.bool_)
        self._estimated = np.zeros(count, dtype=np.bool_)
        self._ready.clear()
        # Batches on their way still count against the window, but their ids mean nothing any more.
        self._in_flight = deque(np.zeros(0, dtype=np.int32) for _ in self._in_flight)

    def want(self, ids: NDArray[np.int32]) -> None:
        """Replace the wanted set by `ids`, less those on their way."""
        self._wanted[:] = False
        self._wanted[ids[~self._sent[ids]] if self._once else ids] = True
        for batch in self._in_flight:
            self._wanted[batch] = False

    def publish(self, ids: NDArray[np.int32], estimate: NDArray[np.bool_] | None = None) -> bool:
        """Note that textures of `ids` are ready; return whether any of them is wanted.

        Of those that are estimates, (K,) `estimate`, none is sent to a page that has one already; None for no estimates.
        """
        known = ids < len(self._wanted)
        if estimate is not None:
            known[known] &= ~(estimate[known] & self._estimated[ids[known]])
        ids = ids[known]
        ids = ids[self._wanted[ids]]
        if len(ids):
            self._ready.append(ids)
        return bool(len(ids))

    def take(self) -> NDArray[np.int32] | None:
        """Return the ids of the next message, None when nothing is ready or the page has to catch up first.

        Every id returned counts as on its way until :meth:`confirm`.
        """
        if not self._may_send():
            return None
        taken: list[NDArray[np.int32]] = []
        room = self._batch_count
        while self._ready and room:
            ids = self._ready.popleft()
            ids = ids[self._wanted[ids]]  # published twice, or no longer wanted
            if len(ids) > room:
                self._ready.appendleft(ids[room:])
                ids = ids[:room]
            self._wanted[ids] = False
            room -= len(ids)
            taken.append(ids)
        batch = np.concatenate(taken) if taken else np.zeros(0, dtype=np.int32)
        if not len(batch):
            return None
        if self._once:
            self._sent[batch] = True
        self._in_flight.append(batch)
        self._sizes.append(len(batch))
        return batch

    def estimated(self, ids: NDArray[np.int32], estimate: NDArray[np.bool_]) -> None:
        """Note which of the textures that :meth:`take` returned are estimates: better ones are wanted still."""
        self._estimated[ids] = estimate
        self._wanted[ids[estimate]] = True

    def confirm(self, batches: int) -> None:
        """Take the page's word that it has `batches` messages in all."""
        while self._confirmed < batches and self._in_flight:
            self._in_flight.popleft()
            self._sizes.popleft()
            self._confirmed += 1

    def withdraw(self) -> None:
        """Undo the last :meth:`take`: its message was not sent after all."""
        self._in_flight.pop()
        self._sizes.pop()

    def _may_send(self) -> bool:
        count, tiles = len(self._sizes), sum(self._sizes)
        if count < _IN_FLIGHT_MAX:
            return True
        if count >= _SMALL_MAX or tiles >= _IN_FLIGHT_MAX * self._batch_count:
            return False
        waiting = sum(int(np.count_nonzero(self._wanted[ids])) for ids in self._ready)
        return waiting >= min(max(tiles, 1), self._batch_count)
