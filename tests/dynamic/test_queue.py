"""The request queue against a plain dictionary."""

import math

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import settings
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from luxel.dynamic.queue import (
    DISTANCE_S,
    RequestQueue,
    largest_first,
    longest_visible_first,
    recent_and_near,
)

from .fakes import ids_of

EXPIRY_S = 2.0
MAX_COUNT = 12
CLIENTS = st.sampled_from(["ann", "bob"])
REQUESTS = st.dictionaries(st.integers(0, 19), st.integers(0, 8), max_size=16)


def push(
    queue: RequestQueue, requests: dict[int, float], now_s: float = 0.0, client: str = "", pixels=None
) -> None:
    """Ask for {particle: distance in diagonals}, with widths in pixels beside them."""
    ids = sorted(requests)
    wide = None if pixels is None else np.array([pixels[each] for each in ids], float)
    queue.push(ids_of(*ids), np.array([requests[each] for each in ids], float), wide, now_s, client)


class QueueMachine(RuleBasedStateMachine):
    """Model: {client: {particle: [seen, since, distance, in the latest sighting]}}."""

    def __init__(self):
        super().__init__()
        self.queue = RequestQueue(expiry_s=EXPIRY_S, max_count=MAX_COUNT)
        self.model: dict[str, dict[int, list]] = {}
        self.waiting: set[int] = set()
        self.now_s = 0.0

    def merged(self) -> dict[int, tuple[float, float]]:
        """{particle: (priority, since)}."""
        found: dict[int, list[list]] = {}
        for wants in self.model.values():
            for particle, want in wants.items():
                found.setdefault(particle, []).append(want)
        return {
            particle: (
                max(want[0] for want in wants) - DISTANCE_S * min(want[2] for want in wants),
                min(want[1] for want in wants),
            )
            for particle, wants in found.items()
        }

    def refresh(self):
        for wants in self.model.values():
            for particle in [
                each for each, want in wants.items() if not want[3] and self.now_s - want[0] >= EXPIRY_S
            ]:
                del wants[particle]
        gone = set(self.queue.refresh(self.now_s).tolist())
        merged = self.merged()
        excess = set(merged) - set(self.queue.ids.tolist())
        # Which of several equally bad requests go is the queue's choice; what goes may not be better than what stays.
        assert len(excess) == max(0, len(merged) - MAX_COUNT)
        worst = min((value for each, (value, _) in merged.items() if each not in excess), default=math.inf)
        assert max((merged[each][0] for each in excess), default=-math.inf) <= worst
        assert gone == (self.waiting - set(merged)) | excess
        self.remove(excess)
        self.waiting = set(self.merged())

    @rule(client=CLIENTS, requests=REQUESTS, wait_s=st.sampled_from([0.0, 0.5, 1.0, 2.0]))
    def push(self, client, requests, wait_s):
        self.now_s += wait_s
        wants = self.model.setdefault(client, {})
        for want in wants.values():
            want[3] = False
        for particle, distance in requests.items():
            since = wants[particle][1] if particle in wants else self.now_s
            wants[particle] = [self.now_s, since, float(distance), True]
        push(self.queue, requests, self.now_s, client)
        self.refresh()

    @rule(wait_s=st.sampled_from([0.5, 2.0]))
    def rest(self, wait_s):
        self.now_s += wait_s
        self.refresh()

    @rule(count=st.integers(1, 6))
    def pop(self, count):
        merged = self.merged()
        taken = self.queue.pop(count).tolist()
        assert len(taken) == min(count, len(merged))
        values = [merged.pop(particle)[0] for particle in taken]
        assert values == sorted(values, reverse=True)
        assert min(values, default=math.inf) >= max(
            (value for value, _ in merged.values()), default=-math.inf
        )
        self.remove(set(taken))
        self.waiting -= set(taken)

    @rule(count=st.integers(1, 6))
    def pop_oldest(self, count):
        merged = self.merged()
        oldest = min((since for _, since in merged.values()), default=math.inf)
        assert self.queue.oldest_s == oldest
        taken = self.queue.pop_oldest(count).tolist()
        as_old = {each: value for each, (value, since) in merged.items() if since == oldest}
        assert len(taken) == min(count, len(as_old))
        values = [as_old.pop(particle) for particle in taken]
        assert values == sorted(values, reverse=True)
        assert min(values, default=math.inf) >= max(as_old.values(), default=-math.inf)
        self.remove(set(taken))
        self.waiting -= set(taken)

    @rule()
    def arrange(self):
        self.queue.arrange()  # changes nothing but when work is done

    @rule(count=st.integers(0, 10))
    def limit(self, count):
        merged = self.merged()
        excess = self.queue.limit(count).tolist()
        assert len(excess) == max(0, len(merged) - count)
        worst = [merged.pop(particle)[0] for particle in excess]
        assert max(worst, default=-math.inf) <= min((value for value, _ in merged.values()), default=math.inf)
        self.remove(set(excess))
        self.waiting -= set(excess)

    @rule(client=CLIENTS)
    def forget(self, client):
        self.queue.forget(client)
        self.model.pop(client, None)
        self.refresh()

    @rule()
    def clear(self):
        assert set(self.queue.clear().tolist()) == self.waiting
        self.model = {}
        self.waiting = set()

    @invariant()
    def contents_agree(self):
        assert len(self.queue) == len(self.waiting)
        assert set(self.queue.ids.tolist()) == self.waiting == set(self.merged())
        assert set(self.queue.clients) == set(self.model)

    def remove(self, ids):
        for wants in self.model.values():
            for particle in ids:
                wants.pop(particle, None)


