"""TextureCache: the luminance texture cache of paper 4.2."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from luxel.dynamic.pool import Reader, TilePool
from luxel.errors import InputError
from luxel.light.mapping import Mapping
from luxel.textures.textures import NO_COARSE, Encoding, TextureTable, decoding_table

__all__ = ["BAKING", "FAILED", "MISSING", "QUEUED", "READY", "CacheStats", "Counts", "TextureCache"]

Ids = NDArray[np.int32]

MISSING, QUEUED, BAKING, READY, FAILED = range(5)
_STATE_COUNT = 5

# Evicting costs a look at every slot: when the cache is full, this share of it goes at once.
_EVICTION_SHARE = 1 / 32
# A particle of a light key costs 5 bytes of bookkeeping even without a tile, so old keys are dropped.
_MAX_LIGHTS = 16
_COARSE_BYTES = 16


@dataclass(frozen=True)
class Counts:
    """How many particles of one light key are in each state."""

    missing: int = 0
    queued: int = 0
    baking: int = 0
    ready: int = 0
    failed: int = 0


@dataclass(frozen=True)
class CacheStats:
    """Counters since the cache was made, and what it holds now.

    Parameters
    ----------
    hits, misses
        Sighted particles that had a tile, and that had none.
    published
        Tiles stored.
    evicted
        Tiles given up to make room.
    dropped
        Finished tiles that found no room, or whose light key was gone.
    nbytes
        Bytes of the tiles and coarse records held now.
    """

    hits: int = 0
    misses: int = 0
    published: int = 0
    evicted: int = 0
    dropped: int = 0
    nbytes: int = 0


@dataclass(eq=False)
class _Light:
    """Everything about one light key. `number` names it in the pool, where it is never reused."""

    key: str
    number: int
    decoding: NDArray[np.float32]
    state: NDArray[np.uint8]
    slot: Ids
    counts: NDArray[np.int64]
    coarse: NDArray[np.float32] = field(default_factory=lambda: NO_COARSE)
    table: TextureTable | None = None  # what snapshot() gave last, while it is still true
    readers: list[Reader] = field(default_factory=list)


class TextureCache:
    """Keeps finished tiles within a byte budget, and knows the state of every particle's texture.

    An entry is named by (light key, particle id) and goes missing → queued → baking → ready. Ready entries are
    evicted in the order in which they were seen last, and never while the latest sighting of some client shows them.
    A sighting is what :meth:`see` is told; a tile also counts as seen when it is published.

    The coarse records of the light key begun last are kept too, 16 bytes for each of its particles, unless that is more than half
    of the budget.

    Safe to use from several threads: the cache owns its lock, takes it within each method and calls nobody else
    while it holds it. There is no thread and no clock inside.

    Parameters
    ----------
    texels
        Rows and columns of every tile.
    max_bytes
        Budget for texels and coarse records; at least one tile is kept.
    mapping
        From texels to directions, for renderers.
    """

    def __init__(self, texels: int = 16, max_bytes: int = 256 << 20, mapping: Mapping = "latlong") -> None:
        if texels < 1 or max_bytes < 1:
            raise InputError(f"a cache needs texels >= 1 and max_bytes >= 1, got {texels} and {max_bytes}")
        self.texels = texels
        self.max_bytes = max_bytes
        self.mapping: Mapping = mapping
        self._lock = threading.Lock()
        self._pool = TilePool(texels, self._tile_count(max_bytes))
        self._lights: dict[str, _Light] = {}  # in the order of their latest begin()
        self._by_number: dict[int, _Light] = {}
        self._light_count = 0
        self._sightings: dict[str, tuple[_Light, Ids]] = {}
        self._sighting_count = 0
        self._hits = self._misses = self._published = self._evicted = self._dropped = 0

    @property
    def capacity(self) -> int:
        """Tiles that the budget holds besides the coarse records."""
        return self._pool.capacity

    def begin(self, key: str, count: int, scale: float, encoding: Encoding) -> None:
        """Make room for a light key with `count` particles whose codes mean `scale` and `encoding`.

        Doing so again only marks the key as recently used. Coarse records of all other keys are dropped.

        Raises
        ------
        InputError
            If the key is there with another particle count or decoding.
        """
        decoding = decoding_table(scale, encoding)
        with self._lock:
            light = self._lights.pop(key, None)
            if light is None:
                state = np.zeros(count, dtype=np.uint8)
                slot = np.full(count, -1, dtype=np.int32)
                counts = np.array([count, 0, 0, 0, 0], dtype=np.int64)
                light = _Light(key, self._light_count, decoding, state, slot, counts)
                self._by_number[light.number] = light
                self._light_count += 1
            self._lights[key] = light
            if len(light.state) != count or not np.array_equal(light.decoding, decoding):
                raise InputError(
                    f"light key {key} already names {len(light.state)} particles with another decoding, got {count} "
                    "— a light key must cover all that light depends on"
                )
            while len(self._lights) > _MAX_LIGHTS:
                self._drop(next(iter(self._lights.values())))
            for other in self._lights.values():
                if other is not light and len(other.coarse):
                    other.coarse, other.table = NO_COARSE, None
            reserved = _COARSE_BYTES * count if self._affords_coarse(light) else 0
            self._pool.capacity = self._tile_count(self.max_bytes - reserved)
            self._evict(len(self._pool.used()) - self.capacity)

    def see(self, key: str, ids: Ids, client: str = "") -> NDArray[np.bool_]:
        """Note the latest sighting of a client; return (K,) True where a tile should be requested.

        That is where the entry is missing or waits in the queue (a new sighting may move it forward). Entries being
        baked, ready or failed need no request, and those of an unknown key get none.

        Parameters
        ----------
        key
            The light key that the client shows.
        ids
            (K,) int32, all particles that it sees now; these are safe from eviction until its next sighting.
        client
            Any name; :meth:`forget` ends its protection.
        """
        with self._lock:
            light = self._lights.get(key)
            if light is None:
                return np.zeros(len(ids), dtype=bool)
            self._sighting_count += 1
            self._sightings[client] = (light, ids.copy())
            state = light.state[ids]
            ready = state == READY
            self._pool.seen[light.slot[ids[ready]]] = self._sighting_count
            hits = int(np.count_nonzero(ready))
            self._hits += hits
            self._misses += len(ids) - hits
            return state <= QUEUED

    def forget(self, client: str) -> None:
        """Stop protecting what a client saw."""
        with self._lock:
            self._sightings.pop(client, None)

    def room(self) -> int:
        """Tiles that could still be stored without giving up any that a latest sighting shows."""
        with self._lock:
            baking = sum(int(light.counts[BAKING]) for light in self._lights.values())
            return max(0, self.capacity - int(np.count_nonzero(self._protected())) - baking)

    def mark_queued(self, key: str, ids: Ids) -> None:
        """Move missing entries to queued; others stay."""
        self._mark(key, ids, (MISSING,), QUEUED)

    def mark_baking(self, key: str, ids: Ids) -> None:
        """Move missing and queued entries to baking; others stay."""
        self._mark(key, ids, (MISSING, QUEUED), BAKING)

    def release(self, key: str, ids: Ids) -> None:
        """Move queued and baking entries back to missing; others stay."""
        self._mark(key, ids, (QUEUED, BAKING), MISSING)

    def fail(self, key: str, ids: Ids) -> None:
        """Give entries up for good: they are never requested again under this key; ready ones stay."""
        self._mark(key, ids, (MISSING, QUEUED, BAKING), FAILED)

    def publish(self, key: str, ids: Ids, codes: NDArray[np.uint8]) -> int:
        """Store finished tiles, evicting others where needed; return how many found room.

        Publishing a ready entry again replaces its tile; snapshots taken before keep the old one.

        Parameters
        ----------
        ids
            (K,) int32, each once.
        codes
            (K, texels, texels) uint8, copied.
        """
        if codes.shape != (len(ids), self.texels, self.texels) or codes.dtype != np.uint8:
            expected = (len(ids), self.texels, self.texels)
            raise InputError(
                f"tiles must be uint8 of shape {expected}, got {codes.dtype} of shape {codes.shape}"
            )
        with self._lock:
            light = self._lights.get(key)
            if light is None:
                self._dropped += len(ids)
                return 0
            slots = self._pool.take(len(ids))
            if len(slots) < len(ids):
                self._evict(len(ids) - len(slots))
                slots = np.concatenate([slots, self._pool.take(len(ids) - len(slots))])
            stored, lost = ids[: len(slots)], ids[len(slots) :]
            old = light.slot[stored]
            self._pool.put(slots, light.number, stored, codes[: len(slots)], self._sighting_count)
            light.slot[stored] = slots
            light.table = None
            self._pool.retire(old[old >= 0], _living(light))
            self._move(light, stored, READY)
            self._move(light, lost[np.isin(light.state[lost], (QUEUED, BAKING))], MISSING)
            self._published += len(stored)
            self._dropped += len(lost)
            return len(stored)

    def lookup(self, key: str, ids: Ids) -> tuple[NDArray[np.bool_], NDArray[np.uint8]]:
        """Return (K,) bool, which of `ids` are ready, and a copy of their tiles (ready, texels, texels) uint8."""
        with self._lock:
            light = self._lights.get(key)
            if light is None:
                return np.zeros(len(ids), dtype=bool), self._pool.codes[:0]
            slots = light.slot[ids]
            ready = slots >= 0
            return ready, self._pool.codes[slots[ready]]

    def put_coarse(self, key: str, ids: Ids, records: NDArray[np.float32]) -> bool:
        """Keep coarse records, (K, 4) of (K,) `ids`; False if `key` is not the one begun last, or they cost too much."""
        with self._lock:
            light = self._newest(key)
            if light is None or not self._affords_coarse(light):
                return False
            if not len(light.coarse):
                light.coarse = np.full((len(light.state), 4), -1, dtype=np.float32)
            elif light.table is not None or _living(light):  # snapshots hold it
                light.coarse = light.coarse.copy()
            light.coarse[ids] = records
            light.table = None
            return True

    def lacks_coarse(self, key: str, ids: Ids) -> NDArray[np.bool_]:
        """Return (K,) True where :meth:`put_coarse` would be welcome."""
        with self._lock:
            light = self._newest(key)
            if light is None or not self._affords_coarse(light):
                return np.zeros(len(ids), dtype=bool)
            lacking: NDArray[np.bool_] = (
                light.coarse[ids, 0] < 0 if len(light.coarse) else np.ones(len(ids), bool)
            )
            return lacking

    def lookup_coarse(self, key: str, ids: Ids) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
        """Return (K,) bool, which of `ids` have a coarse record, and a copy of those (K', 4) float32."""
        with self._lock:
            light = self._lights.get(key)
            if light is None or not len(light.coarse):
                return np.zeros(len(ids), dtype=bool), NO_COARSE
            records = light.coarse[ids]
            there = records[:, 0] >= 0
            return there, records[there]

    def snapshot(self, key: str) -> TextureTable | None:
        """Return a table for renderers that never changes, or None for an unknown key.

        Tiles that it names are neither overwritten nor reused while anybody holds its ``slot`` array.
        """
        with self._lock:
            light = self._lights.get(key)
            if light is None:
                return None
            if light.table is None:
                # Not flagged read-only: Numba would compile every kernel a second time for such arrays.
                slot, codes = light.slot.copy(), self._pool.codes
                light.table = TextureTable(slot, codes, light.decoding, self.mapping, light.coarse)
                light.readers = [*_living(light), weakref.ref(light.table.slot)]
            return light.table

    def particle_count(self, key: str) -> int:
        """Particles of a light key; 0 if it is unknown."""
        with self._lock:
            light = self._lights.get(key)
            return 0 if light is None else len(light.state)

    def counts(self, key: str) -> Counts:
        """How many particles of `key` are in each state."""
        with self._lock:
            light = self._lights.get(key)
            return Counts() if light is None else Counts(*(int(count) for count in light.counts))

    def stats(self) -> CacheStats:
        """Counters of the whole cache."""
        with self._lock:
            nbytes = self._pool.tile_bytes * sum(int(light.counts[READY]) for light in self._lights.values())
            nbytes += sum(light.coarse.nbytes for light in self._lights.values())
            return CacheStats(self._hits, self._misses, self._published, self._evicted, self._dropped, nbytes)

    # What follows runs under the lock.

    def _newest(self, key: str) -> _Light | None:
        newest = next(reversed(self._lights.values()), None)
        return newest if newest is not None and newest.key == key else None

    def _affords_coarse(self, light: _Light) -> bool:
        return _COARSE_BYTES * len(light.state) <= self.max_bytes // 2

    def _tile_count(self, nbytes: int) -> int:
        return min(max(1, nbytes // (self.texels * self.texels)), 2**31 - 1)

    def _mark(self, key: str, ids: Ids, source: tuple[int, ...], target: int) -> None:
        with self._lock:
            light = self._lights.get(key)
            if light is not None:
                self._move(light, ids[np.isin(light.state[ids], source)], target)

    def _move(self, light: _Light, ids: Ids, target: int) -> None:
        light.counts -= np.bincount(light.state[ids], minlength=_STATE_COUNT)
        light.counts[target] += len(ids)
        light.state[ids] = target

    def _protected(self) -> NDArray[np.bool_]:
        mask = np.zeros(len(self._pool.light), dtype=bool)
        for light, ids in self._sightings.values():
            slots = light.slot[ids]
            mask[slots[slots >= 0]] = True
        return mask

    def _evict(self, count: int) -> None:
        if count <= 0:
            return
        used = self._pool.used()
        candidates = used[~self._protected()[used]]
        count = min(max(count, int(self.capacity * _EVICTION_SHARE)), len(candidates))
        if count == 0:
            return
        order = np.argpartition(self._pool.seen[candidates], count - 1)
        victims = candidates[order[:count]].astype(np.int32)
        numbers = self._pool.light[victims]
        for number in np.unique(numbers):
            self._lose(self._by_number[int(number)], victims[numbers == number])
        self._evicted += count

    def _lose(self, light: _Light, slots: Ids) -> None:
        ids = self._pool.owner[slots]
        light.slot[ids] = -1
        light.table = None
        self._move(light, ids, MISSING)
        self._pool.retire(slots, _living(light))

    def _drop(self, light: _Light) -> None:
        slots = light.slot[light.slot >= 0]
        self._evicted += len(slots)
        self._lose(light, slots)
        del self._lights[light.key], self._by_number[light.number]
        for client in [name for name, (shown, _) in self._sightings.items() if shown is light]:
            del self._sightings[client]


def _living(light: _Light) -> Sequence[Reader]:
    """Snapshots of a light that somebody still holds."""
    light.readers = [reader for reader in light.readers if reader() is not None]
    return light.readers
