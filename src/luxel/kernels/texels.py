"""Samples of luminance over the texels of a particle by path tracing, to the letter of the paper (3.2).

All first rays of a particle go through its near field (``near``); what leaves it goes on through the tree.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.light import area_light
from luxel.kernels.mapping import texel_directions
from luxel.kernels.memory import float_lines, index
from luxel.kernels.near import RAY, Near, near_scratch, patch_neighbours
from luxel.kernels.path import INTERREFLECTION, LAMBERTIAN, SHADOWS, luminance_at
from luxel.kernels.periodic import HERE, LOST
from luxel.kernels.rays import (
    EVERY_RAY,
    Site,
    add_sunlight,
    bring,
    escaping,
    first_hits,
    hit_point,
    hits_beyond,
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
from luxel.kernels.waves import Waves, add_path, follow_paths, wave_scratch

__all__ = ["sample_texels"]

_ZERO, _ONE = np.float32(0), np.float32(1)


class _Pad(NamedTuple):
    """Working memory of one thread."""

    near: Near
    waves: Waves
    apart: (
        int  # blocks of sixteen rays from one texel of a row to the next; 0 where their rays need not be kept
    )
    rays: np.ndarray  # (blocks * RAY,) float32
    sun_rays: np.ndarray  # (suns, blocks * RAY) float32
    states: np.ndarray  # (blocks * 16,) uint64
    values: np.ndarray  # (row of texels * samples,) float32
    numbers: np.ndarray  # (blocks of a texel * 16,) uint64 its samples
    cells: np.ndarray  # (2, blocks of a texel * 16) float32: column and row of each within the texel


@kernel(inner=True)
def _make_pad(world, texels, grid):
    count = grid * grid
    blocks = (count + LANES - 1) // LANES
    suns = world.lights.suns.shape[0]
    # Paths of a whole row of texels go on together, so that blocks of sixteen are full; then their first rays have to be kept.
    near_first = _asks_what_is_met(world)
    apart, kept = (blocks, texels * blocks) if near_first else (0, blocks)
    # Samples that fill the last block up go with the last one.
    numbers = np.zeros(blocks * LANES, np.uint64)
    cells = float_lines(2 * blocks * LANES).reshape(2, blocks * LANES)
    for s in range(blocks * LANES):
        sample = min(s, count - 1)
        numbers[s], cells[0, s], cells[1, s] = sample, sample % grid, sample // grid
    return _Pad(
        near_scratch(kept * LANES), wave_scratch(world.tree, texels * count), apart,
        float_lines(kept * RAY), float_lines(suns * kept * RAY).reshape(suns, kept * RAY),
        np.zeros(kept * LANES, np.uint64), np.zeros(texels * count, np.float32), numbers, cells,
    )  # fmt: skip


@kernel(inline=True, borrows=True)
def _asks_what_is_met(world):
    """Whether the nearest hit of a first ray matters, instead of whether there is any."""
    return world.model == INTERREFLECTION or (world.model != LAMBERTIAN and world.reach < FAR)


@kernel(inline=True, borrows=True)
def _draw(world, pad, mapping, sphere, texel, texels, grid, first):
    """Draw a texel's first rays and those towards every sun, from word `first` on; numbers as in ``path.luminance_at``."""
    row, column = texel // texels, texel % texels
    step = _ONE / np.float32(texels * grid)
    left, top = splat(np.float32(column * grid)), splat(np.float32(row * grid))
    suns = world.lights.suns
    rays, sun_rays, cells = pad.rays, pad.sun_rays, pad.cells
    key = texel_key(world.seed, sphere, texel, PURPOSE_TEXEL)
    for block in range((grid * grid + LANES - 1) // LANES):
        o = first + block * RAY
        state = sample_key(key, load(pad.numbers, block * LANES))
        store(pad.states, o // RAY * LANES, state)
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


@kernel(borrows=True)
def _plain(world, work, pad, site, count, base):
    """Every sample by itself through the tree."""
    for s in range(count):
        ax, ay, az, px, py, pz = ray_start(site, pad.rays, ray_word(s))
        pad.values[base + s] = luminance_at(world, work, site.sphere, px, py, pz, ax, ay, az, pad.states[s])


@kernel(inline=True, borrows=True)
def _first_stretch(world, work, pad, site, first, count, base, hits, paths):
    """All that the first vertex of each sample receives but sunlight; buried samples become -1. What they meet is known, from `hits` on.

    Samples that meet a neighbour become paths; returns how many there are by now.
    """
    near, rays, values = pad.near, pad.rays, pad.values
    for s in range(count):
        t, hit = near.hit_t[hits + s], near.hit[hits + s]
        if hit >= 0 and t <= 0:
            values[base + s] = -_ONE
            continue
        o = first + ray_word(s)
        ax, ay, az, px, py, pz = ray_start(site, rays, o)
        value, state = area_light(
            world, work, True, px, py, pz, HERE, ax, ay, az, site.sphere, pad.states[hits + s]
        )
        if hit >= 0:
            t *= site.r
            hx, hy, hz, offset = hit_point(
                world.cell, near, hits + s, px + t * rays[o + 3 * LANES], py + t * rays[o + 4 * LANES],
                pz + t * rays[o + 5 * LANES],
            )  # fmt: skip
            add_path(world.cell, pad.waves, paths, base + s, hit, hx, hy, hz, offset, state)
            paths += 1
        elif hit != LOST:
            value += sky_along(world, site, rays, o)
        values[base + s] = value
    return paths


@kernel(borrows=True)
def _direct(world, work, pad, found, site, first, count, base, hits, listed):
    """Add area lights, unless they have been added, and suns; see ``rays.escaping``."""
    if world.model == SHADOWS and world.lights.globes.shape[0] + world.lights.quads.shape[0] > 0:
        for s in range(count):
            ax, ay, az, px, py, pz = ray_start(site, pad.rays, first + ray_word(s))
            pad.values[base + s] += area_light(
                world, work, True, px, py, pz, HERE, ax, ay, az, site.sphere, pad.states[hits + s]
            )[0]
    for q in range(world.lights.suns.shape[0]):
        listed = add_sunlight(
            world, work, pad.near, found, site, q, pad.sun_rays[q], first, count, pad.values, base,
            pad.waves.shadow, listed,
        )  # fmt: skip
    return listed


@kernel(inline=True, borrows=True)
def _sample_row(world, work, pad, known, site, mapping, row, texels, grid, frames):
    """Write the samples of a row of texels to ``pad.values``."""
    count, apart = index(grid * grid), index(pad.apart)
    near, waves, values = pad.near, pad.waves, pad.values
    near_first = _asks_what_is_met(world)
    after_suns = next_state(np.uint64(0)) * np.uint64(1 + world.lights.suns.shape[0])
    listed = in_shadow = paths = 0
    for column in range(texels):
        texel, base = row * texels + column, column * count
        first, hits = column * apart * RAY, column * apart * LANES
        _draw(world, pad, mapping, site.sphere, texel, texels, grid, first)
        if world.model == LAMBERTIAN:
            _plain(world, work, pad, site, count, base)
            continue
        for s in range(hits, hits + count):
            pad.states[s] += after_suns
        f = frames[texel]
        found = patch_neighbours(near, known, f[0], f[1], f[2], f[3])
        if near_first:
            listed = first_hits(
                world, work, near, found, site, pad.rays, first, count, EVERY_RAY, hits, waves.beyond, listed
            )
        else:
            in_shadow = escaping(
                world, work, near, found, site, pad.rays, first, count, values, base, waves.shadow, in_shadow
            )
            in_shadow = _direct(world, work, pad, found, site, first, count, base, hits, in_shadow)
    hits_beyond(world, work, near, site, waves.beyond, listed)
    for column in range(texels if near_first else 0):
        first, hits, base = column * apart * RAY, column * apart * LANES, column * count
        if world.model == INTERREFLECTION:
            paths = _first_stretch(world, work, pad, site, first, count, base, hits, paths)
        else:
            within_reach(world, near, site, pad.rays, first, count, hits, values, base)
        f = frames[row * texels + column]
        found = patch_neighbours(near, known, f[0], f[1], f[2], f[3])
        in_shadow = _direct(world, work, pad, found, site, first, count, base, hits, in_shadow)
    bring(world, work, waves.shadow, in_shadow, values)
    follow_paths(world, work, near, known, site, waves, paths, values)


@kernel(inline=True, borrows=True)
def _sample(world, work, pad, mapping, particle, grid, frames, mean, variance, exposed):
    """Sample one texture."""
    count, texels = grid * grid, mean.shape[0]
    known, reach = neighbours(world, work, pad.near, particle)
    x, y, z = world.centers[particle, 0], world.centers[particle, 1], world.centers[particle, 2]
    site = Site(particle, x, y, z, world.radii[particle], reach)
    for row in range(texels):
        _sample_row(world, work, pad, known, site, mapping, row, texels, grid, frames)
        for column in range(texels):
            total = total2 = 0.0
            seen = 0
            for s in range(column * count, (column + 1) * count):
                value = pad.values[s]
                if value >= 0:
                    total += value
                    total2 += value * value
                    seen += 1
            mean[row, column] = total / seen if seen > 0 else 0.0
            variance[row, column] = max(0.0, total2 - total * total / seen) / (seen - 1) if seen > 1 else 0.0
            exposed[row, column] = seen


@kernel(borrows=True)
def _sample_all(world, work, pad, mapping, ids, grid, frames, mean, variance, exposed):
    """Sample textures; without reference counts, which of some dozens of arrays would cost a tenth of the time."""
    for k in range(ids.shape[0]):
        _sample(world, work, pad, mapping, ids[k], grid, frames, mean[k], variance[k], exposed[k])


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
    work, pad = scratch(world.tree.stack_size), _make_pad(world, mean.shape[1], grid)
    _sample_all(world, work, pad, mapping, ids, grid, frames, mean, variance, exposed)
