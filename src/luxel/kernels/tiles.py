"""Primary rays: one frustum for each tile of 8 × 8 pixels goes down the sphere tree; at the leaves, rays lie in lanes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.simd import (
    LANES,
    any_lane,
    bits,
    fma,
    fnma,
    lane_max,
    load,
    select,
    splat,
    splat_int,
    store,
    trailing_zeros,
    vmax,
    vmin,
    vsqrt,
)  # fmt: skip
from luxel.kernels.tree_trace import CHILDREN, IDS, LEAF, NODE

__all__ = ["TILE", "Eye", "primary_ray", "primary_tiles"]

TILE = 8
_RAYS = TILE * TILE
_FAR = np.float32(1e30)
_ZERO, _ONE, _TWO = np.float32(0), np.float32(1), np.float32(2)


class Eye(NamedTuple):
    """A camera in normalised units.

    Perspective rays leave `origin` towards forward + sx·right + sy·up; orthographic rays leave
    origin + sx·right + sy·up along forward. (sx, sy) run over [-1, 1] from the left and from the bottom.
    """

    origin: np.ndarray  # (3,) float32
    right: np.ndarray
    up: np.ndarray
    forward: np.ndarray
    orthographic: bool


@kernel(inline=True)
def primary_ray(eye, x, y, width, height):
    """Origin and unit direction of the ray through image point (x, y); y runs down from the top."""
    sx = x / np.float32(width) * _TWO - _ONE
    sy = _ONE - y / np.float32(height) * _TWO
    ax = sx * eye.right[0] + sy * eye.up[0]
    ay = sx * eye.right[1] + sy * eye.up[1]
    az = sx * eye.right[2] + sy * eye.up[2]
    if eye.orthographic:
        return (
            eye.origin[0] + ax, eye.origin[1] + ay, eye.origin[2] + az,
            eye.forward[0], eye.forward[1], eye.forward[2],
        )  # fmt: skip
    dx, dy, dz = eye.forward[0] + ax, eye.forward[1] + ay, eye.forward[2] + az
    scale = _ONE / np.sqrt(dx * dx + dy * dy + dz * dz)
    return eye.origin[0], eye.origin[1], eye.origin[2], dx * scale, dy * scale, dz * scale


@kernel
def _tile_planes(eye, x, y, width, height, corner, planes):
    """Write the four inward planes of a tile's frustum: normal and offset each."""
    for c in range(4):
        cx = np.float32(x + (TILE if c in (1, 2) else 0))
        cy = np.float32(y + (TILE if c >= 2 else 0))
        ox, oy, oz, dx, dy, dz = primary_ray(eye, cx, cy, width, height)
        corner[c, 0], corner[c, 1], corner[c, 2] = ox, oy, oz
        corner[c, 3], corner[c, 4], corner[c, 5] = dx, dy, dz
    ortho = eye.orthographic
    for c in range(4):
        d, e = (c + 1) & 3, (c + 2) & 3
        # Two directions in the plane, and one point of the opposite edge to tell the inside.
        if ortho:
            ax, ay, az = corner[d, 0] - corner[c, 0], corner[d, 1] - corner[c, 1], corner[d, 2] - corner[c, 2]
            ix, iy, iz = corner[e, 0] - corner[c, 0], corner[e, 1] - corner[c, 1], corner[e, 2] - corner[c, 2]
        else:
            ax, ay, az = corner[d, 3], corner[d, 4], corner[d, 5]
            ix, iy, iz = corner[e, 3], corner[e, 4], corner[e, 5]
        bx, by, bz = corner[c, 3], corner[c, 4], corner[c, 5]
        nx, ny, nz = by * az - bz * ay, bz * ax - bx * az, bx * ay - by * ax
        scale = _ONE / np.sqrt(nx * nx + ny * ny + nz * nz)
        if nx * ix + ny * iy + nz * iz < 0:
            scale = -scale
        nx, ny, nz = nx * scale, ny * scale, nz * scale
        planes[4 * c], planes[4 * c + 1], planes[4 * c + 2] = nx, ny, nz
        planes[4 * c + 3] = -(nx * corner[c, 0] + ny * corner[c, 1] + nz * corner[c, 2])


