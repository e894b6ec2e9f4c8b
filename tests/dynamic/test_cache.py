"""The texture cache against a plain dictionary."""

import gc

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import settings
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from luxel.dynamic.cache import BAKING, FAILED, MISSING, QUEUED, READY, TextureCache
from luxel.errors import InputError

TEXELS = 4
TILE_BYTES = TEXELS * TEXELS
CAPACITY = 5
COUNT = 9
KEYS = st.sampled_from(["day", "night"])
CLIENTS = st.sampled_from(["ann", "bob"])
IDS = st.lists(st.integers(0, COUNT - 1), unique=True, max_size=6)


def ids_of(*values: int) -> np.ndarray:
    return np.array(values, dtype=np.int32)


def tiles_of(*values: int) -> np.ndarray:
    return np.repeat(np.array(values, dtype=np.uint8), TILE_BYTES).reshape(-1, TEXELS, TEXELS)


def make_cache(capacity: int = CAPACITY, keys: tuple[str, ...] = ("day",)) -> TextureCache:
    cache = TextureCache(TEXELS, capacity * TILE_BYTES)
    for key in keys:
        cache.begin(key, COUNT, 1.0, "linear")
    return cache


class CacheMachine(RuleBasedStateMachine):
    """Model: the state of every entry, the tile of each ready one with the sighting that showed it last."""

    def __init__(self):
        super().__init__()
        self.cache = make_cache(keys=("day", "night"))
        self.state = {(key, particle): MISSING for key in ("day", "night") for particle in range(COUNT)}
        self.tiles: dict[tuple[str, int], list[int]] = {}  # entry -> [value, last seen]
        self.sightings: dict[str, set[tuple[str, int]]] = {}
        self.sighting_count = 0
        self.evicted = self.dropped = self.hits = self.misses = self.published = 0
        self.next_value = 0
        self.snapshots: list[tuple[object, dict[int, int]]] = []

    @rule(key=KEYS, ids=IDS, client=CLIENTS)
    def see(self, key, ids, client):
        wanted = self.cache.see(key, ids_of(*ids), client)
        assert wanted.tolist() == [self.state[key, each] in (MISSING, QUEUED) for each in ids]
        self.sighting_count += 1
        self.sightings[client] = {(key, each) for each in ids}
        for each in ids:
            if (key, each) in self.tiles:
                self.tiles[key, each][1] = self.sighting_count
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
                ("mark_queued", (MISSING,), QUEUED),
                ("mark_baking", (MISSING, QUEUED), BAKING),
                ("release", (QUEUED, BAKING), MISSING),
                ("fail", (MISSING, QUEUED, BAKING), FAILED),
            ]
        ),
    )
    def mark(self, key, ids, move):
        name, sources, target = move
        getattr(self.cache, name)(key, ids_of(*ids))
        for each in ids:
            if self.state[key, each] in sources:
                self.state[key, each] = target

    @rule(key=KEYS, ids=IDS)
    def publish(self, key, ids):
        values = [(self.next_value + k) % 256 for k in range(len(ids))]
        self.next_value += len(ids)
        protected = set().union(*self.sightings.values())
        before = {entry: seen for entry, (_, seen) in self.tiles.items()}
        stored = self.cache.publish(key, ids_of(*ids), tiles_of(*values))
        written = {(key, each) for each in ids[:stored]}
        gone = {entry for entry in before if not self.cache.lookup(entry[0], ids_of(entry[1]))[0].all()}
        evictable = set(before) - protected
        # The least recently seen went, and nothing that some client sees.
        assert gone <= evictable
        stayed = [before[entry] for entry in evictable - gone - written]
        assert max((before[entry] for entry in gone), default=-1) <= min(stayed, default=self.sighting_count)
        # A tile that is to be replaced may itself have been evicted for the sake of its batch.
        evicted = self.cache.stats().evicted - self.evicted
        assert len(gone) <= evicted <= len(gone) + len(written & evictable)
        if not self.snapshots:
            assert stored == min(len(ids), CAPACITY - len(before) + len(evictable))
        for entry in gone:
            del self.tiles[entry]
            self.state[entry] = MISSING
        for each, value in zip(ids[:stored], values, strict=False):
            self.tiles[key, each] = [value, self.sighting_count]
            self.state[key, each] = READY
        for each in ids[stored:]:
            if self.state[key, each] in (QUEUED, BAKING):
                self.state[key, each] = MISSING
        self.evicted += evicted
        self.published += stored
        self.dropped += len(ids) - stored

    @rule(key=KEYS)
    def take_snapshot(self, key):
        table = self.cache.snapshot(key)
        expected = {each: tile[0] for (name, each), tile in self.tiles.items() if name == key}
        self.snapshots = [*self.snapshots[-2:], (table, expected)]

    @rule()
    def drop_snapshots(self):
        self.snapshots = []

    @invariant()
    def snapshots_never_change(self):
        for table, expected in self.snapshots:
            assert set(np.flatnonzero(table.slot >= 0).tolist()) == set(expected)
            for particle, value in expected.items():
                assert (table.codes[table.slot[particle]] == value).all()

    @invariant()
    def contents_agree(self):
        everything = np.arange(COUNT, dtype=np.int32)
        for key in ("day", "night"):
            ready, codes = self.cache.lookup(key, everything)
            assert {
                int(each): int(code[0, 0]) for each, code in zip(everything[ready], codes, strict=True)
            } == {each: tile[0] for (name, each), tile in self.tiles.items() if name == key}
            states = [self.state[key, each] for each in range(COUNT)]
            counts = self.cache.counts(key)
            assert [counts.missing, counts.queued, counts.baking, counts.ready, counts.failed] == [
                states.count(state) for state in range(5)
            ]

    @invariant()
    def budget_and_counters_hold(self):
        stats = self.cache.stats()
        assert len(self.tiles) <= CAPACITY
        assert stats.nbytes == len(self.tiles) * TILE_BYTES
        assert (stats.hits, stats.misses, stats.published, stats.evicted, stats.dropped) == (
            self.hits,
            self.misses,
            self.published,
            self.evicted,
            self.dropped,
        )


