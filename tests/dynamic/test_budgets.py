"""Budgets and paces: the engine as a callback of frames, and how large its pieces are."""

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from .fakes import GUARD_S, Clock, FakeBaker, Stage


def slow_stage(texture_s: float, **options) -> Stage:
    clock = Clock()
    stage = Stage(**{"count": 100_000, "clock": clock, "shards": 1, "texture_s": texture_s} | options)
    stage.baker_options["clock"] = clock
    stage.select("day")
    return stage


def test_pieces_grow_towards_thirty_milliseconds_and_shrink_back():
    stage = slow_stage(1e-4)
    stage.request("day", range(20_000))
    stage.engine.run_for(1.0)
    sizes = [len(batch) for batch in stage.bakers["day"].batches]
    assert sizes[:5] == [1, 2, 4, 8, 16]
    assert max(sizes) == pytest.approx(300, abs=1)
    stage.bakers["day"].texture_s = 1e-2
    stage.engine.run_for(20.0)
    assert len(stage.bakers["day"].batches[-2]) == 3


def test_the_callback_bounds_the_frame_rate_by_its_budget_and_little_more():
    """Paper 4.2: with 1/30 s a frame for textures there are fewer than 30 frames a second; how many fewer is up to drawing."""
    stage = slow_stage(3e-4)
    stage.request("day", range(50_000))
    for frame in range(100):
        start_s = stage.clock.now_s
        stage.engine.run_for(1 / 30)
        took_s = stage.clock.now_s - start_s
        assert took_s < 1 / 30 + 3e-4  # one texture at most, since the pace is steady
        if frame:
            assert took_s > 1 / 30 - 2 * 3e-4  # what is there to be used is used
    assert stage.engine.textures_per_s == pytest.approx(1 / 3e-4, rel=0.1)
    stage.clock.now_s += 5
    assert stage.engine.textures_per_s == 0


def test_one_slow_texture_a_frame_is_made_even_if_the_budget_is_less():
    stage = slow_stage(0.1)
    stage.request("day", range(10))
    stage.engine.run_for(0.01)
    for frame in range(10):
        start_s = stage.clock.now_s
        stage.engine.run_for(0.01)
        assert stage.clock.now_s - start_s == pytest.approx(0.1 if frame < 9 else 0)
    assert stage.ready("day") == set(range(10))


def test_the_callback_bounds_the_latency_from_below_by_a_frame_and_from_above_by_the_work():
    """Paper 4.2: what is requested in a frame is there one frame later at the earliest; n textures take n t / budget frames."""
    budget_s, each_s, draw_s = 1 / 30, 1e-3, 5e-3
    stage = slow_stage(each_s)
    stage.request("day", range(100, 200))
    stage.engine.wait()  # the pace is known
    visible, seen_ready = np.arange(100, dtype=np.int32), {}
    for frame in range(20):
        stage.clock.now_s += draw_s
        for each in stage.ready("day") & set(visible.tolist()):
            seen_ready.setdefault(each, frame)
        stage.request("day", visible)
        stage.engine.run_for(budget_s)
    assert set(seen_ready) == set(visible.tolist())
    assert min(seen_ready.values()) == 1
    whole = 100 * each_s / budget_s
    assert whole <= max(seen_ready.values()) <= whole + 3


def test_preparation_goes_in_steps_between_frames():
    stage = slow_stage(1e-3, steps=20, step_s=0.01)
    stage.request("day", range(10))
    stage.engine.run_for(0.05)  # makes the baker, first light
    while not stage.ready("day"):
        start_s = stage.clock.now_s
        stage.engine.run_for(0.025)
        assert stage.clock.now_s - start_s < 0.025 + 0.01
    assert [kind for kind, _ in stage.bakers["day"].work].count("prepare") == 1


def test_several_threads_may_call_back_at_once():
    stage = Stage(shards=4)
    stage.select("day")
    stage.request("day", range(1000))
    with ThreadPoolExecutor(4) as pool:
        for done in [pool.submit(stage.engine.run_for, 1e9) for _ in range(4)]:
            done.result(GUARD_S)
    assert stage.engine.wait()
    assert stage.ready("day") == set(range(1000))
    assert len(stage.heard) == len(set(stage.heard))


@pytest.mark.parametrize("shards", [1, 8])
@pytest.mark.parametrize("budget_s", [None, 0.03])
def test_one_that_stays_visible_is_served_within_its_bound_whatever_comes_in_before_it(shards, budget_s):
    """Of four pieces of work one goes to what has waited longest: with w of these, all are served by piece 4 (w + 1).

    With a budget a frame that is too short for two pieces, by frame 4 (w + 1).
    """
    stage = slow_stage(0.5, shards=shards, count=20_000, texels=16)
    stage.request("day", [19_999])
    stage.engine.wait()  # the pace is known: a piece is one texture
    far = list(range(5))
    stage.request("day", far, distance=np.full(5, 9.0), client="far")
    waits = min(shards, len(far)) + len(far)  # first light goes by shards, textures one by one
    for step in range(4 * (waits + 1)):
        stage.clock.now_s += 0.01
        fresh = 100 + 40 * step
        stage.request(
            "day", range(fresh, fresh + 40), client="near"
        )  # first light, then textures: all before the far ones
        if budget_s is None:
            stage.engine.run_once()
        else:
            stage.engine.run_for(budget_s)
        if set(far) <= stage.ready("day"):
            break
    assert set(far) <= stage.ready("day")


