"""Looking textures up for the rays of a tile, sixteen at a time (paper 3.4)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels import STALE
from luxel.kernels.dots import load_fours
from luxel.kernels.jit import kernel
from luxel.kernels.lookup import PLACES, open_texture, opens_freely, prefetch_opened, read_four, side_of
from luxel.kernels.mapping import CORNER_STRIDE, texel_corners
from luxel.kernels.memory import float_lines, int_lines, item
from luxel.kernels.simd import (
    LANES,
    any_lane,
    fma,
    load,
    select,
    splat,
    store,
    to_float,
    vmax,
    vmin,
    vsqrt,
)
from luxel.kernels.tiles import RAYS

__all__ = [
    "APART",
    "DX",
    "DY",
    "DZ",
    "LIGHT",
    "NX",
    "NY",
    "NZ",
    "PLACE",
    "SQUARE",
    "WEIGHT",
    "Hits",
    "Opened",
    "Skin",
    "T",
    "X",
    "Y",
    "Z",
    "light_textures",
    "make_opened",
    "open_textures",
    "unit_normals",
]

_ZERO, _QUARTER, _THIRD, _HALF, _ONE, _TWO, _THREE = (
    np.float32(x) for x in (0, 1 / 4, 1 / 3, 1 / 2, 1, 2, 3)
)
_TINY = np.float32(1e-30)
# Rays closer than so many radii read textures at one point; the filter opens up over as much again.
_FINE = np.float32(0.2)
# Cosine² between normal and ray that the filter keeps to: beyond, a pixel shows more of what lies behind.
_LIMB = np.float32(0.19)
#: The part of a slot that is not `STALE`.
PLACE = STALE - 1
_STALE = np.float32(STALE)

# Fields of `Hits.words`, RAYS words each: from the middle of the sphere to the hit, direction, middle, distance, radius², and light.
(NX, NY, NZ, DX, DY, DZ, X, Y, Z, T, SQUARE, LIGHT, WEIGHT, APART) = (RAYS * k for k in range(14))  # fmt: skip


class Skin(NamedTuple):
    """What particles look like; see :class:`luxel.textures.textures.TextureTable`."""

    slot: np.ndarray
    texels: np.ndarray
    decoding: (
        np.ndarray
    )  # (2, 2) float32: luminance of code c is d0 c + d1 c²; the second row is for those that are stale
    coarse: np.ndarray
    colors: np.ndarray  # (N, 3) float32 linear
    mapping: int


class Hits(NamedTuple):
    """What the rays of one tile have hit."""

    words: np.ndarray
    corners: np.ndarray  # (4 · 64,) int32 texels around each point
    who: np.ndarray  # (64,) int32 particle, -1 for none
    slot: np.ndarray  # (64,) int32 its texture, negative for none
    textured: np.ndarray  # (4,) int32 how many of each sixteen have a texture


class Opened(NamedTuple):
    """Textures of a tile that are ready to be read."""

    words: np.ndarray  # see ``lookup.open_texture``
    handles: np.ndarray  # (64,) int64
    codes: np.ndarray  # (64,) int32, of four texels for each of sixteen rays


def make_opened(words: int) -> Opened:
    """Allocate memory for textures of so many ``lookup.opened_words`` each; not a kernel."""
    return Opened(float_lines(PLACES * words), np.zeros(PLACES, np.int64), int_lines(4 * LANES))


@kernel(inline=True, borrows=True)
def open_textures(skin, opened, hits):
    """Open the textures of all rays, of which some have one, and ask for what they are made of; those without get another's, so that reading needs no branch."""
    slot, corners, handles = hits.slot, hits.corners, opened.handles
    if opens_freely(skin.texels):
        some = item(slot, 0)  # one that is there: slots that nobody has may hold anything
        for j in range(1, RAYS):
            some = max(some, item(slot, j))
        for j in range(RAYS):
            s = item(slot, j)
            handles[j] = open_texture(skin.texels, (s if s >= 0 else some) & PLACE, opened.words, j)
    else:
        for j in range(RAYS):
            # Rays lie in squares of 4 × 4: what is open may be that of the ray to the left, or of the one above.
            s = item(slot, j)
            if j & 3 and item(slot, j - 1) == s:
                handles[j] = item(handles, j - 1)
            elif j & 12 and item(slot, j - 4) == s:
                handles[j] = item(handles, j - 4)
            else:
                handles[j] = open_texture(skin.texels, s & PLACE, opened.words, j) if s >= 0 else 0
    for j in range(RAYS):
        prefetch_opened(skin.texels, item(handles, j), item(corners, j), item(corners, j + 2 * CORNER_STRIDE))


@kernel(inline=True, borrows=True)
def unit_normals(words, v):
    """Normals where sixteen rays hit."""
    nx, ny, nz = load(words, NX + v), load(words, NY + v), load(words, NZ + v)
    scale = splat(_ONE) / vsqrt(vmax(fma(nx, nx, fma(ny, ny, nz * nz)), splat(_TINY)))
    return nx * scale, ny * scale, nz * scale