CacheMachine.TestCase.settings = settings(
    max_examples=200, stateful_step_count=25, deadline=None, derandomize=True
)
TestCacheMachine = CacheMachine.TestCase


def test_the_least_recently_seen_goes_first():
    cache = make_cache(capacity=3)
    for each in (0, 1, 2):
        cache.see("day", ids_of(each))
        cache.publish("day", ids_of(each), tiles_of(each))
    cache.see("day", ids_of(0))
    cache.publish("day", ids_of(3), tiles_of(3))
    assert cache.lookup("day", ids_of(0, 1, 2, 3))[0].tolist() == [True, False, True, True]


def test_a_sighting_counts_even_when_it_is_not_the_latest():
    cache = make_cache(capacity=3)
    cache.publish("day", ids_of(0), tiles_of(0))
    cache.publish("day", ids_of(1, 2), tiles_of(1, 2))
    cache.see("day", ids_of(0))
    cache.see("day", ids_of(2))
    cache.see("day", ids_of())
    cache.publish("day", ids_of(3), tiles_of(3))
    assert cache.lookup("day", ids_of(0, 1, 2, 3))[0].tolist() == [True, False, True, True]


def test_a_replaced_tile_stays_where_a_snapshot_shows_it():
    cache = make_cache(capacity=3)
    cache.publish("day", ids_of(0), tiles_of(10))
    table = cache.snapshot("day")
    cache.publish("day", ids_of(0), tiles_of(20))
    cache.publish("day", ids_of(1), tiles_of(30))
    cache.publish("day", ids_of(2), tiles_of(40))
    assert (table.codes[table.slot[0]] == 10).all()
    assert cache.stats().evicted == 1  # room for the last one came from a tile, not from under the snapshot


