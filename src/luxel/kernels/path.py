"""Monte Carlo path tracing of reflected luminance at one point (paper 3.2)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.light import Lights, direct_light, escape_radiance, sky_irradiance
from luxel.kernels.periodic import HERE, LOST, Periodic, follow, settle, shadowed
from luxel.kernels.rng import next_state, uniform
from luxel.kernels.simd import LANES, any_lane, bits, load, splat, splat_int, trailing_zeros
from luxel.kernels.tree import CHILDREN, IDS, LEAF, NODE, Tree
from luxel.kernels.warp import cosine_direction

__all__ = [
    "AO",
    "INTERREFLECTION",
    "LAMBERTIAN",
    "SHADOWS",
    "World",
    "buried",
    "luminance_at",
    "path_tail",
    "survival",
]

LAMBERTIAN, SHADOWS, AO, INTERREFLECTION = 0, 1, 2, 3

_ZERO, _ONE = np.float32(0), np.float32(1)
# After so many bounces a path survives with at most this chance, so that a closed white hollow cannot hold it for ever.
_PATIENCE = 16
_SURVIVAL = np.float32(0.95)


class World(NamedTuple):
    """Everything light depends on, as kernels take it; normalised units."""

    tree: Tree
    lights: Lights
    centers: np.ndarray  # (N, 3) float32
    radii: np.ndarray  # (N,) float32
    model: int
    albedo: np.float32
    reach: np.float32  # rays of ambient occlusion end here
    max_bounces: int
    seed: np.uint64
    keep: np.float32  # a path that weighs so much survives every bounce, a lighter one by its share of it
    cell: Periodic | None  # light repeats with it; kernels are compiled apart for None, which costs nothing


@kernel(borrows=True, inner=True)
def buried(tree, work, x, y, z, skip):
    """Whether a point lies inside any sphere but `skip`."""
    nodes, child, spheres, ids, stack = tree.nodes, tree.child, tree.spheres, tree.ids, work.node
    vx, vy, vz = splat(x), splat(y), splat(z)
    stack[0] = 0
    height = 1
    while height > 0:
        height -= 1
        node = stack[height]
        if node >= 0:
            o = node * NODE
            inside = (
                (load(nodes, o) <= vx) & (load(nodes, o + LANES) <= vy) & (load(nodes, o + 2 * LANES) <= vz)
            )
            inside = inside & (load(nodes, o + 3 * LANES) >= vx) & (load(nodes, o + 4 * LANES) >= vy)
            m = bits(inside & (load(nodes, o + 5 * LANES) >= vz))
            while m != 0:
                stack[height] = child[o + CHILDREN + trailing_zeros(m)]
                height += 1
                m &= m - 1
        else:
            o = ~node * LEAF
            cx, cy, cz = (
                load(spheres, o) - vx,
                load(spheres, o + LANES) - vy,
                load(spheres, o + 2 * LANES) - vz,
            )
            within = cx * cx + cy * cy + cz * cz < load(spheres, o + 3 * LANES) * np.float32(0.9999)
            if any_lane(within & (load(ids, o + IDS) != splat_int(skip))):
                return True
    return False


@kernel(borrows=True, inner=True)
def luminance_at(world, work, sphere, px, py, pz, nx, ny, nz, state):
    """One-sample estimate of T(p) = (1/π) ∫ L_in cosθ dω at a point of `sphere`; negative where a neighbour buries it."""
    lights = world.lights
    if world.model != INTERREFLECTION:
        tree, qx, qy, qz, skip = settle(world.cell, world, px, py, pz, sphere)
        if buried(tree, work, qx, qy, qz, skip):
            return -_ONE
        return _one_bounce(world, work, sphere, px, py, pz, nx, ny, nz, state)
    state = next_state(state)
    u, v = uniform(state)
    dx, dy, dz = cosine_direction(nx, ny, nz, u, v)
    t, hit, hx, hy, hz, offset = follow(
        world.cell, world, work, px, py, pz, HERE, dx, dy, dz, np.float32(1e30), sphere
    )
    if hit >= 0 and t <= 0:
        return (
            -_ONE
        )  # the ray started inside a neighbour: this one trace has answered whether the point is buried
    total, state = direct_light(world, work, True, px, py, pz, HERE, nx, ny, nz, sphere, state)
    if hit == LOST:
        return total
    if hit < 0:
        return total + escape_radiance(lights, px, py, pz, dx, dy, dz)
    return total + path_tail(world, work, hit, hx, hy, hz, offset, state)


@kernel(inline=True, borrows=True)
def survival(weight, keep, bounce):
    """Probability with which a path of this weight goes on after so many bounces."""
    return min(weight / keep, _ONE if bounce <= _PATIENCE else _SURVIVAL)


@kernel(borrows=True)
def path_tail(world, work, sphere, px, py, pz, offset, state):
    """Estimate the luminance that a path which meets `sphere` at p brings home: albedo · T(p).

    `offset` (three numbers) leads from the particle to the image of it that the path met, see `periodic.follow`.
    """
    lights = world.lights
    total, weight = _ZERO, _ONE
    bounces = 0
    while bounces < world.max_bounces:
        bounces += 1
        weight *= world.albedo
        chance = survival(weight, world.keep, bounces)
        state = next_state(state)
        u, v = uniform(state)
        if u >= chance:
            break
        weight /= chance
        cx, cy, cz = world.centers[sphere, 0], world.centers[sphere, 1], world.centers[sphere, 2]
        hx, hy, hz = px - cx, py - cy, pz - cz
        scale = _ONE / np.sqrt(hx * hx + hy * hy + hz * hz)
        nx, ny, nz = hx * scale, hy * scale, hz * scale
        r = world.radii[sphere]
        px, py, pz = cx + r * nx, cy + r * ny, cz + r * nz
        state = next_state(state)
        u, v = uniform(state)
        dx, dy, dz = cosine_direction(nx, ny, nz, u, v)
        t, hit, hx, hy, hz, hit_offset = follow(
            world.cell, world, work, px, py, pz, offset, dx, dy, dz, np.float32(1e30), sphere
        )
        if hit >= 0 and t <= 0:
            break  # rounding can bury a point where spheres meet
        direct, state = direct_light(world, work, True, px, py, pz, offset, nx, ny, nz, sphere, state)
        total += weight * direct
        if hit == LOST:
            break
        if hit < 0:
            return total + weight * escape_radiance(
                lights, px + offset[0], py + offset[1], pz + offset[2], dx, dy, dz
            )
        px, py, pz = hx, hy, hz
        sphere, offset = hit, hit_offset
    return total


@kernel(borrows=True)
def _one_bounce(world, work, sphere, px, py, pz, nx, ny, nz, state):
    """Sky and direct light without interreflection: the three simpler models."""
    lights = world.lights
    state = next_state(state)
    u, v = uniform(state)
    dx, dy, dz = cosine_direction(nx, ny, nz, u, v)
    total = _ZERO
    if world.model != AO:
        shadows = world.model == SHADOWS
        total, state = direct_light(world, work, shadows, px, py, pz, HERE, nx, ny, nz, sphere, state)
        if not shadows:
            return total + sky_irradiance(lights.sky, nx, ny, nz)
    if not shadowed(world.cell, world, work, px, py, pz, dx, dy, dz, world.reach, sphere):
        total += escape_radiance(lights, px, py, pz, dx, dy, dz)
    return total
