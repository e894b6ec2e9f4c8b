"""Interreflection as a gather: one ray a sample, a shadow ray where it ends, and that particle's record for the rest."""

from __future__ import annotations

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.light import direct_light
from luxel.kernels.near import RAY, collect, near_scratch, patch_neighbours
from luxel.kernels.rays import Site, add_direct, first_hits, ray_start, ray_word, set_of, sky_along
from luxel.kernels.records import record_luminance
from luxel.kernels.rng import PURPOSE_TEXEL, path_key
from luxel.kernels.simd import LANES
from luxel.kernels.tree_trace import scratch

__all__ = ["add_bounces", "average_texels", "trace_texels"]

_ZERO, _ONE = np.float32(0), np.float32(1)
_NONE = np.int32(-1)


@kernel
def _bounce(world, work, site, rays, o, t, hit, records, state):
    """What a ray that meets `hit` brings home: direct light there by shadow rays, the rest from its record."""
    _, _, _, px, py, pz = ray_start(site, rays, o)
    t *= site.r
    cx, cy, cz = world.centers[hit, 0], world.centers[hit, 1], world.centers[hit, 2]
    nx = px + t * rays[o + 3 * LANES] - cx
    ny = py + t * rays[o + 4 * LANES] - cy
    nz = pz + t * rays[o + 5 * LANES] - cz
    scale = _ONE / np.sqrt(max(nx * nx + ny * ny + nz * nz, np.float32(1e-30)))
    nx, ny, nz = nx * scale, ny * scale, nz * scale
    total = record_luminance(records.rest, hit, nx, ny, nz)
    if records.lit[hit]:
        r = world.radii[hit]
        total += direct_light(
            world.tree,
            work,
            world.lights,
            True,
            cx + r * nx,
            cy + r * ny,
            cz + r * nz,
            nx,
            ny,
            nz,
            hit,
            state,
        )[0]
    return world.albedo * total


@kernel
def trace_texels(world, table, ids, values, hits, distance):
    """Trace the rays of particles `ids` (K,) through the near field and the tree.

    Parameters
    ----------
    values
        (K, R) float32: direct light and sky; -1 for samples buried in a neighbour.
    hits, distance
        (K, R) int32 particle met, -1 for none; (K, R) float32 how far, in radii of the particle.
    """
    work = scratch(world.tree.stack_size)
    blocks = table.texel.shape[0] // LANES
    near = near_scratch(table.width * LANES)
    for k in range(ids.shape[0]):
        i = ids[k]
        x, y, z, r = world.centers[i, 0], world.centers[i, 1], world.centers[i, 2], world.radii[i]
        chosen_set = set_of(world, i, table.rays.shape[0])
        rays = table.rays[chosen_set]
        neighbours, reach = collect(world.tree, work, near, x, y, z, r, i)
        site = Site(i, x, y, z, r, reach)
        for patch in range(table.patches.shape[0]):
            block = patch * table.width
            first, at = block * RAY, block * LANES
            here = min(table.width, blocks - block) * LANES
            p = table.patches[patch]
            found = patch_neighbours(near, neighbours, p[0], p[1], p[2], p[3])
            first_hits(world, work, near, found, site, rays, first, here)
            for s in range(here):
                t, hit = near.hit_t[s], near.hit[s]
                value = _ZERO
                if hit < 0 or t * r >= world.reach:
                    value, hit = sky_along(world, site, rays, first + ray_word(s)), _NONE
                elif t <= 0:
                    value, hit = -_ONE, _NONE
                values[k, at + s], hits[k, at + s], distance[k, at + s] = value, hit, t
            add_direct(
                world,
                work,
                near,
                found,
                site,
                table,
                chosen_set,
                first,
                block,
                here,
                values[k, at : at + here],
            )


@kernel
def add_bounces(world, table, records, ids, values, hits, distance):
    """Add what rays that met a particle bring home to values (K, R), see `trace_texels`."""
    work = scratch(world.tree.stack_size)
    for k in range(ids.shape[0]):
        i = ids[k]
        site = Site(i, world.centers[i, 0], world.centers[i, 1], world.centers[i, 2], world.radii[i], _ONE)
        rays = table.rays[set_of(world, i, table.rays.shape[0])]
        for s in range(values.shape[1]):
            if hits[k, s] >= 0:
                state = path_key(world.seed, i, s, 2, PURPOSE_TEXEL)
                values[k, s] += _bounce(
                    world, work, site, rays, ray_word(s), distance[k, s], hits[k, s], records, state
                )


@kernel
def average_texels(table, values, mean, variance, exposed):
    """Turn values (K, R) into the texels' means, variances and counts, as in ``texels.sample_texels``."""
    texels = mean.shape[1] * mean.shape[2]
    for k in range(values.shape[0]):
        total, total2, seen = mean[k].reshape(-1), variance[k].reshape(-1), exposed[k].reshape(-1)
        total[:] = _ZERO
        total2[:] = _ZERO
        seen[:] = 0
        for s in range(values.shape[1]):
            texel, value = table.texel[s], values[k, s]
            if texel >= 0 and value >= 0:
                total[texel] += value
                total2[texel] += value * value
                seen[texel] += 1
        for texel in range(texels):
            n = np.float32(seen[texel])
            if n > 0:
                total[texel] /= n
            spread = total2[texel] - n * total[texel] * total[texel]
            total2[texel] = max(_ZERO, spread) / (n - _ONE) if n > 1 else _ZERO