def test_while_one_thread_takes_sightings_in_another_bakes_what_was_known():
    """Its first piece needs no look at the new sighting, which another thread is at, and comes while that one is not done."""
    stage = Stage(shards=4, count=1000)
    stage.select("day")
    stage.request("day", range(500))
    while len(stage.ready("day")) < 100:
        stage.engine.run_once(0.001)
    for light_up in (False, True):  # both have their first light from now on
        stage.request("day", range(500), client=str(light_up))
    stage.engine.settle()
    known = set(range(500)) - stage.ready("day")
    measuring, go_on = threading.Event(), threading.Event()

    def measure(some):
        measuring.set()
        assert go_on.wait(GUARD_S)
        return np.zeros(len(some)), None

    stage.engine.request("day", np.arange(500, 1000, dtype=np.int32), measure, "new")
    before = len(stage.bakers["day"].batches)
    with ThreadPoolExecutor(2) as pool:
        looking = pool.submit(stage.engine.run_for, 1e9)
        assert measuring.wait(GUARD_S)
        stage.engine.subscribe(lambda batch: go_on.set())
        baking = pool.submit(stage.engine.run_for, 1e9)
        assert go_on.wait(GUARD_S)
        assert set(stage.bakers["day"].batches[before]) <= known
        looking.result(GUARD_S)
        baking.result(GUARD_S)
    assert stage.ready("day") == set(range(1000))
    assert len(stage.heard) == len(set(stage.heard))


def test_a_budget_holds_what_pieces_cost_besides_their_work():
    stage = slow_stage(3e-4)

    handed_in = []

    def hand_in(batch):
        stage.clock.now_s += 2e-3
        handed_in.append(batch)

    stage.engine.subscribe(hand_in)
    stage.request("day", range(20_000))
    stage.engine.run_for(0.01)
    for frame in range(60):
        start_s = stage.clock.now_s
        handed_in.clear()
        stage.engine.run_for(0.01)
        if frame > 20:  # the cost is known
            assert 0.007 < stage.clock.now_s - start_s < 0.01 + 3e-4
            assert len(handed_in) == 1  # the rest is not worth another one


def test_the_rest_of_a_budget_makes_one_longer_piece():
    stage = slow_stage(1e-4)
    stage.request("day", range(20_000))
    stage.engine.run_for(1.0)
    handed_in = []
    stage.engine.subscribe(lambda batch: handed_in.append(len(batch.ids)))
    stage.engine.run_for(0.04)
    assert handed_in[0] == pytest.approx(400, abs=2)
    assert sum(handed_in) == pytest.approx(400, abs=2)


def test_what_a_piece_has_no_time_for_comes_with_the_next_one():
    stage = slow_stage(1e-4)
    baker = stage.bakers.setdefault("day", FakeBaker("day", stage.clock, 1e-4))
    stage.request("day", range(2000))
    stage.engine.run_for(0.1)
    before, started = len(baker.batches), stage.clock.now_s
    baker.texture_s = 1.4e-4
    stage.engine.run_for(0.03)
    first, rest = baker.batches[before:]
    assert len(first) == 200  # two thirds of what the pace promised
    assert len(rest) == pytest.approx(0.002 / 1.4e-4, abs=1)  # then time is short
    assert stage.clock.now_s - started <= 0.03 + 1e-9
    left = stage.cache.counts("day").baking
    assert left == pytest.approx(300 - len(first) - len(rest), abs=2)
    before = len(baker.batches)
    stage.engine.run_for(0.03)
    assert set(baker.batches[before][:left]).isdisjoint([*first, *rest])
    stage.engine.run_for(60.0)
    assert stage.ready("day") == set(range(2000))
    assert len(stage.heard) == len(set(stage.heard)) == 2000


def test_what_a_piece_has_no_time_for_goes_with_its_light():
    stage = slow_stage(1e-4)
    baker = stage.bakers.setdefault("day", FakeBaker("day", stage.clock, 1e-4))
    stage.request("day", range(2000))
    stage.engine.run_for(0.1)
    baker.texture_s = 3e-4
    stage.engine.run_for(0.03)
    assert stage.cache.counts("day").baking > 0
    stage.select("night")
    assert stage.cache.counts("day").baking == stage.cache.counts("day").queued == 0
    stage.select("day")
    stage.request("day", range(2000))
    stage.engine.run_for(60.0)
    assert stage.ready("day") == set(range(2000))


def test_what_has_been_taken_in_waits_for_the_next_budget():
    stage = slow_stage(1e-4)
    stage.request("day", range(100))
    assert stage.cache.counts("day").queued == 0
    stage.engine.take_in()
    assert stage.cache.counts("day").queued == 100
    assert stage.bakers == {}


def test_a_budget_of_nothing_does_nothing():
    stage = slow_stage(1e-4)
    stage.request("day", range(10))
    assert stage.engine.run_for(0.0) == 0
    assert stage.engine.run_for(-1.0) == 0
    assert stage.engine.run_for(1e-12) >= 1  # the first piece is done whatever is left
