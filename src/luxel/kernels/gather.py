"""Interreflection as a gather: one ray a sample, a shadow ray where it ends, and that particle's record for the rest."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.light import direct_light
from luxel.kernels.near import RAY, near_scratch, patch_neighbours
from luxel.kernels.periodic import HERE
from luxel.kernels.rays import (
    Site,
    add_direct,
    first_hits,
    hit_point,
    neighbours,
    ray_start,
    ray_word,
    set_of,
    sky_along,
)
from luxel.kernels.records import record_luminance
from luxel.kernels.rng import PURPOSE_TEXEL, path_key
from luxel.kernels.simd import LANES
from luxel.kernels.tree_trace import MISS, scratch

__all__ = ["Hits", "add_bounces", "average_texels", "trace_texels"]

_ZERO, _ONE = np.float32(0), np.float32(1)
_NONE = np.int32(-1)


class Hits(NamedTuple):
    """Where the rays of a batch of particles meet others."""

    particle: np.ndarray  # (K, R) int32, negative for none
    normal: np.ndarray  # (K, R, 3) float32
    offset: (
        np.ndarray
    )  # (K, R, 3) float32: from the particle to its image that was met; (K, 0, 3) if nothing repeats


@kernel(borrows=True)
def _trace_patch(world, work, near, known, site, table, chosen_set, patch, values, hits, k):
    """Trace the rays of one patch; see `trace_texels`."""
    block = patch * table.width
    first, at = block * RAY, block * LANES
    count = min(table.width * LANES, table.texel.shape[0] - at)
    rays = table.rays[chosen_set]
    p = table.patches[patch]
    found = patch_neighbours(near, known, p[0], p[1], p[2], p[3])
    first_hits(world, work, near, found, site, rays, first, count)
    for s in range(count):
        t, hit = near.hit_t[s], near.hit[s]
        o = first + ray_word(s)
        value, particle = _ZERO, _NONE
        if hit == MISS or (hit >= 0 and t * site.r >= world.reach):
            value = sky_along(world, site, rays, o)
        elif hit >= 0 and t <= 0:
            value = -_ONE
        elif hit >= 0:
            particle = hit
            _, _, _, px, py, pz = ray_start(site, rays, o)
            t *= site.r
            x, y, z, offset = hit_point(
                world.cell, near, s, px + t * rays[o + 3 * LANES], py + t * rays[o + 4 * LANES],
                pz + t * rays[o + 5 * LANES],
            )  # fmt: skip
            nx, ny, nz = x - world.centers[hit, 0], y - world.centers[hit, 1], z - world.centers[hit, 2]
            scale = _ONE / np.sqrt(max(nx * nx + ny * ny + nz * nz, np.float32(1e-30)))
            normal = hits.normal[k, at + s]
            normal[0], normal[1], normal[2] = nx * scale, ny * scale, nz * scale
            if hits.offset.shape[1] > 0:
                there = hits.offset[k, at + s]
                there[0], there[1], there[2] = offset
        values[k, at + s], hits.particle[k, at + s] = value, particle
    add_direct(world, work, near, found, site, table, chosen_set, block, count, values[k, at : at + count])


@kernel
def trace_texels(world, table, ids, values, hits):
    """Trace the rays of particles `ids` (K,) through the near field and what lies beyond.

    `values` (K, R) float32 become direct light and sky, -1 for samples buried in a neighbour; `hits` say what the
    others met.
    """
    work = scratch(world.tree.stack_size)
    near = near_scratch(table.width * LANES)
    for k in range(ids.shape[0]):
        i = ids[k]
        x, y, z, r = world.centers[i, 0], world.centers[i, 1], world.centers[i, 2], world.radii[i]
        known, reach = neighbours(world, work, near, i)
        site = Site(i, x, y, z, r, reach)
        chosen_set = set_of(world, i, table.rays.shape[0])
        for patch in range(table.patches.shape[0]):
            _trace_patch(world, work, near, known, site, table, chosen_set, patch, values, hits, k)


@kernel
def add_bounces(world, records, ids, values, hits):
    """Add to values (K, R) what rays that met a particle bring home: direct light there, and its record for the rest."""
    work = scratch(world.tree.stack_size)
    for k in range(ids.shape[0]):
        for s in range(values.shape[1]):
            hit = hits.particle[k, s]
            if hit < 0:
                continue
            n = hits.normal[k, s]
            nx, ny, nz = n[0], n[1], n[2]
            total = record_luminance(records.rest, hit, nx, ny, nz)
            if records.lit[hit]:
                offset = HERE
                if hits.offset.shape[1] > 0:
                    v = hits.offset[k, s]
                    offset = (v[0], v[1], v[2])
                c, r = world.centers[hit], world.radii[hit]
                total += direct_light(
                    world, work, True, c[0] + r * nx, c[1] + r * ny, c[2] + r * nz, offset, nx, ny, nz, hit,
                    path_key(world.seed, ids[k], s, 2, PURPOSE_TEXEL),
                )[0]  # fmt: skip
            values[k, s] += world.albedo * total


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
