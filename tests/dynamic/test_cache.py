"""The texture cache against a plain dictionary."""

import gc
import itertools
import threading

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import settings
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from luxel.dynamic.allotment import bytes_for
from luxel.dynamic.cache import TextureCache
from luxel.dynamic.entries import BAKING, ESTIMATE, FAILED, FULL, IDLE, NONE, QUEUED
from luxel.dynamic.sightings import Sighting, by_shard, shard_of
from luxel.errors import InputError
from luxel.textures.textures import FIRST_LIGHT

from .fakes import GUARD_S, ids_of

TEXELS = 16  # so that a quarter of few textures holds the tables of two light keys
TILE_BYTES = TEXELS * TEXELS
CAPACITY = 5
COUNT = 9
KEYS = st.sampled_from(["day", "night"])
CLIENTS = st.sampled_from(["ann", "bob"])
IDS = st.lists(st.integers(0, COUNT - 1), unique=True, max_size=6)


def tiles_of(*values: int) -> np.ndarray:
    return np.repeat(np.array(values, dtype=np.uint8), TILE_BYTES).reshape(-1, TEXELS, TEXELS)


def make_cache(
    capacity: int = CAPACITY, keys: tuple[str, ...] = ("day",), count: int = COUNT, shards: int | None = None
) -> TextureCache:
    cache = TextureCache(TEXELS, bytes_for(capacity, TEXELS, count), shards=shards)
    for key in keys:
        cache.begin(key, count, 1.0, "linear")
    return cache


def see(cache: TextureCache, key: str, ids: np.ndarray, client: str = "") -> int:
    sighting = Sighting(client, cache.next_number(), key, np.sort(ids), lambda some: (some, None), 0.0)
    return cache.see(sighting)


def publish(
    cache: TextureCache, key: str, ids: np.ndarray, tiles: np.ndarray, grade: int = FULL
) -> list[bool]:
    return cache.publish(cache.light(key), ids, tiles, grade).tolist()


def there(cache: TextureCache, key: str, *ids: int) -> list[bool]:
    return cache.lookup(key, ids_of(*ids))[0].tolist()


