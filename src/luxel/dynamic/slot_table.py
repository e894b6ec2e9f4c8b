"""SlotTable: where each particle's texture lies; written by workers, read by frames that never wait for them."""

from __future__ import annotations

import threading
import weakref
from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxel.dynamic.sightings import Ids

__all__ = ["SlotTable"]

_LONGEST_LOG = 1024  # batches of changes; whoever has not looked for so long copies the whole table
_MOST_CHANGES = 1 / 8  # of the table: to copy it is cheaper than to repeat more of them


class _Reader:
    """A frozen copy that was handed out; its holder keeps `array` alive."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.array: weakref.ref[NDArray[Any]] | None = None  # None while it is being made

    @property
    def alive(self) -> bool:
        return self.array is None or self.array() is not None


class _Copy:
    """Memory for frozen copies, one after the other."""

    def __init__(self, count: int) -> None:
        self.slots: Ids = np.empty(count, np.int32)
        self.position = -1  # in the history; -1: holds nothing yet
        self.reader: _Reader | None = None

    @property
    def free(self) -> bool:
        return self.reader is None or not self.reader.alive


class SlotTable:
    """(N,) int32 slots of particles: one array that changes, and frozen copies of it, each made by few changes to an old one.

    Writes must be serialised for each particle (:class:`luxel.dynamic.shard.Shard` does it under its lock); they wait
    for nobody who calls :meth:`freeze`, nor the other way round: the lock inside is for those who freeze at the same
    time.

    What `live` named before a change may still be read through frozen copies: :meth:`mark` and :meth:`is_read` tell
    how long.

    Parameters
    ----------
    count
        N.
    most_copies
        Frozen copies at most; when all are held, :meth:`freeze` hands out the last one again.
    """

    def __init__(self, count: int, most_copies: int = 3) -> None:
        self.live: Ids = np.full(count, -1, np.int32)
        self.most_copies = most_copies
        self._log: deque[Ids] | None = None  # of changes that frozen copies lack; None: nobody follows it
        self._number = 0  # of copies frozen so far; never falls
        self._readers: tuple[_Reader, ...] = ()
        self._lock = threading.Lock()  # what follows is for those who freeze
        self._copies: list[_Copy] = []
        self._history: list[Ids] = []
        self._first = 0  # position of the oldest entry of the history
        self._last: weakref.ref[NDArray[Any]] | None = None

    @property
    def nbytes(self) -> int:
        """Bytes of all copies."""
        return int(self.live.nbytes) * (1 + len(self._copies))

    def write(self, ids: Ids, slots: Ids | int) -> None:
        """Set ``live[ids]``."""
        # Noted before as well: a copy that repeats an older change may take what is written here before it is noted,
        # and the next copy must not be without it again.
        self._note(ids)
        self.live[ids] = slots
        self._note(ids)

    def replace(self, old: int, new: int) -> None:
        """Set all that is `old` to `new`."""
        self._note(None)
        self.live[self.live == old] = new
        self._note(None)

    def _note(self, ids: Ids | None) -> None:
        log = self._log
        if log is None:
            return
        if ids is None or len(log) >= _LONGEST_LOG:
            self._log = None
        else:
            log.append(ids)

    def mark(self) -> int:
        """Return a number for :meth:`is_read`; call it after :meth:`write`."""
        return self._number

    def is_read(self, mark: int) -> bool:
        """Whether somebody may hold a copy that lacks what was written before `mark` was taken."""
        return any(reader.alive for reader in self._readers if reader.number <= mark)

    def freeze(self) -> Ids:
        """Return (N,) int32, `live` as it is now; nobody writes there as long as the caller holds this very array.

        While changes go on it may or may not have those that are made during the call; what one copy has, later ones
        have too.
        """
        with self._lock:
            last = None if self._last is None else self._last()
            if last is not None and self._log is not None and not self._log:
                return last
            held = self._held()
            if len(held) >= self.most_copies:
                return held[-1]
            copy = self._choose()
            # Readers are known before they read, so that whoever retires a slot meanwhile sees them.
            self._number += 1
            reader = _Reader(self._number)
            self._readers = (*(each for each in self._readers if each.alive), reader)
            try:
                self._bring_up_to_date(copy)
                frozen = copy.slots[:]
                self._last = reader.array = weakref.ref(frozen)
            except BaseException:
                copy.position = -1
                self._readers = tuple(each for each in self._readers if each is not reader)
                raise
            copy.reader = reader
            return frozen

    def spare(self) -> None:
        """Give up copies that nobody holds."""
        with self._lock:
            self._copies = [copy for copy in self._copies if not copy.free]

    def _held(self) -> list[Ids]:
        """Copies that somebody holds, the oldest first; they stay so for as long as the list."""
        arrays = [
            copy.reader.array()
            for copy in sorted(self._copies, key=lambda copy: copy.position)
            if copy.reader is not None and copy.reader.array is not None
        ]
        return [array for array in arrays if array is not None]

    def _choose(self) -> _Copy:
        free = [copy for copy in self._copies if copy.free]
        if free:
            return max(free, key=lambda copy: copy.position)
        self._copies.append(_Copy(len(self.live)))
        return self._copies[-1]

    def _bring_up_to_date(self, copy: _Copy) -> None:
        if self._log is None:
            # First a new log: what is written from now on is either copied here or noted there.
            self._log = deque()
            self._forget(len(self._history))
            self._first += 1  # all copies are behind
        log = self._log
        while log:
            self._history.append(log.popleft())
        oldest = min(each.position for each in self._copies)
        self._forget(oldest - self._first)
        newest = max(self._copies, key=lambda each: each.position)
        missing = self._missing(copy)
        if newest.position < self._first:
            np.copyto(copy.slots, self.live)
        else:
            if missing is None or sum(map(len, missing)) > _MOST_CHANGES * len(self.live):
                # Not from `live`: it may have what is not noted yet, and the copy made next would lose it again.
                np.copyto(copy.slots, newest.slots)
                missing = self._missing(newest)
            for ids in missing or ():
                copy.slots[ids] = self.live[ids]
        copy.position = self._first + len(self._history)

    def _missing(self, copy: _Copy) -> list[Ids] | None:
        """Changes that `copy` lacks; None where they are no longer known."""
        return self._history[copy.position - self._first :] if copy.position >= self._first else None

    def _forget(self, count: int) -> None:
        """Drop the oldest `count` entries of the history, if so many are there; at least all but the latest few."""
        count = min(max(count, len(self._history) - _LONGEST_LOG), len(self._history))
        if count > 0:
            del self._history[:count]
            self._first += count
