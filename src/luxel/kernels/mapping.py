"""Maps between the unit square of a texture and directions, and what lies beyond the square's edges.

Latitude-longitude is the paper's (3.2). The octahedral one is equal-area (Clarberg, "Fast Equal-Area Mapping of the
(Hemi)Sphere using SIMD", JGT 2008): +Z in the middle of the square, -Z in its four corners, the equator on the square
between the middles of its sides.
"""

from __future__ import annotations

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.simd import LANES, fma, load, select, splat, store, to_int, vabs, vfloor, vmax, vmin, vsqrt
from luxel.kernels.warp import turn, turns

__all__ = [
    "CORNER_STRIDE",
    "LATLONG",
    "OCTAHEDRAL",
    "point_directions",
    "square_directions",
    "texel_corners",
    "texel_direction",
    "texel_directions",
    "texel_neighbours",
    "texel_uv",
    "texel_weights",
    "wrapped",
]

LATLONG, OCTAHEDRAL = 0, 1

_QUARTER, _HALF, _ZERO, _ONE, _TWO = (np.float32(x) for x in (0.25, 0.5, 0, 1, 2))


@kernel(inline=True)
def _quarters(y, x):
    """Angle of (x, y), both >= 0, in quarter turns: to 5e-7, the same on every platform; 0 at the origin."""
    low, high = min(x, y), max(x, y)
    if high == _ZERO:
        return _ZERO
    t = low / high
    s = t * t  # a Chebyshev fit of atan(t) / t in t² on [0, 1]
    p = np.float32(0.0539597) + s * (np.float32(-0.02403348) + s * np.float32(0.0051549))
    p = np.float32(0.12665567) + s * (np.float32(-0.08618352) + s * p)
    p = t * (np.float32(0.63661957) + s * (np.float32(-0.21217248) + s * p))
    return p if y <= x else _ONE - p


@kernel(inline=True)
def _latlong_direction(u, v):
    x, y = turn(u)
    z, s = turn(_HALF * v)
    return s * x, s * y, z


@kernel(inline=True)
def _latlong_uv(x, y, z):
    u = _QUARTER * _quarters(abs(y), abs(x))
    if x < 0:
        u = _HALF - u
    if y < 0:
        u = _ONE - u
    # Not acos(z): near a pole z hardly changes.
    v = _HALF * _quarters(np.sqrt(x * x + y * y), abs(z))
    return u, v if z >= 0 else _ONE - v


@kernel(inline=True)
def _octahedral_direction(u, v):
    x, y = _TWO * u - _ONE, _TWO * v - _ONE
    a, b = abs(x), abs(y)
    above = _ONE - a - b  # distance from the equator, positive on the side of +Z
    r = _ONE - abs(above)
    c, s = turn(np.float32(0.125) * ((b - a) / r + _ONE) if r > 0 else _ZERO)
    sine = r * np.sqrt(_TWO - r * r)
    z = _ONE - r * r
    c, s = c * sine, s * sine
    return c if x >= 0 else -c, s if y >= 0 else -s, z if above >= 0 else -z


@kernel(inline=True)
def _octahedral_uv(x, y, z):
    # 1 - |z| as it is not rounded away near a pole
    r = np.sqrt((x * x + y * y) / (_ONE + abs(z)))
    b = r * _quarters(abs(y), abs(x))
    a = r - b
    if z < 0:
        a, b = _ONE - b, _ONE - a
    a, b = _HALF * a, _HALF * b
    return _HALF + (a if x >= 0 else -a), _HALF + (b if y >= 0 else -b)


@kernel(inline=True)
def texel_direction(mapping, u, v):
    """Unit vector of (u, v) in [0, 1]², u along columns and v along rows.

    Latitude-longitude: azimuth 2πu from +X towards +Y, polar angle πv from +Z. Octahedral: u grows with x, v with y.
    """
    if mapping == OCTAHEDRAL:
        return _octahedral_direction(u, v)
    return _latlong_direction(u, v)


@kernel
def texel_directions(mapping, rays, o):
    """Turn sixteen points of the square, u at word `o` of `rays` and v sixteen words later, into directions there."""
    if mapping == LATLONG:
        x, y = turns(load(rays, o))
        z, s = turns(_HALF * load(rays, o + LANES))
        store(rays, o, s * x)
        store(rays, o + LANES, s * y)
        store(rays, o + 2 * LANES, z)
        return
    for q in range(o, o + LANES):
        rays[q], rays[q + LANES], rays[q + 2 * LANES] = texel_direction(mapping, rays[q], rays[q + LANES])


@kernel(inline=True)
def texel_uv(mapping, x, y, z):
    """Inverse of `texel_direction`; u and v in [0, 1] up to rounding."""
    if mapping == OCTAHEDRAL:
        return _octahedral_uv(x, y, z)
    return _latlong_uv(x, y, z)


@kernel(inline=True)
def wrapped(mapping, texels, row, column):
    """Row and column inside the square of a texel at most one beyond its edges.

    Octahedral edges continue mirrored along themselves; latitude-longitude rows on the opposite side of their pole.
    """
    last = texels - 1
    if mapping == OCTAHEDRAL:
        if column < 0 or column > last:
            row, column = last - row, min(max(column, 0), last)
        if row < 0 or row > last:
            row, column = min(max(row, 0), last), last - column
        return row, column
    if row < 0 or row > last:
        row, column = min(max(row, 0), last), column + texels // 2
    if column < 0:
        column += texels
    elif column > last:
        column -= texels
    return row, column


#: Words from one field to the next of what `texel_corners` writes.
CORNER_STRIDE = 64


