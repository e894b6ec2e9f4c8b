"""Near field: all rays of one particle against its neighbours, found and sorted once, sixteen rays at a time.

A particle's gather rays start on one small sphere, so most of what stops them is among a few dozen neighbours. These
are collected from the tree by the distance of their surfaces, whatever their size, and rays are tested against them
in blocks, nearest neighbours first. Only rays that leave the ball that was searched go on through the tree.

Lengths are in radii of the particle, points relative to its centre: a ray starts at the unit vector a.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.memory import float_lines, index, int_lines
from luxel.kernels.simd import (
    FAR,
    LANES,
    any_lane,
    bits,
    fma,
    fnma,
    load,
    mask_from_bits,
    popcount,
    select,
    splat,
    splat_int,
    store,
    trailing_zeros,
    vmax,
    vsqrt,
)
from luxel.kernels.tree import CHILDREN, IDS, LEAF, NODE

__all__ = [
    "EXIT",
    "GIANT",
    "RAY",
    "Near",
    "buried_starts",
    "collect",
    "near_scratch",
    "nearest",
    "passes_by",
    "patch_neighbours",
    "unblocked",
]

# Words of a block of sixteen rays: start a, direction d, and w = a·d.
RAY = 7 * LANES
# The ball searched reaches this far from the centre, unless it holds too many.
_REACH = np.float32(3.5)
_CAPACITY = 512
_ENOUGH = 128
# Beyond these ratios of radii b² - q, or q itself, cancels: such neighbours are tested by their distance from the ray.
GIANT, _DWARF = np.float32(8), np.float32(0.125)
_APART = np.float32(1.001)  # a sphere that begins there holds no ray's start, whatever rounding says
EXIT = np.float32(1e-4)  # as in tree: a sphere that a ray is about to leave does not block it
_ZERO, _ONE, _TWO = np.float32(0), np.float32(1), np.float32(2)


class Near(NamedTuple):
    """Neighbours of one particle, nearest surface first; working memory of one thread."""

    x: np.ndarray  # (capacity,) float32 centres
    y: np.ndarray
    z: np.ndarray
    far: np.ndarray  # distance of the centre
    power: np.ndarray  # |centre|² - radius² + 1
    radius: np.ndarray
    surface: np.ndarray  # distance of the nearest point of the surface from the particle's centre; of dwarfs and giants at most 1
    id: np.ndarray  # int32
    chosen: np.ndarray  # int32: neighbours that rays of one patch may meet
    hit_t: np.ndarray  # float32 a ray
    hit: np.ndarray  # int32 a ray
    offset: np.ndarray  # (…, 3) float32 a ray: from the particle hit to the image hit, in periodic cells only
    lanes: np.ndarray


@kernel(inner=True)
def near_scratch(rays):
    """Allocate for at most `rays` rays at a time."""
    size = _CAPACITY + LANES
    return Near(
        float_lines(size), float_lines(size), float_lines(size),
        float_lines(size), float_lines(size), float_lines(size),
        float_lines(size), int_lines(size), int_lines(size),
        float_lines(rays), int_lines(rays), np.zeros((rays, 3), np.float32), float_lines(8 * LANES),
    )  # fmt: skip


@kernel
def _shrink(near, count):
    """Keep the `_ENOUGH` neighbours with the nearest surfaces; returns the new reach."""
    low, high = 0, count - 1
    while low < high:  # Hoare's selection
        pivot = near.surface[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while near.surface[i] < pivot:
                i += 1
            while near.surface[j] > pivot:
                j -= 1
            if i <= j:
                _swap(near, i, j)
                i += 1
                j -= 1
        if j >= _ENOUGH:
            high = j
        elif i <= _ENOUGH:
            low = i
        else:
            break
    return near.surface[_ENOUGH]


@kernel(inline=True)
def _swap(near, i, j):
    near.x[i], near.x[j] = near.x[j], near.x[i]
    near.y[i], near.y[j] = near.y[j], near.y[i]
    near.z[i], near.z[j] = near.z[j], near.z[i]
    near.radius[i], near.radius[j] = near.radius[j], near.radius[i]
    near.surface[i], near.surface[j] = near.surface[j], near.surface[i]
    near.id[i], near.id[j] = near.id[j], near.id[i]


@kernel(inner=True)
def collect(tree, work, near, cx, cy, cz, r, skip):
    """Find the neighbours of a sphere; returns (count, reach).

    Every sphere but `skip` whose surface comes within `reach` radii of the centre is among them; where more than the
    buffer holds lie near, `reach` shrinks, and what is left out is found by the tree.
    """
    nodes, child, spheres, ids = tree.nodes, tree.child, tree.spheres, tree.ids
    stack, lanes = work.node, near.lanes
    vx, vy, vz = splat(cx), splat(cy), splat(cz)
    zero = splat(_ZERO)
    inverse = _ONE / r
    reach = _REACH
    count = 0
    stack[0] = 0
    height = 1
    while height > 0:
        height -= 1
        node = stack[height]
        limit = reach * r
        if node >= 0:
            o = node * NODE
            gx = vmax(vmax(load(nodes, o) - vx, vx - load(nodes, o + 3 * LANES)), zero)
            gy = vmax(vmax(load(nodes, o + LANES) - vy, vy - load(nodes, o + 4 * LANES)), zero)
            gz = vmax(vmax(load(nodes, o + 2 * LANES) - vz, vz - load(nodes, o + 5 * LANES)), zero)
            m = bits(fma(gx, gx, fma(gy, gy, gz * gz)) < splat(limit * limit))
            while m != 0:
                stack[height] = child[o + CHILDREN + trailing_zeros(m)]
                height += 1
                m &= m - 1
        else:
            o = ~node * LEAF
            ex, ey, ez = (
                load(spheres, o) - vx,
                load(spheres, o + LANES) - vy,
                load(spheres, o + 2 * LANES) - vz,
            )
            radius = vsqrt(vmax(load(spheres, o + 3 * LANES), zero))
            surface = vsqrt(fma(ex, ex, fma(ey, ey, ez * ez))) - radius
            m = bits((surface < splat(limit)) & (load(ids, o + IDS) != splat_int(skip)))
            if m == 0:
                continue
            store(lanes, 0, ex)
            store(lanes, LANES, ey)
            store(lanes, 2 * LANES, ez)
            store(lanes, 3 * LANES, radius)
            store(lanes, 4 * LANES, surface)
            while m != 0:
                k = trailing_zeros(m)
                m &= m - 1
                near.x[count] = lanes[k] * inverse
                near.y[count] = lanes[LANES + k] * inverse
                near.z[count] = lanes[2 * LANES + k] * inverse
                near.radius[count] = lanes[3 * LANES + k] * inverse
                near.surface[count] = lanes[4 * LANES + k] * inverse
                near.id[count] = ids[o + IDS + k]
                count += 1
            if count > _CAPACITY - LANES:
                reach = _shrink(near, count)
                count = _ENOUGH
    if count > _ENOUGH:
        reach = _shrink(near, count)
        count = _ENOUGH
    _sort(near, count)
    for k in range(count):
        x, y, z = np.float64(near.x[k]), np.float64(near.y[k]), np.float64(near.z[k])
        d = np.sqrt(x * x + y * y + z * z)
        near.far[k] = np.float32(d)
        near.power[k] = np.float32((d - near.radius[k]) * (d + near.radius[k]) + 1.0)
        if not _DWARF <= near.radius[k] <= GIANT:
            # Nearer than it is: rays test it with care, and in vain at worst.
            near.surface[k] = min(near.surface[k], _ONE)
    for k in range(count, (count + LANES - 1) // LANES * LANES):
        near.x[k] = near.y[k] = near.z[k] = near.far[k] = _ZERO
        near.radius[k] = -FAR
    return count, reach


@kernel
def _sort(near, count):
    """Sort by surface distance: each goes where as many are nearer, which no branch has to tell."""
    order, surface = near.chosen, near.surface
    store(surface, count, splat(FAR))
    for a in range(count):
        distance, place = splat(surface[a]), 0
        for k in range(0, count, LANES):
            before = (1 << min(max(a - k, 0), LANES)) - 1
            others = load(surface, k)
            place += popcount(bits(others < distance) | (bits(others <= distance) & before))
        order[place] = a
    # Written only afterwards, so there is room.
    spare = near.far
    _reorder(near.x, order, count, spare)
    _reorder(near.y, order, count, spare)
    _reorder(near.z, order, count, spare)
    _reorder(near.radius, order, count, spare)
    _reorder(near.surface, order, count, spare)
    for k in range(count):
        order[k] = near.id[index(order[k])]
    near.id[:count] = order[:count]


@kernel(inline=True)
def _reorder(values, order, count, spare):
    for k in range(count):
        spare[k] = values[index(order[k])]
    values[:count] = spare[:count]


@kernel(inline=True)
def patch_neighbours(near, count, nx, ny, nz, spread):
    """Choose the neighbours that rise above the horizon somewhere within chord `spread` of n; returns their number."""
    vx, vy, vz, vs = splat(nx), splat(ny), splat(nz), splat(spread)
    chosen = near.chosen
    found = 0
    for k in range(0, count, LANES):
        height = fma(load(near.x, k), vx, fma(load(near.y, k), vy, load(near.z, k) * vz))
        m = bits(fma(load(near.far, k), vs, height) + load(near.radius, k) > splat(_ONE))
        while m != 0:
            chosen[found] = k + trailing_zeros(m)
            found += 1
            m &= m - 1
    return found


@kernel(inline=True)
def _cross(near, j, ax, ay, az, dx, dy, dz, w):
    """Return (b, disc, inside power) of sixteen rays and neighbour j: they meet at b -+ sqrt(disc)."""
    ex, ey, ez = splat(near.x[j]), splat(near.y[j]), splat(near.z[j])
    b = fma(dx, ex, fma(dy, ey, fma(dz, ez, -w)))
    if near.radius[j] < _DWARF or near.radius[j] > GIANT:
        ex, ey, ez = ex - ax, ey - ay, ez - az
        px, py, pz = fnma(b, dx, ex), fnma(b, dy, ey), fnma(b, dz, ez)
        p = vsqrt(fma(px, px, fma(py, py, pz * pz)))
        far = vsqrt(fma(ex, ex, fma(ey, ey, ez * ez)))
        r = splat(near.radius[j])
        return b, (r - p) * (r + p), (far - r) * (far + r)
    q = fnma(splat(_TWO), fma(ax, ex, fma(ay, ey, az * ez)), splat(near.power[j]))
    return b, fma(b, b, -q), q


@kernel(inline=True)
def passes_by(b, disc, margin):
    """Whether rays that meet a sphere at b -+ sqrt(disc) do so nowhere, or leave it within `margin`; said without the root, which costs as much as all else."""
    short = margin - b
    return disc <= short * vmax(short, splat(_ZERO))


@kernel(inner=True)
def nearest(near, found, rays, first, blocks, out):
    """Nearest neighbour met by each ray of `blocks` blocks: writes near.hit_t (FAR for none, 0 for a start inside) and near.hit.

    `found` neighbours were chosen; blocks start at word `first` of `rays`; results start at ray `out`.
    """
    zero, exit_ = splat(_ZERO), splat(EXIT)
    for block in range(blocks):
        o = first + block * RAY
        ax, ay, az = load(rays, o), load(rays, o + LANES), load(rays, o + 2 * LANES)
        dx, dy, dz = load(rays, o + 3 * LANES), load(rays, o + 4 * LANES), load(rays, o + 5 * LANES)
        w = load(rays, o + 6 * LANES)
        t, hit = splat(FAR), splat_int(np.int32(-1))
        for k in range(found):
            j = index(near.chosen[k])
            if not any_lane(t >= splat(near.surface[j] - _ONE)):
                break
            b, disc, _ = _cross(near, j, ax, ay, az, dx, dy, dz, w)
            root = vsqrt(vmax(disc, zero))
            start = vmax(b - root, zero)
            hits = (disc >= zero) & (b + root > exit_ * near.radius[j]) & (start < t)
            t = select(hits, start, t)
            hit = select(hits, splat_int(np.int32(j)), hit)
        store(near.hit_t, out + block * LANES, t)
        store(near.hit, out + block * LANES, hit)


@kernel(inner=True)
def buried_starts(near, count, rays, first):
    """Which of sixteen rays start inside one of the first `count` neighbours, as bits."""
    ax, ay, az = load(rays, first), load(rays, first + LANES), load(rays, first + 2 * LANES)
    buried = 0
    for j in range(count):
        ex, ey, ez = splat(near.x[j]) - ax, splat(near.y[j]) - ay, splat(near.z[j]) - az
        buried |= bits(fma(ex, ex, fma(ey, ey, ez * ez)) < splat(near.radius[j] * near.radius[j]))
    return buried


@kernel(inner=True)
def unblocked(near, found, rays, first, open_):
    """Which of sixteen rays no chosen neighbour blocks: a subset of the bits `open_`."""
    zero, exit_ = splat(_ZERO), splat(EXIT)
    ax, ay, az = load(rays, first), load(rays, first + LANES), load(rays, first + 2 * LANES)
    dx, dy, dz = load(rays, first + 3 * LANES), load(rays, first + 4 * LANES), load(rays, first + 5 * LANES)
    w = load(rays, first + 6 * LANES)
    mx, my, mz = -_TWO * ax, -_TWO * ay, -_TWO * az
    still = mask_from_bits(open_)
    for k in range(found):
        j = index(near.chosen[k])
        # Blocked if b + sqrt(disc) > margin; said without the root.
        if near.surface[j] > _APART:
            ex, ey, ez = splat(near.x[j]), splat(near.y[j]), splat(near.z[j])
            b = fma(dx, ex, fma(dy, ey, fma(dz, ez, -w)))
            q = fma(mx, ex, fma(my, ey, fma(mz, ez, splat(near.power[j]))))
            still = still & (b * vmax(b, zero) <= q)
        else:
            b, disc, q = _cross(near, j, ax, ay, az, dx, dy, dz, w)
            margin = exit_ * near.radius[j]
            still = still & ((disc <= zero) | (vmax(b - margin, (b + b - margin) * margin - q) <= zero))
        if not any_lane(still):
            return 0
    return bits(still)