@kernel(inline=True, borrows=True)
def _reaches(eye, step, t, dx, dy, dz, radius):
    """How far beside their hits sixteen rays read, in radii: a quarter of the distance between rays, 0 where they lie close."""
    right = np.sqrt(eye.right[0] * eye.right[0] + eye.right[1] * eye.right[1] + eye.right[2] * eye.right[2])
    gap = step * right / radius
    if not eye.orthographic:
        gap = gap * t * fma(dx, splat(eye.forward[0]), fma(dy, splat(eye.forward[1]), dz * eye.forward[2]))
    return _QUARTER * gap * vmin(splat(_ONE), vmax(splat(_ZERO), gap / _FINE - _ONE))


@kernel(inline=True, borrows=True)
def light_textures(eye, skin, opened, hits, v, step):
    """Write the light of those of sixteen rays whose particle has a texture (paper 3.4).

    Where rays lie far apart (`step`), it is the mean over what a ray stands for: four points around its hit, in the
    plane of the picture, so that their normals spread towards the limb. Without it, particles a few pixels wide
    sparkle: neighbouring rays fall on unrelated texels.
    """
    words, corners, slot, decoding = hits.words, hits.corners, hits.slot, skin.decoding
    stale = to_float(load(slot, v)) >= _STALE
    linear = select(stale, splat(decoding[1, 0]), splat(decoding[0, 0]))
    square = select(stale, splat(decoding[1, 1]), splat(decoding[0, 1]))
    zero, one = splat(_ZERO), splat(_ONE)
    dx, dy, dz = load(words, DX + v), load(words, DY + v), load(words, DZ + v)
    # The corners around these are known, and do not depend on length.
    nx, ny, nz = load(words, NX + v), load(words, NY + v), load(words, NZ + v)
    reach = ax = ay = az = bx = by = bz = qx = qy = qz = zero
    if step > 0:
        reach = _reaches(eye, step, load(words, T + v), dx, dy, dz, vsqrt(load(words, SQUARE + v)))
        # Axes across the ray, and the part of the normal across it: where on its disc the sphere is hit.
        nx, ny, nz = unit_normals(words, v)
        along = fma(nx, dx, fma(ny, dy, nz * dz))
        qx, qy, qz = nx - along * dx, ny - along * dy, nz - along * dz
        ax, ay, az = splat(eye.right[0]), splat(eye.right[1]), splat(eye.right[2])
        scale = one / vsqrt(fma(ax, ax, fma(ay, ay, az * az)))
        ax, ay, az = ax * scale, ay * scale, az * scale
        along = fma(ax, dx, fma(ay, dy, az * dz))
        ax, ay, az = ax - along * dx, ay - along * dy, az - along * dz
        bx, by, bz = ay * dz - az * dy, az * dx - ax * dz, ax * dy - ay * dx
    count, light = zero, zero
    for k in range(0 if any_lane(reach > zero) else 4, 5):
        if k < 4:
            a = reach if k & 1 else -reach
            b = reach if k & 2 else -reach
            px, py, pz = qx + a * ax + b * bx, qy + a * ay + b * by, qz + a * az + b * bz
            rest = one - fma(px, px, fma(py, py, pz * pz))
            c = vsqrt(vmax(rest, zero))
            weight = select(rest > _LIMB, one, zero)
            texel_corners(skin.mapping, side_of(skin.texels), px - c * dx, py - c * dy, pz - c * dz, words[APART:], corners, v)  # fmt: skip
        else:
            weight = select(count > zero, zero, one)  # what has no such point is read where it is hit
            if any_lane(count > zero):
                if not any_lane(weight > zero):
                    break
                texel_corners(skin.mapping, side_of(skin.texels), nx, ny, nz, words[APART:], corners, v)
        count = count + weight
        for j in range(v, v + LANES):
            p, q = item(corners, j), item(corners, j + CORNER_STRIDE)
            r, s = item(corners, j + 2 * CORNER_STRIDE), item(corners, j + 3 * CORNER_STRIDE)
            read_four(
                skin.texels, item(opened.handles, j), opened.words, p, q, r, s, opened.codes, 4 * (j - v)
            )
        p, q, r, s = load_fours(opened.codes)
        p, q, r, s = to_float(p), to_float(q), to_float(r), to_float(s)
        p, q = p * fma(square, p, linear), q * fma(square, q, linear)
        r, s = r * fma(square, r, linear), s * fma(square, s, linear)
        a, b = load(words, APART + v), load(words, APART + CORNER_STRIDE + v)
        top, low = fma(a, q - p, p), fma(a, s - r, r)
        light = fma(weight, fma(b, low - top, top), light)
    # Not a quotient: some processors' are not exact even by 1, and a picture must not depend on which kernel drew it.
    share = select(
        count > _HALF + _TWO, select(count > _HALF + _THREE, splat(_QUARTER), splat(_THIRD)), splat(_HALF)
    )
    store(words, LIGHT + v, light * select(count > _ONE + _HALF, share, one))
