"""Light sources in kernels: radiance along escaping rays, samples towards lights, closed-form Lambert."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.periodic import shadowed
from luxel.kernels.rng import next_state, uniform
from luxel.kernels.warp import cone_direction

__all__ = [
    "Lights",
    "area_light",
    "direct_light",
    "escape_radiance",
    "hidden_by_light",
    "lambert",
    "sky_irradiance",
    "sun_direction",
    "sun_luminance",
]

_ZERO, _HALF, _ONE, _TWO = np.float32(0), np.float32(0.5), np.float32(1), np.float32(2)
_INV_PI = np.float32(1 / math.pi)
_FAR = np.float32(1e30)


class Lights(NamedTuple):
    """Lights in normalised units, float32."""

    sky: np.ndarray  # (5,) level, ground, axis
    suns: np.ndarray  # (S, 6) direction, level, sin and cos of half the angular diameter
    globes: np.ndarray  # (K, 5) center, radius, level
    quads: np.ndarray  # (Q, 14) corner, edge u, edge v, normal, area, level


@kernel(inline=True, borrows=True)
def _sky(sky, dx, dy, dz):
    slope = _HALF * (_ONE + dx * sky[2] + dy * sky[3] + dz * sky[4])
    return sky[1] + (sky[0] - sky[1]) * slope


@kernel(inline=True, borrows=True)
def sky_irradiance(sky, nx, ny, nz):
    """Luminance of an open surface under the sky: (1/π) ∫ L cosθ dω."""
    slope = _HALF * (_ONE + _TWO / np.float32(3) * (nx * sky[2] + ny * sky[3] + nz * sky[4]))
    return sky[1] + (sky[0] - sky[1]) * slope


@kernel(borrows=True)
def _light_distance(lights, ox, oy, oz, dx, dy, dz):
    """Distance to the nearest area light that shines towards the origin of the ray, or FAR."""
    nearest = _FAR
    for k in range(lights.globes.shape[0]):
        g = lights.globes[k]
        cx, cy, cz = g[0] - ox, g[1] - oy, g[2] - oz
        b = cx * dx + cy * dy + cz * dz
        px, py, pz = cx - b * dx, cy - b * dy, cz - b * dz
        disc = g[3] * g[3] - (px * px + py * py + pz * pz)
        if b > 0 and disc > 0:
            t = b - np.sqrt(disc)
            if t > 0:
                nearest = min(nearest, t)
    for k in range(lights.quads.shape[0]):
        q = lights.quads[k]
        facing = -(q[9] * dx + q[10] * dy + q[11] * dz)
        if facing > 0:
            ex, ey, ez = q[0] - ox, q[1] - oy, q[2] - oz
            t = -(ex * q[9] + ey * q[10] + ez * q[11]) / facing
            if 0 < t < nearest:
                hx, hy, hz = t * dx - ex, t * dy - ey, t * dz - ez
                # Coordinates in the (skewed) basis of the edges, by their cross products with the normal.
                u = (
                    hx * (q[7] * q[11] - q[8] * q[10])
                    + hy * (q[8] * q[9] - q[6] * q[11])
                    + hz * (q[6] * q[10] - q[7] * q[9])
                ) / q[12]
                v = (
                    hx * (q[10] * q[5] - q[11] * q[4])
                    + hy * (q[11] * q[3] - q[9] * q[5])
                    + hz * (q[9] * q[4] - q[10] * q[3])
                ) / q[12]
                if 0 <= u <= 1 and 0 <= v <= 1:
                    nearest = t
    return nearest


@kernel(borrows=True, inner=True)
def escape_radiance(lights, ox, oy, oz, dx, dy, dz):
    """Sky radiance along a ray that met no sphere; 0 where an area light stands before the sky.

    The light's own radiance is left to `direct_light`, which samples it at every vertex.
    """
    if lights.globes.shape[0] + lights.quads.shape[0] > 0:
        if _light_distance(lights, ox, oy, oz, dx, dy, dz) < _FAR:
            return _ZERO
    return _sky(lights.sky, dx, dy, dz)


@kernel(inline=True, borrows=True)
def hidden_by_light(lights, px, py, pz, dx, dy, dz, distance):
    """Whether an area light stands nearer than `distance` along a ray."""
    if lights.globes.shape[0] + lights.quads.shape[0] == 0:
        return False
    return _light_distance(lights, px, py, pz, dx, dy, dz) < distance * np.float32(0.9999)


@kernel(inline=True, borrows=True)
def _blocked(world, work, shadows, px, py, pz, offset, dx, dy, dz, distance, skip):
    lx, ly, lz = px + offset[0], py + offset[1], pz + offset[2]
    if hidden_by_light(world.lights, lx, ly, lz, dx, dy, dz, distance):
        return True
    return shadows and shadowed(world.cell, world, work, px, py, pz, dx, dy, dz, distance, skip)


@kernel(inline=True, borrows=True)
def sun_direction(lights, k, u, v):
    """Direction towards a point of sun k's disc, uniform in solid angle."""
    s = lights.suns[k]
    return cone_direction(s[0], s[1], s[2], s[5], u, v)


@kernel(inline=True, borrows=True)
def sun_luminance(lights, k, cosine):
    """One-sample estimate of sun k's share of T for an open ray at `cosine` from the normal."""
    s = lights.suns[k]
    return s[3] * cosine * _TWO / (_ONE + s[5])