@kernel(inline=True)
def _turned_lanes(t, steep):
    """As `_quarters`, sixteen at a time, of the ratio `t` of the lesser to the greater of two sides, which is y over x unless `steep`."""
    s = t * t
    p = fma(
        s, fma(s, splat(np.float32(0.0051549)), splat(np.float32(-0.02403348))), splat(np.float32(0.0539597))
    )
    p = fma(s, fma(s, p, splat(np.float32(-0.08618352))), splat(np.float32(0.12665567)))
    p = t * fma(s, fma(s, p, splat(np.float32(-0.21217248))), splat(np.float32(0.63661957)))
    return select(steep, _ONE - p, p)


@kernel(inline=True)
def _latlong_uv_lanes(x, y, z):
    zero, tiny = splat(_ZERO), splat(np.float32(1e-18))  # so that the product of two is no zero
    wide, deep, high, flat = vabs(x), vabs(y), vabs(z), vsqrt(fma(x, x, y * y))
    around, up = vmax(vmax(wide, deep), tiny), vmax(vmax(flat, high), tiny)
    ratio = splat(_ONE) / (around * up)  # one division for two
    u = _QUARTER * _turned_lanes(vmin(wide, deep) * (up * ratio), deep > wide)
    u = select(x < zero, _HALF - u, u)
    u = select(y < zero, _ONE - u, u)
    v = _HALF * _turned_lanes(vmin(flat, high) * (around * ratio), flat > high)
    return u, select(z >= zero, v, _ONE - v)


@kernel(inline=True)
def _wrapped_columns(row, column, side):
    """Latitude-longitude rows and columns inside the square of texels at most one beyond its edges."""
    zero, last = splat(_ZERO), splat(np.float32(side - 1))
    beyond = select(vmin(row, last - row) < zero, splat(np.float32(side // 2)), zero)
    column = column + beyond
    column = select(column < zero, column + np.float32(side), column)
    column = select(column > last, column - np.float32(side), column)
    return vmin(vmax(row, zero), last), vmin(
        vmax(column, zero), last
    )  # what is no number must not be read either


@kernel(inline=True, borrows=True)
def texel_corners(mapping, side, x, y, z, apart, corners, at):
    """The four texels around each of sixteen vectors, for bilinear lookups; their length does not matter if it is neither tiny nor huge. Always texels that are there.

    Writes two fields to float32 `apart`, how far the point lies across and down between the corners, [0, 1), and four
    to int32 `corners`, the texels as `lookup.four_codes` takes them; each field from `at` on.
    """
    if mapping == OCTAHEDRAL:
        step = CORNER_STRIDE
        scale = splat(_ONE) / vsqrt(vmax(fma(x, x, fma(y, y, z * z)), splat(np.float32(1e-30))))
        for k, v in enumerate((x, y, z)):
            store(apart, at + k * step, v * scale)
        for k in range(at, at + LANES):
            u, v = _octahedral_uv(apart[k], apart[k + step], apart[k + 2 * step])
            across, down = u * np.float32(side) - _HALF, v * np.float32(side) - _HALF
            column, row = int(np.floor(across)), int(np.floor(down))
            apart[k], apart[k + step] = across - np.float32(column), down - np.float32(row)
            for corner in range(4):
                r, c = wrapped(mapping, side, row + (corner >> 1), column + (corner & 1))
                corners[k + corner * step] = r * side + c
        return
    u, v = _latlong_uv_lanes(x, y, z)
    across, down = u * np.float32(side) - _HALF, v * np.float32(side) - _HALF
    column, row = vfloor(across), vfloor(down)
    store(apart, at, across - column)
    store(apart, at + CORNER_STRIDE, down - row)
    for corner in range(4):
        r, c = _wrapped_columns(row + np.float32(corner >> 1), column + np.float32(corner & 1), side)
        store(corners, at + corner * CORNER_STRIDE, to_int(fma(r, splat(np.float32(side)), c)))


@kernel
def point_directions(mapping, u, v, found):
    """Write the directions (n, 3) of places (u, v), each (n,)."""
    for k in range(u.shape[0]):
        found[k, 0], found[k, 1], found[k, 2] = texel_direction(mapping, u[k], v[k])


@kernel
def square_directions(mapping, at, out):
    """Directions (n, n, 3) float32 of a grid of places in the square: u = at[column], v = at[row]."""
    for row in range(len(at)):
        for column in range(len(at)):
            x, y, z = texel_direction(mapping, at[column], at[row])
            out[row, column, 0], out[row, column, 1], out[row, column, 2] = x, y, z


@kernel
def texel_neighbours(mapping, texels, out):
    """Flat indices (4, T²) int32 of the texels above, below, left and right of every texel."""
    for row in range(texels):
        for column in range(texels):
            for k in range(4):
                down = 2 * k - 1 if k < 2 else 0
                right = 2 * k - 5 if k >= 2 else 0
                r, c = wrapped(mapping, texels, row + down, column + right)
                out[k, row * texels + column] = r * texels + c


@kernel
def texel_weights(mapping, texels, finer, places, weights):
    """Flat indices and weights (4, F²) with which textures of T² texels are interpolated bilinearly at the centres of F² texels."""
    ratio = np.float32(texels) / np.float32(finer)
    for row in range(finer):
        for column in range(finer):
            x = (np.float32(column) + _HALF) * ratio - _HALF
            y = (np.float32(row) + _HALF) * ratio - _HALF
            left, top = int(np.floor(x)), int(np.floor(y))
            a, b = x - np.float32(left), y - np.float32(top)
            for k in range(4):
                r, c = wrapped(mapping, texels, top + k // 2, left + k % 2)
                places[k, row * finer + column] = r * texels + c
                weights[k, row * finer + column] = (a if k % 2 else _ONE - a) * (b if k // 2 else _ONE - b)
