"""First light comes before textures, is kept under its light key alone, and never costs more than its share."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from luxel.dynamic.sightings import shard_of
from luxel.textures.textures import FIRST_LIGHT

from .fakes import GUARD_S, FakeBaker, Stage, ids_of, record_of


@pytest.mark.parametrize("threads", [0, 1, 4])
def test_every_visible_particle_has_its_first_light_once_and_then_its_texture(threads):
    stage = Stage(threads, count=5000)
    stage.select("day")
    visible = range(0, 5000, 2)
    for _ in range(3):
        stage.request("day", visible)
    assert stage.engine.wait(GUARD_S)
    assert sorted(stage.dawned) == [("day", each) for each in visible]
    assert stage.ready("day") == set(visible)
    assert not stage.wrong
    there, records = stage.cache.lookup_coarse("day", np.arange(5000, dtype=np.int32))
    assert np.flatnonzero(there).tolist() == list(visible)
    assert (records == record_of("day", np.flatnonzero(there))).all()
    stage.engine.close()


def test_first_light_comes_before_textures_and_before_what_they_need():
    stage = Stage(count=5000)
    stage.select("day")
    stage.request("day", range(3000), np.linspace(0, 1, 3000))
    stage.engine.wait()
    kinds = [kind for kind, _ in stage.bakers["day"].work]
    ready = kinds.index("prepare")
    assert set(kinds[:ready]) == {"first light"}
    assert set(kinds[ready + 1 :]) == {"bake"}
    assert stage.dawned == [("day", each) for each in range(3000)]  # the nearest first


def test_first_light_of_all_shards_comes_before_textures_of_any():
    stage = Stage(count=40_000, texels=16, shards=8)
    stage.select("day")
    stage.request("day", range(20_000))
    stage.engine.wait()  # the baker is prepared, so that textures could be made at once
    work = stage.bakers["day"].work
    work.clear()
    later = np.arange(20_000, 40_000, dtype=np.int32)
    visible = later[
        shard_of(later, 8).astype(int) ** 2 * 40 > later % 2000
    ]  # more of one shard than of the other
    stage.request("day", visible)
    stage.engine.wait()
    kinds = [kind for kind, _ in work]
    assert kinds.count("first light") >= 8
    assert kinds == sorted(kinds, reverse=True)
    assert sum(len(ids) for kind, ids in work if kind == "bake") == len(visible)


def test_what_comes_into_sight_later_goes_before_textures_that_wait():
    stage = Stage()
    stage.select("day")
    stage.request("day", range(200))
    while len(stage.heard) < 50:
        stage.engine.run_once()
    stage.request("day", range(100, 300))
    stage.engine.run_once()
    stage.engine.run_once()  # one of four pieces goes to those that have waited longest
    assert ("first light", list(range(200, 300))) in stage.bakers["day"].work[-2:]


def test_a_change_of_light_drops_the_records():
    stage = Stage()
    stage.select("day")
    stage.request("day", [1, 2])
    stage.engine.wait()
    table = stage.cache.snapshot("day")
    stage.select("night")
    assert not stage.cache.lookup_coarse("day", ids_of(1, 2))[0].any()
    assert stage.cache.snapshot("day").coarse.shape == (0, 4)
    assert (table.coarse[[1, 2]] == record_of("day", ids_of(1, 2))).all()
    assert stage.cache.stats().textures == 2
    stage.select("day")
    stage.request("day", [1, 3])  # 1 has its texture: only 3 needs anything
    stage.engine.wait()
    assert stage.dawned == [("day", 1), ("day", 2), ("day", 3)]


def test_first_light_that_comes_too_late_is_dropped():
    stage = Stage()
    baker = stage.bakers["day"] = FakeBaker("day")
    make = baker.first_light

    def slow(ids):
        stage.select("night")
        return make(ids)

    baker.first_light = slow
    stage.select("day")
    stage.request("day", [1])
    stage.engine.wait()
    assert stage.dawned == []
    assert not stage.cache.lookup_coarse("day", ids_of(1))[0].any()


def test_what_is_under_way_is_not_asked_for_again():
    stage = Stage(threads=2)
    started, release = threading.Event(), threading.Event()
    baker = stage.bakers["day"] = FakeBaker("day")
    make = baker.first_light

    def slow(ids):
        started.set()
        assert release.wait(GUARD_S)
        return make(ids)

    baker.first_light = slow
    stage.select("day")
    stage.request("day", [1])
    assert started.wait(GUARD_S)
    stage.request("day", [1])
    release.set()
    assert stage.engine.wait(GUARD_S)
    assert stage.dawned == [("day", 1)]
    stage.engine.close()


def test_first_light_reaches_what_the_cache_has_no_room_for():
    stage = Stage(count=100, capacity=60, texels=16)
    stage.select("day")
    stage.request("day", range(100), np.linspace(0, 1, 100))
    stage.engine.wait()
    assert stage.engine.over_budget == 40
    assert stage.ready("day") == set(range(60))
    assert stage.cache.lookup_coarse("day", np.arange(100, dtype=np.int32))[0].all()


def test_a_cache_too_small_for_records_goes_without():
    stage = Stage(count=1000, capacity=100)
    stage.select("day")
    stage.request("day", [1])
    stage.engine.wait()
    assert stage.dawned == []
    assert stage.ready("day") == {1}
    assert stage.cache.snapshot("day").coarse.shape == (0, 4)


def test_a_snapshot_keeps_the_records_it_had():
    stage = Stage()
    stage.select("day")
    stage.request("day", [1])
    stage.engine.wait()
    table = stage.cache.snapshot("day")
    before = table.coarse.copy()
    stage.request("day", [2])
    stage.engine.wait()
    assert np.flatnonzero(table.slot == FIRST_LIGHT).tolist() == []
    assert (table.coarse[1] == before[1]).all()
    assert (stage.cache.snapshot("day").coarse[2] == record_of("day", ids_of(2))[0]).all()


def test_first_light_that_fails_leaves_textures_alone(caplog):
    stage = Stage()
    baker = stage.bakers["day"] = FakeBaker("day")
    tries = []

    def broken(ids):
        tries.append(ids.tolist())
        raise ArithmeticError("no light")

    baker.first_light = broken
    stage.select("day")
    for each in range(100):
        stage.request("day", [each])
        stage.engine.wait()
    assert stage.ready("day") == set(range(100))
    assert len(tries) == 2 * 16  # then it is given up
    assert "no light" in caplog.text
    assert stage.engine.error == "ArithmeticError: no light"
    stage.select("night")
    stage.request("night", [1])
    stage.engine.wait()
    assert stage.dawned == [("night", 1)]


def test_first_light_that_fails_for_one_particle_comes_for_others():
    stage = Stage()
    baker = stage.bakers["day"] = FakeBaker("day")
    make = baker.first_light

    def broken(ids):
        if 3 in ids:
            raise ArithmeticError("no light")
        return make(ids)

    baker.first_light = broken
    stage.select("day")
    stage.request("day", range(10))
    stage.engine.wait()
    assert sorted(each for _, each in stage.dawned) == [0, 1, 2, 4, 5, 6, 7, 8, 9]
    assert stage.ready("day") == set(range(10))


def test_a_baker_that_cannot_be_prepared_is_given_up():
    stage = Stage()
    baker = stage.bakers["day"] = FakeBaker("day")
    tries = []

    def broken(threads):
        tries.append(threads)
        yield
        raise MemoryError("nothing to learn from")

    baker.preparation = broken
    stage.select("day")
    stage.request("day", [1])
    stage.engine.wait()
    assert tries == [1, 1]
    assert stage.dawned == [("day", 1)]
    stage.request("day", [1, 2])
    stage.engine.wait()
    assert tries == [1, 1]
    assert stage.dawned == [("day", 1), ("day", 2)]
    assert stage.cache.counts("day").queued == 0
    assert stage.engine.error == "MemoryError: nothing to learn from"


def test_textures_are_prepared_though_ever_new_particles_come_into_sight():
    stage = Stage(count=120_000, texels=16)
    stage.select("day")
    for step in range(40):  # more of them than a piece of first light takes
        stage.request("day", np.append(np.arange(3000 * step + 1, 3000 * (step + 1)), 0))
        stage.engine.run_once()
        stage.clock.now_s += 0.1
        if stage.heard:
            break
    assert 20 <= step < 35  # two seconds later
