"""Shading of primary hits: texture lookup, coarse record, closed-form Lambert, or path tracing of every pixel."""

from __future__ import annotations

import numpy as np

from luxel.kernels import FIRST_LIGHT
from luxel.kernels.jit import kernel
from luxel.kernels.light import lambert
from luxel.kernels.lookup import four_codes, side_of
from luxel.kernels.mapping import texel_uv, wrapped
from luxel.kernels.path import luminance_at
from luxel.kernels.rng import PURPOSE_PIXEL, path_key
from luxel.kernels.tiles import primary_ray
from luxel.kernels.tree_trace import scratch

__all__ = ["bilinear", "develop", "shade_pixels", "shade_textures"]

_ZERO, _QUARTER, _HALF, _ONE = np.float32(0), np.float32(0.25), np.float32(0.5), np.float32(1)
# Rays closer than so many radii read textures at one point; the filter opens up over as much again.
_FINE = np.float32(0.2)
# Cosine² between normal and ray that the filter keeps to: beyond, a pixel shows more of what lies behind.
_LIMB = np.float32(0.19)


@kernel
def bilinear(mapping, texels, decoding, slot, nx, ny, nz):
    """Luminance of texture `slot` where the unit normal n points, interpolated bilinearly (paper 3.4).

    `texels` are raw codes (M, T, T) or compressed as ``lookup`` describes: only the four that are needed are unpacked.
    """
    side = side_of(texels)
    u, v = texel_uv(mapping, nx, ny, nz)
    x, y = u * np.float32(side) - _HALF, v * np.float32(side) - _HALF
    column, row = int(np.floor(x)), int(np.floor(y))
    a, b = x - np.float32(column), y - np.float32(row)
    r0, c0 = wrapped(mapping, side, row, column)
    r1, c1 = wrapped(mapping, side, row, column + 1)
    r2, c2 = wrapped(mapping, side, row + 1, column)
    r3, c3 = wrapped(mapping, side, row + 1, column + 1)
    p, q, r, s = four_codes(texels, slot, r0, c0, r1, c1, r2, c2, r3, c3)
    top = (_ONE - a) * decoding[p] + a * decoding[q]
    low = (_ONE - a) * decoding[r] + a * decoding[s]
    return (_ONE - b) * top + b * low


@kernel(inline=True)
def _reach(world, eye, spacing, sphere, dx, dy, dz, distance):
    """How far beside a hit the filter reads, in radii: a quarter of the distance between rays, 0 where they lie close."""
    right = np.sqrt(eye.right[0] * eye.right[0] + eye.right[1] * eye.right[1] + eye.right[2] * eye.right[2])
    gap = spacing * right / world.radii[sphere]
    if not eye.orthographic:
        gap *= distance * (dx * eye.forward[0] + dy * eye.forward[1] + dz * eye.forward[2])
    return _QUARTER * gap * min(_ONE, max(_ZERO, gap / _FINE - _ONE))


@kernel
def _filtered(mapping, texels, decoding, slot, eye, dx, dy, dz, nx, ny, nz, reach):
    """Mean luminance of texture `slot` over what a ray along the unit vector d stands for: four points around its hit.

    Without it, particles a few pixels wide sparkle: neighbouring rays fall on unrelated texels. The points lie in the
    plane of the picture, so that their normals spread towards the limb.
    """
    # Axes across the ray, and the part of the normal across it: where on its disc the sphere is hit.
    ax, ay, az = eye.right[0], eye.right[1], eye.right[2]
    scale = _ONE / np.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = scale * ax, scale * ay, scale * az
    along = ax * dx + ay * dy + az * dz
    ax, ay, az = ax - along * dx, ay - along * dy, az - along * dz
    bx, by, bz = ay * dz - az * dy, az * dx - ax * dz, ax * dy - ay * dx
    along = nx * dx + ny * dy + nz * dz
    qx, qy, qz = nx - along * dx, ny - along * dy, nz - along * dz
    total = _ZERO
    count = 0
    for k in range(4):
        u = reach if k & 1 else -reach
        v = reach if k & 2 else -reach
        px, py, pz = qx + u * ax + v * bx, qy + u * ay + v * by, qz + u * az + v * bz
        rest = _ONE - (px * px + py * py + pz * pz)
        if rest > _LIMB:
            c = np.sqrt(rest)
            total += bilinear(mapping, texels, decoding, slot, px - c * dx, py - c * dy, pz - c * dz)
            count += 1
    if count == 0:
        return bilinear(mapping, texels, decoding, slot, nx, ny, nz)
    return total / np.float32(count)


@kernel(inline=True)
def _hit_normal(centers, sphere, ox, oy, oz, dx, dy, dz, t):
    nx, ny, nz = (
        ox + t * dx - centers[sphere, 0],
        oy + t * dy - centers[sphere, 1],
        oz + t * dz - centers[sphere, 2],
    )
    scale = _ONE / np.sqrt(nx * nx + ny * ny + nz * nz)
    return nx * scale, ny * scale, nz * scale


