"""The texture engine with bakers that cost nothing."""

import threading
from collections import Counter
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from luxel.dynamic.entries import ESTIMATE, FULL, Counts
from luxel.errors import SessionClosedError

from .fakes import GUARD_S, FakeBaker, Stage, code_of, ids_of


@pytest.mark.parametrize("threads, shards", [(0, 1), (1, 4), (4, 1), (4, 8)])
def test_every_visible_particle_becomes_ready_exactly_once(threads, shards):
    stage = Stage(threads, shards=shards)
    stage.select("day")
    visible = range(0, 1000, 2)
    stage.request("day", visible)
    stage.request("day", visible)  # a second sighting of what is still queued bakes nothing twice
    assert stage.engine.wait(GUARD_S)
    assert stage.ready("day") == set(visible)
    assert sorted(stage.heard) == [("day", each) for each in visible]
    assert not stage.wrong
    assert stage.made == ["day"]
    assert stage.request("day", visible) == 0
    assert stage.queued("day") == 0
    stage.engine.close()


def test_threads_do_not_change_a_byte():
    found = []
    for threads in (1, 4):
        stage = Stage(threads)
        stage.select("day")
        stage.request("day", range(1000))
        assert stage.engine.wait(GUARD_S)
        found.append(stage.cache.lookup("day", np.arange(1000, dtype=np.int32))[1])
        stage.engine.close()
    assert (found[0] == found[1]).all()


def test_near_particles_come_first():
    stage = Stage()
    stage.select("day")
    stage.request("day", [1, 2, 3], distance=[0.9, 0.1, 0.5])
    assert stage.engine.wait()
    assert [each for _, each in stage.heard] == [2, 3, 1]


def test_a_change_of_light_cancels_what_waits_and_keeps_what_is_done():
    stage = Stage()
    stage.select("day")
    stage.request("day", range(100))
    while not stage.heard:
        assert stage.engine.run_once()
    done = stage.ready("day")
    assert 0 < len(done) < 100
    stage.select("night")
    assert not stage.engine.run_once()
    counts = stage.cache.counts("day")
    assert (counts.queued, counts.baking, counts.ready) == (0, 0, len(done))
    stage.request("night", range(10))
    stage.engine.wait()
    assert stage.ready("night") == set(range(10))
    assert stage.ready("day") == done
    stage.select("day")  # undone: nothing of it is baked again
    assert stage.request("day", range(100)) == 100 - len(done)
    stage.engine.wait()
    assert sorted(stage.heard) == sorted(
        [("day", each) for each in range(100)] + [("night", each) for each in range(10)]
    )
    assert stage.made == ["day", "night"]


def test_requests_for_a_key_that_is_not_current_are_ignored():
    stage = Stage()
    stage.select("day")
    assert stage.request("night", [1, 2]) == 0
    assert not stage.engine.run_once()


def test_results_that_come_too_late_are_cached_under_their_own_key():
    stage = Stage()
    stage.select("day")
    stage.request("day", [1, 2])
    baker = stage.bakers["day"] = FakeBaker("day")
    bake = baker.bake_into

    def slow(ids, codes):
        stage.select("night")
        return bake(ids, codes)

    baker.bake_into = slow
    while not stage.heard:
        assert stage.engine.run_once()
    assert stage.stale == {"day"}
    assert stage.ready("day") == {each for _, each in stage.heard}
    assert stage.ready("night") == set()


def test_a_failed_batch_is_done_once_more_one_by_one(caplog):
    stage = Stage(bad=(3,))
    stage.select("day")
    stage.request("day", range(10))
    while not stage.engine.error:  # reported with the step in which it happens
        assert stage.engine.run_once()
    assert stage.engine.error == "ArithmeticError: a bad particle"
    stage.engine.wait()
    batches = stage.bakers["day"].batches
    failed = next(batch for batch in batches if 3 in batch)
    assert all([particle] in batches for particle in failed)
    assert sum(3 in batch for batch in batches) == 2
    assert stage.ready("day") == set(range(10)) - {3}
    counts = stage.cache.counts("day")
    assert (counts.failed, counts.baking, counts.queued) == (1, 0, 0)
    assert stage.request("day", range(10)) == 0  # never asked for again
    assert not stage.engine.run_once()
    assert not stage.wrong
    assert "a bad particle" in caplog.text
    stage.select("night")
    assert stage.engine.error is None


