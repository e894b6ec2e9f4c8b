"""Warps from the unit square to directions with a density."""

from __future__ import annotations

import math

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.simd import fma, select, splat, vabs, vmax, vsqrt

__all__ = [
    "cone_direction",
    "cone_directions",
    "cosine_direction",
    "cosine_directions",
    "to_frame",
    "turn",
    "turns",
]

_TWO_PI = np.float32(2 * math.pi)
_ONE, _ZERO = np.float32(1), np.float32(0)
_HALF, _QUARTER, _EIGHTH = np.float32(0.5), np.float32(0.25), np.float32(0.125)


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


@kernel(inline=True)
def turns(v):
    """As `turn`, sixteen at a time."""
    y = v - splat(_HALF)
    a = vabs(y)
    far = a > splat(_QUARTER)
    b = select(far, _HALF - a, a)
    steep = b > splat(_EIGHTH)
    x = _TWO_PI * select(steep, _QUARTER - b, b)
    x2 = x * x
    s = fma(x2, splat(np.float32(-1 / 5040)), splat(np.float32(1 / 120)))
    s = x * fma(x2, fma(x2, s, splat(np.float32(-1 / 6))), splat(_ONE))
    c = fma(x2, splat(np.float32(1 / 40320)), splat(np.float32(-1 / 720)))
    c = fma(x2, fma(x2, fma(x2, c, splat(np.float32(1 / 24))), splat(np.float32(-1 / 2))), splat(_ONE))
    sine, cosine = select(steep, c, s), select(steep, s, c)
    # Half a turn away from y: both change sign.
    return select(far, cosine, -cosine), select(y < splat(_ZERO), sine, -sine)


@kernel(inline=True)
def _to_frames(nx, ny, nz, x, y, z):
    one = splat(_ONE)
    sign = select(nz >= splat(_ZERO), one, -one)
    a = -one / (sign + nz)
    b = nx * ny * a
    return (
        x * fma(sign * nx, nx * a, one) + y * b + z * nx,
        x * sign * b + y * fma(ny, ny * a, sign) + z * ny,
        z * nz - x * sign * nx - y * ny,
    )


@kernel(inline=True)
def cosine_directions(nx, ny, nz, u, v):
    """As `cosine_direction`, sixteen at a time."""
    r = vsqrt(u)
    c, s = turns(v)
    return _to_frames(nx, ny, nz, r * c, r * s, vsqrt(vmax(splat(_ZERO), _ONE - u)))


@kernel(inline=True)
def cone_directions(ax, ay, az, cos_half, u, v):
    """As `cone_direction`, sixteen at a time about one axis."""
    z = splat(_ONE) - u * (_ONE - cos_half)
    r = vsqrt(vmax(splat(_ZERO), _ONE - z * z))
    c, s = turns(v)
    return _to_frames(splat(ax), splat(ay), splat(az), r * c, r * s, z)
