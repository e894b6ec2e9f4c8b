"""How fast work goes, by its own account."""

import pytest

from luxel.dynamic.pace import Cost, Pace


def test_a_few_slow_ones_that_fill_up_a_budget_hardly_change_the_pace():
    pace = Pace()
    for _ in range(20):
        pace.record(0.02, 20)
        pace.record(0.003, 2)
    assert pace.each_s == pytest.approx(1.05e-3, rel=0.05)


def test_one_slow_piece_is_forgotten_and_a_change_is_noticed():
    pace = Pace()
    for _ in range(5):
        pace.record(0.01, 10)
    pace.record(10.0, 10)
    assert pace.each_s <= 2e-3
    for _ in range(5):
        pace.record(0.01, 10)
    assert pace.each_s == pytest.approx(1e-3, rel=0.1)
    for _ in range(20):
        pace.record(0.1, 10)
    assert pace.each_s == pytest.approx(1e-2, rel=0.1)


def test_a_cost_falls_sooner_than_it_rises():
    cost = Cost()
    assert cost.each_s == 0
    cost.record(1.0)  # something was compiled
    for _ in range(10):
        cost.record(1e-3)
    assert cost.each_s == pytest.approx(1e-3, abs=1e-3)
    cost.record(-1.0)  # clocks of several threads
    assert cost.each_s >= 0
    for _ in range(60):
        cost.record(5e-3)
    assert cost.each_s == pytest.approx(5e-3, rel=0.01)
