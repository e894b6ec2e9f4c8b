"""Light at one point of a texture, and path tracing of every pixel."""

from __future__ import annotations

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.lookup import open_texture, opened_words, read_four, side_of
from luxel.kernels.mapping import texel_uv, wrapped
from luxel.kernels.path import luminance_at
from luxel.kernels.rng import PURPOSE_PIXEL, path_key
from luxel.kernels.simd import LANES
from luxel.kernels.tiles import primary_ray
from luxel.kernels.tree_trace import scratch

__all__ = ["bilinear", "shade_pixels"]

_HALF, _ONE = np.float32(0.5), np.float32(1)


@kernel
def bilinear(mapping, texels, decoding, slot, nx, ny, nz):
    """Luminance of texture `slot` where the unit normal n points, interpolated bilinearly (paper 3.4).

    `texels` are raw codes (M, T, T) or compressed as ``lookup`` describes: only the four that are needed are unpacked.
    """
    side = side_of(texels)
    u, v = texel_uv(mapping, nx, ny, nz)
    x, y = u * np.float32(side) - _HALF, v * np.float32(side) - _HALF
    column, row = int(np.floor(x)), int(np.floor(y))
    a, b = x - np.float32(column), y - np.float32(row)
    r0, c0 = wrapped(mapping, side, row, column)
    r1, c1 = wrapped(mapping, side, row, column + 1)
    r2, c2 = wrapped(mapping, side, row + 1, column)
    r3, c3 = wrapped(mapping, side, row + 1, column + 1)
    opened = np.zeros(LANES * opened_words(texels), np.float32)
    handle = open_texture(texels, slot, opened, 0)
    codes = np.zeros(4, np.int32)
    read_four(
        texels, handle, opened, r0 * side + c0, r1 * side + c1, r2 * side + c2, r3 * side + c3, codes, 0
    )
    p, q, r, s = codes
    top = (_ONE - a) * decoding[p] + a * decoding[q]
    low = (_ONE - a) * decoding[r] + a * decoding[s]
    return (_ONE - b) * top + b * low


@kernel(inline=True)
def _hit_normal(centers, sphere, ox, oy, oz, dx, dy, dz, t):
    nx, ny, nz = (
        ox + t * dx - centers[sphere, 0],
        oy + t * dy - centers[sphere, 1],
        oz + t * dz - centers[sphere, 2],
    )
    scale = _ONE / np.sqrt(nx * nx + ny * ny + nz * nz)
    return nx * scale, ny * scale, nz * scale


@kernel(inline=True)
def _add(total, colors, sphere, luminance):
    for c in range(3):
        total[c] += luminance * colors[sphere, c]
    total[3] += luminance
    total[4] += _ONE


@kernel
def shade_pixels(
    world, eye, shift_x, shift_y, first_row, last_row, distance, ids, samples, first_sample, colors, total
):
    """Add rows [first_row, last_row) to `total` (see ``frame.draw_frame``), path tracing `samples` times at every hit."""
    work = scratch(world.tree.stack_size)
    height, width = ids.shape
    for y in range(first_row, last_row):
        for x in range(width):
            sphere = ids[y, x]
            if sphere < 0:
                continue
            ox, oy, oz, dx, dy, dz = primary_ray(
                eye, np.float32(x) + shift_x, np.float32(y) + shift_y, width, height
            )
            nx, ny, nz = _hit_normal(world.centers, sphere, ox, oy, oz, dx, dy, dz, distance[y, x])
            r = world.radii[sphere]
            px = world.centers[sphere, 0] + r * nx
            py = world.centers[sphere, 1] + r * ny
            pz = world.centers[sphere, 2] + r * nz
            luminance = np.float32(0)
            count = 0
            for s in range(samples):
                state = path_key(world.seed, y * width + x, 0, first_sample + s, PURPOSE_PIXEL)
                value = luminance_at(world, work, sphere, px, py, pz, nx, ny, nz, state)
                if value >= 0:  # rounding can bury a visible point at the seam of two spheres
                    luminance += value
                    count += 1
            _add(total[y, x], colors, sphere, luminance / np.float32(max(count, 1)))