def test_a_failure_that_passes_leaves_no_trace():
    stage = Stage(bad=(3,))
    stage.select("day")
    stage.request("day", [1, 2, 3])
    while not stage.engine.error:
        stage.engine.run_once()
    stage.bakers["day"].bad.clear()
    stage.engine.wait()
    assert stage.ready("day") == {1, 2, 3}
    assert stage.cache.counts("day").failed == 0


def test_a_failure_under_an_old_light_is_not_repeated():
    stage = Stage(bad=(3,))
    stage.select("day")
    stage.request("day", [3])
    while not stage.engine.error:
        stage.engine.run_once()
    stage.select("night")
    assert not stage.engine.run_once()
    assert stage.cache.counts("day") == Counts(missing=1000)
    stage.select("day")
    stage.bakers["day"].bad.clear()
    stage.request("day", [3])
    stage.engine.wait()
    assert stage.ready("day") == {3}


def test_a_baker_that_fails_for_everything_is_given_up_soon(caplog):
    stage = Stage(bad=tuple(range(1000)))
    stage.select("day")
    stage.request("day", range(1000))
    stage.engine.wait()
    assert len(stage.bakers["day"].batches) < 50
    assert len(caplog.records) < 50
    assert stage.cache.counts("day").failed == 16
    assert stage.cache.counts("day").queued == 0
    stage.request("day", range(1000))
    assert not stage.engine.run_once()
    stage.select("night")
    stage.bakers["night"] = FakeBaker("night")
    stage.request("night", [1])
    stage.engine.wait()
    assert stage.ready("night") == {1}


def test_an_interrupt_leaves_its_batch_to_be_done_later():
    stage = Stage()
    baker = stage.bakers["day"] = FakeBaker("day")
    bake = baker.bake_into

    def interrupted(ids, codes):
        baker.bake_into = bake
        raise KeyboardInterrupt

    baker.bake_into = interrupted
    stage.select("day")
    stage.request("day", [1, 2])
    with pytest.raises(KeyboardInterrupt):
        stage.engine.wait()
    assert stage.cache.counts("day").baking == 0
    stage.request("day", [1, 2])
    assert stage.engine.wait()
    assert stage.ready("day") == {1, 2}


@pytest.mark.parametrize("shards", [1, 8])
def test_workers_survive_failures_of_bakers_and_listeners(shards):
    stage = Stage(threads=2, shards=shards, bad=(3,))

    def fragile(batch):
        raise ValueError("a listener that fails")

    stage.engine.subscribe(fragile)
    stage.select("day")
    stage.request("day", [3])
    assert stage.engine.wait(GUARD_S)
    stage.request("day", range(500))
    assert stage.engine.wait(GUARD_S)
    assert stage.ready("day") == set(range(500)) - {3}
    stage.engine.close()


def test_a_thread_survives_even_what_is_no_exception(caplog):
    stage = Stage(threads=1)
    baker = stage.bakers["day"] = FakeBaker("day")
    bake = baker.bake_into

    def exits(ids, codes):
        baker.bake_into = bake
        raise SystemExit

    baker.bake_into = exits
    stage.select("day")
    stage.request("day", [1])
    assert stage.engine.wait(GUARD_S)
    assert stage.engine.error == "SystemExit: "
    stage.request("day", [1, 2])
    assert stage.engine.wait(GUARD_S)
    assert stage.ready("day") == {1, 2}
    stage.engine.close()


@pytest.mark.parametrize("threads", [0, 2])
def test_a_baker_that_cannot_be_made_is_reported(threads):
    stage = Stage(threads)

    def broken():
        stage.made.append("day")
        raise MemoryError("no room for a tree")

    stage.engine.select("day", stage.count, 1.0, "linear", broken)
    stage.request("day", [1, 2])
    assert stage.engine.wait(GUARD_S)
    assert stage.made == ["day"] * 2
    assert stage.engine.error == "MemoryError: no room for a tree"
    assert stage.cache.counts("day").queued == 0
    stage.request("day", [1, 2])
    assert stage.engine.wait(GUARD_S)
    assert stage.made == ["day"] * 2
    stage.select("night")
    stage.request("night", [1])
    assert stage.engine.wait(GUARD_S)
    assert stage.ready("night") == {1}
    stage.engine.close()


