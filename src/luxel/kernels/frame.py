"""One ray a pixel, from camera to picture: trace a tile, light what it hits, develop the rows.

Light is looked up two steps behind the rays: between asking for a particle's texels and reading them lies the
tracing of the next tile, so that the threads do not wait for memory. Rows are handed out by a counter that all threads of
a frame share; each makes a single call a frame.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from luxel.kernels import FIRST_LIGHT, STALE
from luxel.kernels.direct import lambert_lanes
from luxel.kernels.jit import kernel
from luxel.kernels.lookup import prefetch_texels, side_of
from luxel.kernels.mapping import CORNER_STRIDE, texel_corners
from luxel.kernels.memory import prefetch, take
from luxel.kernels.simd import LANES, fma, load, splat, store, vmax, vsqrt
from luxel.kernels.textured import (
    APART,
    DX,
    DY,
    DZ,
    LIGHT,
    NX,
    NY,
    NZ,
    PLACE,
    RADIUS,
    WEIGHT,
    Hits,
    Opened,
    Skin,
    T,
    X,
    Y,
    Z,
    light_textures,
    make_opened,
    open_textures,
)
from luxel.kernels.tiles import RAYS, TILE, Tile, make_tile, place_of, trace_tile
from luxel.kernels.tone import develop_rows
from luxel.kernels.tree_trace import Scratch, scratch

__all__ = ["Bench", "Skin", "draw_frame", "gather_seen", "make_bench", "slots_digest"]

_ZERO, _ONE, _TWO = (np.float32(x) for x in (0, 1, 2))


class Bench(NamedTuple):
    """Working memory of one thread."""

    tile: Tile
    rays: Scratch
    spare: np.ndarray
    opened: Opened
    now: Hits
    before: Hits


def make_bench(stack_size: int, texels: Any) -> Bench:
    """Allocate the working memory of one thread that reads `texels`; not a kernel."""
    hits = [
        Hits(np.zeros(16 * RAYS, np.float32), *(np.zeros(n * RAYS, np.int32) for n in (4, 1, 1)))
        for _ in range(2)
    ]
    spare = np.zeros(8 * LANES, np.float32)
    return Bench(make_tile(stack_size), scratch(stack_size), spare, make_opened(texels), *hits)


@kernel(inline=True, borrows=True)
def _collect(tree, tile, hits, skin, textured, seen, width, height, tx, ty):
    """Note which particles the rays of a tile hit, and where; ask for their textures."""
    spheres, ids, found = tree.spheres, tree.ids, tile.found
    words, who, slot = hits.words, hits.who, hits.slot
    for j in range(RAYS):
        place = found[j]
        column, row = place_of(j)
        if place < 0 or tx + column >= width or ty + row >= height:
            who[j], slot[j] = -1, -1
            words[X + j], words[Y + j], words[Z + j] = _ZERO, _ZERO, _ZERO
            words[RADIUS + j], words[T + j] = _ONE, _ONE
            continue
        i = ids[place]
        who[j], slot[j] = i, -1
        words[X + j], words[Y + j] = spheres[place - 4 * LANES], spheres[place - 3 * LANES]
        words[Z + j], words[RADIUS + j] = spheres[place - 2 * LANES], spheres[place - LANES]
        words[T + j] = tile.best[j]
        prefetch(skin.colors, i * 12)
        if textured:
            prefetch(skin.slot, i * 4)
        if seen.shape[0] > 0:
            seen[i] = 1
    side = side_of(skin.texels)
    for v in range(0, RAYS, LANES):
        t = load(words, T + v)
        dx, dy, dz = (
            load(tile.rays, 3 * RAYS + v),
            load(tile.rays, 4 * RAYS + v),
            load(tile.rays, 5 * RAYS + v),
        )
        nx = fma(t, dx, load(tile.rays, v) - load(words, X + v))
        ny = fma(t, dy, load(tile.rays, RAYS + v) - load(words, Y + v))
        nz = fma(t, dz, load(tile.rays, 2 * RAYS + v) - load(words, Z + v))
        scale = splat(_ONE) / vsqrt(vmax(fma(nx, nx, fma(ny, ny, nz * nz)), splat(np.float32(1e-30))))
        nx, ny, nz = nx * scale, ny * scale, nz * scale
        store(words, NX + v, nx)
        store(words, NY + v, ny)
        store(words, NZ + v, nz)
        store(words, DX + v, dx)
        store(words, DY + v, dy)
        store(words, DZ + v, dz)
        store(words, RADIUS + v, vsqrt(load(words, RADIUS + v)))
    if textured:
        for v in range(0, RAYS, LANES):
            some = False
            for j in range(v, v + LANES):
                if who[j] >= 0:
                    slot[j] = skin.slot[who[j]]
                    some |= slot[j] >= 0
            if some:
                nx, ny, nz = load(words, NX + v), load(words, NY + v), load(words, NZ + v)
                texel_corners(skin.mapping, side, nx, ny, nz, words[APART:], hits.corners, v)
                for j in range(v, v + LANES):
                    if slot[j] >= 0:
                        place = slot[j] & PLACE
                        prefetch_texels(skin.texels, place, hits.corners[j])
                        prefetch_texels(skin.texels, place, hits.corners[2 * CORNER_STRIDE + j])


@kernel(inline=True, borrows=True)
def _light_bare(tree, lights, work, spare, skin, hits, v, shadows):
    """Write the light of those of sixteen rays whose particle has no texture: its coarse record, or else Lambert."""
    words, who, slot, coarse = hits.words, hits.who, hits.slot, skin.coarse
    bare = False
    for j in range(v, v + LANES):
        i = who[j]
        if i >= 0 and slot[j] < 0:
            if slot[j] == FIRST_LIGHT and i < coarse.shape[0]:
                words[LIGHT + j] = max(
                    _ZERO,
                    coarse[i, 0]
                    + coarse[i, 1] * words[NX + j]
                    + coarse[i, 2] * words[NY + j]
                    + coarse[i, 3] * words[NZ + j],
                )
                slot[j] = 0  # has its light
            else:
                bare = True
        else:
            slot[j] = 0
    if not bare:
        return
    # Rays that have their light ask for no shadows.
    for j in range(v, v + LANES):
        slot[j] = who[j] if slot[j] < 0 else -1
    nx, ny, nz = load(words, NX + v), load(words, NY + v), load(words, NZ + v)
    radius = load(words, RADIUS + v)
    light = lambert_lanes(
        lights, shadows, tree, work, spare,
        fma(radius, nx, load(words, X + v)), fma(radius, ny, load(words, Y + v)), fma(radius, nz, load(words, Z + v)),
        nx, ny, nz, slot, v,
    )  # fmt: skip
    store(words, WEIGHT + v, light)
    for j in range(v, v + LANES):
        if slot[j] >= 0:
            words[LIGHT + j] = words[WEIGHT + j]


@kernel(inline=True, borrows=True)
def _shade(tree, lights, eye, bench, skin, hits, step, textured, shadows, first, total, tx, ty):
    """Light what the rays of a tile have hit, and add it to `total`."""
    words, who, colors = hits.words, hits.who, skin.colors
    height, width = total.shape[0], total.shape[1]
    if textured:
        open_textures(skin, bench.opened, hits)
    for v in range(0, RAYS, LANES):
        if textured:
            light_textures(eye, skin, bench.opened, hits, v, step)
        _light_bare(tree, lights, bench.rays, bench.spare, skin, hits, v, shadows)
    for j in range(RAYS):
        column, row = place_of(j)
        x, y, i = tx + column, ty + row, who[j]
        if i >= 0:
            light = words[LIGHT + j]
            pixel = total[y, x]
            if first:
                pixel[0], pixel[1], pixel[2] = (
                    light * colors[i, 0],
                    light * colors[i, 1],
                    light * colors[i, 2],
                )
                pixel[3], pixel[4] = light, _ONE
            else:
                pixel[0] += light * colors[i, 0]
                pixel[1] += light * colors[i, 1]
                pixel[2] += light * colors[i, 2]
                pixel[3] += light
                pixel[4] += _ONE
        elif first and x < width and y < height:
            total[y, x, :] = _ZERO


@kernel(borrows=True)
def _clear(total, tx, ty):
    width = total.shape[1]
    flat = total.reshape(-1)
    for y in range(ty, min(ty + TILE, total.shape[0])):
        for k in range(5 * (y * width + tx), 5 * (y * width + min(tx + TILE, width))):
            flat[k] = _ZERO


@kernel(borrows=True)
def draw_frame(
    tree, lights, eye, shift_x, shift_y, spacing, textured, shadows, first, skin, seen, total, rays, tone, picture, bench, counter
):  # fmt: skip
    """Send one ray through (x + shift_x, y + shift_y) of every pixel and add what it brings to `total`.

    Several threads may call with the same arguments at once, each with a bench of its own and on rows that it draws
    from `counter`.

    Parameters
    ----------
    spacing
        Distance between the rays of the picture, in pixels: textures are filtered over it; 0 for no filter.
    textured
        Look textures and coarse records up; what has neither is Lambert. False: all is Lambert.
    shadows
        Whether Lambert comes with shadow rays, one to the middle of each light.
    first
        Overwrite `total` instead of adding to it.
    seen
        (N,) uint8: 1 is written for every particle that is hit; or (0,), then nothing is.
    total
        (H, W, 5) float32 sums: light times colour, light, coverage.
    rays
        Rays a pixel in `total` after this one.
    picture
        (H, W, 3) uint8, developed by `tone`; or (0, 0, 3), then nothing is.
    counter
        (1,) int64, the first row; 0 before the first call.
    """
    height, width = total.shape[0], total.shape[1]
    step = _TWO * spacing / np.float32(width)
    now, before = bench.now, bench.before
    while True:
        ty = take(counter, TILE)
        if ty >= height:
            return
        waiting = -1  # column of the tile whose textures are under way
        for tx in range(0, width + TILE, TILE):
            near = tx < width and trace_tile(tree, eye, bench.tile, width, height, tx, ty, shift_x, shift_y)
            if near:
                _collect(tree, bench.tile, now, skin, textured, seen, width, height, tx, ty)
            elif tx < width:
                if first:
                    _clear(total, tx, ty)
                continue
            if waiting >= 0:
                _shade(
                    tree, lights, eye, bench, skin, before, step, textured, shadows, first, total, waiting, ty
                )  # fmt: skip
            now, before = before, now
            waiting = tx
        if picture.shape[0] > 0:
            develop_rows(total, rays, tone, ty, min(ty + TILE, height), picture)


@kernel(inline=True)
def _mixed(particle, slot):
    """Hash of one particle's slot; sums of them tell whether any of many slots has changed."""
    h = (np.uint64(particle) << np.uint64(32)) ^ np.uint64(slot + 8)
    h = (h ^ (h >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
    return (h ^ (h >> np.uint64(32))) * np.uint64(0x94D049BB133111EB)


@kernel
def gather_seen(seen, slot, found):
    """List the particles marked in `seen`, ascending, into `found` (N,) int32.

    Returns how many, how many of them have a texture, how many only first light, how many a texture of another light, and the digest of their
    slots. `seen` is (N',) uint8 with N' a multiple of 8 and at least N.
    """
    words = seen.view(np.uint64)
    count = textured = dim = stale = 0
    digest = np.uint64(0)
    for w in range(words.shape[0]):
        if words[w] == 0:
            continue
        for i in range(8 * w, 8 * w + 8):
            if seen[i]:
                s = slot[i]
                found[count] = i
                count += 1
                textured += 0 <= s < STALE
                dim += s == FIRST_LIGHT
                stale += s >= STALE
                digest += _mixed(i, s)
    return count, textured, dim, stale, digest


@kernel
def slots_digest(ids, slot):
    """Sum of hashes of the slots of particles: what `gather_seen` returns last."""
    digest = np.uint64(0)
    for k in range(ids.shape[0]):
        digest += _mixed(ids[k], slot[ids[k]])
    return digest
