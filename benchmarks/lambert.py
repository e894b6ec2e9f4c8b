"""The yardstick of the paper's tables: Lambert with one shadow ray a pixel towards one light, in the same renderer."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from luxel.kernels import tiles
from luxel.kernels.path import World
from luxel.kernels.tiles import primary_ray
from luxel.kernels.tree_trace import occluded, scratch
from luxel.trace.tree import run_parts

_BAND = 32


@njit(nogil=True, error_model="numpy")
def _shade(world, eye, first_row, last_row, distance, ids, sun, colors, total):
    work = scratch(world.tree.stack_size)
    height, width = ids.shape
    half, zero = np.float32(0.5), np.float32(0)
    for y in range(first_row, last_row):
        for x in range(width):
            sphere = ids[y, x]
            if sphere < 0:
                continue
            ox, oy, oz, dx, dy, dz = primary_ray(
                eye, np.float32(x) + half, np.float32(y) + half, width, height
            )
            t = distance[y, x]
            px, py, pz = ox + t * dx, oy + t * dy, oz + t * dz
            nx, ny, nz = (
                px - world.centers[sphere, 0],
                py - world.centers[sphere, 1],
                pz - world.centers[sphere, 2],
            )
            scale = np.float32(1) / np.sqrt(nx * nx + ny * ny + nz * nz)
            light = (nx * sun[0] + ny * sun[1] + nz * sun[2]) * scale
            if light > 0 and occluded(
                world.tree, work, px, py, pz, sun[0], sun[1], sun[2], np.float32(1e30), sphere
            ):
                light = zero
            light = max(zero, light)
            for c in range(3):
                total[y, x, c] += light * colors[sphere, c]
            total[y, x, 3] += light
            total[y, x, 4] += np.float32(1)


def draw_lambert(
    world: World,
    eye: tiles.Eye,
    sun: NDArray[np.float32],
    colors: NDArray[np.float32],
    total: NDArray[np.float32],
    threads: int,
) -> None:
    """Add one ray a pixel to `total` (H, W, 5), as ``picture.raytrace.draw_textures`` does; `sun` is (3,), a unit vector."""
    height, width = total.shape[:2]
    distance, ids = np.empty((height, width), np.float32), np.empty((height, width), np.int32)
    middle = np.float32(0.5)

    def band(row: int) -> None:
        last = min(row + _BAND, height)
        tiles.primary_tiles(world.tree, eye, width, height, middle, middle, row, last, distance, ids)
        _shade(world, eye, row, last, distance, ids, sun, colors, total)

    run_parts(band, range(0, height, _BAND), threads)
