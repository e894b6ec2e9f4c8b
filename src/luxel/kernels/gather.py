"""Samples of luminance for ``fast`` mode: path tracing as in ``texels``, from rays that particles share, spread evenly."""

from __future__ import annotations

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.near import RAY, near_scratch, patch_neighbours
from luxel.kernels.path import INTERREFLECTION
from luxel.kernels.rays import (
    Site,
    add_area_lights,
    first_hits,
    hit_point,
    neighbours,
    ray_start,
    ray_word,
    set_of,
    sky_along,
)
from luxel.kernels.rng import PURPOSE_TEXEL, path_key
from luxel.kernels.simd import LANES
from luxel.kernels.sunlight import sun_scratch, sunlight
from luxel.kernels.tree_trace import MISS, scratch
from luxel.kernels.waves import add_path, follow_paths, wave_scratch

__all__ = ["gather_texels"]

_ZERO, _ONE = np.float32(0), np.float32(1)


@kernel(borrows=True)
def _trace_patch(world, work, near, known, site, table, chosen_set, patch, values, waves, paths):
    """Estimate what the rays of one patch bring without bounces and suns; -1 for samples buried in a neighbour.

    Rays that meet a neighbour become paths; returns how many there are by now.
    """
    block = patch * table.width
    first, at = block * RAY, block * LANES
    count = min(table.width * LANES, table.texel.shape[0] - at)
    rays = table.rays[chosen_set]
    p = table.patches[patch]
    found = patch_neighbours(near, known, p[0], p[1], p[2], p[3])
    first_hits(world, work, near, found, site, rays, first, count)
    bouncing = world.model == INTERREFLECTION and world.albedo > 0
    for s in range(count):
        t, hit = near.hit_t[s], near.hit[s]
        o = first + ray_word(s)
        value = _ZERO
        if hit == MISS or (hit >= 0 and t * site.r >= world.reach):
            value = sky_along(world, site, rays, o)
        elif hit >= 0 and t <= 0:
            value = -_ONE
        elif hit >= 0 and bouncing and table.texel[at + s] >= 0:
            _, _, _, px, py, pz = ray_start(site, rays, o)
            t *= site.r
            px, py, pz, offset = hit_point(
                world.cell, near, s, px + t * rays[o + 3 * LANES], py + t * rays[o + 4 * LANES],
                pz + t * rays[o + 5 * LANES],
            )  # fmt: skip
            state = path_key(world.seed, site.sphere, at + s, 2, PURPOSE_TEXEL)
            add_path(world.cell, waves, paths, at + s, hit, px, py, pz, offset, state)
            paths += 1
        values[at + s] = value
    add_area_lights(world, work, site, table, chosen_set, block, count, values)
    return paths


@kernel
def gather_texels(world, table, sun_table, ids, mean, variance, exposed, sun, sun_variance, sun_exposed):
    """As ``texels.sample_texels``, with the rays of `table`; sunlight apart, with those of `sun_table`.

    The last three are as the three before them; where there is no sun they are not written.
    """
    work = scratch(world.tree.stack_size)
    near = near_scratch(table.width * LANES)
    rays = table.texel.shape[0]
    waves = wave_scratch(rays)
    suns = sun_scratch(sun_table)
    values = np.zeros(rays, np.float32)
    for k in range(ids.shape[0]):
        i = ids[k]
        x, y, z, r = world.centers[i, 0], world.centers[i, 1], world.centers[i, 2], world.radii[i]
        known, reach = neighbours(world, work, near, i)
        site = Site(i, x, y, z, r, reach)
        chosen_set = set_of(world, i, table.rays.shape[0])
        paths = 0
        for patch in range(table.patches.shape[0]):
            paths = _trace_patch(
                world, work, near, known, site, table, chosen_set, patch, values, waves, paths
            )
        follow_paths(world, work, near, known, site, waves, paths, values)
        total, total2, seen = mean[k].reshape(-1), variance[k].reshape(-1), exposed[k].reshape(-1)
        _clear(total, total2, seen)
        for s in range(rays):
            texel, value = table.texel[s], values[s]
            if texel >= 0 and value >= 0:
                total[texel] += value
                total2[texel] += value * value
                seen[texel] += 1
        _average(total, total2, seen)
        if sun_table.rays.shape[0] > 0:
            total, total2, seen = sun[k].reshape(-1), sun_variance[k].reshape(-1), sun_exposed[k].reshape(-1)
            _clear(total, total2, seen)
            sunlight(world, work, near, known, site, sun_table, suns, total, total2, seen)
            _average(total, total2, seen)


@kernel(inline=True)
def _clear(total, total2, seen):
    total[:] = _ZERO
    total2[:] = _ZERO
    seen[:] = 0


@kernel(inline=True)
def _average(total, total2, seen):
    """Turn sums into means and variances of one sample."""
    for texel in range(total.shape[0]):
        n = np.float32(seen[texel])
        if n > 0:
            total[texel] /= n
        spread = total2[texel] - n * total[texel] * total[texel]
        total2[texel] = max(_ZERO, spread) / (n - _ONE) if n > 1 else _ZERO
