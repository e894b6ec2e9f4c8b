"""The order in which pages get large data sets: every beginning is spread evenly."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import luxel
from luxel.app import order
from luxel.app.order import Order, order_of


@given(
    count=st.integers(1, 3000),
    part=st.floats(0.02, 1.0),
    power=st.sampled_from([1.0, 4.0]),  # even, or dense in a corner
    seed=st.integers(0, 99),
)
def test_every_beginning_has_its_share_of_every_octant(
    count: int, part: float, power: float, seed: int
) -> None:
    centers = (np.random.default_rng(seed).random((count, 3)) ** power).astype(np.float32)
    found = Order.even(centers)
    assert (np.sort(found.to_file) == np.arange(count)).all()
    assert (found.to_page[found.to_file] == np.arange(count)).all()
    some = found.to_file[: round(part * count)]
    low, extent = centers.min(axis=0), float(np.ptp(centers, axis=0).max()) or 1.0
    for cells in (2, 4, 8):
        at = np.minimum((cells * (centers - low) / extent).astype(int), cells - 1)
        cell = np.ravel_multi_index(tuple(at.T), (cells, cells, cells))
        have = np.bincount(cell[some], minlength=cells**3)
        share = np.bincount(cell, minlength=cells**3) * len(some) / count
        # Points of a cell follow each other on the curve, and a van der Corput sequence is so even on every stretch. A point on
        # the edge of a cell may count for either.
        assert np.abs(have - share).max() <= 2 + np.log2(count + 1)


@pytest.mark.parametrize(
    "centers", [np.zeros((5, 3)), np.eye(3) * 1e6, np.arange(12).reshape(4, 3) * [0, 1, 0]]
)
def test_degenerate_places_are_ordered_too(centers: np.ndarray) -> None:
    found = Order.even(centers.astype(np.float32))
    assert (np.sort(found.to_file) == np.arange(len(centers))).all()


def test_small_data_sets_stay_as_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(order, "FIRST", 100)
    at = np.random.default_rng(0).random((101, 3))
    assert order_of(luxel.Particles(at[:100], 0.1)) is None
    particles = luxel.Particles(at, 0.1)
    found = order_of(particles)
    assert found is not None
    assert order_of(particles) is found
