"""Samples of luminance over the texels of a particle by path tracing, to the letter of the paper (3.2).

All first rays of a particle go through its near field (``near``); what leaves it goes on through the tree.
"""

from __future__ import annotations

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.light import area_light
from luxel.kernels.mapping import texel_directions
from luxel.kernels.memory import float_lines
from luxel.kernels.near import RAY, near_scratch, patch_neighbours
from luxel.kernels.path import INTERREFLECTION, LAMBERTIAN, SHADOWS, luminance_at
from luxel.kernels.periodic import HERE, LOST
from luxel.kernels.rays import (
    EVERY_RAY,
    Site,
    add_sunlight,
    escaping,
    first_hits,
    hit_point,
    neighbours,
    put_rays,
    ray_start,
    ray_word,
    sky_along,
    within_reach,
)
from luxel.kernels.rng import PURPOSE_TEXEL, next_state, sample_key, texel_key, uniforms
from luxel.kernels.simd import FAR, LANES, load, splat, store
from luxel.kernels.tree_trace import scratch
from luxel.kernels.warp import cone_directions, cosine_directions
from luxel.kernels.waves import add_path, follow_paths, wave_scratch

__all__ = ["sample_texels"]

_ZERO, _ONE = np.float32(0), np.float32(1)


@kernel(borrows=True)
def _draw(world, mapping, sphere, texel, texels, grid, numbers, cells, rays, sun_rays, states):
    """Draw a texel's first rays and those towards every sun, numbers as in ``path.luminance_at``."""
    row, column = texel // texels, texel % texels
    step = _ONE / np.float32(texels * grid)
    left, top = splat(np.float32(column * grid)), splat(np.float32(row * grid))
    suns = world.lights.suns
    key = texel_key(world.seed, sphere, texel, PURPOSE_TEXEL)
    for block in range((grid * grid + LANES - 1) // LANES):
        o = block * RAY
        state = sample_key(key, load(numbers, block * LANES))
        store(states, block * LANES, state)
        u, v = uniforms(state)
        x, y = load(cells[0], block * LANES), load(cells[1], block * LANES)
        store(rays, o, (left + x + u) * step)
        store(rays, o + LANES, (top + y + v) * step)
        texel_directions(mapping, rays, o)
        ax, ay, az = load(rays, o), load(rays, o + LANES), load(rays, o + 2 * LANES)
        state = next_state(state)
        u, v = uniforms(state)
        put_rays(rays, o, ax, ay, az, cosine_directions(ax, ay, az, u, v))
        for q in range(suns.shape[0]):
            state = next_state(state)
            u, v = uniforms(state)
            s = suns[q]
            put_rays(sun_rays[q], o, ax, ay, az, cone_directions(s[0], s[1], s[2], s[5], u, v))


@kernel
def _plain(world, work, site, rays, count, values, base, states):
    """Every sample by itself through the tree."""
    for s in range(count):
        ax, ay, az, px, py, pz = ray_start(site, rays, ray_word(s))
        values[base + s] = luminance_at(world, work, site.sphere, px, py, pz, ax, ay, az, states[s])


@kernel
def _first_stretch(world, work, near, found, site, rays, count, values, base, states, waves, paths):
    """All that the first vertex of each sample receives but sunlight; buried samples become -1.

    Samples that meet a neighbour become paths; returns how many there are by now.
    """
    first_hits(world, work, near, found, site, rays, 0, count, EVERY_RAY)
    for s in range(count):
        t, hit = near.hit_t[s], near.hit[s]
        if hit >= 0 and t <= 0:
            values[base + s] = -_ONE
            continue
        o = ray_word(s)
        ax, ay, az, px, py, pz = ray_start(site, rays, o)
        value, state = area_light(world, work, True, px, py, pz, HERE, ax, ay, az, site.sphere, states[s])
        if hit >= 0:
            t *= site.r
            hx, hy, hz, offset = hit_point(
                world.cell, near, s, px + t * rays[o + 3 * LANES], py + t * rays[o + 4 * LANES],
                pz + t * rays[o + 5 * LANES],
            )  # fmt: skip
            add_path(world.cell, waves, paths, base + s, hit, hx, hy, hz, offset, state)
            paths += 1
        elif hit != LOST:
            value += sky_along(world, site, rays, o)
        values[base + s] = value
    return paths


@kernel
def _area_lights(world, work, site, rays, count, values, base, states):
    if world.lights.globes.shape[0] + world.lights.quads.shape[0] == 0:
        return
    for s in range(count):
        ax, ay, az, px, py, pz = ray_start(site, rays, ray_word(s))
        values[base + s] += area_light(
            world, work, True, px, py, pz, HERE, ax, ay, az, site.sphere, states[s]
        )[0]


@kernel
def sample_texels(world, mapping, ids, grid, frames, mean, variance, exposed):
    """Sample the textures of particles `ids` with grid × grid jittered samples a texel, uniform in (u, v).

    Parameters
    ----------
    frames
        (T·T, 4) float32: middle of every texel and the largest chord from it to a point of the texel.
    mean
        (K, T, T) float32: mean over the samples whose origin is not buried in a neighbour; 0 where all are.
    variance
        (K, T, T) float32: variance of one sample, unbiased; 0 where fewer than two samples are exposed.
    exposed
        (K, T, T) uint32: number of samples that are not buried. Models without bounces, which only ask whether a ray
        is blocked, count buried samples as exposed and dark.
    """
    texels = mean.shape[1]
    count = grid * grid
    blocks = (count + LANES - 1) // LANES
    suns = world.lights.suns.shape[0]
    work = scratch(world.tree.stack_size)
    near = near_scratch(blocks * LANES)
    rays = float_lines(blocks * RAY)
    sun_rays = float_lines(suns * blocks * RAY).reshape(suns, blocks * RAY)
    states = np.zeros(blocks * LANES, np.uint64)
    # Samples that fill the last block up go with the last one. Cells: column and row of each within its texel.
    numbers = np.zeros(blocks * LANES, np.uint64)
    cells = float_lines(2 * blocks * LANES).reshape(2, blocks * LANES)
    for s in range(blocks * LANES):
        sample = min(s, count - 1)
        numbers[s], cells[0, s], cells[1, s] = sample, sample % grid, sample // grid
    # Paths of a whole row of texels go on together, so that blocks of sixteen stay full.
    waves = wave_scratch(texels * count)
    values = np.zeros(texels * count, np.float32)
    after_suns = next_state(np.uint64(0)) * np.uint64(1 + suns)
    for k in range(ids.shape[0]):
        i = ids[k]
        x, y, z, r = world.centers[i, 0], world.centers[i, 1], world.centers[i, 2], world.radii[i]
        known, reach = neighbours(world, work, near, i)
        site = Site(i, x, y, z, r, reach)
        for row in range(texels):
            paths = 0
            for column in range(texels):
                texel, base = row * texels + column, column * count
                _draw(world, mapping, i, texel, texels, grid, numbers, cells, rays, sun_rays, states)
                if world.model == LAMBERTIAN:
                    _plain(world, work, site, rays, count, values, base, states)
                    continue
                f = frames[texel]
                found = patch_neighbours(near, known, f[0], f[1], f[2], f[3])
                for s in range(count):
                    states[s] += after_suns
                if world.model == INTERREFLECTION:
                    paths = _first_stretch(
                        world, work, near, found, site, rays, count, values, base, states, waves, paths
                    )
                elif world.reach < FAR:
                    within_reach(world, work, near, found, site, rays, 0, count, values, base)
                else:
                    escaping(world, work, near, found, site, rays, 0, count, values, base)
                if world.model == SHADOWS:
                    _area_lights(world, work, site, rays, count, values, base, states)
                for q in range(suns):
                    add_sunlight(world, work, near, found, site, q, sun_rays[q], 0, count, values, base)
            follow_paths(world, work, near, known, site, waves, paths, values)
            for column in range(texels):
                total = total2 = 0.0
                seen = 0
                for s in range(column * count, (column + 1) * count):
                    value = values[s]
                    if value >= 0:
                        total += value
                        total2 += value * value
                        seen += 1
                mean[k, row, column] = total / seen if seen > 0 else 0.0
                variance[k, row, column] = (
                    max(0.0, total2 - total * total / seen) / (seen - 1) if seen > 1 else 0.0
                )
                exposed[k, row, column] = seen
