"""Closed-form Lambert for sixteen points at a time, with or without a shadow ray towards the middle of each light."""

from __future__ import annotations

import math

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.simd import FAR, LANES, fma, load, select, splat, store, vmax, vsqrt
from luxel.kernels.tree_trace import occluded

__all__ = ["lambert_lanes"]

_ZERO, _HALF, _ONE, _TWO, _FOUR = (np.float32(x) for x in (0, 0.5, 1, 2, 4))
_INV_PI = np.float32(1 / math.pi)
_TINY = np.float32(1e-20)


@kernel(inline=True)
def _soft(c, s):
    """As ``light._soft``: clamped cosine of a cap whose edge sets over the horizon."""
    setting = (c + s) * (c + s) / vmax(_FOUR * s, splat(_TINY))
    return select(c >= s, c, select(c <= -s, splat(_ZERO), setting))


@kernel(borrows=True)
def _unshadowed(tree, work, spare, who, at):
    """Zero what lanes with a particle hold in `spare`, where a ray from there (its words from 16 on) meets another particle."""
    for k in range(LANES):
        if who[at + k] >= 0 and spare[k] > 0 and occluded(
            tree, work, spare[LANES + k], spare[2 * LANES + k], spare[3 * LANES + k],
            spare[4 * LANES + k], spare[5 * LANES + k], spare[6 * LANES + k], spare[7 * LANES + k], who[at + k],
        ):  # fmt: skip
            spare[k] = _ZERO


@kernel(inline=True, borrows=True)
def _add(total, share, shadows, tree, work, spare, dx, dy, dz, reach, who, at):
    """Add a light's share to `total`, where it is in sight if `shadows` matter."""
    if not shadows:
        return total + share
    store(spare, 0, share)
    store(spare, 4 * LANES, dx)
    store(spare, 5 * LANES, dy)
    store(spare, 6 * LANES, dz)
    store(spare, 7 * LANES, reach)
    _unshadowed(tree, work, spare, who, at)
    return total + load(spare, 0)


@kernel(borrows=True, inner=True)
def lambert_lanes(lights, shadows, tree, work, spare, x, y, z, nx, ny, nz, who, at):
    """Unshadowed direct light at sixteen points with unit normals, as ``light.lambert``; sky light is never shadowed.

    With `shadows`, a ray from each point to the middle of each light decides whether the light counts: hard shadows,
    the paper's baseline. `who` holds, from `at` on, the particle of each point, -1 where nobody asks; `spare` has
    room for 8 · 16 words.
    """
    sky = lights.sky
    slope = _HALF * (
        _ONE + _TWO / np.float32(3) * fma(nx, splat(sky[2]), fma(ny, splat(sky[3]), nz * sky[4]))
    )
    total = sky[1] + (sky[0] - sky[1]) * slope
    store(spare, LANES, x)
    store(spare, 2 * LANES, y)
    store(spare, 3 * LANES, z)
    for k in range(lights.suns.shape[0]):
        sun = lights.suns
        dx, dy, dz = splat(sun[k, 0]), splat(sun[k, 1]), splat(sun[k, 2])
        share = sun[k, 3] * _soft(fma(nx, dx, fma(ny, dy, nz * dz)), splat(sun[k, 4]))
        total = _add(total, share, shadows, tree, work, spare, dx, dy, dz, splat(FAR), who, at)
    for k in range(lights.globes.shape[0]):
        globe = lights.globes
        cx, cy, cz = globe[k, 0] - x, globe[k, 1] - y, globe[k, 2] - z
        r = globe[k, 3]
        d2 = fma(cx, cx, fma(cy, cy, cz * cz))
        d = vsqrt(vmax(d2, splat(_TINY)))
        dx, dy, dz = cx / d, cy / d, cz / d
        share = globe[k, 4] * r * r / vmax(d2, splat(_TINY)) * _soft(fma(nx, dx, fma(ny, dy, nz * dz)), r / d)
        share = select(d2 > splat(r * r), share, splat(_ZERO))  # inside the light: it shines outwards only
        total = _add(total, share, shadows, tree, work, spare, dx, dy, dz, d - r, who, at)
    for k in range(lights.quads.shape[0]):
        q = lights.quads
        cx = q[k, 0] + _HALF * (q[k, 3] + q[k, 6]) - x
        cy = q[k, 1] + _HALF * (q[k, 4] + q[k, 7]) - y
        cz = q[k, 2] + _HALF * (q[k, 5] + q[k, 8]) - z
        d2 = vmax(fma(cx, cx, fma(cy, cy, cz * cz)), splat(_TINY))
        d = vsqrt(d2)
        dx, dy, dz = cx / d, cy / d, cz / d
        c = vmax(splat(_ZERO), fma(nx, dx, fma(ny, dy, nz * dz)))
        facing = vmax(splat(_ZERO), -(q[k, 9] * dx + q[k, 10] * dy + q[k, 11] * dz))
        share = q[k, 13] * q[k, 12] * _INV_PI * (c * facing) / d2
        total = _add(total, share, shadows, tree, work, spare, dx, dy, dz, d, who, at)
    return total
