"""Frozen copies of a table that changes: right, never changing, cheap, and known for as long as they are held."""

import gc
import threading

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import settings
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from luxel.dynamic.slot_table import SlotTable

from .fakes import GUARD_S, ids_of

COUNT = 40


class SlotTableMachine(RuleBasedStateMachine):
    """Model: an array, and a copy of it for everything frozen."""

    def __init__(self):
        super().__init__()
        self.table = SlotTable(COUNT, most_copies=3)
        self.model = np.full(COUNT, -1)
        self.held: list[tuple[np.ndarray, np.ndarray]] = []

    @rule(ids=st.lists(st.integers(0, COUNT - 1), unique=True, max_size=8), slot=st.integers(-2, 99))
    def change(self, ids, slot):
        ids = ids_of(*ids)
        self.table.write(ids, slot)
        self.model[ids] = slot

    @rule(old=st.integers(-2, 99), new=st.integers(-2, 99))
    def replace(self, old, new):
        self.table.replace(old, new)
        self.model[self.model == old] = new

    @rule()
    def freeze(self):
        full = len({id(array) for array, _ in self.held}) == 3
        frozen = self.table.freeze()
        if full:  # the last one again
            assert frozen is self.held[-1][0]
            self.held.append(self.held[-1])
        else:
            self.held.append((frozen, self.model.copy()))

    @rule(which=st.integers(0, 9))
    def let_go(self, which):
        if self.held:
            self.held.pop(which % len(self.held))

    @rule()
    def spare(self):
        self.table.spare()
        assert self.table.nbytes <= 4 * COUNT * (1 + len(self.held))

    @invariant()
    def what_is_held_does_not_change(self):
        for array, expected in self.held:
            assert (array == expected).all()

    @invariant()
    def copies_are_few(self):
        assert self.table.nbytes <= 4 * COUNT * 4


SlotTableMachine.TestCase.settings = settings(
    max_examples=150, stateful_step_count=30, deadline=None, derandomize=True
)
TestSlotTableMachine = SlotTableMachine.TestCase


def test_freezing_again_without_a_change_gives_the_same_array():
    table = SlotTable(COUNT)
    frozen = table.freeze()
    assert table.freeze() is frozen
    table.write(ids_of(3), 3)
    assert table.freeze() is not frozen


def test_what_was_retired_is_read_until_the_copies_that_show_it_are_gone():
    table = SlotTable(COUNT)
    before = table.freeze()
    table.write(ids_of(3), 7)
    mark = table.mark()
    assert table.is_read(mark)
    after = table.freeze()
    del before
    gc.collect()
    assert not table.is_read(mark)  # `after` shows the change
    assert table.is_read(table.mark())
    del after
    assert not table.is_read(table.mark())


def test_fewer_copies_than_are_held():
    table = SlotTable(COUNT, most_copies=3)
    first = table.freeze()
    table.write(ids_of(1), 1)
    second = table.freeze()
    del second
    table.most_copies = 1
    table.spare()
    table.write(ids_of(2), 2)
    assert table.freeze() is first


def test_two_copies_take_turns_and_cost_only_what_changed():
    table = SlotTable(100_000)
    held = table.freeze()
    addresses = set()
    for step in range(50):
        ids = np.arange(step, 100_000, 5000, dtype=np.int32)
        table.write(ids, step)
        held = table.freeze()
        addresses.add(held.ctypes.data)
        assert (held == table.live).all()
    assert len(addresses) == 2
    assert len(table._history) <= 4  # two notes a change


def test_a_reader_that_comes_back_after_ages_sees_everything():
    table = SlotTable(COUNT)
    table.freeze()
    for step in range(5000):
        table.write(ids_of(step % COUNT), step)
    assert table._log is None  # it did not pile up
    assert (table.freeze() == table.live).all()
    assert (table.freeze() == table.live).all()


def test_a_copy_that_cannot_be_made_holds_nothing_back(monkeypatch):
    table = SlotTable(COUNT)
    monkeypatch.setattr(table, "_bring_up_to_date", lambda copy: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        table.freeze()
    monkeypatch.undo()
    assert not table.is_read(table.mark())
    assert (table.freeze() == -1).all()


def test_frames_and_workers_at_once():
    """Slots grow with every change; a frozen copy never goes back, never tears an entry, and its marks hold."""
    table = SlotTable(2000)
    stop = threading.Event()
    wrong: list[str] = []
    retired: list[tuple[int, int, int]] = []  # (particle, slot that it had, mark)

    def work(first: int) -> None:
        rng = np.random.default_rng(first)
        for step in range(1, 400):
            ids = np.unique(rng.integers(0, 1000, 30) * 2 + first).astype(np.int32)  # each worker has its own
            old = int(table.live[ids[0]])
            table.write(ids, step)
            retired.append((int(ids[0]), old, table.mark()))
        stop.set()

    def look() -> None:
        last = np.full(2000, -1)
        while not stop.is_set():
            frozen = table.freeze()
            now = frozen.copy()
            if (now < last).any():
                wrong.append("went back")
            last = now
            for particle, old, mark in retired[-5:]:
                if frozen[particle] == old and old != table.live[particle] and not table.is_read(mark):
                    wrong.append("reads what nobody is said to read")
            if (frozen != now).any():
                wrong.append("changed")

    threads = [threading.Thread(target=work, args=(k,)) for k in (0, 1)]
    threads += [threading.Thread(target=look) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(GUARD_S)
    assert not wrong
    assert (table.freeze() == table.live).all()