def test_only_the_latest_bakers_are_kept():
    stage = Stage()
    for key in ("a", "b", "c", "d", "c", "a"):
        stage.select(key)
        stage.request(key, [len(stage.heard)])
        stage.engine.wait()
    assert stage.made == ["a", "b", "c", "d", "a"]


def test_the_last_requests_are_spread_over_threads():
    stage = Stage(shards=1)
    stage.select("day")
    stage.request("day", range(16))
    stage.engine.thread_count = 4
    while stage.engine.run_once():
        pass
    assert max(len(batch) for batch in stage.bakers["day"].batches) <= 4


def test_requests_lapse_once_their_client_looks_elsewhere():
    stage = Stage(engine={"expiry_s": 2.0})
    stage.select("day")
    stage.request("day", [1], client="ann")
    stage.request("day", [2], client="bob")
    assert stage.queued("day") == 2
    stage.clock.now_s += 3
    assert stage.queued("day") == 2  # both rest
    stage.request("day", [5], client="ann")
    assert stage.queued("day") == 2
    stage.engine.wait()
    assert stage.ready("day") == {2, 5}


def test_requests_lapse_though_all_in_sight_is_ready():
    stage = Stage()
    stage.select("day")
    stage.request("day", [1])
    stage.engine.wait()
    stage.request("day", [2])
    assert stage.queued("day") == 1
    stage.request("day", [1])
    assert stage.queued("day") == 1
    stage.clock.now_s += 3
    assert stage.queued("day") == 0
    assert not stage.engine.run_once()


def test_a_client_that_leaves_takes_its_requests_with_it():
    stage = Stage()
    stage.select("day")
    stage.request("day", [1, 2], client="ann")
    stage.request("day", [2, 3], client="bob")
    stage.engine.forget("ann")
    stage.engine.wait()
    assert stage.ready("day") == {2, 3}
    assert stage.cache.counts("day").missing == 998


def test_a_view_larger_than_the_cache_bakes_what_fits_and_stops():
    stage = Stage(capacity=50, count=140)
    stage.select("day")
    distance = np.linspace(0, 1, 80)
    stage.request("day", range(80), distance)
    stage.engine.wait()
    assert stage.ready("day") == set(range(50))  # the nearest
    assert stage.engine.over_budget == 30
    for _ in range(5):
        assert stage.request("day", range(80), distance) == 30
        stage.engine.wait()
    assert len(stage.heard) == 50
    stage.request("day", range(100, 140))
    stage.engine.wait()
    assert stage.ready("day") >= set(range(100, 140))
    assert stage.engine.over_budget == 0


def test_what_is_being_made_counts_as_room_taken():
    """A piece that fails is done again one by one, with looks in between at what else there is room for."""
    stage = Stage(count=1000, capacity=16, estimates=True)
    stage.bakers["day"] = FakeBaker("day", bad=(3,))
    stage.estimators["day"] = FakeBaker("day", bad=(3,), grade=ESTIMATE)
    stage.select("day")
    stage.request("day", range(23))
    while stage.engine.run_once():
        pass
    assert stage.cache.stats().dropped == 0
    assert len(stage.ready("day")) == stage.cache.capacity


def test_clipped_texels_are_counted():
    stage = Stage()
    stage.select("day")
    stage.request("day", range(100))
    stage.engine.wait()
    assert stage.engine.clipped_count == 10


def test_listeners_can_leave():
    stage = Stage()
    heard = []
    leave = stage.engine.subscribe(heard.append)
    stage.select("day")
    stage.request("day", [1])
    stage.engine.wait()
    leave()
    leave()
    stage.request("day", [2])
    stage.engine.wait()
    assert [batch.ids.tolist() for batch in heard] == [[1]]


def test_a_listener_may_call_back():
    stage = Stage(threads=2)
    stage.select("day")

    def follow(batch):
        if batch.ids.max() < 5:
            stage.request("day", batch.ids + 1)

    stage.engine.subscribe(follow)
    stage.request("day", [0])
    assert stage.engine.wait(GUARD_S)
    assert stage.ready("day") == set(range(6))
    stage.engine.close()


