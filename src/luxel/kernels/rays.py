"""The rays of one particle: near field first, the tree for what leaves it.

Rays stand in blocks of sixteen (see ``near.RAY``) and start at unit vectors; distances are in radii of the particle.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels.blockers import forget, ray_kind
from luxel.kernels.bundle import ROOM, first_met, line_of, meets, put, trace_bundle, whose
from luxel.kernels.jit import kernel
from luxel.kernels.light import area_light, escape_radiance, hidden_by_light, sun_luminance
from luxel.kernels.memory import index
from luxel.kernels.near import RAY, collect, nearest, unblocked
from luxel.kernels.periodic import HERE, LOST, follow, image_of, shadowed, surroundings
from luxel.kernels.rng import PURPOSE_TEXEL, path_key
from luxel.kernels.simd import FAR, LANES, store, trailing_zeros
from luxel.kernels.tree import MISS

__all__ = [
    "EVERY_RAY",
    "RayTable",
    "Site",
    "add_area_lights",
    "add_sunlight",
    "bring",
    "escaping",
    "first_hits",
    "hit_point",
    "hits_beyond",
    "neighbours",
    "pass_beyond",
    "put_rays",
    "ray_start",
    "ray_word",
    "set_of",
    "sky_along",
    "within_reach",
]

_ZERO, _ONE = np.float32(0), np.float32(1)
_ALL = (1 << LANES) - 1
_LAST_BIT = 63
#: Bits of rays, all of them wanted.
EVERY_RAY = np.int64(-1)
_NONE = np.int32(MISS)
_SKY = -_ONE  # what a ray is worth that brings what the sky shows where it goes, which is looked up only if nothing stops it
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
    k = index(k)
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
    forget(work.blockers)
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


@kernel(inline=True, borrows=True)
def _note_hit(world, near, site, k, t, particle, offset):
    """Note what ray k meets beyond the near ball, if anything."""
    if particle >= 0:
        near.hit_t[k], near.hit[k] = max(t, _TOUCHING) if site.reach > _ONE else t, particle
        _note_offset(world.cell, near, k, offset)
    elif particle == LOST and near.hit[k] < 0:
        near.hit[k] = particle


@kernel(borrows=True, inner=True)
def hits_beyond(world, work, near, site, bundle, listed):
    """Find out what those rays meet beyond the near ball that :func:`first_hits` has put into the bundle."""
    trace_bundle(world.tree, work, bundle, listed, False)
    for j in range(listed):
        s, particle = first_met(bundle, world.tree, j)
        k, start = whose(bundle, j)
        _note_hit(world, near, site, k, start + s / site.r, particle, HERE)


@kernel(inline=True, borrows=True)
def first_hits(world, work, near, found, site, rays, first, count, wanted, base, bundle, listed):
    """Nearest hits of `count` rays from word `first`, within ``world.reach`` at least, but for those that :func:`hits_beyond` has to be asked about.

    Writes, from ray `base` on, near.hit_t, 0 for a start inside a neighbour; near.hit: particle, MISS or LOST; near.offset. Only for rays whose
    bit of `wanted` is set; rays from the 64th on go by the last bit. `listed` rays are in the bundle already; returns how many then are.
    """
    begin, end = 0, (count + LANES - 1) // LANES
    while begin < end and wanted >> min(begin * LANES, _LAST_BIT) & _ALL == 0:
        begin += 1
    while begin < end and wanted >> min((end - 1) * LANES, _LAST_BIT) & _ALL == 0:
        end -= 1
    nearest(near, found, rays, first + begin * RAY, end - begin, base + begin * LANES)
    most = world.reach / site.r
    for s in range(count):
        if wanted >> min(s, _LAST_BIT) & 1 == 0:
            continue
        k = base + s
        t, hit = min(near.hit_t[k], most), near.hit[k]
        particle, offset = _NONE, HERE
        if hit >= 0:
            particle, offset = image_of(world.cell, world, site.sphere, near.id[index(hit)])
        near.hit[k] = particle
        _note_offset(world.cell, near, k, offset)
        o = index(first) + ray_word(s)
        start, px, py, pz = _leave(site, rays, o)
        if t <= start:
            continue
        limit = (t - start) * site.r if t < FAR else FAR
        dx, dy, dz = rays[o + 3 * LANES], rays[o + 4 * LANES], rays[o + 5 * LANES]
        if world.cell is None:
            if listed == ROOM:
                hits_beyond(world, work, near, site, bundle, listed)
                listed = 0
            put(bundle, listed, k, start, px, py, pz, dx, dy, dz, limit, site.sphere, MISS)
            listed += 1
        else:
            beyond, other, _, _, _, offset = follow(
                world.cell, world, work, px, py, pz, HERE, dx, dy, dz, limit, site.sphere
            )
            _note_hit(world, near, site, k, start + beyond / site.r, other, offset)
    return listed


@kernel(inline=True, borrows=True)
def within_reach(world, near, site, rays, first, count, hits, values, base):
    """Sky radiance for rays that meet nothing within ``world.reach``, else 0; -1 for starts inside a neighbour. Their hits are known, from `hits` on."""
    for s in range(count):
        t, hit = near.hit_t[hits + s], near.hit[hits + s]
        if hit == LOST or (hit >= 0 and t * site.r < world.reach):
            values[base + s] = -_ONE if t <= 0 else _ZERO
        else:
            values[base + s] = sky_along(world, site, rays, first + ray_word(s))


@kernel(inline=True, borrows=True)
def _put_beyond(bundle, listed, who, worth, site, rays, o):
    """Make ray `listed` of a bundle of one from where it leaves the near ball on, which anything may stop."""
    _, px, py, pz = _leave(site, rays, o)
    dx, dy, dz = rays[o + 3 * LANES], rays[o + 4 * LANES], rays[o + 5 * LANES]
    x, y, z = px - site.x, py - site.y, pz - site.z
    kind = ray_kind(x, y, z, max(site.reach, _ONE) * site.r, dx, dy, dz)
    put(bundle, listed, who, worth, px, py, pz, dx, dy, dz, FAR, site.sphere, kind)


@kernel(inline=True, borrows=True)
def _shadowed_beyond(world, work, site, rays, o):
    """Whether anything in a periodic cell stops a ray beyond the near ball."""
    _, px, py, pz = _leave(site, rays, o)
    dx, dy, dz = rays[o + 3 * LANES], rays[o + 4 * LANES], rays[o + 5 * LANES]
    return shadowed(world.cell, world, work, px, py, pz, dx, dy, dz, FAR, site.sphere)


@kernel(borrows=True)
def _take_stopped(world, work, bundle, listed, open_):
    """Of the rays that are open, take out those of a bundle that anything stops."""
    trace_bundle(world.tree, work, bundle, listed, True)
    for j in range(listed):
        if meets(bundle, j):
            k, _ = whose(bundle, j)
            open_[k // LANES] &= ~(np.int64(1) << np.int64(k % LANES))


@kernel(borrows=True, inner=True)
def pass_beyond(world, work, bundle, site, rays, open_):
    """Of the rays of blocks that are open, bits in `open_` (blocks,), keep those that nothing beyond the near ball stops."""
    listed = 0
    for block in range(open_.shape[0]):
        if listed + LANES > ROOM:
            _take_stopped(world, work, bundle, listed, open_)
            listed = 0
        left = open_[block]
        while left != 0:
            lane = trailing_zeros(left)
            left &= left - 1
            o = block * RAY + lane
            if world.cell is None:
                _put_beyond(bundle, listed, block * LANES + lane, _ZERO, site, rays, o)
                listed += 1
            elif _shadowed_beyond(world, work, site, rays, o):
                open_[block] &= ~(np.int64(1) << lane)
    _take_stopped(world, work, bundle, listed, open_)


@kernel(borrows=True, inner=True)
def bring(world, work, bundle, listed, values):
    """Add what those rays of a bundle are worth that nothing stops."""
    trace_bundle(world.tree, work, bundle, listed, True)
    for j in range(listed):
        if not meets(bundle, j):
            k, light = whose(bundle, j)
            if light < 0:
                x, y, z, dx, dy, dz = line_of(bundle, j)
                light = escape_radiance(world.lights, x, y, z, dx, dy, dz)
            values[k] += light


@kernel(inline=True, borrows=True)
def _add_unless_stopped(world, work, bundle, listed, site, rays, o, values, k, light):
    """Add the light that a ray brings if nothing beyond the near ball stops it, perhaps only when :func:`bring` is called."""
    if world.cell is None:
        _put_beyond(bundle, listed, k, light, site, rays, o)
        return listed + 1
    else:
        if not _shadowed_beyond(world, work, site, rays, o):
            values[k] += light
        return listed


@kernel(inline=True, borrows=True)
def escaping(world, work, near, found, site, rays, first, count, values, base, bundle, listed):
    """Sky radiance for rays that nothing stops, else 0; :func:`bring` adds what is not known yet.

    `listed` rays are in the bundle already; returns how many then are.
    """
    # Lamps may stand before the point where a ray enters the tree.
    alone = world.cell is None and world.lights.globes.shape[0] + world.lights.quads.shape[0] == 0
    for block in range((count + LANES - 1) // LANES):
        o = index(first) + block * RAY
        lanes = min(LANES, count - block * LANES)
        at = base + block * LANES
        values[at : at + lanes] = _ZERO
        if listed + LANES > ROOM:
            bring(world, work, bundle, listed, values)
            listed = 0
        open_ = unblocked(near, found, rays, o, (1 << lanes) - 1)
        while open_ != 0:
            lane = trailing_zeros(open_)
            open_ &= open_ - 1
            light = _SKY if alone else sky_along(world, site, rays, o + lane)
            listed = _add_unless_stopped(
                world, work, bundle, listed, site, rays, o + lane, values, at + lane, light
            )
    return listed


@kernel(borrows=True, inner=True)
def add_sunlight(world, work, near, found, site, sun, rays, first, count, values, base, bundle, listed):
    """Add sun `sun`'s light to values that are not negative, see :func:`escaping`; rays point towards its disc."""
    for block in range((count + LANES - 1) // LANES):
        o = index(first) + block * RAY
        at = base + block * LANES
        open_ = 0
        for lane in range(min(LANES, count - block * LANES)):
            if values[at + lane] >= 0 and rays[o + 6 * LANES + lane] > 0:
                open_ |= 1 << lane
        if open_ != 0:
            open_ = unblocked(near, found, rays, o, open_)
        if listed + LANES > ROOM:
            bring(world, work, bundle, listed, values)
            listed = 0
        while open_ != 0:
            lane = trailing_zeros(open_)
            open_ &= open_ - 1
            q = o + lane
            _, _, _, px, py, pz = ray_start(site, rays, q)
            dx, dy, dz = rays[q + 3 * LANES], rays[q + 4 * LANES], rays[q + 5 * LANES]
            if not hidden_by_light(world.lights, px, py, pz, dx, dy, dz, FAR):
                light = sun_luminance(world.lights, sun, rays[q + 6 * LANES])
                listed = _add_unless_stopped(
                    world, work, bundle, listed, site, rays, q, values, at + lane, light
                )
    return listed


@kernel(borrows=True, inner=True)
def add_area_lights(world, work, site, table, chosen_set, values):
    """Add area lights to those values that are not negative."""
    if world.lights.globes.shape[0] + world.lights.quads.shape[0] == 0:
        return
    for s in range(table.texel.shape[0]):
        if values[s] >= 0:
            state = path_key(world.seed, site.sphere, s, 1, PURPOSE_TEXEL)
            ax, ay, az, px, py, pz = ray_start(site, table.rays[chosen_set], ray_word(s))
            values[s] += area_light(world, work, True, px, py, pz, HERE, ax, ay, az, site.sphere, state)[0]
