"""Primary rays: one frustum for each tile of 8 × 8 pixels goes down the sphere tree; at the leaves, rays lie in lanes.

The rays of a tile are numbered by blocks of 4 × 4 pixels, sixteen lanes each: at a leaf, two planes through the middle of the
tile tell which spheres concern which blocks, so that a sphere two pixels wide meets 16 or 32 rays instead of 64.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels.frustum import (
    Frustum,
    depth_inside,
    height_above,
    look_through,
    make_frustum,
)
from luxel.kernels.jit import kernel
from luxel.kernels.memory import float_lines, int_lines
from luxel.kernels.simd import (
    LANES,
    bits,
    fma,
    fnma,
    lane_max,
    load,
    popcount,
    select,
    splat,
    splat_int,
    store,
    trailing_zeros,
    vmax,
    vmin,
    vsqrt,
)  # fmt: skip
from luxel.kernels.tree import CHILDREN, IDS, LEAF, NODE
from luxel.kernels.tree_trace import ask_for

__all__ = [
    "RAYS",
    "TILE",
    "Tile",
    "block_of",
    "leaders",
    "make_tile",
    "note_nearest",
    "place_of",
    "primary_ray",
    "primary_tiles",
    "ray_at",
    "trace_points",
    "trace_tile",
]

TILE = 8
RAYS = TILE * TILE
_FAR = np.float32(1e30)
_HAS_LEFT, _HAS_ABOVE = 0xEEEE, 0xFFF0  # of the rays of a block
_ZERO, _ONE, _TWO = (np.float32(x) for x in (0, 1, 2))


class Tile(NamedTuple):
    """Working memory of one thread, and what `trace_tile` leaves there: rays, and what they hit first."""

    rays: np.ndarray  # (6 · 64,) float32: origin x, y, z, direction x, y, z
    best: np.ndarray  # (64,) float32 distance
    found: (
        np.ndarray
    )  # (64,) int32 word of the tree's leaves that holds the particle's id; -1 for the background
    places: np.ndarray  # (2 · 64,) float32: column and row of each ray within the tile
    points: np.ndarray  # (2 · 64,) float32: image point of each ray, in pixels
    frustum: Frustum
    stack: np.ndarray
    near: np.ndarray
    lanes: np.ndarray


@kernel
def make_tile(stack_size):
    """Allocate the working memory of one thread."""
    places = float_lines(2 * RAYS)
    for j in range(RAYS):
        column, row = place_of(j)
        places[j], places[RAYS + j] = column, row
    return Tile(
        float_lines(6 * RAYS),
        float_lines(RAYS),
        int_lines(RAYS),
        places,
        float_lines(2 * RAYS),
        make_frustum(),
        np.empty(stack_size, np.int32),
        float_lines(stack_size),
        float_lines(LANES),
    )


@kernel(inline=True)
def place_of(ray):
    """Column and row within its tile of a ray."""
    return ((ray >> 4) & 1) * 4 + (ray & 3), (ray >> 5) * 4 + ((ray >> 2) & 3)


@kernel(inline=True)
def ray_at(column, row):
    """Inverse of `place_of`."""
    return (row >> 2) * 32 + (column >> 2) * 16 + (row & 3) * 4 + (column & 3)


@kernel(inline=True, borrows=True)
def leaders(what):
    """Return a bit for each ray of a tile that has a number which neither the ray to the left nor the one above has.

    `what` (64,) int32 is negative for rays that have none; sixteen words before the first may be read.
    """
    found = 0
    for v in range(0, RAYS, LANES):
        here = load(what, v)
        same = bits(here == load(what, v - 1)) & _HAS_LEFT
        same |= bits(here == load(what, v - 4)) & _HAS_ABOVE
        found |= (bits(here >= splat_int(np.int32(0))) & ~same) << v
    return found


@kernel(inline=True)
def block_of(number, edge, width, height):
    """Left, top, right and bottom pixels of a block of `edge` × `edge` tiles, the last two not in it; blocks that are not there begin below the picture."""
    side = edge * TILE
    across = (width + side - 1) // side
    left, top = number % across * side, number // across * side
    return left, top, min(left + side, width), min(top + side, height)


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


@kernel(borrows=True)
def _aim(eye, tile, width, height):
    """Make the rays of a tile through its `points`, as `primary_ray` does."""
    rays, points = tile.rays, tile.points
    wide, high = splat(_TWO / np.float32(width)), splat(_TWO / np.float32(height))
    for v in range(0, RAYS, LANES):
        sx = fma(load(points, v), wide, splat(-_ONE))
        sy = fnma(load(points, RAYS + v), high, splat(_ONE))
        ax = fma(sx, splat(eye.right[0]), sy * eye.up[0])
        ay = fma(sx, splat(eye.right[1]), sy * eye.up[1])
        az = fma(sx, splat(eye.right[2]), sy * eye.up[2])
        ox, oy, oz = splat(eye.origin[0]), splat(eye.origin[1]), splat(eye.origin[2])
        dx, dy, dz = splat(eye.forward[0]), splat(eye.forward[1]), splat(eye.forward[2])
        if eye.orthographic:
            ox, oy, oz = ox + ax, oy + ay, oz + az
        else:
            dx, dy, dz = dx + ax, dy + ay, dz + az
            scale = splat(_ONE) / vsqrt(fma(dx, dx, fma(dy, dy, dz * dz)))
            dx, dy, dz = dx * scale, dy * scale, dz * scale
        store(rays, v, ox)
        store(rays, RAYS + v, oy)
        store(rays, 2 * RAYS + v, oz)
        store(rays, 3 * RAYS + v, dx)
        store(rays, 4 * RAYS + v, dy)
        store(rays, 5 * RAYS + v, dz)


@kernel(inline=True, borrows=True)
def _choose_children(nodes, child, o, tree, eye, tile, slack, limit, height):
    """Put those children of the node at word `o` on the stack that rays of the tile may meet before `limit`, the nearest on top; returns the stack's height."""
    stack, near, lanes = tile.stack, tile.near, tile.lanes
    ox, oy, oz = eye.origin[0], eye.origin[1], eye.origin[2]
    fx, fy, fz = eye.forward[0], eye.forward[1], eye.forward[2]
    inside = depth_inside(tile.frustum, nodes, o)
    lx, ly, lz = load(nodes, o) - ox, load(nodes, o + LANES) - oy, load(nodes, o + 2 * LANES) - oz
    hx, hy, hz = (
        load(nodes, o + 3 * LANES) - ox,
        load(nodes, o + 4 * LANES) - oy,
        load(nodes, o + 5 * LANES) - oz,
    )
    if eye.orthographic:
        ahead = vmin(lx * fx, hx * fx) + vmin(ly * fy, hy * fy) + vmin(lz * fz, hz * fz)
    else:
        zero = splat(_ZERO)
        ax, ay, az = (
            vmax(zero, vmax(lx, -hx)),
            vmax(zero, vmax(ly, -hy)),
            vmax(zero, vmax(lz, -hz)),
        )
        ahead = vsqrt(fma(ax, ax, fma(ay, ay, az * az)))
    m = bits((inside >= slack) & (ahead < limit))
    store(lanes, 0, ahead)
    base = o + CHILDREN
    if m & (m - 1) == 0:
        if m != 0:
            k = trailing_zeros(m)
            stack[height], near[height] = child[base + k], lanes[k]
            height += 1
        return height
    rest = m
    while rest != 0:  # by rank, since a sort's branches cannot be predicted
        k = trailing_zeros(rest)
        rest &= rest - 1
        t = lanes[k]
        link = child[base + k]
        farther = bits(ahead > t) & m
        level = bits(ahead >= t) & m & ~farther & ((1 << k) - 1)
        j = height + popcount(farther) + popcount(level)
        stack[j], near[j] = link, t
        ask_for(tree.nodes, tree.spheres, link)
    return height + popcount(m)


