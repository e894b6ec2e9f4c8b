"""TextureCache: the luminance texture cache of paper 4.2, decentralised as its section 5 asks for."""

from __future__ import annotations

import contextlib
import itertools
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxel.dynamic.allotment import (
    ALL_BYTES,
    COARSE_BYTES,
    COPY_BYTES,
    LEAST_COPIES,
    LIGHT_BYTES,
    MAX_LIGHTS,
    OTHER_BYTES,
    bytes_for,
    set_aside,
    slot_count,
)
from luxel.dynamic.arena import NOBODY, SLOT_BYTES, Arena
from luxel.dynamic.compressor import Compressor
from luxel.dynamic.entries import (
    DAWNING,
    FAILED,
    FULL,
    LIT,
    STORED,
    WANTING,
    Counts,
    Entries,
)
from luxel.dynamic.shard import Shard
from luxel.dynamic.sightings import Ids, Sighting, by_shard, shard_of
from luxel.dynamic.slot_table import SlotTable
from luxel.errors import InputError
from luxel.kernels.seen import note_sighting
from luxel.light.mapping import Mapping
from luxel.textures.textures import FIRST_LIGHT, NO_COARSE, Encoding, TextureTable, decoding_table
from luxel.trace.tree import thread_count

__all__ = ["CacheStats", "TextureCache"]

_MOST_COPIES = 3
# Fewer particles, or room for fewer textures, are not worth several locks.
_SHARDED_COUNT = 16_384
_MOST_SHARDS = 8


@dataclass(frozen=True)
class CacheStats:
    """Counters since the cache was made, and what it holds now.

    Parameters
    ----------
    hits, misses
        Sighted particles that had a texture, and that had none.
    queued
        Requests taken in.
    ready
        Textures stored where there was none.
    refined
        Textures stored in place of others.
    evicted
        Textures given up to make room.
    dropped
        Finished textures that found no room, or whose light key was gone.
    textures
        Textures held now.
    nbytes
        Bytes of these textures, of their slots and of all tables of particles.
    error
        Root mean square of what compression changed, in codes, over all textures stored; 0 without compression.
    """

    hits: int = 0
    misses: int = 0
    queued: int = 0
    ready: int = 0
    refined: int = 0
    evicted: int = 0
    dropped: int = 0
    textures: int = 0
    nbytes: int = 0
    error: float = 0.0


