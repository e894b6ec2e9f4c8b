"""Random numbers: sixteen at a time as one by one, evenly spread, and apart from key to key."""

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.memory import float_lines
from luxel.kernels.rng import next_state, path_key, sample_key, texel_key, uniform, uniforms
from luxel.kernels.simd import LANES, load, store

SEED, ITEM, TEXEL, PURPOSE = 11, 70_000, 255, 1


@kernel
def one_by_one(draws, out):
    for sample in range(LANES):
        state = path_key(np.uint64(SEED), ITEM, TEXEL, sample, PURPOSE)
        for k in range(draws):
            out[k, 0, sample], out[k, 1, sample] = uniform(state)
            state = next_state(state)


@kernel
def in_lanes(draws, numbers, out):
    state = sample_key(texel_key(np.uint64(SEED), ITEM, TEXEL, PURPOSE), load(numbers, 0))
    pair = float_lines(2 * LANES)
    for k in range(draws):
        u, v = uniforms(state)
        store(pair, 0, u)
        store(pair, LANES, v)
        for lane in range(LANES):
            out[k, 0, lane], out[k, 1, lane] = pair[lane], pair[LANES + lane]
        state = next_state(state)


def test_lanes_are_single_numbers():
    draws = 4096
    single, lanes = (np.empty((draws, 2, LANES), np.float32) for _ in range(2))
    one_by_one(draws, single)
    in_lanes(draws, np.arange(LANES, dtype=np.uint64), lanes)
    np.testing.assert_array_equal(lanes, single)
    assert (single >= 0).all()
    assert (single < 1).all()
    # Sixteen cells are filled evenly, to five standard deviations, by pairs too.
    cells = (np.int64(4 * single[:, 0]) * 4 + np.int64(4 * single[:, 1])).ravel()
    counts = np.bincount(cells, minlength=16)
    expected = cells.size / 16
    assert np.abs(counts - expected).max() < 5 * np.sqrt(expected)
    correlation = np.corrcoef(single.reshape(draws, -1), rowvar=False)
    np.fill_diagonal(correlation, 0)
    assert np.abs(correlation).max() < 5 / np.sqrt(draws)