def test_close_ends_the_threads_and_later_use_is_an_error():
    before = set(threading.enumerate())
    stage = Stage(threads=3)
    assert set(threading.enumerate()) == before  # no work, no threads
    stage.select("day")
    stage.request("day", range(1000))
    assert len(set(threading.enumerate()) - before) == 3
    stage.engine.close()
    stage.engine.close()
    assert set(threading.enumerate()) == before
    for use in (
        lambda: stage.select("night"),
        lambda: stage.request("day", [1]),
        lambda: stage.engine.run_once(),
        lambda: stage.engine.run_for(1.0),
        lambda: stage.engine.wait(),
        lambda: stage.engine.subscribe(print),
    ):
        with pytest.raises(SessionClosedError, match="closed"):
            use()


def test_close_waits_for_the_batch_in_progress():
    stage = Stage(threads=1)
    started, release = threading.Event(), threading.Event()
    baker = FakeBaker("day")
    bake = baker.bake_into

    def slow(ids, codes):
        started.set()
        assert release.wait(GUARD_S)
        return bake(ids, codes)

    baker.bake_into = slow
    stage.bakers["day"] = baker
    stage.select("day")
    stage.request("day", range(1000))
    assert started.wait(GUARD_S)
    closer = threading.Thread(target=stage.engine.close)
    closer.start()
    release.set()
    closer.join(GUARD_S)
    assert not closer.is_alive()
    assert len(baker.batches) == 1
    assert stage.ready("day") == set(baker.batches[0])


@pytest.mark.parametrize("shards", [1, 8])
def test_many_clients_lights_and_workers_at_once(shards):
    """Nothing is lost, baked twice or mixed up between keys while everything happens at the same time."""
    stage = Stage(threads=4, count=2000, shards=shards, estimates=True)
    stage.select("k0")

    def client(number):
        rng = np.random.default_rng(number)
        for step in range(60):
            ids = np.unique(rng.integers(0, stage.count, 300))
            key = f"k{rng.integers(0, 3)}"
            if number == 0 and step % 6 == 0:
                stage.select(key)
            stage.request(key, ids, rng.random(len(ids)), client=str(number))
            table = stage.cache.snapshot(key)
            if table is not None:
                there = np.flatnonzero(table.slot >= 0).astype(np.int32)
                shown = table.codes[table.slot[there]][:, 0, 0]
                assert ((shown == code_of(key, there)) | (shown == code_of(key, there, ESTIMATE))).all()
            if step % 20 == 19:
                stage.engine.forget(str(number))

    with ThreadPoolExecutor(4) as pool:
        for done in [pool.submit(client, number) for number in range(4)]:
            done.result(GUARD_S)
    stage.select("k0")
    stage.request("k0", np.arange(stage.count))
    assert stage.engine.wait(GUARD_S)
    assert stage.ready("k0") == set(range(stage.count))
    assert stage.cache.counts("k0") == Counts(ready=stage.count)
    assert (stage.cache.lookup("k0", np.arange(stage.count, dtype=np.int32))[2] == FULL).all()
    assert max(Counter(stage.heard).values()) <= 2  # an estimate, a texture
    assert not stage.wrong
    for key in ("k0", "k1", "k2"):
        counts = stage.cache.counts(key)
        assert counts.queued == counts.baking == counts.failed == counts.refining == 0
        assert counts.ready == len(stage.ready(key))
    stage.engine.close()


def test_a_small_cache_under_many_workers_never_shows_a_wrong_tile():
    stage = Stage(threads=4, count=2000, capacity=800)
    stage.select("day")
    for step in range(40):
        visible = np.arange(step * 80, step * 80 + 300) % stage.count
        stage.request("day", visible)
        table = stage.cache.snapshot("day")
        shown = {each: table.codes[table.slot[each]].copy() for each in np.flatnonzero(table.slot >= 0)}
        assert stage.engine.wait(GUARD_S)
        for each, tile in shown.items():
            assert (table.codes[table.slot[each]] == tile).all()
            assert (tile == code_of("day", ids_of(each))[0]).all()
        del table
        stage.request("day", visible)
        assert stage.engine.wait(GUARD_S)
        assert stage.ready("day") >= set(visible.tolist())
    assert stage.cache.stats().evicted > 0
    stage.engine.close()