@kernel(inline=True)
def _add(total, colors, sphere, luminance):
    for c in range(3):
        total[c] += luminance * colors[sphere, c]
    total[3] += luminance
    total[4] += _ONE


@kernel
def shade_textures(
    world,
    eye,
    shift_x,
    shift_y,
    spacing,
    first_row,
    last_row,
    distance,
    ids,
    mapping,
    slot,
    texels,
    decoding,
    coarse,
    colors,
    total,
):
    """Add rows [first_row, last_row) to `total` (H, W, 5): luminance times colour, luminance, coverage.

    Particles without a texture are shaded by their coarse record where slot is `FIRST_LIGHT`, or else by closed-form Lambert.
    `spacing` is the distance between the rays of the picture, in pixels: textures are filtered over it.
    """
    height, width = ids.shape
    step = np.float32(2) * spacing / np.float32(width)
    for y in range(first_row, last_row):
        for x in range(width):
            sphere = ids[y, x]
            if sphere < 0:
                continue
            ox, oy, oz, dx, dy, dz = primary_ray(
                eye, np.float32(x) + shift_x, np.float32(y) + shift_y, width, height
            )
            nx, ny, nz = _hit_normal(world.centers, sphere, ox, oy, oz, dx, dy, dz, distance[y, x])
            s = slot[sphere]
            if s >= 0:
                reach = _reach(world, eye, step, sphere, dx, dy, dz, distance[y, x])
                if reach > 0:
                    luminance = _filtered(mapping, texels, decoding, s, eye, dx, dy, dz, nx, ny, nz, reach)
                else:
                    luminance = bilinear(mapping, texels, decoding, s, nx, ny, nz)
            elif s == FIRST_LIGHT and sphere < coarse.shape[0]:
                c = coarse[sphere]
                luminance = max(_ZERO, c[0] + c[1] * nx + c[2] * ny + c[3] * nz)
            else:
                r = world.radii[sphere]
                luminance = lambert(
                    world.lights, world.centers[sphere, 0] + r * nx, world.centers[sphere, 1] + r * ny,
                    world.centers[sphere, 2] + r * nz, nx, ny, nz,
                )  # fmt: skip
            _add(total[y, x], colors, sphere, luminance)


@kernel
def shade_pixels(
    world, eye, shift_x, shift_y, first_row, last_row, distance, ids, samples, first_sample, colors, total
):
    """Add rows [first_row, last_row) to `total` as `shade_textures` does, path tracing `samples` times at every hit."""
    work = scratch(world.tree.stack_size)
    height, width = ids.shape
    for y in range(first_row, last_row):
        for x in range(width):
            sphere = ids[y, x]
            if sphere < 0:
                continue
            ox, oy, oz, dx, dy, dz = primary_ray(
                eye, np.float32(x) + shift_x, np.float32(y) + shift_y, width, height
            )
            nx, ny, nz = _hit_normal(world.centers, sphere, ox, oy, oz, dx, dy, dz, distance[y, x])
            r = world.radii[sphere]
            px = world.centers[sphere, 0] + r * nx
            py = world.centers[sphere, 1] + r * ny
            pz = world.centers[sphere, 2] + r * nz
            luminance = np.float32(0)
            count = 0
            for s in range(samples):
                state = path_key(world.seed, y * width + x, 0, first_sample + s, PURPOSE_PIXEL)
                value = luminance_at(world, work, sphere, px, py, pz, nx, ny, nz, state)
                if value >= 0:  # rounding can bury a visible point at the seam of two spheres
                    luminance += value
                    count += 1
            _add(total[y, x], colors, sphere, luminance / np.float32(max(count, 1)))


@kernel
def develop(total, rays, exposure, white, background, picture):
    """Turn `total` of `rays` rays a pixel into linear colours (H, W, 3): tone curve on luminance, then colour, then background.

    The tone curve is Reinhard's extended one (2002) after a factor of white^-0.6: `white` displays as 1, and where
    white <= 1 it is linear. It acts on luminance alone, so that a pixel keeps the chromaticity of its colours however bright it is lit (paper 3.1).
    """
    scale = _ONE / np.float32(rays)
    toe = white ** np.float32(-0.6)  # keeps contrast in the shade of a strong sun
    for y in range(total.shape[0]):
        for x in range(total.shape[1]):
            cover = total[y, x, 4] * scale
            luminance = total[y, x, 3]
            gain = np.float32(0)
            if luminance > 0:
                v = luminance / total[y, x, 4] * exposure
                if white > _ONE:
                    v *= toe
                    v = v * (_ONE + v / (toe * white * toe * white)) / (_ONE + v)
                gain = min(v, _ONE) * cover / luminance
            for c in range(3):
                picture[y, x, c] = total[y, x, c] * gain + background[c] * (_ONE - cover)