@kernel(borrows=True, inner=True)
def trace_tile(tree, eye, tile, width, height, tx, ty, shift_x, shift_y):
    """Trace the 64 rays through (x + shift_x, y + shift_y), x from `tx` and y from `ty` on; write `tile`.

    Returns whether any sphere came near the tile; if not, nothing is written and all is background.
    """
    x, y = np.float32(tx) + shift_x, np.float32(ty) + shift_y
    for v in range(0, RAYS, LANES):
        store(tile.points, v, load(tile.places, v) + x)
        store(tile.points, RAYS + v, load(tile.places, RAYS + v) + y)
    # Parts of a picture have shifts beyond a pixel, see `picture.drawing.part_of`.
    across, down = _TWO / np.float32(width), _TWO / np.float32(height)
    left = (np.float32(tx) + np.floor(shift_x)) * across - _ONE
    top = _ONE - (np.float32(ty) + np.floor(shift_y)) * down
    return trace_points(
        tree, tree.nodes, tree.child, eye, tile, width, height, left, top,
        np.float32(TILE) * across, np.float32(TILE) * down,
    )  # fmt: skip


@kernel(borrows=True, inner=True)
def trace_points(tree, node, link, eye, tile, width, height, left, top, wide, high):
    """As `trace_tile`, through ``tile.points``, which lie where sx goes from `left` over `wide`, and sy from `top` down over `high`.

    They lie in squares as `place_of` says, so that a middle column and row of the part has half of them to each side. The tree is
    entered by `node` and `link`: its own, or a ``frustum.Cut`` of a rectangle around this one.
    """
    spheres = tree.spheres
    stack, near, rays, best, found = tile.stack, tile.near, tile.rays, tile.best, tile.found
    planes = tile.frustum.planes
    ortho = eye.orthographic
    ox, oy, oz = eye.origin[0], eye.origin[1], eye.origin[2]
    fx, fy, fz = eye.forward[0], eye.forward[1], eye.forward[2]
    zero = splat(_ZERO)
    slack = look_through(eye, tile.frustum, left, top, wide, high)
    aimed = False
    # No ray of the tile, or of each of its blocks, goes farther.
    limit = far0 = far1 = far2 = far3 = _FAR
    stacked = _choose_children(node, link, 0, tree, eye, tile, slack, limit, 0)
    while stacked > 0:
        stacked -= 1
        if near[stacked] >= limit:
            continue
        current = stack[stacked]
        if current >= 0:
            stacked = _choose_children(
                tree.nodes, tree.child, current * NODE, tree, eye, tile, slack, limit, stacked
            )
            continue
        o = ~current * LEAF
        cx, cy, cz = load(spheres, o), load(spheres, o + LANES), load(spheres, o + 2 * LANES)
        r2 = load(spheres, o + 3 * LANES)
        r = vsqrt(vmax(r2, zero))
        edge = slack - r
        touches = r2 > zero
        for c in range(4):
            touches = touches & (height_above(planes, c, cx, cy, cz) >= edge)
        ex, ey, ez = cx - ox, cy - oy, cz - oz
        if ortho:
            ahead = fma(ex, splat(fx), fma(ey, splat(fy), ez * fz))
        else:
            ahead = vsqrt(fma(ex, ex, fma(ey, ey, ez * ez)))
        ahead = ahead + edge
        across, above = height_above(planes, 4, cx, cy, cz), height_above(planes, 5, cx, cy, cz)
        north, south = touches & (above >= edge), touches & (above <= -edge)
        west, east = across <= -edge, across >= edge
        # One loop over spheres of all blocks: where loops end cannot be predicted, and costs as much as three spheres.
        m = bits(north & west & (ahead < far0)) | bits(north & east & (ahead < far1)) << LANES
        m |= bits(south & west & (ahead < far2)) << 2 * LANES
        m |= bits(south & east & (ahead < far3)) << 3 * LANES
        if m != 0:
            if not aimed:
                aimed = True
                _aim(eye, tile, width, height)
                for v in range(0, RAYS, LANES):
                    store(best, v, splat(_FAR))
                    store(found, v, splat_int(np.int32(-1)))
            while m != 0:
                k = trailing_zeros(m)
                m &= m - 1
                v = k & ~(LANES - 1)
                k &= LANES - 1
                nearest, who = load(best, v), load(found, v)
                dx, dy, dz = load(rays, 3 * RAYS + v), load(rays, 4 * RAYS + v), load(rays, 5 * RAYS + v)
                sx, sy, sz = spheres[o + k], spheres[o + LANES + k], spheres[o + 2 * LANES + k]
                if ortho:
                    ex, ey, ez = (
                        sx - load(rays, v),
                        sy - load(rays, RAYS + v),
                        sz - load(rays, 2 * RAYS + v),
                    )
                else:
                    ex, ey, ez = splat(sx - ox), splat(sy - oy), splat(sz - oz)
                b = fma(dx, ex, fma(dy, ey, dz * ez))
                px, py, pz = fnma(b, dx, ex), fnma(b, dy, ey), fnma(b, dz, ez)
                disc = fnma(px, px, fnma(py, py, fnma(pz, pz, splat(spheres[o + 3 * LANES + k]))))
                # No branch: it would be mispredicted every other time. A hit has disc > 0 and t > 0.
                t = b - vsqrt(vmax(disc, zero))
                t = select(vmin(disc, t) > zero, t, splat(_FAR))
                store(found, v, select(t < nearest, splat_int(np.int32(o + IDS + k)), who))
                store(best, v, vmin(t, nearest))
            far0, far1 = lane_max(load(best, 0)), lane_max(load(best, LANES))
            far2, far3 = lane_max(load(best, 2 * LANES)), lane_max(load(best, 3 * LANES))
            limit = max(max(far0, far1), max(far2, far3))
    return aimed


