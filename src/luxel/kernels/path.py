"""Monte Carlo path tracing of reflected luminance, at one point and over the texels of a particle (paper 3.2)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.light import Lights, direct_light, escape_radiance, sky_irradiance
from luxel.kernels.rng import PURPOSE_TEXEL, next_state, path_key, uniform
from luxel.kernels.simd import LANES, any_lane, bits, load, splat, splat_int, trailing_zeros
from luxel.kernels.tree_trace import CHILDREN, IDS, LEAF, NODE, Tree, occluded, scratch, trace
from luxel.kernels.warp import cosine_direction, latlong_direction

__all__ = [
    "AO",
    "INTERREFLECTION",
    "LAMBERTIAN",
    "SHADOWS",
    "World",
    "buried",
    "luminance_at",
    "sample_texels",
]

LAMBERTIAN, SHADOWS, AO, INTERREFLECTION = 0, 1, 2, 3

_ZERO, _ONE = np.float32(0), np.float32(1)
# A path survives a bounce with the probability of its weight; after so many bounces with at most this, so that a
# closed white hollow cannot hold it for ever.
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


@kernel
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


@kernel
def luminance_at(world, work, sphere, px, py, pz, nx, ny, nz, state):
    """One-sample estimate of T(p) = (1/π) ∫ L_in cosθ dω at a point of `sphere`; negative where a neighbour buries it."""
    tree, lights = world.tree, world.lights
    if world.model != INTERREFLECTION:
        if buried(tree, work, px, py, pz, sphere):
            return -_ONE
        return _one_bounce(world, work, sphere, px, py, pz, nx, ny, nz, state)
    total, weight = _ZERO, _ONE
    bounces = 0
    while True:
        state = next_state(state)
        u, v = uniform(state)
        dx, dy, dz = cosine_direction(nx, ny, nz, u, v)
        t, hit = trace(tree, work, px, py, pz, dx, dy, dz, np.float32(1e30), sphere, False)
        hx, hy, hz = px, py, pz
        if hit >= 0:
            cx, cy, cz = world.centers[hit, 0], world.centers[hit, 1], world.centers[hit, 2]
            hx, hy, hz = px + t * dx - cx, py + t * dy - cy, pz + t * dz - cz
            if t <= 0:
                # The ray started inside a neighbour: this one trace has answered whether the point is buried.
                return -_ONE if bounces == 0 else total
        direct, state = direct_light(tree, work, lights, True, px, py, pz, nx, ny, nz, sphere, state)
        total += weight * direct
        if hit < 0:
            return total + weight * escape_radiance(lights, px, py, pz, dx, dy, dz)
        if bounces == world.max_bounces:
            return total
        bounces += 1
        weight *= world.albedo
        survival = min(weight, _ONE if bounces <= _PATIENCE else _SURVIVAL)
        state = next_state(state)
        u, v = uniform(state)
        if u >= survival:
            return total
        weight /= survival
        scale = _ONE / np.sqrt(hx * hx + hy * hy + hz * hz)
        nx, ny, nz = hx * scale, hy * scale, hz * scale
        r = world.radii[hit]
        px, py, pz = cx + r * nx, cy + r * ny, cz + r * nz
        sphere = hit


@kernel
def _one_bounce(world, work, sphere, px, py, pz, nx, ny, nz, state):
    """Sky and direct light without interreflection: the three simpler models."""
    tree, lights = world.tree, world.lights
    total = _ZERO
    if world.model != AO:
        shadows = world.model == SHADOWS
        total, state = direct_light(tree, work, lights, shadows, px, py, pz, nx, ny, nz, sphere, state)
        if not shadows:
            return total + sky_irradiance(lights.sky, nx, ny, nz)
    state = next_state(state)
    u, v = uniform(state)
    dx, dy, dz = cosine_direction(nx, ny, nz, u, v)
    if not occluded(tree, work, px, py, pz, dx, dy, dz, world.reach, sphere):
        total += escape_radiance(lights, px, py, pz, dx, dy, dz)
    return total


@kernel
def sample_texels(world, ids, grid, mean, variance, exposed):
    """Sample the textures of particles `ids` with grid × grid jittered samples a texel, uniform in (u, v).

    Parameters
    ----------
    mean
        (K, T, T) float32: mean over the samples whose origin is not buried in a neighbour; 0 where all are.
    variance
        (K, T, T) float32: variance of one sample, unbiased; 0 where fewer than two samples are exposed.
    exposed
        (K, T, T) uint32: number of samples that are not buried.
    """
    work = scratch(world.tree.stack_size)
    texels = mean.shape[1]
    step = _ONE / np.float32(texels * grid)
    for k in range(ids.shape[0]):
        sphere = ids[k]
        r = world.radii[sphere]
        cx, cy, cz = world.centers[sphere, 0], world.centers[sphere, 1], world.centers[sphere, 2]
        for row in range(texels):
            for column in range(texels):
                total = total2 = 0.0
                count = 0
                for s in range(grid * grid):
                    state = path_key(world.seed, sphere, row * texels + column, s, PURPOSE_TEXEL)
                    ju, jv = uniform(state)
                    u = (np.float32(column * grid + s % grid) + ju) * step
                    v = (np.float32(row * grid + s // grid) + jv) * step
                    nx, ny, nz = latlong_direction(u, v)
                    px, py, pz = cx + r * nx, cy + r * ny, cz + r * nz
                    value = luminance_at(world, work, sphere, px, py, pz, nx, ny, nz, state)
                    if value < 0:
                        continue
                    total += value
                    total2 += value * value
                    count += 1
                mean[k, row, column] = total / count if count > 0 else 0.0
                variance[k, row, column] = (
                    max(0.0, total2 - total * total / count) / (count - 1) if count > 1 else 0.0
                )
                exposed[k, row, column] = count