class TextureCache:
    """Keeps finished textures within a byte budget, and knows the state of every particle's texture.

    An entry is named by (light key, particle id) and goes missing → queued → baking → ready, and on to refining and
    ready again when its first texture was an estimate. What was seen longest ago is evicted first, and never what the latest
    sighting of some client shows. A sighting is what :meth:`see` is told; a texture also counts as seen when it is published.

    *Budget.* Memory for textures is one block, reserved with the first light key and taken from the system as slots are first
    written, never more; what tables of particles need is set aside before (states, slots, copies of these for frames, coarse records
    of the light key begun last). Where that is too little, old light keys are dropped, then coarse records done without.

    *Threads.* Particles are spread over shards, each with slots and a lock of its own, held for one method of one
    shard at a time. :meth:`see` and :meth:`snapshot`, which frames call, take none of these locks: what they read is written so that it
    can be read at any time. A sighting protects from its end on against evictions that begin later. There is no thread and no clock inside.

    Parameters
    ----------
    texels
        Rows and columns of every texture.
    max_bytes
        Budget, see :func:`bytes_for`.
    mapping
        From texels to directions, for renderers.
    shards
        A power of two up to 256; None means 1 for few particles or little room, else as many as the process may use threads, up to 8.
    components
        Keep textures as so many principal components, a byte each, see :class:`luxel.dynamic.compressor.Compressor`; 0 keeps them as they are.
    """

    def __init__(
        self,
        texels: int = 16,
        max_bytes: int = 256 << 20,
        mapping: Mapping = "latlong",
        shards: int | None = None,
        components: int = 0,
    ) -> None:
        if texels < 1 or max_bytes < 1:
            raise InputError(f"a cache needs texels >= 1 and max_bytes >= 1, got {texels} and {max_bytes}")
        if shards is not None and not (1 <= shards <= 256 and shards & (shards - 1) == 0):
            raise InputError(f"shards must be a power of two in 1..256, got {shards}")
        self.texels, self.components = texels, components
        self.max_bytes = max_bytes
        self.mapping: Mapping = mapping
        self.sightings: dict[str, Sighting] = {}  # the latest of every client; written by frames
        self.version = 0  # changes with every sighting
        self._compressor = Compressor(texels, components, self._bases_in_use) if components else None
        self._shard_count = shards
        self._numbers = itertools.count(1)
        self._number = 0
        self._lock = threading.Lock()  # of those who begin light keys
        self._seen_lock = threading.Lock()  # of those who see, about the next two
        self._hits = self._misses = 0
        self._arena: Arena | None = None
        self._shards: tuple[Shard, ...] = ()
        self._set_aside = 0  # bytes for tables of particles
        self._lights: dict[str, Entries] = {}  # in the order of their latest begin()
        self._by_number: dict[int, Entries] = {}
        self._light_count = 0

    @property
    def capacity(self) -> int:
        """Textures that may be kept for as long as somebody looks at them; 0 before the first light key."""
        return sum(shard.capacity for shard in self._shards)

    @property
    def shards(self) -> tuple[Shard, ...]:
        """All shards; none before the first light key."""
        return self._shards

    def begin(
        self, key: str, count: int, scale: float, encoding: Encoding, *, beside: bool = False
    ) -> Entries:
        """Make room for a light key with `count` particles whose codes mean `scale` and `encoding`.

        Doing so again only marks the key as recently used. Coarse records of all other keys are forgotten.

        With `beside`, the key is a second one that is looked at together with the one begun last: that stays what it is, and keeps
        its coarse records; the second has none.

        Raises
        ------
        InputError
            If the key is there with another particle count or decoding, or the budget is too small for so many particles,
            or for two keys of so many.
        """
        decoding = decoding_table(scale, encoding)
        with self._lock:
            light = self._lights.get(key)
            if light is not None and (
                len(light.state) != count or not np.array_equal(light.decoding, decoding)
            ):
                raise InputError(
                    f"light key {key} already names {len(light.state)} particles with another decoding, got {count} "
                    "— a light key must cover all that light depends on"
                )
            self._reserve(count)
            if light is None:
                state, table = np.zeros(count, np.uint8), SlotTable(count)
                counts = np.zeros((len(self._shards), 16), np.int64)
                counts[:, 0] = _population(count, len(self._shards))
                light = Entries(key, self._light_count, decoding, state, table, counts)
                self._light_count += 1
                self._by_number[light.number] = light
            others = {name: other for name, other in self._lights.items() if other is not light}
            if beside and others:
                latest, current = others.popitem()
                self._lights = {**others, key: light, latest: current}
                self._share_out(current, [*others.values(), light])
                if light.dropped:
                    raise InputError(
                        f"{self.max_bytes} bytes are too few to keep {count} particles under two lights at once — set max_bytes to "
                        f"{ALL_BYTES * 4 * count} at least"
                    )
            else:
                self._lights = {**others, key: light}
                self._share_out(light, list(others.values()))
            return light

    def light(self, key: str) -> Entries | None:
        """Return the entries of a light key, None if it is unknown."""
        return self._lights.get(key)

    def see(self, sighting: Sighting) -> int:
        """Note the latest sighting of a client; return for how many particles something may be left to do.

        Its particles are safe from eviction until the client's next sighting or :meth:`forget`. Takes no lock that others
        hold for long.
        """
        light = self._lights.get(sighting.key)
        if light is None:
            return 0
        ids = sighting.ids
        self.sightings[sighting.client] = sighting
        self.version = self.next_number()
        self._number = sighting.number
        arena = self._arena
        assert arena is not None  # there is a light key
        # A slot may change hands while it is looked at: then another texture counts as seen, which does no harm.
        hits, lacking = note_sighting(
            ids, light.table.live, light.state, STORED, WANTING, arena.seen, sighting.number
        )
        with self._seen_lock:
            self._hits += hits
            self._misses += len(ids) - hits
        return int(lacking)

    def next_number(self) -> int:
        """Return a number that was not there before, for a sighting."""
        return next(self._numbers)

    def forget(self, client: str) -> None:
        """Stop protecting what a client saw."""
        self.sightings.pop(client, None)
        self.version = self.next_number()

    def room(self) -> int:
        """Textures that could still be stored without giving up any that a latest sighting shows."""
        return sum(shard.room() for shard in self._shards)

    def mark_queued(self, light: Entries, ids: Ids) -> NDArray[np.bool_]:
        """Move idle entries to queued; return (K,) bool, which of `ids` these were."""
        moved = np.zeros(len(ids), np.bool_)
        for shard, place in self._split(ids):
            moved[place] = shard.mark_queued(light, ids[place])
        return moved

    def mark_baking(self, light: Entries, ids: Ids) -> NDArray[np.bool_]:
        """Move queued entries to baking; return (K,) bool, which of `ids` these were."""
        moved = np.zeros(len(ids), np.bool_)
        for shard, place in self._split(ids):
            moved[place] = shard.mark_baking(light, ids[place])
        return moved

    def mark_dawning(self, light: Entries, ids: Ids) -> NDArray[np.bool_]:
        """Note that first light is being made; return (K,) bool, which of `ids` had none and were not being made."""
        moved = np.zeros(len(ids), np.bool_)
        for shard, place in self._split(ids):
            moved[place] = shard.mark_dawning(light, ids[place])
        return moved

    def release_dawning(self, light: Entries, ids: Ids) -> None:
        """Note that first light is not being made after all."""
        for shard, place in self._split(ids):
            shard.release_dawning(light, ids[place])

    def release(self, light: Entries, ids: Ids) -> None:
        """Move queued and baking entries back to idle; others stay."""
        for shard, place in self._split(ids):
            shard.release(light, ids[place])

    def fail(self, light: Entries, ids: Ids) -> None:
        """Give queued and baking entries up: nothing better is requested for them under this key."""
        for shard, place in self._split(ids):
            shard.release(light, ids[place], FAILED)

    def publish(
        self, light: Entries, ids: Ids, codes: NDArray[np.uint8], grade: int = FULL
    ) -> NDArray[np.bool_]:
        """Store finished textures, evicting others where needed; return (K,) bool, which of `ids` found room.

        Publishing an entry again replaces its texture; snapshots taken before keep the old one.

        Parameters
        ----------
        light
            What :meth:`begin` returned.
        ids
            (K,) int32, each once.
        codes
            (K, texels, texels) uint8, copied.
        grade
            `ESTIMATE` or `FULL`.
        """
        if codes.shape != (len(ids), self.texels, self.texels) or codes.dtype != np.uint8:
            expected = (len(ids), self.texels, self.texels)
            raise InputError(
                f"textures must be uint8 of shape {expected}, got {codes.dtype} of shape {codes.shape}"
            )
        kept = codes if self._compressor is None else self._compressor.pack(light.key, codes)
        stored = np.zeros(len(ids), np.bool_)
        for shard, place in self._split(ids):
            stored[place] = shard.publish(light, ids[place], kept[place], self._number, grade)
        return stored

    def lookup(self, key: str, ids: Ids) -> tuple[NDArray[np.bool_], NDArray[np.uint8], NDArray[np.uint8]]:
        """Return (K,) bool, which of `ids` have a texture, and copies of these (K', texels, texels) and of their grades (K',)."""
        there = np.zeros(len(ids), np.bool_)
        codes = np.empty((len(ids), *self._shape), np.uint8)
        grades = np.empty(len(ids), np.uint8)
        light = self._lights.get(key)
        if light is not None:
            for shard, place in self._split(ids):
                found, some, grade = shard.lookup(light, ids[place])
                there[place] = found
                codes[place[found]], grades[place[found]] = some, grade
        kept = codes[there]
        return there, kept if self._compressor is None else self._compressor.unpack(kept), grades[there]

    def put_coarse(self, light: Entries, ids: Ids, records: NDArray[np.float32]) -> bool:
        """Keep coarse records, (K, 4) of (K,) `ids`; False if the key is not the one begun last, or they cost too much."""
        kept = True
        for shard, place in self._split(ids):
            kept &= shard.light_up(light, ids[place], records[place])
        return kept

    def lookup_coarse(self, key: str, ids: Ids) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
        """Return (K,) bool, which of `ids` have a coarse record, and a copy of those (K', 4) float32."""
        light = self._lights.get(key)
        there = np.zeros(len(ids), np.bool_)
        if light is None:
            return there, NO_COARSE
        coarse = light.coarse
        if len(coarse):
            there = (light.state[ids] & np.uint8(LIT)) != 0
        return there, coarse[ids[there]]

    def snapshot(self, key: str) -> TextureTable | None:
        """Return a table for renderers that never changes, or None for an unknown key.

        Textures that it names are neither overwritten nor reused while anybody holds its ``slot`` array. Costs as much as has changed since
        an earlier one, and waits for nobody but others who take one.
        """
        light = self._lights.get(key)
        arena = self._arena
        if light is None or arena is None:
            return None
        # Not flagged read-only: Numba would compile every kernel a second time for such arrays.
        compressor = self._compressor
        bases = None if compressor is None else compressor.bases
        slot = light.table.freeze()
        codes: Any = arena.codes
        while compressor is not None:
            codes = compressor.lookup(arena.codes)
            if compressor.bases is bases:
                break
            bases, slot = (
                compressor.bases,
                light.table.freeze(),
            )  # a record may name a basis that has come or gone meanwhile
        return TextureTable(slot, codes, light.decoding, self.mapping, light.coarse)

    def particle_count(self, key: str) -> int:
        """Particles of a light key; 0 if it is unknown."""
        light = self._lights.get(key)
        return 0 if light is None else len(light.state)

    def counts(self, key: str) -> Counts:
        """How many particles of `key` are in each state."""
        light = self._lights.get(key)
        return Counts() if light is None else Counts.of(light.counts.sum(axis=0))

    def stats(self) -> CacheStats:
        """Counters of the whole cache."""
        textures = sum(shard.used for shard in self._shards)
        nbytes = textures * (self._texture_bytes + SLOT_BYTES)
        nbytes += sum(_table_bytes(light) for light in list(self._lights.values()))

        def total(name: str) -> int:
            return sum(getattr(shard, name) for shard in self._shards)

        return CacheStats(
            self._hits,
            self._misses,
            total("queued"),
            total("ready"),
            total("refined"),
            total("evicted"),
            total("dropped"),
            textures,
            nbytes,
            0.0 if self._compressor is None else self._compressor.error,
        )

    @property
    def _shape(self) -> tuple[int, ...]:
        """Of a texture as it is kept."""
        return (self.texels, self.texels) if self._compressor is None else (self._compressor.record_bytes,)

    @property
    def _texture_bytes(self) -> int:
        return int(np.prod(self._shape))

    def _reserve(self, count: int) -> None:
        """Divide the budget between textures and tables when it is first known how many particles there are."""
        fixed = 0 if self._compressor is None else self._compressor.most_bytes
        if self._arena is None:
            slots = slot_count(self.max_bytes - fixed, self._texture_bytes, count)
            if slots > 0:
                self._set_aside = set_aside(self.max_bytes - fixed, count)
                shards = self._shard_count or (_usual_shards() if min(slots, count) >= _SHARDED_COUNT else 1)
                slots = max(slots, shards)
                self._arena = arena = Arena(slots, self._shape)
                ends = [k * slots // shards for k in range(shards + 1)]
                self._shards = tuple(
                    Shard(k, arena, ends[k], ends[k + 1], self._protection, self._by_number)
                    for k in range(shards)
                )
        if self._arena is None or LIGHT_BYTES * count > self._set_aside:
            components = 0 if self._compressor is None else self._compressor.components
            needed = bytes_for(1, self.texels, count, components)
            raise InputError(
                f"{self.max_bytes} bytes are too few to keep textures of {count} particles — set max_bytes to {needed} at least, "
                f"better {ALL_BYTES * 4} for each particle"
            )

    def _share_out(self, light: Entries, others: list[Entries]) -> None:
        """Fit the tables of all light keys, oldest first in `others`, into what is set aside; give the oldest up."""
        count = len(light.state)
        for each in (light, *others):
            each.table.spare()
        # Frames that go on may hold copies of older light keys, and more of this one than there were to be.
        held = max(0, light.state.nbytes + light.table.nbytes - LIGHT_BYTES * count)
        left = self._set_aside - LIGHT_BYTES * count - held
        coarse = COARSE_BYTES * count <= left
        if coarse:
            left -= COARSE_BYTES * count
        needed = [
            max(OTHER_BYTES * len(other.state), other.state.nbytes + other.table.nbytes) for other in others
        ]
        while others and (len(others) >= MAX_LIGHTS or sum(needed) > left):
            self._drop(others.pop(0))
            del needed[0]
        for other in others:
            self._put_out(other)
            other.table.most_copies = 1
        left -= sum(needed)
        light.table.most_copies = min(_MOST_COPIES, LEAST_COPIES + left // max(1, COPY_BYTES * count))
        if coarse and not len(light.coarse):
            light.coarse = np.empty((count, 4), np.float32)

    def _put_out(self, light: Entries) -> None:
        """Forget coarse records."""
        if not len(light.coarse):
            return
        with contextlib.ExitStack() as stack:
            for shard in self._shards:
                stack.enter_context(shard.lock)
            light.coarse = NO_COARSE
            light.state &= np.uint8(~(LIT | DAWNING) & 0xFF)
            light.table.replace(FIRST_LIGHT, NOBODY)

    def _drop(self, light: Entries) -> None:
        light.dropped = True
        self._put_out(light)
        for shard in self._shards:
            shard.lose_all(light)
        del self._by_number[light.number]
        self._lights = {key: other for key, other in self._lights.items() if other is not light}

    def _bases_in_use(self) -> set[int]:
        return {basis for shard in self._shards for basis in shard.first_bytes()}

    def _split(self, ids: Ids) -> Iterator[tuple[Shard, NDArray[np.intp]]]:
        """Yield every shard that has some of `ids`, and where these are."""
        if not len(ids):
            return
        if len(self._shards) == 1:
            yield self._shards[0], np.arange(len(ids))
            return
        first = shard_of(ids, len(self._shards))
        if (first == first[0]).all():
            yield self._shards[int(first[0])], np.arange(len(ids))
            return
        for shard, place in zip(self._shards, by_shard(ids, len(self._shards)), strict=True):
            if len(place):
                yield shard, place

    def _protection(self, shard: int) -> Sequence[tuple[Entries, Ids]]:
        found = []
        for sighting in list(self.sightings.values()):
            light = self._lights.get(sighting.key)
            if light is not None:
                found.append((light, sighting.part(shard, len(self._shards))))
        return found


def _usual_shards() -> int:
    """Enough that threads seldom wait for each other; every one costs something at every sighting, however little there is to do."""
    threads = min(thread_count(None), _MOST_SHARDS)
    return 1 << (threads - 1).bit_length()


@lru_cache(maxsize=4)
def _population(count: int, shards: int) -> NDArray[np.int64]:
    """(shards,) how many of `count` particles each shard has."""
    return np.bincount(shard_of(np.arange(count, dtype=np.int32), shards), minlength=shards)


def _table_bytes(light: Entries) -> int:
    return light.state.nbytes + light.table.nbytes + light.coarse.nbytes
