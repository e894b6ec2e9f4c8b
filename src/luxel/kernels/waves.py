"""All paths that leave one particle, bounce by bounce together: sixteen at a time against its near field.

Most paths bounce on among the particle's neighbours. Their rays start all over the near ball, so that no neighbour can
be ruled out beforehand; but sixteen rays against all of them still cost less than one goes through the tree.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels.blockers import ray_kind
from luxel.kernels.bundle import (
    ROOM,
    Bundle,
    bundle_scratch,
    first_met,
    line_of,
    put,
    trace_bundle,
    whose,
)
from luxel.kernels.jit import kernel
from luxel.kernels.light import area_light, escape_radiance, hidden_by_light, sun_luminance
from luxel.kernels.memory import float_lines, index, int_lines
from luxel.kernels.near import EXIT, GIANT, passes_by
from luxel.kernels.path import path_tail, survival
from luxel.kernels.periodic import HERE
from luxel.kernels.rays import bring
from luxel.kernels.rng import next_state, uniforms
from luxel.kernels.simd import (
    FAR,
    LANES,
    any_lane,
    bits,
    fma,
    fnma,
    load,
    mask_from_bits,
    select,
    splat,
    splat_int,
    store,
    trailing_zeros,
    vmax,
    vsqrt,
)
from luxel.kernels.tree import MISS
from luxel.kernels.warp import cone_directions, cosine_directions

__all__ = ["Waves", "add_path", "follow_paths", "wave_scratch"]

_ZERO, _ONE = np.float32(0), np.float32(1)


class Waves(NamedTuple):
    """Paths of one particle under way, and a block of sixteen of their rays; working memory of one thread."""

    ray: np.ndarray  # (n,) int32: where the light of a path goes
    sphere: np.ndarray  # (n,) int32 it was reflected by last
    point: np.ndarray  # (n, 3) float32 where
    weight: np.ndarray  # (n,) float32
    light: np.ndarray  # (n,) float32 found so far
    state: np.ndarray  # (n + 16,) uint64 of its random numbers
    offset: np.ndarray  # (n, 3) float32, see ``periodic.follow``; in periodic cells only
    start: np.ndarray  # (3 * 16,) float32, in radii of the particle from its centre
    direction: np.ndarray  # (3 * 16,) float32
    skip: np.ndarray  # (16,) int32 spheres that rays leave
    t: np.ndarray  # (16,) float32 distance in radii
    hit: np.ndarray  # (16,) int32 index of a neighbour, -1 for none, _SELF
    normal: np.ndarray  # (3 * 16,) float32
    center: (
        np.ndarray
    )  # (4 * 16,) float32 x, y, z, r of the spheres that rays leave; then the points where they do
    random: np.ndarray  # (16,) float32
    exit: (
        np.ndarray
    )  # (16,) float32 distance in radii at which rays leave the near ball, negative if they start outside
    direct: np.ndarray  # (n,) float32 direct light at the point of a path
    next_point: np.ndarray  # (3, n + 16) float32 where paths meet something
    next_sphere: np.ndarray  # (n,) int32 what: a particle, MISS for the sky, or _BURIED
    beyond: Bundle  # rays of paths that leave the near ball
    shadow: Bundle  # those towards a sun


_SELF = np.int32(-2)
_BURIED = np.int32(-3)  # rounding can bury a point where spheres meet: its path ends without its light


@kernel(inner=True)
def wave_scratch(tree, paths):
    """Allocate for at most `paths` paths."""
    return Waves(
        np.zeros(paths, np.int32), np.zeros(paths, np.int32), np.zeros((paths, 3), np.float32),
        np.zeros(paths, np.float32), np.zeros(paths, np.float32), np.zeros(paths + LANES, np.uint64),
        np.zeros((paths, 3), np.float32), float_lines(3 * LANES), float_lines(3 * LANES),
        int_lines(LANES), float_lines(LANES), int_lines(LANES),
        float_lines(3 * LANES), float_lines(4 * LANES), float_lines(LANES),
        float_lines(LANES), np.zeros(paths, np.float32), np.zeros((3, paths + LANES), np.float32),
        np.zeros(paths, np.int32), bundle_scratch(tree), bundle_scratch(tree),
    )  # fmt: skip


@kernel(inline=True, borrows=True)
def add_path(cell, waves, k, ray, sphere, x, y, z, offset, state):
    """Path k has met a sphere at (x, y, z); its light will be added to that of ray `ray`."""
    waves.ray[k], waves.sphere[k], waves.state[k] = ray, sphere, state
    waves.point[k, 0], waves.point[k, 1], waves.point[k, 2] = x, y, z
    waves.weight[k], waves.light[k] = _ONE, _ZERO
    if cell is not None:
        waves.offset[k, 0], waves.offset[k, 1], waves.offset[k, 2] = offset


@kernel(inline=True, borrows=True)
def _meet(ex, ey, ez, dx, dy, dz, radius):
    """Return (b, disc): rays meet a sphere whose centre lies at e from their starts at b -+ sqrt(disc)."""
    b = fma(dx, ex, fma(dy, ey, dz * ez))
    px, py, pz = fnma(b, dx, ex), fnma(b, dy, ey), fnma(b, dz, ez)
    p2 = fma(px, px, fma(py, py, pz * pz))
    r = splat(radius)
    if radius > GIANT:
        p = vsqrt(p2)
        return b, (r - p) * (r + p)
    return b, fma(r, r, -p2)


@kernel(inline=True, borrows=True)
def _nearest(near, known, self_, waves):
    """Nearest sphere of the near field, the particle itself among them, that each of sixteen rays meets."""
    zero, exit_ = splat(_ZERO), splat(EXIT)
    ax, ay, az = load(waves.start, 0), load(waves.start, LANES), load(waves.start, 2 * LANES)
    dx, dy, dz = load(waves.direction, 0), load(waves.direction, LANES), load(waves.direction, 2 * LANES)
    skip = load(waves.skip, 0)
    far = vsqrt(fma(ax, ax, fma(ay, ay, az * az)))
    b, disc = _meet(-ax, -ay, -az, dx, dy, dz, _ONE)
    root = vsqrt(vmax(disc, zero))
    hits = (disc >= zero) & (b + root > exit_) & (skip != splat_int(self_))
    t = select(hits, vmax(b - root, zero), splat(FAR))
    hit = select(hits, splat_int(_SELF), splat_int(np.int32(-1)))
    for j in range(known):
        if not any_lane(t + far >= splat(near.surface[j])):
            break
        b, disc = _meet(
            splat(near.x[j]) - ax, splat(near.y[j]) - ay, splat(near.z[j]) - az, dx, dy, dz, near.radius[j]
        )
        root = vsqrt(vmax(disc, zero))
        start = vmax(b - root, zero)
        hits = (
            (disc >= zero)
            & (skip != splat_int(near.id[j]))
            & (b + root > exit_ * near.radius[j])
            & (start < t)
        )
        t = select(hits, start, t)
        hit = select(hits, splat_int(np.int32(j)), hit)
    store(waves.t, 0, t)
    store(waves.hit, 0, hit)


@kernel(inline=True, borrows=True)
def _unblocked(near, known, self_, waves, open_):
    """Which of sixteen rays nothing in the near field blocks: a subset of the bits `open_`."""
    exit_ = splat(EXIT)
    ax, ay, az = load(waves.start, 0), load(waves.start, LANES), load(waves.start, 2 * LANES)
    dx, dy, dz = load(waves.direction, 0), load(waves.direction, LANES), load(waves.direction, 2 * LANES)
    skip = load(waves.skip, 0)
    b, disc = _meet(-ax, -ay, -az, dx, dy, dz, _ONE)
    still = mask_from_bits(open_) & (passes_by(b, disc, exit_) | (skip == splat_int(self_)))
    for j in range(known):
        if not any_lane(still):
            return 0
        b, disc = _meet(
            splat(near.x[j]) - ax, splat(near.y[j]) - ay, splat(near.z[j]) - az, dx, dy, dz, near.radius[j]
        )
        still = still & (passes_by(b, disc, exit_ * near.radius[j]) | (skip == splat_int(near.id[j])))
    return bits(still)


@kernel(inline=True, borrows=True)
def _exits_of_ball(waves, reach):
    """Note where sixteen rays leave the near ball; return them."""
    ax, ay, az = load(waves.start, 0), load(waves.start, LANES), load(waves.start, 2 * LANES)
    dx, dy, dz = load(waves.direction, 0), load(waves.direction, LANES), load(waves.direction, 2 * LANES)
    w = fma(ax, dx, fma(ay, dy, az * dz))
    inside = splat(reach * reach) - fma(ax, ax, fma(ay, ay, az * az))
    zero = splat(_ZERO)
    found = select(inside > zero, vsqrt(fma(w, w, vmax(inside, zero))) - w, splat(-_ONE))
    store(waves.exit, 0, found)
    return found


@kernel(borrows=True)
def _meet_beyond(world, work, waves, listed):
    """Find out what the rays of paths meet beyond the near ball, or else let in the sky."""
    bundle = waves.beyond
    trace_bundle(world.tree, work, bundle, listed, False)
    for j in range(listed):
        k, before = whose(bundle, j)
        t, sphere = first_met(bundle, world.tree, j)
        x, y, z, dx, dy, dz = line_of(bundle, j)
        if sphere >= 0:
            waves.next_sphere[k] = sphere if before + t > 0 else _BURIED
            waves.next_point[0, k], waves.next_point[1, k] = x + t * dx, y + t * dy
            waves.next_point[2, k] = z + t * dz
        elif waves.next_sphere[k] == MISS:
            x, y, z = waves.point[k, 0], waves.point[k, 1], waves.point[k, 2]
            waves.light[k] += waves.weight[k] * escape_radiance(world.lights, x, y, z, dx, dy, dz)


@kernel(inline=True, borrows=True)
def _point(waves, lane):
    """Where a ray of the block starts."""
    return waves.center[lane], waves.center[LANES + lane], waves.center[2 * LANES + lane]


@kernel(inline=True, borrows=True)
def _normal(waves, lane):
    return waves.normal[lane], waves.normal[LANES + lane], waves.normal[2 * LANES + lane]


@kernel(inline=True, borrows=True)
def _draw(waves, first):
    """Two random numbers for each of sixteen paths."""
    state = next_state(load(waves.state, first))
    store(waves.state, first, state)
    return uniforms(state)


@kernel(inline=True, borrows=True)
def _aim_at_sun(world, work, near, known, site, waves, first, count, sun, listed):
    """Send rays towards a sun from the points of a block of paths; returns how many wait for the tree."""
    s = world.lights.suns[sun]
    u, v = _draw(waves, first)
    dx, dy, dz = cone_directions(s[0], s[1], s[2], s[5], u, v)
    store(waves.direction, 0, dx)
    store(waves.direction, LANES, dy)
    store(waves.direction, 2 * LANES, dz)
    nx, ny, nz = load(waves.normal, 0), load(waves.normal, LANES), load(waves.normal, 2 * LANES)
    cosine = fma(nx, dx, fma(ny, dy, nz * dz))
    store(waves.t, 0, cosine)
    zero = splat(_ZERO)
    open_ = ((1 << count) - 1) & bits(cosine > zero)
    inside = open_ & bits(_exits_of_ball(waves, site.reach) >= zero)
    if inside != 0:
        open_ = (open_ & ~inside) | _unblocked(near, known, site.sphere, waves, inside)
    if listed + LANES > ROOM:
        bring(world, work, waves.shadow, listed, waves.direct)
        listed = 0
    while open_ != 0:
        lane = trailing_zeros(open_)
        open_ &= open_ - 1
        dx, dy, dz = waves.direction[lane], waves.direction[LANES + lane], waves.direction[2 * LANES + lane]
        x, y, z = _point(waves, lane)
        if hidden_by_light(world.lights, x, y, z, dx, dy, dz, FAR):
            continue
        before = max(waves.exit[lane], _ZERO) * site.r
        x, y, z = x + before * dx, y + before * dy, z + before * dz
        kind = ray_kind(x - site.x, y - site.y, z - site.z, max(site.reach, _ONE) * site.r, dx, dy, dz)
        light = sun_luminance(world.lights, sun, waves.t[lane])
        put(waves.shadow, listed, first + lane, light, x, y, z, dx, dy, dz, FAR, waves.skip[lane], kind)
        listed += 1
    return listed


@kernel(inline=True, borrows=True)
def _move(waves, k, to):
    waves.ray[to], waves.sphere[to], waves.state[to] = waves.ray[k], waves.sphere[k], waves.state[k]
    waves.weight[to], waves.light[to] = waves.weight[k], waves.light[k]
    for c in range(3):
        waves.point[to, c] = waves.point[k, c]


@kernel(inline=True, borrows=True)
def _roulette(world, waves, count, bounce, values):
    """Let paths survive by their weight; return how many do."""
    alive = 0
    for first in range(0, count, LANES):
        store(waves.random, 0, _draw(waves, first)[0])
        for k in range(first, min(first + LANES, count)):
            weight = waves.weight[k] * world.albedo
            chance = survival(weight, world.keep, bounce)
            if waves.random[k - first] >= chance:
                values[waves.ray[k]] += waves.light[k]
            else:
                waves.weight[k] = weight / chance
                _move(waves, k, alive)
                alive += 1
    return alive


@kernel(inline=True, borrows=True)
def _aim(world, site, waves, first, count):
    """Put sixteen paths on their spheres, and their next rays into the block."""
    center = waves.center
    for lane in range(LANES):
        k = first + min(lane, count - 1)  # what an earlier block has left must not slow this one down
        sphere = index(waves.sphere[k])
        waves.skip[lane] = sphere
        center[lane], center[3 * LANES + lane] = world.centers[sphere, 0], world.radii[sphere]
        center[LANES + lane], center[2 * LANES + lane] = world.centers[sphere, 1], world.centers[sphere, 2]
        for c in range(3):
            waves.start[c * LANES + lane] = waves.point[k, c]
        waves.state[first + lane] = waves.state[k]
    cx, cy, cz = load(center, 0), load(center, LANES), load(center, 2 * LANES)
    r = load(center, 3 * LANES)
    x, y, z = load(waves.start, 0) - cx, load(waves.start, LANES) - cy, load(waves.start, 2 * LANES) - cz
    scale = splat(_ONE) / vsqrt(fma(x, x, fma(y, y, z * z)))
    nx, ny, nz = x * scale, y * scale, z * scale
    u, v = _draw(waves, first)
    dx, dy, dz = cosine_directions(nx, ny, nz, u, v)
    store(waves.direction, 0, dx)
    store(waves.direction, LANES, dy)
    store(waves.direction, 2 * LANES, dz)
    store(waves.normal, 0, nx)
    store(waves.normal, LANES, ny)
    store(waves.normal, 2 * LANES, nz)
    # By way of the difference of centres: points of a giant far from its own centre keep their digits.
    inverse = splat(_ONE / site.r)
    store(waves.start, 0, fma(r, nx, cx - site.x) * inverse)
    store(waves.start, LANES, fma(r, ny, cy - site.y) * inverse)
    store(waves.start, 2 * LANES, fma(r, nz, cz - site.z) * inverse)
    store(center, 0, fma(r, nx, cx))
    store(center, LANES, fma(r, ny, cy))
    store(center, 2 * LANES, fma(r, nz, cz))


@kernel(inline=True, borrows=True)
def _bounce(world, work, near, known, site, waves, first, count, listed):
    """Send sixteen paths on: what they meet in the near field is known then; returns how many rays wait for the tree."""
    _aim(world, site, waves, first, count)
    _nearest(near, known, site.sphere, waves)
    t = load(waves.t, 0)
    here = (load(waves.hit, 0) != splat_int(np.int32(-1))) & (t <= _exits_of_ball(waves, site.reach))
    t = t * splat(site.r)
    for c in range(3):
        at = fma(t, load(waves.direction, c * LANES), load(waves.center, c * LANES))
        store(waves.next_point[c], first, at)
    if listed + LANES > ROOM:
        _meet_beyond(world, work, waves, listed)
        listed = 0
    far = ~bits(here)
    for lane in range(count):
        k, hit = first + lane, waves.hit[lane]
        x, y, z = _point(waves, lane)
        waves.point[k, 0], waves.point[k, 1], waves.point[k, 2] = x, y, z
        waves.direct[k] = _ZERO
        if hit == -1:
            waves.next_sphere[k] = MISS
        elif waves.t[lane] > 0:
            waves.next_sphere[k] = site.sphere if hit == _SELF else near.id[hit]
        else:
            waves.next_sphere[k] = _BURIED
        if far >> lane & 1:
            before = max(waves.exit[lane], _ZERO) * site.r
            limit = waves.t[lane] * site.r - before if hit != -1 else FAR
            dx, dy, dz = (
                waves.direction[lane],
                waves.direction[LANES + lane],
                waves.direction[2 * LANES + lane],
            )
            x, y, z = x + before * dx, y + before * dy, z + before * dz
            put(waves.beyond, listed, k, before, x, y, z, dx, dy, dz, limit, waves.skip[lane], MISS)
            listed += 1
    return listed


@kernel(borrows=True)
def _add_area_lights(world, work, waves, first, count):
    if world.lights.globes.shape[0] + world.lights.quads.shape[0] == 0:
        return
    for lane in range(count):
        k = first + lane
        x, y, z = _point(waves, lane)
        nx, ny, nz = _normal(waves, lane)
        light, waves.state[k] = area_light(
            world, work, True, x, y, z, HERE, nx, ny, nz, waves.skip[lane], waves.state[k]
        )
        waves.direct[k] += light


@kernel(inline=True, borrows=True)
def _go_on(waves, count, values):
    """Add the light at the points of paths, and move those that meet something there; returns how many do."""
    alive = 0
    for k in range(count):
        sphere = waves.next_sphere[k]
        if sphere != _BURIED:
            waves.light[k] += waves.weight[k] * waves.direct[k]
        if sphere < 0:
            values[waves.ray[k]] += waves.light[k]
            continue
        _move(waves, k, alive)
        waves.sphere[alive] = sphere
        for c in range(3):
            waves.point[alive, c] = waves.next_point[c, k]
        alive += 1
    return alive


@kernel(borrows=True, inner=True)
def follow_paths(world, work, near, known, site, waves, count, values):
    """Add to `values` the light that `count` paths bring: what ``path.path_tail`` finds, from the same random numbers."""
    if world.cell is not None:
        for k in range(count):
            offset = (waves.offset[k, 0], waves.offset[k, 1], waves.offset[k, 2])
            x, y, z = waves.point[k, 0], waves.point[k, 1], waves.point[k, 2]
            values[waves.ray[k]] += path_tail(world, work, waves.sphere[k], x, y, z, offset, waves.state[k])
    else:
        for bounce in range(1, world.max_bounces + 1):
            count = _roulette(world, waves, count, bounce, values)
            if count == 0:
                break
            listed = in_shadow = 0
            for first in range(0, count, LANES):
                lanes = min(LANES, count - first)
                listed = _bounce(world, work, near, known, site, waves, first, lanes, listed)
                for sun in range(world.lights.suns.shape[0]):
                    in_shadow = _aim_at_sun(
                        world, work, near, known, site, waves, first, lanes, sun, in_shadow
                    )
                _add_area_lights(world, work, waves, first, lanes)
            _meet_beyond(world, work, waves, listed)
            bring(world, work, waves.shadow, in_shadow, waves.direct)
            count = _go_on(waves, count, values)
        for k in range(count):
            values[waves.ray[k]] += waves.light[k]
