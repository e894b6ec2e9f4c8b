"""Desk: what is to be done for the particles of one shard, and which of it next."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np

from luxel.dynamic.cache import TextureCache
from luxel.dynamic.entries import (
    DAWNING,
    ESTIMATE,
    LIT,
    NONE,
    QUEUED,
    WANTING,
    Entries,
    grade_of,
    work_of,
)
from luxel.dynamic.queue import RequestQueue
from luxel.dynamic.sightings import Ids, Sighting
from luxel.kernels.requests import list_lacking

__all__ = ["Desk", "Kind", "Piece"]


class Kind(Enum):
    """Kinds of work on particles, in the order in which they are done."""

    FIRST_LIGHT = "first light"
    FIRST_TEXTURE = "first texture"
    REFINEMENT = "refinement"


@dataclass(frozen=True, eq=False)
class Piece:
    """Some particles of one shard, to be worked on at one go.

    Parameters
    ----------
    kind
        What to do.
    light
        For which light key.
    ids
        (K,) int32.
    alone
        Whether it is the second attempt at something that failed.
    """

    kind: Kind
    light: Entries
    ids: Ids
    alone: bool = False


# Fewer are not worth a piece of work of their own: every fourth goes to those who have waited longest, and new ones would wait for many.
_LEAST = {Kind.FIRST_LIGHT: 32}

_NONE: Ids = np.empty(0, np.int32)


class Desk:
    """Takes in sightings and hands out pieces of work, for the particles of one shard and one light key.

    Frames leave their sightings with the cache; whoever asks for work takes them in here first. Of several by one client that have piled
    up, the latest counts.

    Safe to share: it owns one lock, and calls the cache and `Sighting.measure` while it holds it.

    Parameters
    ----------
    number
        Which shard.
    cache
        Knows the state of all entries.
    make_queue
        Makes its queues, one for each :class:`Kind`.
    small_pixels
        A particle narrower than this on every screen is content with an estimate.
    """

    def __init__(
        self, number: int, cache: TextureCache, make_queue: Callable[[], RequestQueue], small_pixels: float
    ) -> None:
        self.number = number
        self.small_pixels = small_pixels
        self._cache = cache
        self._lock = threading.Lock()
        self._queues: dict[Kind, RequestQueue] = {kind: make_queue() for kind in Kind}
        self._again: deque[tuple[Kind, int]] = deque()
        self._left: dict[Kind, Ids] = {}  # of pieces for which time was too short; marked as being baked
        self._light: Entries | None = None
        self._version = -1
        self._taken_in: dict[str, int] = {}
        self._over_budget = 0
        self._look_again = False  # once nothing waits any more
        self._hopeless: set[Kind] = set()
        self._looking = False

    def select(self, light: Entries | None) -> None:
        """Withdraw all requests, and take those for another light key from now on; None for none."""
        with self._lock:
            self._clear()
            self._light = light
            self._version = -1
            self._taken_in = {}
            self._hopeless = set()
            self._over_budget = 0

    def look(self, now_s: float) -> None:
        """Take in what frames have sighted, and find out what comes first: whoever asks for work then is not kept waiting."""
        if self._version != self._cache.version:
            with self._lock:
                self._refresh(now_s)
                for queue in self._queues.values():
                    queue.arrange()

    def waiting(self, now_s: float) -> dict[Kind, int]:
        """How many particles wait for each kind of work that can be done, second attempts included."""
        with self._lock:
            self._refresh(now_s)
            found = {kind: len(queue) for kind, queue in self._queues.items()}
            if found[Kind.REFINEMENT]:
                found[Kind.REFINEMENT] = min(found[Kind.REFINEMENT], self._spare())
            for kind, _ in self._again:
                found[kind] += 1
            for kind, ids in self._left.items():
                found[kind] += len(ids)
            return found

    def oldest_s(self, kinds: Collection[Kind], now_s: float) -> dict[Kind, float]:
        """When the request came that has waited longest for each of some kinds of work; those that nobody waits for are left out.

        Second attempts have waited longest of all.
        """
        with self._lock:
            self._refresh(now_s)
            found = {kind: self._queues[kind].oldest_s for kind in kinds if len(self._queues[kind])}
            return found | {kind: -math.inf for kind, _ in self._again if kind in kinds}

    def may_have(self, kind: Kind) -> bool:
        """Whether it is worth to ask for a kind of work; takes no lock, and never says no where there is some."""
        fresh = self._looking or self._look_again or self._version != self._cache.version
        return fresh or len(self._queues[kind]) > 0 or len(self._again) > 0 or kind in self._left

    @property
    def over_budget(self) -> int:
        """Visible particles that the cache has no room for, as of the last look."""
        return self._over_budget

    def take_known(self, light: Entries, kind: Kind, most: int, threads: int) -> Piece | None:
        """As :meth:`take`, of what has been taken in before; None if another thread is at this desk."""
        if not (len(self._queues[kind]) or kind in self._left) or not self._lock.acquire(blocking=False):
            return None
        try:
            return self._pop(light, kind, most, threads, oldest=False) if light is self._light else None
        finally:
            self._lock.release()

    def take(
        self, light: Entries, kind: Kind, most: int, now_s: float, threads: int, *, oldest: bool = False
    ) -> Piece | None:
        """Return a piece of one kind of work, None if there is none.

        Parameters
        ----------
        light
            For which light key; for another there is none.
        kind
            What to do.
        most
            For how many particles at most.
        now_s
            When, in seconds.
        threads
            Work is divided between so many.
        oldest
            Whether to serve those that have waited longest, instead of the best.
        """
        with self._lock:
            if light is not self._light:
                return None
            self._refresh(now_s)
            for _ in range(len(self._again)):
                tried, particle = self._again.popleft()
                if tried is kind:
                    return Piece(kind, light, np.array([particle], np.int32), alone=True)
                self._again.append((tried, particle))
            return self._pop(light, kind, most, threads, oldest=oldest)

    def done(self, piece: Piece, grade: int) -> None:
        """Note that textures of a piece are there, or given up (`NONE`).

        Where they are estimates, those who rest may want better ones; where not all that is visible had room, there may be some now.
        """
        if piece.light is self._light and (grade == ESTIMATE or self._over_budget):
            self._look_again = True

    def lost(self, piece: Piece) -> None:
        """Note that some textures of a piece found no slot: what clients have begun to look at meanwhile may have taken all room.

        Where frames hold the slots that are free, asking for them again would only make them in vain once more.
        """
        if piece.light is self._light and self._cache.shards[self.number].room() == 0:
            self._look_again = True

    def leave(self, piece: Piece, ids: Ids) -> None:
        """Give back particles of a piece for which time was too short: they come with the next one, or not at all if its light key is not wanted any more."""
        with self._lock:
            if piece.light is self._light and piece.kind not in self._hopeless:
                self._left[piece.kind] = np.concatenate([self._left.get(piece.kind, ids[:0]), ids])
                return
        self._cache.release(piece.light, ids)

    def retry(self, piece: Piece) -> bool:
        """Do a piece that failed once more, one particle at a time; False if its light key is not wanted any more."""
        with self._lock:
            if piece.light is not self._light:
                return False
            self._again.extend((piece.kind, particle) for particle in piece.ids.tolist())
            return True

    def give_up(self, light: Entries, kinds: Collection[Kind]) -> None:
        """Withdraw all requests for some kinds of work, and take none until the light changes."""
        with self._lock:
            if light is self._light:
                self._clear(kinds)
                self._hopeless.update(kinds)

    # What follows runs under the lock.

    def _spare(self) -> int:
        """Refined textures that could be stored now, while frames hold those that they replace."""
        return self._cache.shards[self.number].spare()

    def _pop(self, light: Entries, kind: Kind, most: int, threads: int, *, oldest: bool) -> Piece | None:
        queue = self._queues[kind]
        count = min(most, max(_LEAST.get(kind, 1), -(-len(queue) // threads)))
        if kind is Kind.REFINEMENT:
            count = min(count, self._spare())
        left = self._left.pop(kind, None)
        if left is not None:
            count = max(1, count)
            if len(left) > count:
                self._left[kind] = left[count:]
            left = left[:count]
            count -= len(left)
        # What another client or a frame has overtaken is not in the queued state any more.
        while count > 0 and len(queue):
            ids = queue.pop_oldest(count) if oldest else queue.pop(count)
            mark = self._cache.mark_dawning if kind is Kind.FIRST_LIGHT else self._cache.mark_baking
            ids = ids[mark(light, ids)]
            if len(ids):
                return Piece(kind, light, ids if left is None else np.concatenate([left, ids]))
        return None if left is None else Piece(kind, light, left)

    def _clear(self, kinds: Collection[Kind] = tuple(Kind)) -> None:
        for kind in kinds:
            self._release(kind, self._queues[kind].clear())
            self._release(kind, self._left.pop(kind, _NONE))
        again, self._again = self._again, deque()
        for kind, particle in again:
            if kind in kinds:
                self._release(kind, np.array([particle], np.int32))
            else:
                self._again.append((kind, particle))

    def _release(self, kind: Kind, ids: Ids) -> None:
        if self._light is None or not len(ids):
            return
        if kind is Kind.FIRST_LIGHT:
            self._cache.release_dawning(self._light, ids)
        else:
            self._cache.release(self._light, ids)

    def _withdraw(self, kind: Kind, ids: Ids) -> None:
        """Release what a queue has given up, unless the other one has it now: an estimate that was to be refined may be lost."""
        if len(ids):
            other = Kind.REFINEMENT if kind is Kind.FIRST_TEXTURE else Kind.FIRST_TEXTURE
            self._release(kind, np.setdiff1d(ids, self._queues[other].ids, assume_unique=True))

    def _refresh(self, now_s: float) -> None:
        """Take in what frames have sighted, drop what lapsed, and give up what there is no room for."""
        light = self._light
        if light is None:
            return
        again = self._look_again and not len(self._queues[Kind.FIRST_TEXTURE])
        if not again and self._version == self._cache.version:
            self._drop_lapsed(now_s)
            return
        self._looking = True  # until it is over, `may_have` must not take unfinished queues at their word
        try:
            self._look(light, now_s, again)
        finally:
            self._looking = False

    def _look(self, light: Entries, now_s: float, again: bool) -> None:
        self._version = self._cache.version
        self._look_again = False
        sightings = self._cache.sightings.copy()
        for queue in self._queues.values():
            for client in queue.clients:
                if client not in sightings:
                    queue.forget(client)
        if again or self._over_budget:  # what one client looks away from may be room for what others see
            self._taken_in = {}
        self._take_in(light, sightings)
        self._drop_lapsed(now_s)
        self._over_budget = 0
        # Baking more than fits would only evict what is on the screen.
        shard = self._cache.shards[self.number]
        queue = self._queues[Kind.FIRST_TEXTURE]
        if len(queue) + shard.claimed > shard.capacity // 2 and len(queue) > shard.room():
            # What is out of sight gives way to all that is in sight, however long ago it was asked for.
            queue.drop_unseen()
            self._taken_in = {}
            self._take_in(light, sightings)
            self._drop_lapsed(now_s)
            excess = queue.limit(shard.room())
            self._over_budget = len(excess)
            self._withdraw(Kind.FIRST_TEXTURE, excess)

    def _drop_lapsed(self, now_s: float) -> None:
        gone = {kind: queue.refresh(now_s) for kind, queue in self._queues.items()}
        for kind in (Kind.FIRST_TEXTURE, Kind.REFINEMENT):
            self._withdraw(kind, gone[kind])

    def _take_in(self, light: Entries, sightings: Mapping[str, Sighting]) -> None:
        """Ask for what is lacking in the sightings that have not been taken in yet."""
        self._taken_in = {client: n for client, n in self._taken_in.items() if client in sightings}
        for client, sighting in sightings.items():
            if sighting.key == light.key and self._taken_in.get(client) != sighting.number:
                self._taken_in[client] = sighting.number
                self._ask(light, sighting)

    def _ask(self, light: Entries, sighting: Sighting) -> None:
        visible = sighting.part(self.number, len(self._cache.shards))
        ids, state = np.empty(len(visible), np.int32), np.empty(len(visible), np.uint8)
        count = list_lacking(visible, light.state, WANTING, ids, state)
        ids, state = ids[:count], state[:count]
        found, pixels = sighting.measure(ids)
        distance = np.asarray(found, np.float64)
        width = np.zeros(len(ids)) if pixels is None else np.asarray(pixels, np.float64)
        bare = grade_of(state) == NONE
        asked = {
            Kind.FIRST_LIGHT: bare & ((state & np.uint8(LIT | DAWNING)) == 0),
            Kind.FIRST_TEXTURE: bare,
            Kind.REFINEMENT: ~bare if pixels is None else ~(bare | (width < self.small_pixels)),
        }
        if not len(light.coarse):
            asked[Kind.FIRST_LIGHT][:] = False
        queued = work_of(state) == QUEUED
        for kind, chosen in asked.items():
            if kind in self._hopeless:
                chosen = np.zeros(len(ids), np.bool_)
            elif kind is not Kind.FIRST_LIGHT and (fresh := chosen & ~queued).any():
                idle = np.flatnonzero(fresh)  # some may be more than that by now
                chosen[idle] = self._cache.mark_queued(light, ids[idle])
            whole = chosen.all()
            self._queues[kind].push(
                ids if whole else ids[chosen],
                distance if whole else distance[chosen],
                width if whole else width[chosen],
                sighting.seen_s,
                sighting.client,
            )