QueueMachine.TestCase.settings = settings(
    max_examples=150, stateful_step_count=25, deadline=None, derandomize=True
)
TestQueueMachine = QueueMachine.TestCase


def test_the_near_and_the_recent_come_first():
    queue = RequestQueue()
    push(queue, {1: 0.5, 2: 0.1, 3: 0.9}, 10.0, "ann")
    push(queue, {4: 1.0}, 10.0 + 2 * DISTANCE_S, "bob")
    queue.refresh(20.0)
    assert queue.pop(10).tolist() == [4, 2, 1, 3]


def test_a_later_sighting_replaces_the_priority():
    queue = RequestQueue()
    push(queue, {1: 0.1, 2: 0.5}, 0.0)
    push(queue, {1: 0.9, 2: 0.5}, 1.0)
    queue.refresh(1.0)
    assert queue.pop(10).tolist() == [2, 1]


def test_of_several_clients_the_nearest_and_the_latest_count():
    queue = RequestQueue()
    push(queue, {1: 0.9, 2: 0.5}, 0.0, "ann")
    push(queue, {1: 0.1}, 0.0, "bob")
    queue.refresh(0.0)
    assert len(queue) == 2
    assert queue.pop(10).tolist() == [1, 2]
    push(queue, {1: 0.1, 2: 0.2}, 1.0, "ann")
    push(queue, {2: 0.9}, 5.0, "bob")  # T is bob's, D is ann's
    queue.refresh(5.0)
    assert queue.pop(10).tolist() == [2, 1]


def test_what_the_latest_sighting_shows_never_lapses():
    queue = RequestQueue(expiry_s=2.0)
    push(queue, {1: 0.0, 2: 0.0}, 0.0, "ann")
    assert queue.refresh(1000.0).tolist() == []  # ann rests: she still sees them
    push(queue, {2: 0.0}, 1000.0, "ann")
    assert queue.refresh(1000.0).tolist() == [1]  # last seen long ago
    assert queue.refresh(5000.0).tolist() == []


def test_what_is_out_of_sight_lapses_two_seconds_later_though_nothing_more_is_sighted():
    queue = RequestQueue(expiry_s=2.0)
    push(queue, {1: 0.0}, 0.0)
    push(queue, {2: 0.0}, 1.0)
    assert queue.refresh(1.9).tolist() == []
    assert queue.refresh(2.0).tolist() == [1]


def test_sighting_again_in_time_keeps_the_place_in_the_line():
    queue = RequestQueue(expiry_s=2.0)
    push(queue, {1: 0.9}, 0.0)
    push(queue, {2: 0.0}, 1.0)
    push(queue, {1: 0.9, 2: 0.0}, 1.5)
    queue.refresh(1.5)
    assert queue.oldest_s == 0.0
    assert queue.pop_oldest(5).tolist() == [1]
    assert queue.oldest_s == 1.0


