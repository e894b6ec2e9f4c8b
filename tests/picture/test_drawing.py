"""Drawing threads, and what their kernels read."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from luxel.kernels import FIRST_LIGHT, STALE
from luxel.kernels.frame import make_bench
from luxel.kernels.jit import kernel
from luxel.kernels.mapping import CORNER_STRIDE, texel_corners
from luxel.kernels.simd import load
from luxel.kernels.textured import open_textures
from luxel.kernels.tiles import RAYS
from luxel.picture.drawing import Crew, bare_table, make_skin


@kernel
def opened(skin, bench, hits):
    open_textures(skin, bench.opened, hits)


@kernel
def corners_of(mapping, side, points, apart, corners):
    texel_corners(mapping, side, load(points, 0), load(points, 16), load(points, 32), apart, corners, 0)


def test_rays_without_a_texture_open_one_that_others_have() -> None:
    """What lies in slots that nobody has may be anything, such as the number of a basis that is not there."""
    skin = make_skin(bare_table(9), np.ones((9, 3), np.float32))
    bench = make_bench(16, 0, 0)
    hits = bench.hits[0]
    size = skin.texels[0].size
    rng = np.random.default_rng(2)
    for _ in range(20):
        has = rng.choice(np.array([3, 5, STALE | 7], np.int32), RAYS)
        slot = np.where(rng.random(RAYS) < 0.9, rng.choice(np.array([-1, FIRST_LIGHT], np.int32), RAYS), has)
        slot[rng.integers(RAYS)] = 5
        hits.slot[:] = slot
        opened(skin, bench, hits)
        handles = bench.opened.handles
        assert set(handles.tolist()) <= {3 * size, 5 * size, 7 * size}
        there = slot >= 0
        np.testing.assert_array_equal(handles[there], (slot[there] & (STALE - 1)) * size)


@pytest.mark.parametrize("mapping", [0, 1])
def test_corners_are_texels_for_any_vector(mapping: int) -> None:
    points = np.zeros((3, 16), np.float32)
    points[:, 1] = 1e-30
    points[:, 2] = 3e38
    points[0, 3], points[1, 4], points[2, 5] = 1e-20, -1e-20, 1e-12
    points[:, 6] = np.nan
    points[2, 7:] = np.inf
    apart, corners = np.zeros(4 * CORNER_STRIDE, np.float32), np.full(4 * CORNER_STRIDE, -1, np.int32)
    corners_of(mapping, 16, points.ravel(), apart, corners)
    found = corners.reshape(4, -1)[:, :16]
    assert found.min() >= 0
    assert found.max() < 256


def test_corners_do_not_depend_on_length() -> None:
    rng = np.random.default_rng(1)
    points = rng.normal(size=(3, 16)).astype(np.float32)
    found = []
    for length in (1.0, 2.0**-20, 2.0**10):
        apart, corners = np.zeros(4 * CORNER_STRIDE, np.float32), np.zeros(4 * CORNER_STRIDE, np.int32)
        corners_of(0, 16, (length * points).ravel(), apart, corners)
        found.append((apart, corners))
    for apart, corners in found[1:]:
        np.testing.assert_array_equal(corners, found[0][1])
        np.testing.assert_allclose(apart, found[0][0], atol=1e-5)


def test_an_error_leaves_no_thread_at_work() -> None:
    crew, started, release, done = Crew(2), threading.Event(), threading.Event(), []

    def work() -> None:
        started.set()
        release.wait()
        done.append(True)

    def first() -> None:
        started.wait()
        threading.Timer(0.01, release.set).start()
        raise ValueError("first")

    with pytest.raises(ValueError, match="first"):
        crew.run(work, first)
    assert done == [True]
    crew.close()