class CacheMachine(RuleBasedStateMachine):
    """Model: what is done for every entry, and the texture of each that has one, with the sighting that showed it last."""

    @initialize(shards=st.sampled_from([1, 2, 4]), capacity=st.sampled_from([5, 80]))
    def start(self, shards, capacity):
        # 80 leaves slots for textures on their way in and out, but nothing has to be evicted then.
        self.capacity = capacity
        self.cache = make_cache(capacity, ("day", "night"), shards=shards)
        self.exact = shards == 1 and capacity == CAPACITY
        self.keys = {key: self.cache.light(key) for key in ("day", "night")}
        entries = list(itertools.product(("day", "night"), range(COUNT)))
        self.work = dict.fromkeys(entries, IDLE)
        self.tiles: dict[tuple[str, int], list[int]] = {}  # entry -> [value, last seen, grade]
        self.lit: dict[tuple[str, int], float] = {}
        self.newest = "night"
        self.sightings: dict[str, set[tuple[str, int]]] = {}
        self.number = 0
        self.hits = self.misses = self.queued = self.ready = self.refined = self.dropped = 0
        self.next_value = 0
        self.snapshots: list[tuple[object, dict[int, int], dict[int, float]]] = []

    @rule(key=KEYS, ids=IDS, client=CLIENTS)
    def see(self, key, ids, client):
        lacking = see(self.cache, key, ids_of(*ids), client)
        grades = [self.tiles[key, each][2] if (key, each) in self.tiles else NONE for each in ids]
        assert lacking == sum(
            grade < FULL and self.work[key, each] in (IDLE, QUEUED)
            for grade, each in zip(grades, ids, strict=True)
        )
        self.number += 1
        self.sightings[client] = {(key, each) for each in ids}
        for each in ids:
            if (key, each) in self.tiles:
                self.tiles[key, each][1] = self.number
                self.hits += 1
            else:
                self.misses += 1

    @rule(client=CLIENTS)
    def forget(self, client):
        self.cache.forget(client)
        self.sightings.pop(client, None)

    @rule(
        key=KEYS,
        ids=IDS,
        move=st.sampled_from(
            [
                ("mark_queued", (IDLE,), QUEUED),
                ("mark_baking", (QUEUED,), BAKING),
                ("release", (QUEUED, BAKING), IDLE),
                ("fail", (QUEUED, BAKING), FAILED),
            ]
        ),
    )
    def mark(self, key, ids, move):
        name, sources, target = move
        moved = getattr(self.cache, name)(self.keys[key], ids_of(*ids))
        expected = [self.work[key, each] in sources for each in ids]
        if moved is not None:
            assert moved.tolist() == expected
        for each, does in zip(ids, expected, strict=True):
            if does:
                self.work[key, each] = target
        if name == "mark_queued":
            self.queued += sum(expected)

    @rule(key=KEYS, ids=IDS, grade=st.sampled_from([ESTIMATE, FULL]))
    def publish(self, key, ids, grade):
        values = [(self.next_value + k) % 256 for k in range(len(ids))]
        self.next_value += len(ids)
        protected = set().union(*self.sightings.values())
        before = {entry: tile[1] for entry, tile in self.tiles.items()}
        evicted = self.cache.stats().evicted
        stored = publish(self.cache, key, ids_of(*ids), tiles_of(*values), grade)
        written = {(key, each) for each, does in zip(ids, stored, strict=True) if does}
        gone = {entry for entry in before if not there(self.cache, entry[0], entry[1])[0]}
        evictable = set(before) - protected
        # The least recently seen went, and nothing that some client sees.
        assert gone <= evictable
        evicted = self.cache.stats().evicted - evicted
        # One that is to be replaced may itself have been evicted for the sake of its batch.
        assert len(gone) <= evicted <= len(gone) + len(written & evictable)
        if self.exact:
            stayed = [before[entry] for entry in evictable - gone - written]
            assert max((before[entry] for entry in gone), default=-1) <= min(stayed, default=self.number)
        fresh = [each for each, does in zip(ids, stored, strict=True) if does and (key, each) not in before]
        if self.capacity != CAPACITY:
            assert all(stored)
        elif self.exact and not self.snapshots:
            # What replaces another needs a slot besides, and here there are none to spare.
            room = CAPACITY - len(before) + len(evictable)
            assert len(written) <= room
            assert len(written) == min(len(ids), room) or any((key, each) in before for each in ids)
        replaced = len(written) - len(fresh)
        for entry in gone:
            del self.tiles[entry]
        lost = {entry for entry in written if entry in before} if evicted > len(gone) else set()
        counted = self.cache.stats()
        assert counted.ready - self.ready + counted.refined - self.refined == len(written)
        assert len(fresh) <= counted.ready - self.ready <= len(fresh) + len(lost)
        assert counted.refined - self.refined <= replaced
        self.ready, self.refined = counted.ready, counted.refined
        for each, value, does in zip(ids, values, stored, strict=True):
            if does:
                self.tiles[key, each] = [value, self.number, grade]
                self.work[key, each] = IDLE
            elif self.work[key, each] in (QUEUED, BAKING):
                self.work[key, each] = IDLE
        for entry in gone:
            if self.work[entry] == FAILED:  # it may be asked for again
                self.work[entry] = IDLE
        self.dropped += len(ids) - len(written)

    @rule(key=KEYS, ids=IDS)
    def light_up(self, key, ids):
        records = np.arange(4 * len(ids), dtype=np.float32).reshape(-1, 4) + self.next_value
        self.next_value += 1
        kept = self.cache.put_coarse(self.keys[key], ids_of(*ids), records)
        assert kept == (key == self.newest) or not ids
        if key == self.newest:
            self.lit.update(
                {(key, each): float(record[0]) for each, record in zip(ids, records, strict=True)}
            )

    @rule(key=KEYS)
    def begin(self, key):
        self.cache.begin(key, COUNT, 1.0, "linear")
        self.newest = key
        self.lit = {entry: record for entry, record in self.lit.items() if entry[0] == key}

    @rule(key=KEYS)
    def take_snapshot(self, key):
        table = self.cache.snapshot(key)
        if any(table.slot is known.slot for known, _, _ in self.snapshots):
            return
        expected = {each: tile[0] for (name, each), tile in self.tiles.items() if name == key}
        lit = {
            each: record for (name, each), record in self.lit.items() if name == key and each not in expected
        }
        self.snapshots = [*self.snapshots[-1:], (table, expected, lit)]

    @rule()
    def drop_snapshots(self):
        self.snapshots = []

    @invariant()
    def snapshots_never_change(self):
        for table, expected, lit in self.snapshots:
            assert set(np.flatnonzero(table.slot >= 0).tolist()) == set(expected)
            assert set(np.flatnonzero(table.slot == FIRST_LIGHT).tolist()) == set(lit)
            for particle, value in expected.items():
                assert (table.codes[table.slot[particle]] == value).all()

    @invariant()
    def contents_agree(self):
        everything = np.arange(COUNT, dtype=np.int32)
        for key in ("day", "night"):
            ready, codes, grades = self.cache.lookup(key, everything)
            found = zip(everything[ready].tolist(), codes[:, 0, 0].tolist(), grades.tolist(), strict=True)
            assert {each: (code, grade) for each, code, grade in found} == {
                each: (tile[0], tile[2]) for (name, each), tile in self.tiles.items() if name == key
            }
            lit, records = self.cache.lookup_coarse(key, everything)
            assert dict(zip(everything[lit].tolist(), records[:, 0].tolist(), strict=True)) == {
                each: record for (name, each), record in self.lit.items() if name == key
            }
            bare = [self.work[key, each] for each in range(COUNT) if (key, each) not in self.tiles]
            clad = [self.work[key, each] for each in range(COUNT) if (key, each) in self.tiles]
            counts = self.cache.counts(key)
            assert [counts.missing, counts.queued, counts.baking, counts.failed] == [
                bare.count(work) for work in (IDLE, QUEUED, BAKING, FAILED)
            ]
            assert counts.ready == clad.count(IDLE) + clad.count(FAILED)
            assert counts.refining == clad.count(QUEUED) + clad.count(BAKING)

    @invariant()
    def budget_and_counters_hold(self):
        stats = self.cache.stats()
        assert len(self.tiles) == stats.textures <= self.cache.capacity
        assert stats.nbytes <= self.cache.max_bytes
        assert (stats.hits, stats.misses, stats.queued, stats.dropped) == (
            self.hits,
            self.misses,
            self.queued,
            self.dropped,
        )