@kernel(borrows=True, inner=True)
def direct_light(world, work, shadows, px, py, pz, offset, nx, ny, nz, skip, state):
    """One-sample estimate of (1/π) ∫ L cosθ dω over suns, spheres and quads; returns (luminance, state).

    The point lies on particle `skip`; `offset` (three numbers) leads to the image of it that is lit, since lights do
    not repeat with a periodic cell.
    """
    lights = world.lights
    total = _ZERO
    for k in range(lights.suns.shape[0]):
        state = next_state(state)
        u, v = uniform(state)
        dx, dy, dz = sun_direction(lights, k, u, v)
        c = nx * dx + ny * dy + nz * dz
        if c > 0 and not _blocked(world, work, shadows, px, py, pz, offset, dx, dy, dz, _FAR, skip):
            total += sun_luminance(lights, k, c)
    area, state = area_light(world, work, shadows, px, py, pz, offset, nx, ny, nz, skip, state)
    return total + area, state


@kernel(borrows=True, inner=True)
def area_light(world, work, shadows, px, py, pz, offset, nx, ny, nz, skip, state):
    """As `direct_light`, spheres and quads only."""
    lights = world.lights
    lx, ly, lz = px + offset[0], py + offset[1], pz + offset[2]
    total = _ZERO
    for k in range(lights.globes.shape[0]):
        g = lights.globes[k]
        state = next_state(state)
        u, v = uniform(state)
        cx, cy, cz = g[0] - lx, g[1] - ly, g[2] - lz
        d2 = cx * cx + cy * cy + cz * cz
        r2 = g[3] * g[3]
        if d2 <= r2:
            continue  # inside the light: it shines outwards only
        d = np.sqrt(d2)
        sin2 = r2 / d2
        cos_half = np.sqrt(_ONE - sin2)
        cap = sin2 / (_ONE + cos_half)  # 1 - cos_half without cancellation
        dx, dy, dz = cone_direction(cx / d, cy / d, cz / d, _ONE - cap, u, v)
        c = nx * dx + ny * dy + nz * dz
        if c > 0:
            b = cx * dx + cy * dy + cz * dz
            # As in `_light_distance`, to the bit: the light must not seem to stand before itself.
            ox, oy, oz = cx - b * dx, cy - b * dy, cz - b * dz
            t = b - np.sqrt(max(_ZERO, r2 - (ox * ox + oy * oy + oz * oz)))
            if not _blocked(world, work, shadows, px, py, pz, offset, dx, dy, dz, t, skip):
                total += g[4] * c * _TWO * cap
    for k in range(lights.quads.shape[0]):
        q = lights.quads[k]
        state = next_state(state)
        u, v = uniform(state)
        ex, ey, ez = (
            q[0] + u * q[3] + v * q[6] - lx,
            q[1] + u * q[4] + v * q[7] - ly,
            q[2] + u * q[5] + v * q[8] - lz,
        )
        d2 = ex * ex + ey * ey + ez * ez
        d = np.sqrt(d2)
        if d <= 0:
            continue
        dx, dy, dz = ex / d, ey / d, ez / d
        c = nx * dx + ny * dy + nz * dz
        facing = -(q[9] * dx + q[10] * dy + q[11] * dz)
        if (
            c > 0
            and facing > 0
            and not _blocked(world, work, shadows, px, py, pz, offset, dx, dy, dz, d, skip)
        ):
            total += q[13] * c * facing * q[12] * _INV_PI / d2
    return total, state


@kernel(inline=True)
def _soft(c, s):
    """Clamped cosine of a cap whose edge sets over the horizon: smooth, exact outside |c| < s."""
    if c >= s:
        return c
    if c <= -s:
        return _ZERO
    return (c + s) * (c + s) / (np.float32(4) * s)


@kernel
def lambert(lights, px, py, pz, nx, ny, nz):
    """Unshadowed direct light in closed form: what is shown until a texture arrives. The browser has the same formula."""
    total = sky_irradiance(lights.sky, nx, ny, nz)
    for k in range(lights.suns.shape[0]):
        s = lights.suns[k]
        total += s[3] * _soft(nx * s[0] + ny * s[1] + nz * s[2], s[4])
    for k in range(lights.globes.shape[0]):
        g = lights.globes[k]
        cx, cy, cz = g[0] - px, g[1] - py, g[2] - pz
        d2 = cx * cx + cy * cy + cz * cz
        if d2 > g[3] * g[3]:
            d = np.sqrt(d2)
            total += g[4] * g[3] * g[3] / d2 * _soft((nx * cx + ny * cy + nz * cz) / d, g[3] / d)
    for k in range(lights.quads.shape[0]):
        q = lights.quads[k]
        cx = q[0] + _HALF * (q[3] + q[6]) - px
        cy = q[1] + _HALF * (q[4] + q[7]) - py
        cz = q[2] + _HALF * (q[5] + q[8]) - pz
        d2 = cx * cx + cy * cy + cz * cz
        if d2 > 0:
            d = np.sqrt(d2)
            c = max(_ZERO, (nx * cx + ny * cy + nz * cz) / d)
            facing = max(_ZERO, -(q[9] * cx + q[10] * cy + q[11] * cz) / d)
            total += q[13] * c * facing * q[12] * _INV_PI / d2
    return total
