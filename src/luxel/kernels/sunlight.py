"""Sunlight on the texels of one particle: rays through its near field, then against what stands in its beam.

Towards the sun all rays of a particle run almost side by side. The spheres that any of them could meet are few, and
found by one descent of the tree; so many more rays can be afforded than for light from all around.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels.bundle import Bundle, bundle_scratch
from luxel.kernels.jit import kernel
from luxel.kernels.light import hidden_by_light, sun_luminance
from luxel.kernels.memory import float_lines, index
from luxel.kernels.near import RAY, Near, buried_starts, near_scratch, unblocked
from luxel.kernels.rays import pass_beyond, ray_start, set_of
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

__all__ = ["SunScratch", "SunTable", "sun_scratch", "sunlight"]

_ZERO, _HALF, _ONE = np.float32(0), np.float32(0.5), np.float32(1)
# A beam is looked through part by part, since in dense matter none of it leaves the first: up to so many radii, then three times as far.
_FIRST_PART, _LAST_PART, _LONGER = np.float32(10), np.float32(200), np.float32(3)
_MOST = 128  # spheres of a part that are listed; where there are more, rays that none of these blocks go through the tree one by one
_WIDEST = np.float32(0.5)  # sine of half the angular diameter of suns that have beams
_ALL = (1 << LANES) - 1
_CLOSED = -1
_SURE = np.float32(0.999)  # of a radius: what stops every ray by more than rounding


class SunTable(NamedTuple):
    """Ray sets towards the suns, as ``rays.RayTable``."""

    rays: np.ndarray  # (suns, sets, blocks * RAY) float32
    texel: np.ndarray  # (blocks * 16,) int32: the texel of each ray, -1 for padding
    patches: np.ndarray  # (patches, 4) float32
    width: int
    whole: bool  # the sixteen rays of a block start from one texel


class SunScratch(NamedTuple):
    """Working memory of one thread."""

    beam: Near
    bundle: Bundle
    open_: np.ndarray  # (blocks,) int64: rays of each block that nothing near blocks
    seen: np.ndarray  # (blocks,) int64: rays whose start is not buried
    cosine: np.ndarray  # (16,) float32


@kernel(inner=True)
def sun_scratch(tree, table):
    """Allocate for the rays of a table."""
    blocks = table.texel.shape[0] // LANES
    return SunScratch(
        near_scratch(LANES),
        bundle_scratch(tree),
        np.zeros(blocks, np.int64),
        np.zeros(blocks, np.int64),
        float_lines(LANES),
    )


@kernel(borrows=True)
def _in_beam(spheres, count, patch, sx, sy, sz, slope):
    """Choose the spheres that rays from a patch towards a disc around s might meet; returns their number, -1 if one of them stops all."""
    px, py, pz, spread = splat(patch[0]), splat(patch[1]), splat(patch[2]), splat(patch[3])
    zero, steep, sure = splat(_ZERO), splat(slope), splat(_SURE)
    chosen = spheres.chosen
    found = 0
    for k in range(0, count, LANES):
        ex, ey, ez = load(spheres.x, k) - px, load(spheres.y, k) - py, load(spheres.z, k) - pz
        h = fma(ex, splat(sx), fma(ey, splat(sy), ez * splat(sz)))
        qx, qy, qz = fnma(h, splat(sx), ex), fnma(h, splat(sy), ey), fnma(h, splat(sz), ez)
        aside = vsqrt(fma(qx, qx, fma(qy, qy, qz * qz)))
        radius = load(spheres.radius, k)
        wide = spread + vmax(h + radius + spread, zero) * steep
        m = bits((aside < radius + wide) & (h + radius + spread > zero))
        if m == 0:
            continue
        aside = aside + spread
        if any_lane((fma(h + spread, steep, aside) < radius * sure) & (h - spread > aside * steep)):
            return _CLOSED
        while m != 0:
            chosen[found] = k + trailing_zeros(m)
            found += 1
            m &= m - 1
    return found


@kernel(borrows=True)
def _collect_beam(tree, work, beam, site, sx, sy, sz, sine, cosine, low, high):
    """Find spheres beyond the near ball that rays towards a disc around s might meet; returns their number, and whether these are all.

    The beam is a cone with the particle as its base; only centres from `low` up to `high` along its axis count. Lengths, in `beam` too,
    are in radii of the particle.
    """
    nodes, child, spheres, ids = tree.nodes, tree.child, tree.spheres, tree.ids
    stack, lanes = work.node, work.lanes
    zero, half, r = splat(_ZERO), splat(_HALF), splat(site.r)
    vx, vy, vz = splat(site.x), splat(site.y), splat(site.z)
    slope = splat(sine / cosine)
    inverse = _ONE / site.r
    reach = splat(site.reach * site.r)
    begin, end = splat(low * site.r), splat(high * site.r)
    count, all_ = 0, True
    stack[0] = 0
    height = 1
    while height > 0 and all_:
        height -= 1
        node = stack[height]
        if node >= 0:
            o = node * NODE
            lx, ly, lz = load(nodes, o), load(nodes, o + LANES), load(nodes, o + 2 * LANES)
            hx, hy, hz = load(nodes, o + 3 * LANES), load(nodes, o + 4 * LANES), load(nodes, o + 5 * LANES)
            ex, ey, ez = (lx + hx) * half - vx, (ly + hy) * half - vy, (lz + hz) * half - vz
            gx, gy, gz = hx - lx, hy - ly, hz - lz
            size = vsqrt(fma(gx, gx, fma(gy, gy, gz * gz))) * half
            exists = hx >= lx
        else:
            o = ~node * LEAF
            ex, ey, ez = (
                load(spheres, o) - vx,
                load(spheres, o + LANES) - vy,
                load(spheres, o + 2 * LANES) - vz,
            )
            size = vsqrt(vmax(load(spheres, o + 3 * LANES), zero))
            surface = vsqrt(fma(ex, ex, fma(ey, ey, ez * ez))) - size
            exists = (surface >= reach) & (load(ids, o + IDS) != splat_int(site.sphere))
            exists = exists & (load(spheres, o + 3 * LANES) > zero)
        h = fma(ex, splat(sx), fma(ey, splat(sy), ez * splat(sz)))
        px, py, pz = fnma(h, splat(sx), ex), fnma(h, splat(sy), ey), fnma(h, splat(sz), ez)
        aside = vsqrt(fma(px, px, fma(py, py, pz * pz)))
        inside = (aside - r - vmax(h, zero) * slope) * splat(cosine) < size
        exists = exists & inside & (h + size > -r)
        if node >= 0:
            m = bits(exists & (h + size >= begin) & (h - size < end))
            while m != 0:
                stack[height] = child[o + CHILDREN + trailing_zeros(m)]
                height += 1
                m &= m - 1
            continue
        m = bits(exists & (h >= begin) & (h < end))
        if m == 0:
            continue
        store(lanes, 0, ex)
        store(lanes, LANES, ey)
        store(lanes, 2 * LANES, ez)
        store(lanes, 3 * LANES, size)
        if count + popcount(m) > _MOST:
            all_ = False
            continue
        while m != 0:
            k = trailing_zeros(m)
            m &= m - 1
            beam.x[count] = lanes[k] * inverse
            beam.y[count] = lanes[LANES + k] * inverse
            beam.z[count] = lanes[2 * LANES + k] * inverse
            beam.radius[count] = lanes[3 * LANES + k] * inverse
            count += 1
    for k in range(count, (count + LANES - 1) // LANES * LANES):
        beam.x[k] = beam.y[k] = beam.z[k] = _ZERO
        beam.radius[k] = -FAR
    return count, all_


@kernel(borrows=True)
def _clear_of(beam, found, rays, first, open_):
    """Which of sixteen rays no chosen sphere of the beam blocks: a subset of the bits `open_`."""
    zero = splat(_ZERO)
    ax, ay, az = load(rays, first), load(rays, first + LANES), load(rays, first + 2 * LANES)
    dx, dy, dz = load(rays, first + 3 * LANES), load(rays, first + 4 * LANES), load(rays, first + 5 * LANES)
    still = mask_from_bits(open_)
    for k in range(found):
        j = index(beam.chosen[k])
        ex, ey, ez = splat(beam.x[j]) - ax, splat(beam.y[j]) - ay, splat(beam.z[j]) - az
        b = fma(dx, ex, fma(dy, ey, dz * ez))
        px, py, pz = fnma(b, dx, ex), fnma(b, dy, ey), fnma(b, dz, ez)
        radius = splat(beam.radius[j])
        outside = fma(px, px, fma(py, py, pz * pz)) >= radius * radius
        still = still & (outside | (b <= zero))
        if not any_lane(still):
            return 0
    return bits(still)


@kernel(borrows=True)
def _wanted_lanes(table, block, wanted):
    """Bits of the rays of a block that start from texels that are wanted."""
    o = block * LANES
    if table.whole:
        return _ALL if wanted[table.texel[o]] != 0 else 0
    found = 0
    for lane in range(LANES):
        texel = table.texel[o + lane]
        if texel >= 0 and wanted[texel] != 0:
            found |= 1 << lane
    return found


@kernel(borrows=True)
def _leave_near_field(near, known, rays, table, s, wanted, scratch):
    """Mark the rays towards sun `s` from wanted texels that leave the near field; returns how many do."""
    overlapping = 0
    while overlapping < known and near.surface[overlapping] < _ONE:
        overlapping += 1
    slope = s[4] / s[5]
    leaving = 0
    blocks = table.texel.shape[0] // LANES
    for patch in range(table.patches.shape[0]):
        p = table.patches[patch]
        first, last = patch * table.width, min((patch + 1) * table.width, blocks)
        some = 0
        for block in range(first, last):
            scratch.seen[block] = _wanted_lanes(table, block, wanted)
            scratch.open_[block] = 0
            some |= scratch.seen[block]
        if some == 0:
            continue
        away = p[0] * s[0] + p[1] * s[1] + p[2] * s[2] + p[3] + s[4] <= 0
        found = 0
        if not away:
            found = _in_beam(near, known, p, s[0], s[1], s[2], slope)
        for block in range(first, last):
            o = block * RAY
            seen, open_ = scratch.seen[block], 0
            if overlapping > 0:
                seen &= ~buried_starts(near, overlapping, rays, o)
            if not away:
                if found != _CLOSED:
                    open_ = seen & bits(load(rays, o + 6 * LANES) > splat(_ZERO))
                if open_ != 0 and found > 0:
                    open_ = unblocked(near, found, rays, o, open_)
            scratch.seen[block], scratch.open_[block] = seen, open_
            leaving += popcount(open_)
    return leaving


@kernel(borrows=True)
def _pass_spheres(beam, listed, rays, table, s, scratch):
    """Of the rays that are open, keep those that no listed sphere blocks; returns whether there are any."""
    any_open = False
    for patch in range(table.patches.shape[0]):
        first = patch * table.width
        last = min(first + table.width, table.texel.shape[0] // LANES)
        leaving = 0
        for block in range(first, last):
            leaving |= scratch.open_[block]
        if leaving == 0:
            continue
        found = _in_beam(beam, listed, table.patches[patch], s[0], s[1], s[2], s[4] / s[5])
        for block in range(first, last):
            open_ = scratch.open_[block]
            if found == _CLOSED:
                open_ = 0
            elif found > 0 and open_ != 0:
                open_ = _clear_of(beam, found, rays, block * RAY, open_)
            scratch.open_[block] = open_
            any_open |= open_ != 0
    return any_open


@kernel(borrows=True)
def _leave_beam(world, work, site, rays, table, s, scratch):
    """Of the rays that leave the near field, keep those that nothing beyond blocks either."""
    if world.cell is None and s[4] < _WIDEST:
        low, high = -FAR, _FIRST_PART
        while True:
            listed, all_ = _collect_beam(
                world.tree, work, scratch.beam, site, s[0], s[1], s[2], s[4], s[5], low, high
            )
            if listed > 0 and not _pass_spheres(scratch.beam, listed, rays, table, s, scratch):
                return
            if not all_:
                break
            if high == FAR:
                return
            low = high
            high = high * _LONGER if high < _LAST_PART else FAR
    pass_beyond(world, work, scratch.bundle, site, rays, scratch.open_)


@kernel(borrows=True)
def _hide_by_lights(world, site, rays, table, scratch):
    """Take away the rays before which an area light stands."""
    for block in range(table.texel.shape[0] // LANES):
        open_ = scratch.open_[block]
        while open_ != 0:
            lane = trailing_zeros(open_)
            open_ &= open_ - 1
            q = block * RAY + lane
            _, _, _, px, py, pz = ray_start(site, rays, q)
            dx, dy, dz = rays[q + 3 * LANES], rays[q + 4 * LANES], rays[q + 5 * LANES]
            if hidden_by_light(world.lights, px, py, pz, dx, dy, dz, FAR):
                scratch.open_[block] &= ~(1 << lane)


@kernel(borrows=True)
def _gather_block(world, sun, rays, table, block, scratch, light, light2):
    """Add the light of a block's open rays to their texels."""
    open_, o = scratch.open_[block], block * RAY
    if table.whole:
        scale = sun_luminance(world.lights, sun, _ONE)
        w = select(mask_from_bits(open_), load(rays, o + 6 * LANES), splat(_ZERO))
        store(scratch.cosine, 0, w)
        total = total2 = _ZERO
        for lane in range(LANES):
            value = scratch.cosine[lane]
            total += value
            total2 += value * value
        texel = table.texel[block * LANES]
        light[texel] += scale * total
        light2[texel] += scale * scale * total2
        return
    while open_ != 0:
        lane = trailing_zeros(open_)
        open_ &= open_ - 1
        texel = table.texel[block * LANES + lane]
        if texel >= 0:
            value = sun_luminance(world.lights, sun, rays[o + 6 * LANES + lane])
            light[texel] += value
            light2[texel] += value * value