def test_of_many_that_have_waited_as_long_the_best_come_first():
    rng = np.random.default_rng(0)
    queue = RequestQueue()
    order = rng.permutation(2000)
    push(queue, {int(particle): float(rank) / 2000 for rank, particle in enumerate(order)}, 0.0)
    push(queue, {5000: 0.0}, 0.1, "another")
    queue.refresh(0.1)
    left = order.tolist()
    for _ in range(40):
        count = int(rng.integers(1, 400))
        if rng.random() < 0.3:  # takes the newer, but best one too
            taken = [each for each in queue.pop(count).tolist() if each != 5000]
        else:
            queue.arrange()
            taken = queue.pop_oldest(count).tolist()
            if not left:
                break
            assert len(taken) == min(count, len(left))
        assert taken == left[: len(taken)]
        left = left[len(taken) :]
    assert not left
    assert not len(queue)


def test_one_that_stays_visible_is_served_however_much_comes_in_before_it():
    """Every fourth batch goes to the oldest: with w that waited as long, after 4 (w + 1) batches at the latest."""
    queue = RequestQueue()
    push(queue, dict.fromkeys(range(5), 1.0), 0.0, "far")
    fresh = 100
    for batch in range(1, 4 * 5 + 1):
        push(queue, {fresh + k: 0.0 for k in range(10)}, 0.01 * batch, "near")
        fresh += 10
        queue.refresh(0.01 * batch)
        taken = queue.pop_oldest(1) if batch % 4 == 0 else queue.pop(1)
        assert len(taken) == 1
    assert not set(range(5)) & set(queue.ids.tolist())
    assert len(queue) > 100


def test_heuristics_can_be_exchanged():
    def order(heuristic) -> list[int]:
        queue = RequestQueue(heuristic)
        push(queue, {3: 0.9}, 0.0, "ann", {3: 8})
        push(queue, {1: 0.4, 2: 0.1}, 1.0, "bob", {1: 100, 2: 2})
        push(queue, {3: 0.9}, 1.0, "ann", {3: 8})
        queue.refresh(1.0)
        return queue.pop(3).tolist()

    assert order(recent_and_near) == [2, 1, 3]
    assert order(largest_first) == [1, 3, 2]
    assert order(longest_visible_first) == [3, 2, 1]
    assert order(lambda requests: requests.ids.astype(float)) == [3, 2, 1]


def test_popping_many_of_very_many_keeps_the_order():
    rng = np.random.default_rng(0)
    ids = np.arange(20_000, dtype=np.int32)
    distance = rng.random(20_000)
    queue = RequestQueue()
    queue.push(ids, distance, None, 0.0)
    queue.refresh(0.0)
    taken = []
    while len(queue):
        taken.append(queue.pop(300))
        if len(taken) % 10 == 0:
            queue.push(np.sort(queue.ids), distance[np.sort(queue.ids)], None, 0.0)
            queue.refresh(0.0)
    assert np.array_equal(np.concatenate(taken), np.argsort(distance, kind="stable"))


@pytest.mark.parametrize("method", ["pop", "pop_oldest"])
def test_of_equal_requests_the_first_comes_first_however_many_there_are(method):
    distance = np.random.default_rng(5).integers(0, 4, 5000).astype(float)
    queue = RequestQueue()
    queue.push(np.arange(5000, dtype=np.int32), distance, None, 0.0)
    queue.refresh(0.0)
    taken = [getattr(queue, method)(70) for _ in range(72)]
    assert np.array_equal(np.concatenate(taken), np.argsort(distance, kind="stable"))


def test_the_bound_on_requests_holds_for_all_clients_together():
    queue = RequestQueue(max_count=10)
    for client in range(5):
        push(queue, {10 * client + k: 0.1 * k for k in range(10)}, 0.0, str(client))
    gone = queue.refresh(0.0)
    assert len(queue) == 10
    assert len(gone) == 40
    assert set(queue.ids % 10) == {0, 1}


@pytest.mark.parametrize("method", ["pop", "pop_oldest"])
def test_an_empty_queue_gives_nothing(method):
    queue = RequestQueue()
    assert getattr(queue, method)(5).size == 0
    assert queue.refresh(1.0).size == 0
    assert queue.clear().size == 0
    assert queue.oldest_s == math.inf


def test_its_length_makes_sense_halfway_through_a_change():
    lengths = []

    def peeking(requests):
        lengths.append(len(queue))  # as another thread may ask at any moment
        return recent_and_near(requests)

    queue = RequestQueue(peeking)
    push(queue, dict.fromkeys(range(9), 1.0))
    queue.refresh(0.0)
    queue.pop(8)
    push(queue, {20: 1.0}, 1.0)
    queue.refresh(1.0)
    assert len(lengths) >= 2
    assert min(lengths) >= 0
    assert len(queue) == 2