CacheMachine.TestCase.settings = settings(
    max_examples=120, stateful_step_count=25, deadline=None, derandomize=True
)
TestCacheMachine = CacheMachine.TestCase


def test_the_least_recently_seen_goes_first():
    cache = make_cache(capacity=3)
    for each in (0, 1, 2):
        see(cache, "day", ids_of(each))
        publish(cache, "day", ids_of(each), tiles_of(each))
    see(cache, "day", ids_of(0))
    publish(cache, "day", ids_of(3), tiles_of(3))
    assert there(cache, "day", 0, 1, 2, 3) == [True, False, True, True]


def test_a_sighting_counts_even_when_it_is_not_the_latest():
    cache = make_cache(capacity=3)
    publish(cache, "day", ids_of(0), tiles_of(0))
    publish(cache, "day", ids_of(1, 2), tiles_of(1, 2))
    see(cache, "day", ids_of(0))
    see(cache, "day", ids_of(2))
    see(cache, "day", ids_of())
    publish(cache, "day", ids_of(3), tiles_of(3))
    assert there(cache, "day", 0, 1, 2, 3) == [True, False, True, True]


def test_what_any_client_sees_is_never_evicted():
    cache = make_cache(capacity=2)
    publish(cache, "day", ids_of(0, 1), tiles_of(0, 1))
    see(cache, "day", ids_of(0), "ann")
    see(cache, "day", ids_of(1), "bob")
    assert cache.room() == 0
    assert publish(cache, "day", ids_of(2), tiles_of(2)) == [False]
    assert cache.stats().dropped == 1
    cache.forget("ann")
    assert cache.room() == 1
    assert publish(cache, "day", ids_of(2), tiles_of(2)) == [True]
    assert there(cache, "day", 0, 1, 2) == [False, True, True]