@kernel(borrows=True, inner=True)
def sunlight(world, work, near, known, site, table, wanted, scratch, light, light2, seen):
    """Estimate sunlight on the texels of a particle whose `wanted` (T·T,) is not 0.

    Adds up, over samples that are not buried, their luminance in `light` and its square in `light2` (T·T,), summed over
    suns, and counts them in `seen`.
    """
    sets = table.rays.shape[1]
    blocks = table.texel.shape[0] // LANES
    for sun in range(table.rays.shape[0]):
        rays = table.rays[sun, set_of(world, site.sphere, sets)]
        s = world.lights.suns[sun]
        if _leave_near_field(near, known, rays, table, s, wanted, scratch) > 0:
            _leave_beam(world, work, site, rays, table, s, scratch)
            if world.lights.globes.shape[0] + world.lights.quads.shape[0] > 0:
                _hide_by_lights(world, site, rays, table, scratch)
            for block in range(blocks):
                if scratch.open_[block] != 0:
                    _gather_block(world, sun, rays, table, block, scratch, light, light2)
        if sun > 0:
            continue  # all suns' rays have the same starts
        for block in range(blocks):
            counted = scratch.seen[block]
            if table.whole:
                seen[table.texel[block * LANES]] += popcount(counted)
                continue
            for lane in range(LANES):
                texel = table.texel[block * LANES + lane]
                if texel >= 0 and counted >> lane & 1:
                    seen[texel] += 1
