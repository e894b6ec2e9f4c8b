"""Warps from the unit square to directions, and the latitude-longitude map."""

from __future__ import annotations

import math

import numpy as np

from luxel.kernels.jit import kernel

__all__ = ["cone_direction", "cosine_direction", "latlong_direction", "latlong_uv", "to_frame"]

_TWO_PI = np.float32(2 * math.pi)
_PI = np.float32(math.pi)
_INV_PI = np.float32(1 / math.pi)
_INV_TWO_PI = np.float32(0.5 / math.pi)
_ONE, _TWO, _ZERO = np.float32(1), np.float32(2), np.float32(0)


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
    phi = _TWO_PI * v
    return to_frame(nx, ny, nz, r * np.cos(phi), r * np.sin(phi), np.sqrt(max(_ZERO, _ONE - u)))


@kernel(inline=True)
def cone_direction(ax, ay, az, cos_half, u, v):
    """Unit vector within the cone of half angle acos(cos_half) about a, uniform in solid angle."""
    z = _ONE - u * (_ONE - cos_half)
    r = np.sqrt(max(_ZERO, _ONE - z * z))
    phi = _TWO_PI * v
    return to_frame(ax, ay, az, r * np.cos(phi), r * np.sin(phi), z)


@kernel(inline=True)
def latlong_direction(u, v):
    """Unit vector of (u, v) in [0, 1)²: azimuth 2πu from +X towards +Y, polar angle πv from +Z (paper 3.2)."""
    phi = _TWO_PI * u
    theta = _PI * v
    s = np.sin(theta)
    return s * np.cos(phi), s * np.sin(phi), np.cos(theta)


@kernel(inline=True)
def latlong_uv(x, y, z):
    """Inverse of `latlong_direction`; u in [0, 1]."""
    u = np.arctan2(y, x) * _INV_TWO_PI
    if u < 0:
        u += _ONE
    return u, np.arccos(min(_ONE, max(-_ONE, z))) * _INV_PI