def test_slots_under_a_snapshot_are_not_reused_until_it_is_gone():
    cache = make_cache(capacity=2)
    publish(cache, "day", ids_of(0, 1), tiles_of(10, 11))
    table = cache.snapshot("day")
    slot, codes = table.slot, table.codes
    del table
    assert publish(cache, "day", ids_of(2), tiles_of(12)) == [False]  # every slot is held by a reader
    assert (codes[slot[0]] == 10).all()
    assert (codes[slot[1]] == 11).all()
    del slot, codes
    gc.collect()
    assert publish(cache, "day", ids_of(2), tiles_of(12)) == [True]


def test_a_texture_is_replaced_under_the_eyes_of_a_frame_though_all_is_visible():
    cache = make_cache(capacity=64, count=70)
    everything = np.arange(64, dtype=np.int32)
    assert all(publish(cache, "day", everything, tiles_of(*range(64)), ESTIMATE))
    see(cache, "day", everything)
    table = cache.snapshot("day")
    assert cache.room() == 0
    assert publish(cache, "day", ids_of(5, 69), tiles_of(200, 201)) == [True, False]
    assert (table.codes[table.slot[5]] == 5).all()
    again = cache.snapshot("day")
    assert (again.codes[again.slot[5]] == 200).all()
    assert cache.stats().refined == 1
    assert cache.stats().textures == 64


def test_room_is_made_ahead_of_need():
    """What is evicted stays where frames read it for a while, so it has to go early."""
    cache = make_cache(capacity=640, count=2000)
    table = None
    for start in range(0, 2000, 10):
        ids = np.arange(start, start + 10, dtype=np.int32)
        see(cache, "day", ids)
        assert all(publish(cache, "day", ids, tiles_of(*ids % 256)))
        shown = {each: table.codes[table.slot[each]] for each in range(start - 10, start)} if table else {}
        assert all((tile == each % 256).all() for each, tile in shown.items())
        table = cache.snapshot("day")
    assert cache.stats().dropped == 0
    assert cache.stats().evicted >= 2000 - 660


def test_an_unchanged_snapshot_costs_nothing():
    cache = make_cache()
    publish(cache, "day", ids_of(0), tiles_of(1))
    table = cache.snapshot("day")
    assert cache.snapshot("day").slot is table.slot
    publish(cache, "day", ids_of(1), tiles_of(2))
    assert cache.snapshot("day").slot is not table.slot


def test_unknown_keys_hold_nothing():
    cache = make_cache()
    assert cache.snapshot("dusk") is None
    assert cache.light("dusk") is None
    assert see(cache, "dusk", ids_of(0, 1)) == 0
    ready, codes, grades = cache.lookup("dusk", ids_of(0, 1))
    assert ready.tolist() == [False, False]
    assert codes.shape == (0, TEXELS, TEXELS)
    assert len(grades) == 0
    assert cache.counts("dusk").missing == 0


def test_old_light_keys_are_dropped_with_their_tiles():
    cache = make_cache(capacity=1000)
    light = cache.light("day")
    publish(cache, "day", ids_of(0), tiles_of(0))
    cache.mark_queued(light, ids_of(1))
    cache.mark_baking(light, ids_of(1))
    for number in range(17):
        cache.begin(f"hour {number}", COUNT, 1.0, "linear")
    assert cache.snapshot("day") is None
    assert cache.stats().textures == 0
    assert cache.stats().evicted == 1
    # What was being made for it finds nobody who wants it.
    assert cache.publish(light, ids_of(1), tiles_of(1)).tolist() == [False]
    assert cache.stats().dropped == 1


