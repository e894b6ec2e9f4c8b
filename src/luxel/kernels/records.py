"""Coarse records of the light on particles: what gathers look up where they end, and the first light that is shown.

A record is nine numbers, T(n) = max(0, c · (1, x, y, z, xy, yz, zx, x² - y², 3z² - 1)): spherical harmonics up to order
2, as Ramamoorthi and Hanrahan (2001) showed to suffice for irradiance. It is fitted to a few paths of its own, so it
depends on no other record and on nothing but its particle.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.near import RAY, near_scratch, patch_neighbours
from luxel.kernels.path import INTERREFLECTION, path_tail
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
from luxel.kernels.rng import PURPOSE_TEXEL, path_key
from luxel.kernels.simd import LANES
from luxel.kernels.tree_trace import MISS, scratch

__all__ = ["Records", "make_records", "record_luminance"]

_ZERO, _ONE, _THREE = np.float32(0), np.float32(1), np.float32(3)
# Coefficients are fitted with this much doubt, in rays: order 1, order 2.
_DOUBT, _MORE_DOUBT = np.float32(0.3), np.float32(0.5)


class Records(NamedTuple):
    """Coarse light on every particle."""

    whole: np.ndarray  # (N, 4) float32, orders 0 and 1 alone: all light
    rest: np.ndarray  # (N, 9) float32: sky and all bounces
    lit: np.ndarray  # (N,) bool: whether any ray saw a sun or an area light


@kernel(inline=True, borrows=True)
def record_luminance(rest, particle, x, y, z):
    """Sky and bounces of a record towards the unit normal (x, y, z)."""
    c = rest[particle]
    value = c[0] + c[1] * x + c[2] * y + c[3] * z
    value += (
        c[4] * x * y + c[5] * y * z + c[6] * z * x + c[7] * (x * x - y * y) + c[8] * (_THREE * z * z - _ONE)
    )
    return max(_ZERO, value)


@kernel
def make_records(world, table, ids, records):
    """Records of particles `ids` (K,): writes K rows of `records`."""
    work = scratch(world.tree.stack_size)
    count = table.texel.shape[0]
    blocks = count // LANES
    near = near_scratch(table.width * LANES)
    values, lit = np.zeros(count, np.float32), np.zeros(count, np.float32)
    bounces = world.model == INTERREFLECTION and world.albedo > 0
    for k in range(ids.shape[0]):
        i = ids[k]
        x, y, z, r = world.centers[i, 0], world.centers[i, 1], world.centers[i, 2], world.radii[i]
        chosen_set = set_of(world, i, table.rays.shape[0])
        rays = table.rays[chosen_set]
        known, reach = neighbours(world, work, near, i)
        site = Site(i, x, y, z, r, reach)
        any_light = False
        for patch in range(table.patches.shape[0]):
            block = patch * table.width
            first, at = block * RAY, block * LANES
            here = min(table.width, blocks - block) * LANES
            p = table.patches[patch]
            found = patch_neighbours(near, known, p[0], p[1], p[2], p[3])
            first_hits(world, work, near, found, site, rays, first, here)
            for s in range(here):
                t, hit = near.hit_t[s], near.hit[s]
                o = first + ray_word(s)
                value = _ZERO
                if hit == MISS or (hit >= 0 and t * r >= world.reach):
                    value = sky_along(world, site, rays, o)
                elif hit >= 0 and t <= 0:
                    value = -_ONE
                elif hit >= 0 and bounces:
                    _, _, _, px, py, pz = ray_start(site, rays, o)
                    t *= r
                    px, py, pz, offset = hit_point(
                        world.cell, near, s, px + t * rays[o + 3 * LANES], py + t * rays[o + 4 * LANES],
                        pz + t * rays[o + 5 * LANES],
                    )  # fmt: skip
                    state = path_key(world.seed, i, at + s, 3, PURPOSE_TEXEL)
                    value = path_tail(world, work, hit, px, py, pz, offset, state)
                values[at + s] = value
                lit[at + s] = min(_ZERO, value)
                any_light |= value > 0
            add_direct(world, work, near, found, site, table, chosen_set, block, here, lit[at : at + here])
        if any_light:
            _fit(rays, count, values, records.rest[k], 9)
        else:
            records.rest[k] = _ZERO
        records.lit[k] = False
        for s in range(count):
            if lit[s] > 0:
                records.lit[k] = any_light = True
                values[s] += lit[s]
        if any_light:
            _fit(rays, count, values, records.whole[k], 4)
        else:
            records.whole[k] = _ZERO


@kernel(inline=True)
def _fit(rays, count, values, record, size):
    """Fit `size` numbers to the values (count,) at the starts of `rays` that are not negative, by damped least squares."""
    m = np.zeros((9, 10), np.float32)
    phi = np.zeros(9, np.float32)
    for s in range(count):
        value = values[s]
        if value < 0:
            continue
        o = ray_word(s)
        x, y, z = rays[o], rays[o + LANES], rays[o + 2 * LANES]
        phi[0], phi[1], phi[2], phi[3] = _ONE, x, y, z
        phi[4], phi[5], phi[6], phi[7], phi[8] = x * y, y * z, z * x, x * x - y * y, _THREE * z * z - _ONE
        for a in range(size):
            for b in range(a, size):
                m[a, b] += phi[a] * phi[b]
            m[a, 9] += phi[a] * value
    for a in range(1, size):
        m[a, a] += _DOUBT if a < 4 else _MORE_DOUBT
        for b in range(a):
            m[a, b] = m[b, a]
    for pivot in range(size):  # positive definite: no pivoting
        for row in range(pivot + 1, size):
            factor = m[row, pivot] / m[pivot, pivot]
            for column in range(pivot, size):
                m[row, column] -= factor * m[pivot, column]
            m[row, 9] -= factor * m[pivot, 9]
    for row in range(size - 1, -1, -1):
        value = m[row, 9]
        for column in range(row + 1, size):
            value -= m[row, column] * record[column]
        record[row] = value / m[row, row]
