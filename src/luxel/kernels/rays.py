"""The rays of one particle: near field first, the tree for what leaves it.

Rays stand in blocks of sixteen (see ``near.RAY``) and start at unit vectors; distances are in radii of the particle.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.light import area_light, escape_radiance, hidden_by_light, sun_luminance
from luxel.kernels.near import RAY, collect, nearest, unblocked
from luxel.kernels.periodic import HERE, LOST, follow, image_of, shadowed, surroundings
from luxel.kernels.rng import PURPOSE_TEXEL, path_key
from luxel.kernels.simd import FAR, LANES, store, trailing_zeros
from luxel.kernels.tree_trace import MISS, blocked

__all__ = [
    "EVERY_RAY",
    "RayTable",
    "Site",
    "add_area_lights",
    "add_sunlight",
    "escaping",
    "first_hits",
    "hit_point",
    "neighbours",
    "put_rays",
    "ray_kind",
    "ray_start",
    "ray_word",
    "set_of",
    "sky_along",
    "stopped",
    "within_reach",
]

_ZERO, _ONE = np.float32(0), np.float32(1)
_HALF_A_SIDE, _MIDDLE = np.float32(1.99), np.float32(4)  # of a cube of `BLOCKERS` cells
_ALL = (1 << LANES) - 1
_LAST_BIT = 63
#: Bits of rays, all of them wanted.
EVERY_RAY = np.int64(-1)
_NONE = np.int32(MISS)
_TOUCHING = np.float32(
    1e-6
)  # a hit beyond the near ball is no start inside a neighbour, whatever rounding says


class RayTable(NamedTuple):
    """Ray sets that particles share, in blocks of sixteen rays; see ``light.ray_sets``."""

    rays: np.ndarray  # (sets, blocks * RAY) float32
    texel: np.ndarray  # (blocks * 16,) int32: the texel of each ray, -1 for padding
    patches: np.ndarray  # (patches, 4) float32: middle of the starts of a patch and the largest chord from it
    width: int  # blocks a patch


class Site(NamedTuple):
    """A particle whose rays are followed; `reach` bounds its near field, see ``near.collect``."""

    sphere: np.int32
    x: np.float32
    y: np.float32
    z: np.float32
    r: np.float32
    reach: np.float32


@kernel(inline=True, borrows=True)
def set_of(world, particle, sets):
    """Which of the shared ray sets a particle uses."""
    return int(path_key(world.seed, particle, 0, 0, PURPOSE_TEXEL) >> np.uint64(33)) % sets


@kernel(inline=True, borrows=True)
def put_rays(rays, o, ax, ay, az, direction):
    """Write a block of sixteen rays at word `o`."""
    dx, dy, dz = direction
    store(rays, o, ax)
    store(rays, o + LANES, ay)
    store(rays, o + 2 * LANES, az)
    store(rays, o + 3 * LANES, dx)
    store(rays, o + 4 * LANES, dy)
    store(rays, o + 5 * LANES, dz)
    store(rays, o + 6 * LANES, ax * dx + ay * dy + az * dz)


@kernel(inline=True, borrows=True)
def ray_word(k):
    """First word of ray k."""
    return (k // LANES) * RAY + k % LANES


@kernel(inline=True, borrows=True)
def ray_start(site, rays, o):
    """Normal and point where a ray starts."""
    ax, ay, az = rays[o], rays[o + LANES], rays[o + 2 * LANES]
    return ax, ay, az, site.x + site.r * ax, site.y + site.r * ay, site.z + site.r * az


@kernel(inline=True, borrows=True)
def sky_along(world, site, rays, o):
    """What an unblocked ray sees."""
    _, _, _, px, py, pz = ray_start(site, rays, o)
    return escape_radiance(
        world.lights, px, py, pz, rays[o + 3 * LANES], rays[o + 4 * LANES], rays[o + 5 * LANES]
    )


@kernel(borrows=True, inner=True)
def neighbours(world, work, near, particle):
    """Collect the neighbours of a particle, images among them; returns (count, reach), see ``near.collect``."""
    # What was in the way of others must not tell: boxes that a ray just grazes round one way, the spheres in them the other.
    work.blockers[:] = MISS
    tree, x, y, z, complete = surroundings(world.cell, world, particle)
    r = world.radii[particle]
    count, reach = collect(tree, work, near, x, y, z, r, particle)
    return count, min(reach, complete / r)


@kernel(inline=True, borrows=True)
def _leave(site, rays, o):
    """Distance at which a ray leaves the near ball, and the point there."""
    w = rays[o + 6 * LANES]
    reach = site.reach
    start = np.sqrt(max(_ZERO, w * w + reach * reach - _ONE)) - w if reach > _ONE else _ZERO
    px = site.x + site.r * (rays[o] + start * rays[o + 3 * LANES])
    py = site.y + site.r * (rays[o + LANES] + start * rays[o + 4 * LANES])
    pz = site.z + site.r * (rays[o + 2 * LANES] + start * rays[o + 5 * LANES])
    return start, px, py, pz


@kernel(inline=True, borrows=True)
def _beyond(world, work, site, rays, o, t):
    """Follow a ray from where it leaves the near ball up to distance t; returns (distance, particle, offset)."""
    start, px, py, pz = _leave(site, rays, o)
    if t <= start:
        return t, _NONE, HERE
    limit = (t - start) * site.r if t < FAR else FAR
    s, hit, _, _, _, offset = follow(
        world.cell, world, work, px, py, pz, HERE, rays[o + 3 * LANES], rays[o + 4 * LANES], rays[o + 5 * LANES],
        limit, site.sphere,
    )  # fmt: skip
    return start + s / site.r, hit, offset


@kernel(inline=True, borrows=True)
def stopped(world, work, site, rays, o):
    """Whether anything stops a ray beyond the near ball."""
    _, px, py, pz = _leave(site, rays, o)
    dx, dy, dz = rays[o + 3 * LANES], rays[o + 4 * LANES], rays[o + 5 * LANES]
    if world.cell is not None:
        return shadowed(world.cell, world, work, px, py, pz, dx, dy, dz, FAR, site.sphere)
    else:
        kind = ray_kind(px - site.x, py - site.y, pz - site.z, max(site.reach, _ONE) * site.r, dx, dy, dz)
        return blocked(world.tree, work, px, py, pz, dx, dy, dz, site.sphere, kind)


@kernel(inline=True, borrows=True)
def ray_kind(x, y, z, reach, dx, dy, dz):
    """Tell rays apart by their directions and by where within `reach` of the origin they leave: one of ``tree_trace.BLOCKERS``."""
    scale = _HALF_A_SIDE / reach
    a = int(scale * x + _HALF_A_SIDE * dx + _MIDDLE)
    b = int(scale * y + _HALF_A_SIDE * dy + _MIDDLE)
    c = int(scale * z + _HALF_A_SIDE * dz + _MIDDLE)
    return ((a & 7) << 6) | ((b & 7) << 3) | (c & 7)


@kernel(inline=True, borrows=True)
def _note_offset(cell, near, k, offset):
    if cell is not None:
        near.offset[k, 0], near.offset[k, 1], near.offset[k, 2] = offset


@kernel(inline=True, borrows=True)
def hit_point(cell, near, k, px, py, pz):
    """Move the point that ray k hits to the particle where the file has it; returns it and the offset back."""
    if cell is None:
        return px, py, pz, HERE
    else:
        x, y, z = near.offset[k, 0], near.offset[k, 1], near.offset[k, 2]
        return px - x, py - y, pz - z, (x, y, z)


@kernel(borrows=True, inner=True)
def first_hits(world, work, near, found, site, rays, first, count, wanted):
    """Nearest hits of `count` rays from word `first`, within ``world.reach`` at least.

    Writes near.hit_t, 0 for a start inside a neighbour; near.hit: particle, MISS or LOST; near.offset. Only for rays whose
    bit of `wanted` is set; rays from the 64th on go by the last bit.
    """
    begin, end = 0, (count + LANES - 1) // LANES
    while begin < end and wanted >> min(begin * LANES, _LAST_BIT) & _ALL == 0:
        begin += 1
    while begin < end and wanted >> min((end - 1) * LANES, _LAST_BIT) & _ALL == 0:
        end -= 1
    nearest(near, found, rays, first + begin * RAY, end - begin, begin * LANES)
    most = world.reach / site.r
    for k in range(count):
        if wanted >> min(k, _LAST_BIT) & 1 == 0:
            continue
        t, hit = near.hit_t[k], near.hit[k]
        particle, offset = _NONE, HERE
        if hit >= 0:
            particle, offset = image_of(world.cell, world, site.sphere, near.id[hit])
        beyond, other, other_offset = _beyond(world, work, site, rays, first + ray_word(k), min(t, most))
        if other >= 0:
            t = max(beyond, _TOUCHING) if site.reach > _ONE else beyond
            particle, offset = other, other_offset
        elif other == LOST and hit < 0:
            particle = other
        near.hit_t[k], near.hit[k] = t, particle
        _note_offset(world.cell, near, k, offset)


@kernel(borrows=True, inner=True)
def within_reach(world, work, near, found, site, rays, first, count, values, base):
    """Sky radiance for rays that nothing stops within ``world.reach``, else 0; -1 for starts inside a neighbour."""
    first_hits(world, work, near, found, site, rays, first, count, EVERY_RAY)
    for k in range(count):
        t = near.hit_t[k]
        if near.hit[k] == LOST or (near.hit[k] >= 0 and t * site.r < world.reach):
            values[base + k] = -_ONE if t <= 0 else _ZERO
        else:
            values[base + k] = sky_along(world, site, rays, first + ray_word(k))


@kernel(borrows=True, inner=True)
def escaping(world, work, near, found, site, rays, first, count, values, base):
    """Sky radiance for rays that nothing stops, else 0."""
    for block in range((count + LANES - 1) // LANES):
        o = first + block * RAY
        lanes = min(LANES, count - block * LANES)
        at = base + block * LANES
        values[at : at + lanes] = _ZERO
        open_ = unblocked(near, found, rays, o, (1 << lanes) - 1)
        while open_ != 0:
            lane = trailing_zeros(open_)
            open_ &= open_ - 1
            if not stopped(world, work, site, rays, o + lane):
                values[at + lane] = sky_along(world, site, rays, o + lane)


@kernel(borrows=True, inner=True)
def add_sunlight(world, work, near, found, site, sun, rays, first, count, values, base):
    """Add sun `sun`'s light to values that are not negative; rays point towards its disc."""
    for block in range((count + LANES - 1) // LANES):
        o = first + block * RAY
        at = base + block * LANES
        open_ = 0
        for lane in range(min(LANES, count - block * LANES)):
            if values[at + lane] >= 0 and rays[o + 6 * LANES + lane] > 0:
                open_ |= 1 << lane
        if open_ != 0:
            open_ = unblocked(near, found, rays, o, open_)
        while open_ != 0:
            lane = trailing_zeros(open_)
            open_ &= open_ - 1
            q = o + lane
            if stopped(world, work, site, rays, q):
                continue
            _, _, _, px, py, pz = ray_start(site, rays, q)
            dx, dy, dz = rays[q + 3 * LANES], rays[q + 4 * LANES], rays[q + 5 * LANES]
            if not hidden_by_light(world.lights, px, py, pz, dx, dy, dz, FAR):
                values[at + lane] += sun_luminance(world.lights, sun, rays[q + 6 * LANES])


@kernel(borrows=True, inner=True)
def add_area_lights(world, work, site, table, chosen_set, block, count, values):
    """Add area lights to those of `count` values from `block` on that are not negative."""
    if world.lights.globes.shape[0] + world.lights.quads.shape[0] == 0:
        return
    for s in range(block * LANES, block * LANES + count):
        if values[s] >= 0:
            state = path_key(world.seed, site.sphere, s, 1, PURPOSE_TEXEL)
            ax, ay, az, px, py, pz = ray_start(site, table.rays[chosen_set], ray_word(s))
            values[s] += area_light(world, work, True, px, py, pz, HERE, ax, ay, az, site.sphere, state)[0]