def test_a_key_that_comes_back_keeps_its_tiles():
    cache = make_cache(capacity=1000)
    publish(cache, "day", ids_of(0), tiles_of(3))
    for number in range(40):
        cache.begin(f"hour {number}", COUNT, 1.0, "linear")
        cache.begin("day", COUNT, 1.0, "linear")
    assert there(cache, "day", 0) == [True]


@pytest.mark.parametrize("change", [(COUNT + 1, 1.0, "linear"), (COUNT, 2.0, "linear"), (COUNT, 1.0, "sqrt")])
def test_a_key_cannot_mean_two_things(change):
    cache = make_cache()
    with pytest.raises(InputError, match="already names"):
        cache.begin("day", *change)


@pytest.mark.parametrize(
    "codes",
    [np.zeros((1, TEXELS, TEXELS)), np.zeros((2, TEXELS, TEXELS), np.uint8), np.zeros((1, 5, 5), np.uint8)],
)
def test_tiles_of_another_shape_are_refused(codes):
    cache = make_cache()
    with pytest.raises(InputError, match="uint8 of shape"):
        cache.publish(cache.light("day"), ids_of(0), codes)


@pytest.mark.parametrize(
    "arguments", [{"texels": 0}, {"max_bytes": 0}, {"shards": 3}, {"shards": 512}, {"shards": 0}]
)
def test_a_cache_needs_a_size(arguments):
    with pytest.raises(InputError):
        TextureCache(**arguments)


@pytest.mark.parametrize("particles", [1, 50, 4000, 1_000_000])
@pytest.mark.parametrize("textures", [1, 31, 32, 1000, 50_000])
def test_a_budget_is_the_least_that_holds_so_many_textures(textures, particles):
    def capacity(nbytes: int) -> int:
        cache = TextureCache(TEXELS, nbytes, shards=1)
        try:
            cache.begin("day", particles, 1.0, "linear")
        except InputError:
            return 0
        return cache.capacity

    needed = bytes_for(textures, TEXELS, particles)
    assert capacity(needed) >= textures > capacity(needed - 1)


def test_a_budget_below_what_the_tables_need_is_refused():
    cache = TextureCache(16, 1000)
    with pytest.raises(InputError, match=r"1000 bytes are too few .* 10000 particles — set max_bytes to \d+"):
        cache.begin("day", 10_000, 1.0, "linear")
    needed = bytes_for(1, 16, 10_000)
    TextureCache(16, needed).begin("day", 10_000, 1.0, "linear")


def test_a_frame_with_far_more_particles_than_the_first_is_refused():
    cache = TextureCache(16, 1 << 20)
    cache.begin("few", 1000, 1.0, "linear")
    with pytest.raises(InputError, match="too few"):
        cache.begin("many", 1_000_000, 1.0, "linear")
    cache.begin("more", 2000, 1.0, "linear")


def test_a_key_beside_the_current_one_takes_nothing_from_it():
    cache = TextureCache(TEXELS, 1 << 20, shards=1)
    current = cache.begin("current", 2000, 1.0, "linear")
    ids = ids_of(1, 2, 3)
    assert cache.put_coarse(current, ids, np.ones((3, 4), np.float32))
    beside = cache.begin("beside", 2000, 1.0, "linear", beside=True)
    assert cache.lookup_coarse("current", ids)[0].all()
    assert not len(beside.coarse)
    assert cache.begin("beside", 2000, 1.0, "linear", beside=True) is beside
    # It is as recently used as the current one: others are given up before it.
    for k in range(40):
        cache.begin(f"b{k}", 2000, 1.0, "linear")
        assert cache.begin("beside", 2000, 1.0, "linear", beside=True) is beside
    assert cache.light("beside") is beside
    assert len(cache.light("b39").coarse)
    # Where the budget has no room for two, the second is refused and the first is as it was.
    many = cache._set_aside // 13
    alone = TextureCache(TEXELS, 1 << 20, shards=1)
    alone.begin("few", 2000, 1.0, "linear")
    first = alone.begin("many", many, 1.0, "linear")
    with pytest.raises(InputError, match="two lights at once"):
        alone.begin("as many", many, 1.0, "linear", beside=True)
    assert alone.light("many") is first


