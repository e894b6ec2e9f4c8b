"""Lists of ascending ids against sets."""

import numpy as np
import pytest

from luxel.dynamic.sightings import by_shard, shard_of
from luxel.kernels.requests import carry_over, list_lacking, mark_common, pick


def ascending(rng: np.random.Generator, count: int, most: int = 300) -> np.ndarray:
    return np.sort(rng.permutation(most)[:count]).astype(np.int32)


@pytest.mark.parametrize(
    ("first", "second"), [(0, 0), (0, 9), (9, 0), (1, 200), (200, 1), (90, 120), (300, 300)]
)
def test_what_two_lists_have_in_common(first, second):
    rng = np.random.default_rng(first + second)
    ids, others = ascending(rng, first), ascending(rng, second)
    common = np.empty(first, np.bool_)
    mark_common(ids, others, common)
    np.testing.assert_array_equal(common, np.isin(ids, others))

    old_since, since = rng.random(second), np.full(first, -1.0)
    gone = np.empty(second, np.bool_)
    count = carry_over(others, old_since, ids, since, gone)
    np.testing.assert_array_equal(gone, ~np.isin(others, ids))
    assert count == gone.sum()
    known = dict(zip(others.tolist(), old_since.tolist(), strict=True))
    assert since.tolist() == [known.get(each, -1.0) for each in ids.tolist()]


def test_what_is_lacking_is_listed_with_its_state():
    rng = np.random.default_rng(1)
    ids, state = ascending(rng, 120), rng.integers(0, 256, 300).astype(np.uint8)
    wanting = rng.random(256) < 0.4
    lacking, found = np.empty(120, np.int32), np.empty(120, np.uint8)
    count = list_lacking(ids, state, wanting, lacking, found)
    np.testing.assert_array_equal(lacking[:count], ids[wanting[state[ids]]])
    np.testing.assert_array_equal(found[:count], state[lacking[:count]])


def test_rows_are_picked_from_all_columns():
    rng = np.random.default_rng(2)
    ids, columns, chosen = ascending(rng, 50), rng.random((4, 50)), rng.random(50) < 0.5
    some, rows = np.empty(chosen.sum(), np.int32), np.empty((4, chosen.sum()))
    pick(chosen, ids, *columns, some, *rows)
    np.testing.assert_array_equal(some, ids[chosen])
    np.testing.assert_array_equal(rows, columns[:, chosen])


@pytest.mark.parametrize("shards", [2, 8, 256])
def test_places_by_shard_are_a_stable_order(shards):
    ids = ascending(np.random.default_rng(3), 5000, 100_000)
    shard = shard_of(ids, shards)
    parts = by_shard(ids, shards)
    assert len(parts) == shards
    np.testing.assert_array_equal(np.concatenate(parts), np.argsort(shard, kind="stable"))
    for k, place in enumerate(parts):
        assert (shard[place] == k).all()
