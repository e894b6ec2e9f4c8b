"""Warps from the unit square to directions with a density."""

from __future__ import annotations

import math

import numpy as np

from luxel.kernels.jit import kernel

__all__ = ["cone_direction", "cosine_direction", "to_frame", "turn"]

_TWO_PI = np.float32(2 * math.pi)
_ONE, _ZERO = np.float32(1), np.float32(0)


@kernel(inline=True)
def turn(v):
    """Cosine and sine of v turns, v in [0, 1]: to 3e-7, cheaper than libm's and the same on every platform."""
    quarter = int(np.float32(4) * v + np.float32(0.5))
    x = _TWO_PI * (v - np.float32(0.25) * np.float32(quarter))  # within an eighth of a turn
    x2 = x * x
    s = x * (_ONE + x2 * (np.float32(-1 / 6) + x2 * (np.float32(1 / 120) + x2 * np.float32(-1 / 5040))))
    c = _ONE + x2 * (
        np.float32(-1 / 2)
        + x2 * (np.float32(1 / 24) + x2 * (np.float32(-1 / 720) + x2 * np.float32(1 / 40320)))
    )
    quarter &= 3
    if quarter == 1:
        return -s, c
    if quarter == 2:
        return -c, -s
    if quarter == 3:
        return s, -c
    return c, s


@kernel(inline=True)
def to_frame(nx, ny, nz, x, y, z):
    """Express local (x, y, z) in a frame whose third axis is the unit vector n (Duff et al., JCGT 2017)."""
    sign = _ONE if nz >= 0 else -_ONE
    a = -_ONE / (sign + nz)
    b = nx * ny * a
    return (
        x * (_ONE + sign * nx * nx * a) + y * b + z * nx,
        x * sign * b + y * (sign + ny * ny * a) + z * ny,
        -x * sign * nx - y * ny + z * nz,
    )


@kernel(inline=True)
def cosine_direction(nx, ny, nz, u, v):
    """Unit vector about n with density cosθ/π."""
    r = np.sqrt(u)
    c, s = turn(v)
    return to_frame(nx, ny, nz, r * c, r * s, np.sqrt(max(_ZERO, _ONE - u)))


@kernel(inline=True)
def cone_direction(ax, ay, az, cos_half, u, v):
    """Unit vector within the cone of half angle acos(cos_half) about a, uniform in solid angle."""
    z = _ONE - u * (_ONE - cos_half)
    r = np.sqrt(max(_ZERO, _ONE - z * z))
    c, s = turn(v)
    return to_frame(ax, ay, az, r * c, r * s, z)
