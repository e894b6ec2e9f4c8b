"""Coarse records of the light on particles, and the links between particles that they are solved from.

A record is four or nine numbers, T(n) = max(0, c · (1, x, y, z, xy, yz, zx, x² - y², 3z² - 1)): spherical harmonics up to
order 1 or 2. The rays of a small set are traced once and kept as links (particle met, normal there, direct light
there); T = E + albedo K T is then a sparse linear system, solved by Jacobi iteration (radiosity: Goral et al. 1984).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.light import direct_light, escape_radiance
from luxel.kernels.near import RAY, collect, near_scratch, patch_neighbours
from luxel.kernels.path import INTERREFLECTION
from luxel.kernels.rays import Site, add_direct, first_hits, ray_start, ray_word, set_of
from luxel.kernels.rng import PURPOSE_TEXEL, path_key
from luxel.kernels.simd import LANES
from luxel.kernels.tree_trace import scratch

__all__ = [
    "Links", "Records", "first_light", "is_lit", "light_links", "record_luminance", "relax", "trace_links",
]  # fmt: skip

_ZERO, _HALF, _ONE, _TWO, _THREE = (np.float32(v) for v in (0, 0.5, 1, 2, 3))
_ESCAPED, _BURIED = np.int32(-1), np.int32(-2)
# Coefficients are fitted with this much doubt, in rays: order 1, order 2.
_DOUBT, _MORE_DOUBT = np.float32(0.3), np.float32(0.5)
_STEPS = np.float32(4096)  # of the luminance scale: fixed point of direct light at links


class Records(NamedTuple):
    """Coarse light on every particle."""

    direct: np.ndarray  # (N, 4) float32: suns and area lights; all 0 where no ray of the particle saw any
    rest: np.ndarray  # (N, 9) float32: sky and all bounces


class Links(NamedTuple):
    """Where the R link rays of every particle end."""

    particle: np.ndarray  # (N, R) int32, negative for rays that escaped or were buried
    normal: np.ndarray  # (N, R) uint16, octahedral
    direct: np.ndarray  # (N, R) uint16: direct light there, in 1/4096 of `scale`
    scale: np.float32


@kernel(inline=True)
def record_luminance(records, particle, x, y, z):
    """Luminance of a record towards the unit normal (x, y, z)."""
    c = records[particle]
    value = c[0] + c[1] * x + c[2] * y + c[3] * z
    if records.shape[1] == 9:
        value += c[4] * x * y + c[5] * y * z + c[6] * z * x + c[7] * (x * x - y * y) + c[8] * (_THREE * z * z - _ONE)
    return max(_ZERO, value)


@kernel(inline=True)
def is_lit(direct, particle):
    """Whether any link ray of a particle saw a sun or an area light."""
    return direct[particle, 0] != 0 or direct[particle, 1] != 0


@kernel(inline=True)
def _pack_normal(nx, ny, nz):
    """Octahedral map to two bytes (Meyer et al. 2010)."""
    scale = _ONE / (abs(nx) + abs(ny) + abs(nz))
    u, v = nx * scale, ny * scale
    if nz < 0:
        u, v = (_ONE - abs(v)) * (_ONE if u >= 0 else -_ONE), (_ONE - abs(u)) * (_ONE if v >= 0 else -_ONE)
    steps = np.float32(127.5)
    return (int(u * steps + np.float32(128)) << 8) | int(v * steps + np.float32(128))


@kernel(inline=True)
def _unpack_normal(code):
    u = np.float32(code >> 8) * np.float32(2 / 255) - _ONE
    v = np.float32(code & 255) * np.float32(2 / 255) - _ONE
    z = _ONE - abs(u) - abs(v)
    if z < 0:
        u, v = (_ONE - abs(v)) * (_ONE if u >= 0 else -_ONE), (_ONE - abs(u)) * (_ONE if v >= 0 else -_ONE)
    scale = _ONE / np.sqrt(u * u + v * v + z * z)
    return u * scale, v * scale, z * scale


@kernel
def trace_links(world, table, ids, links, direct):
    """Trace the link rays of particles `ids` (K,): writes K rows of `links` and of `direct` (K, 4)."""
    work = scratch(world.tree.stack_size)
    count = table.texel.shape[0]
    blocks = count // LANES
    near = near_scratch(table.width * LANES)
    values = np.zeros(count, np.float32)
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
                o = first + ray_word(s)
                values[at + s] = _ZERO
                links.normal[k, at + s] = links.direct[k, at + s] = 0
                if hit < 0:
                    links.particle[k, at + s] = _ESCAPED
                elif t <= 0:
                    values[at + s] = -_ONE
                    links.particle[k, at + s] = _BURIED
                else:
                    links.particle[k, at + s] = hit
                    _, _, _, px, py, pz = ray_start(site, rays, o)
                    t *= r
                    links.normal[k, at + s] = _pack_normal(
                        px + t * rays[o + 3 * LANES] - world.centers[hit, 0],
                        py + t * rays[o + 4 * LANES] - world.centers[hit, 1],
                        pz + t * rays[o + 5 * LANES] - world.centers[hit, 2],
                    )
            add_direct(world, work, near, found, site, table, chosen_set, first, block, here, values[at : at + here])
        _fit(rays, count, values, direct[k], 4)


@kernel
def light_links(world, ids, links, direct):
    """Direct light where the links of particles `ids` (K,) end, by shadow rays to particles that see any.

    `links` has K rows, `direct` (N, 4) all.
    """
    work = scratch(world.tree.stack_size)
    for k in range(ids.shape[0]):
        i = ids[k]
        for s in range(links.particle.shape[1]):
            j = links.particle[k, s]
            if j < 0 or not is_lit(direct, j):
                continue
            nx, ny, nz = _unpack_normal(links.normal[k, s])
            r = world.radii[j]
            value = direct_light(
                world.tree, work, world.lights, True, world.centers[j, 0] + r * nx, world.centers[j, 1] + r * ny,
                world.centers[j, 2] + r * nz, nx, ny, nz, j, path_key(world.seed, i, s, 3, PURPOSE_TEXEL),
            )[0]  # fmt: skip
            links.direct[k, s] = int(min(value / links.scale * _STEPS + _HALF, np.float32(65535)))


@kernel(inline=True)
def _escape(world, particle, rays, o):
    return escape_radiance(
        world.lights, world.centers[particle, 0], world.centers[particle, 1], world.centers[particle, 2],
        rays[o + 3 * LANES], rays[o + 4 * LANES], rays[o + 5 * LANES],
    )  # fmt: skip


@kernel
def relax(world, table, first, links, old, new):
    """One Jacobi step for particles `first` and on: new = sky + albedo K (direct + old); returns the largest change of a mean.

    `links` and `new` have a row for each of them, `new` with 4 or 9 columns; `old` (N, 4) has all.
    """
    count = links.particle.shape[1]
    values = np.zeros(count, np.float32)
    change = _ZERO
    step = links.scale / _STEPS
    for k in range(new.shape[0]):
        rays = table.rays[set_of(world, first + k, table.rays.shape[0])]
        any_light = False
        for s in range(count):
            link = links.particle[k, s]
            if link >= 0:
                nx, ny, nz = _unpack_normal(links.normal[k, s])
                values[s] = world.albedo * (
                    np.float32(links.direct[k, s]) * step + record_luminance(old, link, nx, ny, nz)
                )
            elif link == _BURIED:
                values[s] = -_ONE
            else:
                values[s] = _escape(world, first + k, rays, ray_word(s))
            any_light |= values[s] > 0
        if not any_light:
            new[k] = _ZERO
        elif new.shape[1] == 4:
            _fit(rays, count, values, new[k], 4)
        else:
            _fit(rays, count, values, new[k], 9)
        change = max(change, abs(new[k, 0] - old[first + k, 0]))
    return change


@kernel
def first_light(world, table, ids, links, direct, records):
    """Records (K, 4) of particles `ids` by themselves; a ray that meets another brings home its own particle's mean.

    `links` and `direct` (K, 4) are working memory.
    """
    trace_links(world, table, ids, links, direct)
    count = links.particle.shape[1]
    values = np.zeros(count, np.float32)
    for k in range(ids.shape[0]):
        rays = table.rays[set_of(world, ids[k], table.rays.shape[0])]
        blocked = exposed = total = _ZERO
        for s in range(count):
            link = links.particle[k, s]
            values[s] = -_ONE if link == _BURIED else _ZERO
            if link == _ESCAPED:
                values[s] = _escape(world, ids[k], rays, ray_word(s))
            if link != _BURIED:
                exposed += _ONE
                total += values[s]
                blocked += _ONE if link >= 0 else _ZERO
        if exposed > 0 and world.model == INTERREFLECTION:
            # m = own + albedo · blocked share · m
            own = total / exposed + max(_ZERO, direct[k, 0])
            guess = world.albedo * own
            for s in range(count):
                if links.particle[k, s] >= 0:
                    values[s] = guess
        _fit(rays, count, values, records[k], 4)
        for c in range(4):
            records[k, c] += direct[k, c]
        records[k, 0] = max(_ZERO, records[k, 0])


@kernel(inline=True)
def _fit(rays, count, values, record, size):
    """Fit a record of `size` numbers to the values (count,) at the starts of `rays` that are not negative, by damped least squares."""
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
    if m[0, 0] == 0:
        record[:] = _ZERO
        return
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
