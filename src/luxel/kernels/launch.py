"""Rays of a table from one particle: the light that each brings itself, and the paths that they become."""

from __future__ import annotations

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.memory import index
from luxel.kernels.near import RAY, patch_neighbours
from luxel.kernels.path import INTERREFLECTION
from luxel.kernels.rays import (
    add_area_lights,
    first_hits,
    hit_point,
    hits_beyond,
    ray_start,
    ray_word,
    set_of,
    sky_along,
)
from luxel.kernels.rng import PURPOSE_TEXEL, path_key
from luxel.kernels.simd import LANES
from luxel.kernels.tree import MISS
from luxel.kernels.waves import add_path

__all__ = ["launch"]

_ZERO, _ONE = np.float32(0), np.float32(1)


@kernel(borrows=True)
def _wanted_rays(table, at, count, wanted):
    """Bits of those of up to 64 rays from `at` on that start from texels that are wanted."""
    found = np.int64(0)
    for s in range(count):
        texel = table.texel[at + s]
        if texel >= 0 and wanted[index(texel)] != 0:
            found |= np.int64(1) << np.int64(s)
    return found


@kernel(borrows=True)
def _meet(world, work, near, known, site, table, chosen_set, wanted, bundle):
    """Find out what all rays from texels that are wanted meet."""
    rays, width = table.rays[chosen_set], index(table.width)
    lanes = width * LANES
    listed = 0
    for patch in range(table.patches.shape[0]):
        at = patch * lanes
        count = min(lanes, table.texel.shape[0] - at)
        chosen = _wanted_rays(table, at, count, wanted)
        if chosen != 0:
            p = table.patches[patch]
            found = patch_neighbours(near, known, p[0], p[1], p[2], p[3])
            first = patch * width * RAY
            listed = first_hits(
                world, work, near, found, site, rays, first, count, chosen, at, bundle, listed
            )
    hits_beyond(world, work, near, site, bundle, listed)


@kernel(borrows=True, inner=True)
def launch(world, work, near, known, site, table, wanted, values, waves):
    """Follow the rays of one particle to what they meet; returns the number of paths that go on from there.

    Writes to `values` what each ray brings without bounces and suns, -1 if it starts inside a neighbour, or from a
    texel whose `wanted` (texels,) is 0.
    """
    chosen_set = set_of(world, site.sphere, table.rays.shape[0])
    _meet(world, work, near, known, site, table, chosen_set, wanted, waves.beyond)
    rays = table.rays[chosen_set]
    bouncing = world.model == INTERREFLECTION and world.albedo > 0
    paths = 0
    for s in range(table.texel.shape[0]):
        texel, t, hit, o = table.texel[s], near.hit_t[s], near.hit[s], ray_word(s)
        value = _ZERO
        if texel < 0 or wanted[index(texel)] == 0:
            value = -_ONE
        elif hit == MISS or (hit >= 0 and t * site.r >= world.reach):
            value = sky_along(world, site, rays, o)
        elif hit >= 0 and t <= 0:
            value = -_ONE
        elif hit >= 0 and bouncing:
            _, _, _, px, py, pz = ray_start(site, rays, o)
            t *= site.r
            px, py, pz, offset = hit_point(
                world.cell, near, s, px + t * rays[o + 3 * LANES], py + t * rays[o + 4 * LANES],
                pz + t * rays[o + 5 * LANES],
            )  # fmt: skip
            state = path_key(world.seed, site.sphere, s, 2, PURPOSE_TEXEL)
            add_path(world.cell, waves, paths, s, hit, px, py, pz, offset, state)
            paths += 1
        values[s] = value
    add_area_lights(world, work, site, table, chosen_set, values)
    return paths