def test_what_any_client_sees_is_never_evicted():
    cache = make_cache(capacity=2)
    cache.publish("day", ids_of(0, 1), tiles_of(0, 1))
    cache.see("day", ids_of(0), "ann")
    cache.see("day", ids_of(1), "bob")
    assert cache.room() == 0
    assert cache.publish("day", ids_of(2), tiles_of(2)) == 0
    assert cache.stats().dropped == 1
    cache.forget("ann")
    assert cache.room() == 1
    assert cache.publish("day", ids_of(2), tiles_of(2)) == 1
    assert cache.lookup("day", ids_of(0, 1, 2))[0].tolist() == [False, True, True]


def test_a_caller_may_reuse_the_array_it_sighted_with():
    cache = make_cache(capacity=1)
    ids = ids_of(0)
    cache.publish("day", ids, tiles_of(0))
    cache.see("day", ids)
    ids[0] = 5
    assert cache.publish("day", ids_of(1), tiles_of(1)) == 0


def test_slots_under_a_snapshot_are_not_reused_until_it_is_gone():
    cache = make_cache(capacity=2)
    cache.publish("day", ids_of(0, 1), tiles_of(10, 11))
    table = cache.snapshot("day")
    slot, codes = table.slot, table.codes
    del table
    assert cache.publish("day", ids_of(2), tiles_of(12)) == 0  # every slot is held by a reader
    assert (codes[slot[0]] == 10).all()
    assert (codes[slot[1]] == 11).all()
    del slot, codes
    gc.collect()
    assert cache.publish("day", ids_of(2), tiles_of(12)) == 1


def test_the_pool_grows_and_old_snapshots_stay():
    cache = TextureCache(TEXELS, 1 << 20)
    cache.begin("day", 5000, 1.0, "linear")
    cache.publish("day", ids_of(7), tiles_of(99))
    table = cache.snapshot("day")
    cache.publish(
        "day", np.arange(100, 5000, dtype=np.int32), np.zeros((4900, TEXELS, TEXELS), dtype=np.uint8)
    )
    assert (table.codes[table.slot[7]] == 99).all()
    again = cache.snapshot("day")
    assert (again.codes[again.slot[7]] == 99).all()
    assert np.count_nonzero(again.slot >= 0) == 4901


def test_an_unchanged_snapshot_costs_nothing():
    cache = make_cache()
    cache.publish("day", ids_of(0), tiles_of(1))
    table = cache.snapshot("day")
    assert cache.snapshot("day") is table
    cache.publish("day", ids_of(1), tiles_of(2))
    assert cache.snapshot("day") is not table


def test_unknown_keys_hold_nothing():
    cache = make_cache()
    assert cache.snapshot("dusk") is None
    assert cache.see("dusk", ids_of(0, 1)).tolist() == [False, False]
    ready, codes = cache.lookup("dusk", ids_of(0, 1))
    assert ready.tolist() == [False, False]
    assert codes.shape == (0, TEXELS, TEXELS)
    assert cache.publish("dusk", ids_of(0), tiles_of(0)) == 0
    assert cache.stats().dropped == 1


def test_old_light_keys_are_dropped_with_their_tiles():
    cache = make_cache(capacity=1000)
    cache.publish("day", ids_of(0), tiles_of(0))
    for number in range(16):
        cache.begin(f"hour {number}", COUNT, 1.0, "linear")
    assert cache.snapshot("day") is None
    assert cache.stats().nbytes == 0
    assert cache.stats().evicted == 1


def test_a_key_that_comes_back_keeps_its_tiles():
    cache = make_cache(capacity=1000)
    cache.publish("day", ids_of(0), tiles_of(3))
    for number in range(40):
        cache.begin(f"hour {number}", COUNT, 1.0, "linear")
        cache.begin("day", COUNT, 1.0, "linear")
    assert cache.lookup("day", ids_of(0))[0].all()


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
    with pytest.raises(InputError, match="uint8 of shape"):
        make_cache().publish("day", ids_of(0), codes)


@pytest.mark.parametrize("arguments", [(0, 100), (16, 0)])
def test_a_cache_needs_a_size(arguments):
    with pytest.raises(InputError):
        TextureCache(*arguments)
