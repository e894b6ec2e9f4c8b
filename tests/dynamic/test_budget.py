"""Light by budget: threads that give way after their share of a frame, and sleep while there is nothing to do."""

from __future__ import annotations

import queue
import threading

import numpy as np
import pytest

from luxel.dynamic.budget import BudgetDriver, pause_after
from luxel.errors import InputError
from luxel.particles import Particles
from luxel.session import Session
from luxel.textures.spec import TextureSpec

from .fakes import GUARD_S, TEXELS, FakeBaker, code_of


def test_a_frame_is_a_thirtieth_of_a_second_or_the_budget():
    for budget_s in (0.001, 0.01, 0.03):
        assert budget_s + pause_after(budget_s) == pytest.approx(1 / 30)
    for budget_s in (0.033, 0.1, 1.0):
        assert 0 < pause_after(budget_s) <= 0.003


@pytest.mark.parametrize("threads", [1, 3])
def test_it_works_until_nothing_is_left_and_again_when_there_is_more(threads):
    left, calls = queue.SimpleQueue(), queue.SimpleQueue()

    def run_for(budget_s):
        try:
            left.get_nowait()
        except queue.Empty:
            calls.put(None)
            return 0
        calls.put(budget_s)
        return 1

    driver = BudgetDriver(run_for, 0.005, threads)
    try:
        for lot in (5, 3):
            for _ in range(lot):
                left.put(None)
            driver.wake()
            done = 0
            while done < lot:
                budget_s = calls.get(timeout=GUARD_S)
                done += budget_s is not None
                assert budget_s in (None, 0.005)
    finally:
        driver.close()
    assert not [each for each in threading.enumerate() if each.name.startswith("luxel-frame")]


def test_an_error_does_not_end_it(caplog):
    calls = queue.SimpleQueue()

    def run_for(budget_s):
        calls.put(budget_s)
        raise ArithmeticError("once more")

    driver = BudgetDriver(run_for, 0.001, 1)
    for _ in range(2):
        driver.wake()
        assert calls.get(timeout=GUARD_S) == 0.001
    driver.close()
    driver.close()
    assert "once more" in caplog.text


def test_a_session_by_budget_makes_the_same_textures():
    particles = Particles(np.stack(np.unravel_index(np.arange(60), (3, 4, 5)), axis=1).astype(float), 0.5)
    spec = TextureSpec(texels=TEXELS, mode="fast", samples=1)
    heard = threading.Event()
    with Session(
        particles,
        spec=spec,
        threads=2,
        bake_budget_s=0.004,
        make_baker=lambda scene, spec: FakeBaker("fake"),
    ) as session:
        done: set[int] = set()

        def listen(batch):
            done.update(batch.ids.tolist())
            if len(done) == 60:
                heard.set()

        session.subscribe(listen)
        session.sighted(range(60), (9, 9, 9))
        assert heard.wait(GUARD_S)  # nobody but the driver works
        batch = session.tiles(range(60))
        assert (batch.codes == code_of("fake", batch.ids)[:, None, None]).all()
        assert len(batch) == 60
    assert not [each for each in threading.enumerate() if each.name.startswith("luxel-frame")]


@pytest.mark.parametrize(
    "bad", [{"bake_budget_s": -1}, {"bake_budget_s": float("nan")}, {"bake_budget_s": 0.01, "threads": 0}]
)
def test_budgets_out_of_range_are_refused(bad):
    with pytest.raises(InputError, match="budget"):
        Session(Particles(np.zeros((1, 3)), 0.5), **bad)