def test_tables_of_other_keys_give_way_and_then_coarse_records():
    cache = TextureCache(TEXELS, 1 << 20, shards=1)
    cache.begin("a", 2000, 1.0, "linear")
    set_aside = cache._set_aside
    for k in range(20):
        cache.begin(f"b{k}", 2000, 1.0, "linear")
        assert (
            sum(
                light.state.nbytes + light.table.nbytes + light.coarse.nbytes
                for light in cache._lights.values()
            )
            <= set_aside
        )
    assert len(cache.light("b19").coarse)
    assert not len(cache.light("b18").coarse)
    # So many that only states, slots and two copies fit.
    many = set_aside // 13
    cache.begin("many", many, 1.0, "linear")
    assert len(cache._lights) == 1
    assert not len(cache.light("many").coarse)
    held = [cache.snapshot("many")]
    for each in range(5):
        publish(cache, "many", ids_of(each), tiles_of(each))
        held.append(cache.snapshot("many"))
        assert cache.stats().nbytes <= cache.max_bytes
    assert held[-1].slot is held[1].slot  # the third to be held is the second again


def test_shards_share_out_every_particle_and_lattices_evenly():
    ids = np.arange(100_000, dtype=np.int32)
    for shards in (1, 2, 8, 256):
        parts = by_shard(ids, shards)
        assert np.array_equal(np.sort(np.concatenate(parts)), ids)
        for k, place in enumerate(parts):
            assert (shard_of(ids[place], shards) == k).all()
            assert (np.diff(place) > 0).all()
        for step in (1, 2, 7, 8, 22, 128):  # the top layer of a lattice
            counts = np.bincount(shard_of(ids[::step], shards), minlength=shards)
            assert counts.max() <= 1.6 * max(16, len(ids[::step]) / shards)


def test_many_threads_publish_to_few_slots():
    """Textures are right, within the budget, and counted, whatever happens at the same time."""
    cache = make_cache(capacity=200, count=3000, shards=4)
    light = cache.light("day")
    wrong: list[str] = []
    stop = threading.Event()

    def work(number: int) -> None:
        rng = np.random.default_rng(number)
        for _ in range(150):
            ids = np.unique(rng.integers(0, 1000, 12) * 3 + number).astype(np.int32)
            cache.mark_queued(light, ids)
            mine = ids[cache.mark_baking(light, ids)]
            cache.publish(light, mine, tiles_of(*mine % 251))
        stop.set()

    def frames() -> None:
        rng = np.random.default_rng(9)
        while not stop.is_set():
            table = cache.snapshot("day")
            shown = np.flatnonzero(table.slot >= 0).astype(np.int32)
            see(cache, "day", np.unique(rng.integers(0, 3000, 100)).astype(np.int32))
            if not (table.codes[table.slot[shown]][:, 0, 0] == shown % 251).all():
                wrong.append("a texture of another particle")
            if cache.stats().nbytes > cache.max_bytes:
                wrong.append("budget")

    threads = [threading.Thread(target=work, args=(k,)) for k in range(3)] + [threading.Thread(target=frames)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(GUARD_S)
    assert not wrong
    stats, counts = cache.stats(), cache.counts("day")
    ready, codes, _ = cache.lookup("day", np.arange(3000, dtype=np.int32))
    assert stats.textures == np.count_nonzero(ready) == counts.ready
    assert (codes[:, 0, 0] == np.flatnonzero(ready) % 251).all()
    assert stats.ready - stats.evicted == stats.textures
    assert counts.queued == counts.baking == 0