@kernel(borrows=True, inner=True)
def note_nearest(tree, tile, near, width, height, tx, ty, distance, ids):
    """Write what the rays of a tile have hit first to `distance` and `ids`, as `primary_tiles` does; nothing if not `near`."""
    for row in range(min(TILE, height - ty)):
        for column in range(min(TILE, width - tx)):
            j = ray_at(column, row)
            hit = near and tile.found[j] >= 0
            distance[ty + row, tx + column] = tile.best[j] if hit else np.float32(np.inf)
            ids[ty + row, tx + column] = tree.ids[tile.found[j]] if hit else np.int32(-1)


@kernel(borrows=True)
def _trace_rows(tree, eye, tile, width, height, shift_x, shift_y, first_row, last_row, distance, ids):
    for ty in range(first_row, last_row, TILE):
        for tx in range(0, width, TILE):
            near = trace_tile(tree, eye, tile, width, height, tx, ty, shift_x, shift_y)
            note_nearest(tree, tile, near, width, min(height, last_row), tx, ty, distance, ids)


@kernel
def primary_tiles(tree, eye, width, height, shift_x, shift_y, first_row, last_row, distance, ids):
    """Trace the pixels of rows [first_row, last_row), a multiple of 8 apart, through (x + shift_x, y + shift_y).

    Writes `distance` (H, W) float32, infinite for the background, and `ids` (H, W) int32, -1 for the background.
    """
    tile = make_tile(tree.stack_size)
    _trace_rows(tree, eye, tile, width, height, shift_x, shift_y, first_row, last_row, distance, ids)