@kernel
def primary_tiles(tree, eye, width, height, shift_x, shift_y, first_row, last_row, distance, ids):
    """Trace the pixels of rows [first_row, last_row), a multiple of 8 apart, through (x + shift_x, y + shift_y).

    Writes `distance` (H, W) float32, infinite for the background, and `ids` (H, W) int32, -1 for the background.
    """
    nodes, child, spheres, sphere_ids = tree.nodes, tree.child, tree.spheres, tree.ids
    stack, near = np.empty(tree.stack_size, np.int32), np.empty(tree.stack_size, np.float32)
    lanes = np.empty(4 * LANES, np.float32)
    rays = np.empty(6 * _RAYS, np.float32)  # origin x, y, z, direction x, y, z
    best, slot = np.empty(_RAYS, np.float32), np.empty(_RAYS, np.int32)
    corner, planes = np.empty((4, 6), np.float32), np.empty(16, np.float32)
    low_or_high = np.zeros(12, np.int64)
    ortho = eye.orthographic
    ox, oy, oz = eye.origin[0], eye.origin[1], eye.origin[2]
    fx, fy, fz = eye.forward[0], eye.forward[1], eye.forward[2]
    zero = splat(_ZERO)
    # Rounding of the plane offsets grows with the distance of the eye.
    slack = splat(np.float32(-1e-6) * (_TWO + abs(ox) + abs(oy) + abs(oz)))
    for ty in range(first_row, last_row, TILE):
        for tx in range(0, width, TILE):
            for j in range(_RAYS):
                x = np.float32(tx + (j & (TILE - 1))) + shift_x
                y = np.float32(ty + j // TILE) + shift_y
                rx, ry, rz, dx, dy, dz = primary_ray(eye, x, y, width, height)
                rays[j], rays[_RAYS + j], rays[2 * _RAYS + j] = rx, ry, rz
                rays[3 * _RAYS + j], rays[4 * _RAYS + j], rays[5 * _RAYS + j] = dx, dy, dz
                best[j], slot[j] = _FAR, -1
            _tile_planes(eye, tx, ty, width, height, corner, planes)
            for c in range(4):
                for a in range(3):
                    low_or_high[3 * c + a] = ((3 if planes[4 * c + a] > 0 else 0) + a) * LANES
            limit = _FAR
            height_of_stack = 0
            current = 0
            while True:
                if current >= 0:
                    o = current * NODE
                    inside = splat(_FAR)
                    for c in range(4):
                        reach = fma(
                            load(nodes, o + low_or_high[3 * c]), splat(planes[4 * c]),
                            fma(
                                load(nodes, o + low_or_high[3 * c + 1]), splat(planes[4 * c + 1]),
                                fma(load(nodes, o + low_or_high[3 * c + 2]), splat(planes[4 * c + 2]), splat(planes[4 * c + 3])),
                            ),
                        )  # fmt: skip
                        inside = vmin(inside, reach)
                    lx, ly, lz = (
                        load(nodes, o) - ox,
                        load(nodes, o + LANES) - oy,
                        load(nodes, o + 2 * LANES) - oz,
                    )
                    hx, hy, hz = (
                        load(nodes, o + 3 * LANES) - ox,
                        load(nodes, o + 4 * LANES) - oy,
                        load(nodes, o + 5 * LANES) - oz,
                    )
                    if ortho:
                        ahead = vmin(lx * fx, hx * fx) + vmin(ly * fy, hy * fy) + vmin(lz * fz, hz * fz)
                    else:
                        ax, ay, az = (
                            vmax(zero, vmax(lx, -hx)),
                            vmax(zero, vmax(ly, -hy)),
                            vmax(zero, vmax(lz, -hz)),
                        )
                        ahead = vsqrt(fma(ax, ax, fma(ay, ay, az * az)))
                    m = bits((inside >= slack) & (ahead < limit))
                    if m != 0:
                        k = trailing_zeros(m)
                        m &= m - 1
                        base = o + CHILDREN
                        if m == 0:
                            current = child[base + k]
                            continue
                        store(lanes, 0, ahead)
                        bottom = height_of_stack
                        stack[bottom], near[bottom] = child[base + k], lanes[k]
                        height_of_stack += 1
                        while m != 0:
                            k = trailing_zeros(m)
                            m &= m - 1
                            t = lanes[k]
                            j = height_of_stack
                            while j > bottom and near[j - 1] < t:
                                near[j], stack[j] = near[j - 1], stack[j - 1]
                                j -= 1
                            near[j], stack[j] = t, child[base + k]
                            height_of_stack += 1
                        height_of_stack -= 1
                        current = stack[height_of_stack]
                        continue
                else:
                    o = ~current * LEAF
                    cx, cy, cz = load(spheres, o), load(spheres, o + LANES), load(spheres, o + 2 * LANES)
                    r2 = load(spheres, o + 3 * LANES)
                    edge = slack - vsqrt(vmax(r2, zero))
                    touches = r2 > zero
                    for c in range(4):
                        side = fma(cx, splat(planes[4 * c]), fma(cy, splat(planes[4 * c + 1]), fma(cz, splat(planes[4 * c + 2]), splat(planes[4 * c + 3]))))  # fmt: skip
                        touches = touches & (side >= edge)
                    m = bits(touches)
                    if m != 0:
                        store(lanes, 0, cx)
                        store(lanes, LANES, cy)
                        store(lanes, 2 * LANES, cz)
                        store(lanes, 3 * LANES, r2)
                        changed = False
                        while m != 0:
                            k = trailing_zeros(m)
                            m &= m - 1
                            sx, sy, sz, sr2 = (
                                lanes[k],
                                lanes[LANES + k],
                                lanes[2 * LANES + k],
                                lanes[3 * LANES + k],
                            )
                            me = splat_int(np.int32(o + IDS + k))
                            ex, ey, ez = splat(sx - ox), splat(sy - oy), splat(sz - oz)
                            for v in range(0, _RAYS, LANES):
                                if ortho:
                                    ex = sx - load(rays, v)
                                    ey = sy - load(rays, _RAYS + v)
                                    ez = sz - load(rays, 2 * _RAYS + v)
                                dx, dy, dz = (
                                    load(rays, 3 * _RAYS + v),
                                    load(rays, 4 * _RAYS + v),
                                    load(rays, 5 * _RAYS + v),
                                )
                                b = fma(dx, ex, fma(dy, ey, dz * ez))
                                px, py, pz = fnma(b, dx, ex), fnma(b, dy, ey), fnma(b, dz, ez)
                                disc = fnma(px, px, fnma(py, py, fnma(pz, pz, splat(sr2))))
                                hit = disc > zero
                                if any_lane(hit):
                                    t = b - vsqrt(vmax(disc, zero))
                                    before = load(best, v)
                                    hit = hit & (t < before) & (t > zero)
                                    store(best, v, select(hit, t, before))
                                    store(slot, v, select(hit, me, load(slot, v)))
                                    changed = True
                        if changed:
                            limit = lane_max(
                                vmax(
                                    vmax(load(best, 0), load(best, LANES)),
                                    vmax(load(best, 2 * LANES), load(best, 3 * LANES)),
                                )
                            )
                while height_of_stack > 0 and near[height_of_stack - 1] >= limit:
                    height_of_stack -= 1
                if height_of_stack == 0:
                    break
                height_of_stack -= 1
                current = stack[height_of_stack]
            for j in range(_RAYS):
                x, y = tx + (j & (TILE - 1)), ty + j // TILE
                if x < width and y < min(height, last_row):
                    found = slot[j] >= 0
                    distance[y, x] = best[j] if found else np.float32(np.inf)
                    ids[y, x] = sphere_ids[slot[j]] if found else np.int32(-1)
