"""The request queue against a plain dictionary."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import settings
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from luxel.dynamic.queue import DISTANCE_S, RequestQueue, priority

EXPIRY_S = 2.0
MAX_COUNT = 12
KEYS = st.sampled_from(["day", "night"])
CLIENTS = st.sampled_from(["ann", "bob"])
REQUESTS = st.dictionaries(st.integers(0, 19), st.integers(-8, 8), max_size=16)


def ids_of(*values: int) -> np.ndarray:
    return np.array(values, dtype=np.int32)


class QueueMachine(RuleBasedStateMachine):
    """Model: {key: {client: {id: (priority, seen)}}}."""

    def __init__(self):
        super().__init__()
        self.queue = RequestQueue(EXPIRY_S, MAX_COUNT)
        self.model: dict[str, dict[str, dict[int, tuple[float, float]]]] = {"day": {}, "night": {}}
        self.now_s = 0.0

    def merged(self, key: str) -> dict[int, float]:
        best: dict[int, float] = {}
        for wants in self.model[key].values():
            for particle, (value, _) in wants.items():
                best[particle] = max(value, best.get(particle, -np.inf))
        return best

    @rule(key=KEYS, client=CLIENTS, requests=REQUESTS, wait_s=st.sampled_from([0.0, 0.5, 1.0, 2.0]))
    def push(self, key, client, requests, wait_s):
        self.now_s += wait_s
        before = set(self.merged(key)) | set(requests)
        wants = self.model[key].setdefault(client, {})
        for particle in [each for each, (_, seen) in wants.items() if self.now_s - seen >= EXPIRY_S]:
            del wants[particle]
        wants.update({particle: (float(value), self.now_s) for particle, value in requests.items()})
        gone = self.queue.push(
            key, ids_of(*requests), np.array(list(requests.values()), dtype=float), self.now_s, client
        )
        assert len(set(gone.tolist())) == len(gone)
        # Which of several equally bad requests go is the queue's choice; what goes may not be better than what stays.
        merged = self.merged(key)
        excess = set(gone.tolist()) & set(merged)
        assert len(excess) == max(0, len(merged) - MAX_COUNT)
        kept = set(merged) - excess
        assert max((merged[each] for each in excess), default=-np.inf) <= min(
            (merged[each] for each in kept), default=np.inf
        )
        assert set(gone.tolist()) == before - kept
        self.remove(key, excess)

    @rule(key=st.none() | KEYS, count=st.integers(1, 6))
    def pop(self, key, count):
        found, ids = self.queue.pop(count, key)
        total = {each: self.merged(each) for each in self.model}
        if not len(ids):
            assert not any(total.values()) if key is None else not total[key]
            return
        taken = [total[found].pop(particle) for particle in ids.tolist()]
        assert len(taken) == count or not total[found]
        assert taken == sorted(taken, reverse=True)
        rest = [value for each in total if key is None and each != found for value in total[each].values()]
        assert taken[0] >= max(rest, default=-np.inf)
        assert taken[-1] >= max(total[found].values(), default=-np.inf)
        self.remove(found, set(ids.tolist()))

    @rule(key=KEYS)
    def cancel(self, key):
        assert set(self.queue.cancel(key).tolist()) == set(self.merged(key))
        self.model[key] = {}

    @rule(client=CLIENTS)
    def forget(self, client):
        expected = {}
        for key, clients in self.model.items():
            before = set(self.merged(key))
            clients.pop(client, None)
            expected[key] = before - set(self.merged(key))
        gone = self.queue.forget(client)
        found = {key: set(ids.tolist()) for key, ids in gone}
        assert {key: ids for key, ids in found.items() if ids} == {
            key: ids for key, ids in expected.items() if ids
        }

    @invariant()
    def counts_agree(self):
        assert len(self.queue) == sum(len(self.merged(key)) for key in self.model)
        assert set(self.queue.keys()) == {key for key in self.model if self.merged(key)}

    def remove(self, key, ids):
        for wants in self.model[key].values():
            for particle in ids:
                wants.pop(particle, None)
        if not self.merged(key):
            self.model[key] = {}


QueueMachine.TestCase.settings = settings(
    max_examples=200, stateful_step_count=25, deadline=None, derandomize=True
)
TestQueueMachine = QueueMachine.TestCase


def test_the_near_and_the_recent_come_first():
    queue = RequestQueue()
    queue.push("day", ids_of(1, 2, 3), priority(10.0, [0.5, 0.1, 0.9]), 10.0)
    queue.push("day", ids_of(4), priority(10.0 + 2 * DISTANCE_S, [1.0]), 11.0)
    assert queue.pop(10)[1].tolist() == [4, 2, 1, 3]


def test_a_later_sighting_replaces_the_priority():
    queue = RequestQueue()
    queue.push("day", ids_of(1, 2), np.array([5.0, 1.0]), 0.0)
    queue.push("day", ids_of(1, 2), np.array([0.0, 1.0]), 1.0)
    assert queue.pop(10)[1].tolist() == [2, 1]


def test_of_several_clients_the_best_priority_counts():
    queue = RequestQueue()
    queue.push("day", ids_of(1, 2), np.array([0.0, 1.0]), 0.0, "ann")
    queue.push("day", ids_of(1), np.array([2.0]), 0.0, "bob")
    assert len(queue) == 2
    assert queue.pop(10)[1].tolist() == [1, 2]


def test_what_is_out_of_sight_lapses_only_while_its_client_looks_elsewhere():
    queue = RequestQueue(expiry_s=2.0)
    queue.push("day", ids_of(1), np.array([0.0]), 0.0, "ann")
    queue.push("day", ids_of(2), np.array([0.0]), 60.0, "bob")
    assert len(queue) == 2  # ann rests: her request stands
    assert queue.push("day", ids_of(3), np.array([0.0]), 1.9, "ann").tolist() == []
    assert queue.push("day", ids_of(3), np.array([0.0]), 2.0, "ann").tolist() == [1]


@pytest.mark.parametrize("key", [None, "day"])
def test_an_empty_queue_gives_nothing(key):
    queue = RequestQueue()
    assert queue.pop(5, key)[1].size == 0
    assert queue.best() is None


def test_best_leaves_out_keys():
    queue = RequestQueue()
    queue.push("day", ids_of(1), np.array([1.0]))
    queue.push("night", ids_of(1), np.array([0.0]))
    assert queue.best() == "day"
    assert queue.best(skip={"day"}) == "night"
    assert queue.best(skip={"day", "night"}) is None
