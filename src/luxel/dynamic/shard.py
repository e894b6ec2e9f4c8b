"""Shard: the part of the cache that keeps the textures of the particles that hash to it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from luxel.dynamic.arena import NOBODY, Arena
from luxel.dynamic.entries import (
    BAKING,
    DAWNING,
    ESTIMATE,
    FAILED,
    FULL,
    GRADE_SHIFT,
    IDLE,
    LIT,
    NONE,
    QUEUED,
    Entries,
    grade_of,
    work_of,
)
from luxel.dynamic.sightings import Ids
from luxel.textures.textures import FIRST_LIGHT

__all__ = ["Shard", "kept_slots"]

# Room for tiles that replace others while frames still show those, and for what is evicted ahead of need.
_SPARE_SHARE = 1 / 32
# Evicting costs a look at every slot: this share goes at once.
_EVICTION_SHARE = 1 / 32

#: (light key, ids of this shard): what is not to be evicted.
Protection = Callable[[int], Sequence[tuple[Entries, Ids]]]


class Shard:
    """Keeps textures in slots of its own; gives up what has not been seen longest.

    Every method takes ids of this shard only. The shard owns one lock, takes it within each method, and calls nobody
    who takes another.

    Parameters
    ----------
    number
        Which shard.
    arena, first, last
        Its slots: first <= slot < last.
    protection
        Returns the latest sightings of all clients, as far as they are of this shard.
    lights
        The entries that each light number in the arena means; others add and remove some.
    """

    def __init__(
        self,
        number: int,
        arena: Arena,
        first: int,
        last: int,
        protection: Protection,
        lights: Mapping[int, Entries],
    ) -> None:
        self.number = number
        self.lock = threading.Lock()
        self.queued = self.ready = self.refined = self.evicted = self.dropped = 0
        self._arena = arena
        self._first, self._last = first, last
        self._kept = kept_slots(last - first)
        self._protection = protection
        self._lights = lights
        self._touched = first
        self._free: list[Ids] = []
        self._free_count = 0
        self._used = 0
        self._retired: list[tuple[Ids, Entries, int]] = []

    @property
    def capacity(self) -> int:
        """Textures that may be kept for as long as somebody looks at them."""
        return self._kept

    @property
    def used(self) -> int:
        """Slots in use."""
        return self._used

    @property
    def claimed(self) -> int:
        """Slots in use, and those that textures under way will need."""
        return self._used + self._baking(NONE)

    def room(self) -> int:
        """Textures that could still be stored without giving up any that a latest sighting shows."""
        with self.lock:
            free = self.capacity - self._used - self._baking(NONE)
            if self._used:
                free += self._used - int(np.count_nonzero(self._protected()))
            return max(0, free)

    def spare(self) -> int:
        """Slots that could be filled now, frames being as they are."""
        with self.lock:
            self._reclaim()
            return self._free_count + self._last - self._touched - self._baking(NONE, ESTIMATE)

    def mark_queued(self, light: Entries, ids: Ids) -> NDArray[np.bool_]:
        """Move idle entries to queued; return which of `ids` (K,) these were."""
        with self.lock:
            moved = self._mark(light, ids, IDLE, QUEUED)
            self.queued += int(np.count_nonzero(moved))
            return moved

    def mark_baking(self, light: Entries, ids: Ids) -> NDArray[np.bool_]:
        """Move queued entries to baking; return which of `ids` (K,) these were."""
        with self.lock:
            return self._mark(light, ids, QUEUED, BAKING)

    def mark_dawning(self, light: Entries, ids: Ids) -> NDArray[np.bool_]:
        """Note that first light is being made; return which of `ids` (K,) had none and were not being made."""
        with self.lock:
            chosen = np.asarray(light.state[ids] & np.uint8(LIT | DAWNING)) == 0
            light.state[ids[chosen]] |= np.uint8(DAWNING)
            return np.asarray(chosen)

    def release_dawning(self, light: Entries, ids: Ids) -> None:
        """Note that first light is not being made after all."""
        with self.lock:
            light.state[ids] &= np.uint8(~DAWNING & 0xFF)

    def release(self, light: Entries, ids: Ids, work: int = IDLE) -> None:
        """Move queued and baking entries back to idle, or to `work`, which may be FAILED."""
        with self.lock:
            light.move(self.number, ids[_pending(light, ids)], work)

    def publish(
        self, light: Entries, ids: Ids, codes: NDArray[np.uint8], seen: int, grade: int = FULL
    ) -> NDArray[np.bool_]:
        """Store textures, evicting others where needed; return which of `ids` (K,), each once, found room.

        One that replaces another takes a slot of its own: frames that are being drawn keep the old one.
        """
        with self.lock:
            stored = np.zeros(len(ids), np.bool_)
            if not light.dropped:
                self._evict(self._used + int(np.count_nonzero(~_have(light, ids))) - self.capacity)
                there = _have(light, ids)
                stored[:] = there | (np.cumsum(~there) <= self.capacity - self._used)
                slots = self._take(int(np.count_nonzero(stored)))
                stored &= np.cumsum(stored) <= len(slots)
                there = _have(light, ids)  # room may have come from one that was to be replaced
                self._store(light, ids[stored], slots, codes[stored], seen, grade)
                self.ready += int(np.count_nonzero(stored & ~there))
                self.refined += int(np.count_nonzero(stored & there))
            lost = ids[~stored]
            self.dropped += len(lost)
            light.move(self.number, lost[_pending(light, lost)], IDLE)
            return stored

    def light_up(self, light: Entries, ids: Ids, records: NDArray[np.float32]) -> bool:
        """Store coarse records; False if none are kept for this light."""
        with self.lock:
            if not len(light.coarse):
                return False
            light.coarse[ids] = records
            light.state[ids] = (light.state[ids] | np.uint8(LIT)) & np.uint8(~DAWNING & 0xFF)
            bare = ids[light.table.live[ids] < 0]
            light.table.write(bare, FIRST_LIGHT)
            return True

    def lose_all(self, light: Entries) -> None:
        """Give up all textures of a light key."""
        with self.lock:
            used = self._in_use()
            slots = used[self._arena.light[used] == light.number]
            self._lose(light, slots)
            self.evicted += len(slots)

    def lookup(
        self, light: Entries, ids: Ids
    ) -> tuple[NDArray[np.bool_], NDArray[np.uint8], NDArray[np.uint8]]:
        """Return (K,) bool, which of `ids` have a texture, and copies of these and their grades."""
        with self.lock:
            slots = light.table.live[ids]
            there = slots >= 0
            return there, self._arena.codes[slots[there]], grade_of(light.state[ids[there]])

    def first_bytes(self) -> list[int]:
        """Return the first bytes that kept textures have, each once."""
        with self.lock:
            codes = self._arena.codes
            found: list[int] = np.unique(codes.reshape(len(codes), -1)[self._in_use(), 0]).tolist()
            return found

    # What follows runs under the lock.

    def _mark(self, light: Entries, ids: Ids, source: int, target: int) -> NDArray[np.bool_]:
        chosen = np.asarray(work_of(light.state[ids]) == source)
        light.move(self.number, ids[chosen], target)
        return chosen

    def _baking(self, *grades: int) -> int:
        """Textures being made for particles that have one of `grades`."""
        index = [BAKING | grade << GRADE_SHIFT for grade in grades]
        return sum(int(light.counts[self.number, index].sum()) for light in list(self._lights.values()))

    def _store(
        self, light: Entries, ids: Ids, slots: Ids, codes: NDArray[np.uint8], seen: int, grade: int
    ) -> None:
        arena, table = self._arena, light.table
        old = table.live[ids]
        old = old[old >= 0]
        arena.codes[slots] = codes
        arena.light[slots] = light.number
        arena.owner[slots] = ids
        arena.seen[slots] = seen
        table.write(ids, slots)  # only now that it is written may the slot be found
        light.move(self.number, ids, IDLE, grade)
        self._used += len(slots)
        self._retire(light, old)

    def _in_use(self) -> Ids:
        used = self._arena.light[self._first : self._touched] != NOBODY
        return (np.flatnonzero(used) + self._first).astype(np.int32)

    def _protected(self) -> NDArray[np.bool_]:
        """Which slots, counted from the first, some client's latest sighting shows."""
        mask = np.zeros(self._last - self._first, np.bool_)
        for light, ids in self._protection(self.number):
            slots = light.table.live[ids]
            mask[slots[slots >= 0] - self._first] = True
        return mask

    def _take(self, count: int) -> Ids:
        """Return up to `count` slots that no frame reads."""
        if self._free_count < count:
            self._reclaim()
        fresh = min(count - self._free_count, self._last - self._touched)
        if fresh > 0:
            self._arena.light[self._touched : self._touched + fresh] = NOBODY
            self._give_back(np.arange(self._touched, self._touched + fresh, dtype=np.int32))
            self._touched += fresh
        if self._free_count < count:
            self._evict(count - self._free_count)
            self._reclaim()
        taken: list[Ids] = [np.empty(0, np.int32)]
        while count and self._free:
            slots = self._free.pop()
            if len(slots) > count:
                self._free.append(slots[:-count])
                slots = slots[-count:]
            taken.append(slots)
            count -= len(slots)
            self._free_count -= len(slots)
        return np.concatenate(taken)

    def _give_back(self, slots: Ids) -> None:
        self._free.append(slots)
        self._free_count += len(slots)

    def _retire(self, light: Entries, slots: Ids) -> None:
        """Take slots out of use; `live` names them no more, but frames may."""
        if len(slots):
            self._arena.light[slots] = NOBODY
            self._used -= len(slots)
            self._retired.append((slots, light, light.table.mark()))

    def _reclaim(self) -> None:
        held = []
        for slots, light, mark in self._retired:
            if light.table.is_read(mark):
                held.append((slots, light, mark))
            else:
                self._give_back(slots)
        self._retired = held

    def _evict(self, count: int) -> None:
        if count <= 0:
            return
        used = self._in_use()
        candidates = used[~self._protected()[used - self._first]]
        count = min(max(count, int(self.capacity * _EVICTION_SHARE)), len(candidates))
        if count == 0:
            return
        order = np.argpartition(self._arena.seen[candidates], count - 1)
        victims = candidates[order[:count]]
        numbers = self._arena.light[victims]
        for number in np.unique(numbers):
            self._lose(self._lights[int(number)], victims[numbers == number])
        self.evicted += count

    def _lose(self, light: Entries, slots: Ids) -> None:
        ids = self._arena.owner[slots]
        state = light.state[ids]
        light.table.write(ids, np.where(state & np.uint8(LIT), FIRST_LIGHT, NOBODY))
        for work in np.unique(work_of(state)):  # what is being done goes on
            chosen = ids[work_of(state) == work]
            light.move(self.number, chosen, int(work) if work != FAILED else IDLE, NONE)
        self._retire(light, slots)


def kept_slots(slots: int) -> int:
    """Of so many slots, how many are for textures that may stay; the others are for those on their way in and out."""
    return slots - int(slots * _SPARE_SHARE)


def _pending(light: Entries, ids: Ids) -> NDArray[np.bool_]:
    work = work_of(light.state[ids])
    return np.asarray((work == QUEUED) | (work == BAKING))


def _have(light: Entries, ids: Ids) -> NDArray[np.bool_]:
    return np.asarray(light.table.live[ids] >= 0)
