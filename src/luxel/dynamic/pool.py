"""TilePool: memory for tiles in slots that nobody overwrites while a reader may still look at them."""

from __future__ import annotations

import weakref
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Reader", "TilePool"]

Ids = NDArray[np.int32]
Reader = weakref.ref[NDArray[Any]]

_FIRST_ALLOCATION = 1024
_NOBODY = -1


class TilePool:
    """Slots for (texels, texels) uint8 tiles, up to a fixed number, allocated as they are needed.

    Holds no lock: :class:`luxel.dynamic.cache.TextureCache` calls it under its own, and may change `capacity`.

    Parameters
    ----------
    texels
        Rows and columns of a tile.
    capacity
        Tiles at most.

    Attributes
    ----------
    codes
        (A, texels, texels) uint8, A the slots allocated so far. Replaced by a longer array when the pool grows;
        whoever holds the old array keeps reading what it held.
    light, owner, seen
        (A,) int32, int32, int64: light number (-1 for a slot not in use), particle id, and number of the sighting
        that showed it last.
    """

    def __init__(self, texels: int, capacity: int) -> None:
        self.capacity = capacity
        self.codes: NDArray[np.uint8] = np.empty((0, texels, texels), dtype=np.uint8)
        self.light: Ids = np.empty(0, dtype=np.int32)
        self.owner: Ids = np.empty(0, dtype=np.int32)
        self.seen: NDArray[np.int64] = np.empty(0, dtype=np.int64)
        self._untouched = 0
        self._free: Ids = np.empty(0, dtype=np.int32)
        self._quarantine: list[tuple[Ids, Sequence[Reader]]] = []

    @property
    def tile_bytes(self) -> int:
        """Bytes of one tile."""
        rows, columns = self.codes.shape[1:]
        return int(rows * columns)

    def used(self) -> NDArray[np.intp]:
        """Slots in use, ascending."""
        return np.flatnonzero(self.light[: self._untouched] != _NOBODY)

    def take(self, count: int) -> Ids:
        """Return up to `count` slots that no reader sees; they are in use once `light` is set."""
        if self._untouched > self.capacity:  # it was larger once
            count = min(count, max(0, self.capacity - len(self.used())))
        if len(self._free) < count:
            self._reclaim()
        if len(self._free) < count:
            self._touch(count - len(self._free))
        taken, self._free = self._free[:count], self._free[count:]
        return taken

    def put(self, slots: Ids, light: int, owners: Ids, codes: NDArray[np.uint8], seen: int) -> None:
        """Fill slots from :meth:`take`: (K,) slots, (K,) particle ids, (K, texels, texels) codes."""
        self.codes[slots] = codes
        self.light[slots] = light
        self.owner[slots] = owners
        self.seen[slots] = seen

    def retire(self, slots: Ids, readers: Sequence[Reader]) -> None:
        """Give slots back; they are reused only when every one of `readers` is gone."""
        self.light[slots] = _NOBODY
        if readers:
            self._quarantine.append((slots, readers))
        else:
            self._free = np.concatenate([self._free, slots])

    def _reclaim(self) -> None:
        held: list[tuple[Ids, Sequence[Reader]]] = []
        for slots, readers in self._quarantine:
            alive = [reader for reader in readers if reader() is not None]
            if alive:
                held.append((slots, alive))
            else:
                self._free = np.concatenate([self._free, slots])
        self._quarantine = held

    def _touch(self, count: int) -> None:
        end = max(self._untouched, min(self._untouched + count, self.capacity))
        if end > len(self.light):
            self._allocate(min(self.capacity, max(end, 2 * len(self.light), _FIRST_ALLOCATION)))
        self._free = np.concatenate([self._free, np.arange(self._untouched, end, dtype=np.int32)])
        self._untouched = end

    def _allocate(self, size: int) -> None:
        used = self._untouched
        for name, fill in (("codes", 0), ("light", _NOBODY), ("owner", 0), ("seen", 0)):
            old = getattr(self, name)
            new = np.empty((size, *old.shape[1:]), dtype=old.dtype)
            new[:used] = old[:used]
            if (
                name != "codes"
            ):  # texels stay untouched, so that the system commits their memory only when written
                new[used:] = fill
            setattr(self, name, new)
