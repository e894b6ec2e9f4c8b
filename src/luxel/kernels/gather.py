"""Interreflection as a gather: one ray a sample, a shadow ray where it ends, and that particle's record for the rest."""

from __future__ import annotations

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.light import direct_light
from luxel.kernels.near import RAY, collect, near_scratch, patch_neighbours
from luxel.kernels.path import INTERREFLECTION
from luxel.kernels.rays import Site, add_direct, first_hits, ray_start, ray_word, set_of, sky_along
from luxel.kernels.records import is_lit, record_luminance
from luxel.kernels.rng import PURPOSE_TEXEL, path_key
from luxel.kernels.simd import LANES
from luxel.kernels.tree_trace import scratch

__all__ = ["gather_texels"]

_ZERO, _ONE = np.float32(0), np.float32(1)


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
    if is_lit(records.direct, hit):
        r = world.radii[hit]
        total += direct_light(
            world.tree, work, world.lights, True, cx + r * nx, cy + r * ny, cz + r * nz, nx, ny, nz, hit, state
        )[0]
    return world.albedo * total


@kernel
def gather_texels(world, table, records, ids, mean, variance, exposed):
    """As ``texels.sample_texels``, one ray a sample from `table`; `records` of all particles stand for further bounces."""
    work = scratch(world.tree.stack_size)
    blocks = table.texel.shape[0] // LANES
    near = near_scratch(table.width * LANES)
    values = np.zeros(table.width * LANES, np.float32)
    bounces = world.model == INTERREFLECTION and world.albedo > 0
    sets, texels = table.rays.shape[0], mean.shape[1]
    for k in range(ids.shape[0]):
        i = ids[k]
        x, y, z, r = world.centers[i, 0], world.centers[i, 1], world.centers[i, 2], world.radii[i]
        chosen_set = set_of(world, i, sets)
        rays = table.rays[chosen_set]
        neighbours, reach = collect(world.tree, work, near, x, y, z, r, i)
        site = Site(i, x, y, z, r, reach)
        total, total2, seen = mean[k].reshape(-1), variance[k].reshape(-1), exposed[k].reshape(-1)
        total[:] = _ZERO
        total2[:] = _ZERO
        seen[:] = 0
        for patch in range(table.patches.shape[0]):
            first_block = patch * table.width
            first = first_block * RAY
            count = min(table.width, blocks - first_block) * LANES
            p = table.patches[patch]
            found = patch_neighbours(near, neighbours, p[0], p[1], p[2], p[3])
            first_hits(world, work, near, found, site, rays, first, count)
            for s in range(count):
                t, hit = near.hit_t[s], near.hit[s]
                o = first + ray_word(s)
                if hit < 0 or t * r >= world.reach:
                    values[s] = sky_along(world, site, rays, o)
                elif t <= 0:
                    values[s] = -_ONE
                elif bounces:
                    state = path_key(world.seed, i, first_block * LANES + s, 2, PURPOSE_TEXEL)
                    values[s] = _bounce(world, work, site, rays, o, t, hit, records, state)
                else:
                    values[s] = _ZERO
            add_direct(world, work, near, found, site, table, chosen_set, first, first_block, count, values)
            for s in range(count):
                texel = table.texel[first_block * LANES + s]
                value = values[s]
                if texel >= 0 and value >= 0:
                    total[texel] += value
                    total2[texel] += value * value
                    seen[texel] += 1
        for texel in range(texels * texels):
            n = np.float32(seen[texel])
            if n > 0:
                total[texel] /= n
            spread = total2[texel] - n * total[texel] * total[texel]
            total2[texel] = max(_ZERO, spread) / (n - _ONE) if n > 1 else _ZERO
