"""One ray a pixel, from camera to picture: trace a tile, light what it hits, develop the rows.

Light is looked up three steps behind the rays, so that threads do not wait for memory: between asking where a particle's texture lies, asking for
its texels and reading them, other tiles are traced. Blocks of tiles are handed out by a counter that all threads of a frame share; each
thread makes a single call a frame.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels import FIRST_LIGHT
from luxel.kernels.direct import lambert_lanes
from luxel.kernels.frustum import Cut, make_cut
from luxel.kernels.jit import kernel
from luxel.kernels.lookup import prefetch_texels, side_of
from luxel.kernels.mapping import CORNER_STRIDE, texel_corners
from luxel.kernels.memory import float_lines, int_lines, prefetch, take
from luxel.kernels.seen import mark_seen, tally_seen
from luxel.kernels.simd import LANES, any_lane, fma, fma_one, load, splat_int, store, trailing_zeros, vsqrt
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
    SQUARE,
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
    unit_normals,
)
from luxel.kernels.tiles import (
    RAYS,
    TILE,
    Tile,
    block_of,
    leaders,
    make_tile,
    note_nearest,
    place_of,
    trace_tile,
)
from luxel.kernels.tone import develop_block
from luxel.kernels.tree_trace import Scratch, scratch

__all__ = [
    "BLOCK",
    "Bench",
    "Skin",
    "collect_hits",
    "draw_frame",
    "find_slots",
    "light_hits",
    "make_bench",
]

#: Pixels along the longest side of a block that a thread draws.
BLOCK = 8 * TILE
_ZERO, _ONE, _TWO = (np.float32(x) for x in (0, 1, 2))


class Kept(NamedTuple):
    """Light of the rays of 8 × 8 pixels, ray by ray of each pixel, see ``folded``."""

    place: np.ndarray  # (rays · 64,) int32: where a ray's light is kept
    who: np.ndarray  # (rays · 64,) int32 particle, -1 for none
    light: np.ndarray  # (rays · 64,) float32
    far: np.ndarray  # (rays · 64,) float32 distance
    sums: np.ndarray  # (64, 64, 5) float32, of a block of pixels


class Bench(NamedTuple):
    """Working memory of one thread."""

    tile: Tile
    rays: Scratch
    spare: np.ndarray
    opened: Opened
    hits: tuple  # three Hits: of the tiles whose particles, slots, and textures are under way
    kept: Kept
    cut: Cut


def make_bench(stack_size: int, words: int, rays: int) -> Bench:
    """Allocate the working memory of one thread, for textures of so many ``lookup.opened_words`` and so many rays a pixel at once; not a kernel."""
    hits = [
        Hits(
            float_lines(16 * RAYS),
            int_lines(4 * RAYS),
            int_lines(LANES + RAYS)[LANES:],  # see ``tiles.leaders``
            int_lines(RAYS),
            int_lines(RAYS // LANES),
        )
        for _ in range(3)
    ]
    return Bench(
        make_tile(stack_size),
        scratch(stack_size),
        float_lines(8 * LANES),
        make_opened(words),
        tuple(hits),
        Kept(
            int_lines(rays * RAYS),
            int_lines(rays * RAYS),
            float_lines(rays * RAYS),
            float_lines(rays * RAYS),
            np.zeros((BLOCK if rays else 0, BLOCK, 5), np.float32),
        ),
        make_cut(),
    )


@kernel(inline=True, borrows=True)
def collect_hits(tree, tile, hits, skin, textured, width, height, tx, ty):
    """Note which particles the rays of a tile hit, and where; ask where their textures lie. Returns those rays that lead, see ``tiles.leaders``."""
    spheres, ids, found = tree.spheres, tree.ids, tile.found
    words, who, slot = hits.words, hits.who, hits.slot
    for j in range(RAYS):
        place = found[j]
        column, row = place_of(j)
        if place < 0 or tx + column >= width or ty + row >= height:
            who[j], slot[j] = -1, -1
            words[X + j], words[Y + j], words[Z + j] = _ZERO, _ZERO, _ZERO
            words[SQUARE + j], words[T + j] = _ONE, _ONE
            continue
        i = ids[place]
        who[j], slot[j] = i, -1
        words[X + j], words[Y + j] = spheres[place - 4 * LANES], spheres[place - 3 * LANES]
        words[Z + j], words[SQUARE + j] = spheres[place - 2 * LANES], spheres[place - LANES]
        words[T + j] = tile.best[j]
    leading = rest = leaders(who)
    while rest != 0:
        i = who[trailing_zeros(rest)]
        rest &= rest - 1
        prefetch(skin.colors, i * 12)
        if textured:
            prefetch(skin.slot, i * 4)
    for v in range(0, RAYS, LANES):
        t = load(words, T + v)
        dx, dy, dz = (
            load(tile.rays, 3 * RAYS + v),
            load(tile.rays, 4 * RAYS + v),
            load(tile.rays, 5 * RAYS + v),
        )
        store(words, NX + v, fma(t, dx, load(tile.rays, v) - load(words, X + v)))
        store(words, NY + v, fma(t, dy, load(tile.rays, RAYS + v) - load(words, Y + v)))
        store(words, NZ + v, fma(t, dz, load(tile.rays, 2 * RAYS + v) - load(words, Z + v)))
        store(words, DX + v, dx)
        store(words, DY + v, dy)
        store(words, DZ + v, dz)
    return leading


@kernel(inline=True, borrows=True)
def find_slots(hits, skin):
    """Note where the textures of a tile's particles lie; ask for them."""
    words, who, slot = hits.words, hits.who, hits.slot
    side = side_of(skin.texels)
    for v in range(0, RAYS, LANES):
        count = 0
        for j in range(v, v + LANES):
            i = who[j]
            if i < 0:
                continue
            s = skin.slot[i]
            slot[j] = s
            count += s >= 0
            if s == FIRST_LIGHT:
                prefetch(skin.coarse, i * 16)
        hits.textured[v // LANES] = count
        if count:
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
    none = splat_int(np.int32(0))
    if not any_lane((load(who, v) >= none) & (load(slot, v) < none)):
        return
    nx, ny, nz = unit_normals(words, v)
    store(words, NX + v, nx)
    store(words, NY + v, ny)
    store(words, NZ + v, nz)
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
    radius = vsqrt(load(words, SQUARE + v))
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
def light_hits(tree, lights, eye, bench, skin, hits, step, textured, shadows):
    """Light what the rays of a tile have hit."""
    some = hits.textured[0] | hits.textured[1] | hits.textured[2] | hits.textured[3]
    if textured and some != 0:
        open_textures(skin, bench.opened, hits)
    for v in range(0, RAYS, LANES):
        if textured and hits.textured[v // LANES]:
            light_textures(eye, skin, bench.opened, hits, v, step)
        _light_bare(tree, lights, bench.rays, bench.spare, skin, hits, v, shadows)


@kernel(inline=True, borrows=True)
def _add_ray(total, y, x, colors, i, light, first):
    """Add what one ray brings that hits particle i."""
    pixel = total[y, x]
    if first:
        pixel[0], pixel[1], pixel[2] = light * colors[i, 0], light * colors[i, 1], light * colors[i, 2]
        pixel[3], pixel[4] = light, _ONE
    else:
        pixel[0] = fma_one(light, colors[i, 0], pixel[0])
        pixel[1] = fma_one(light, colors[i, 1], pixel[1])
        pixel[2] = fma_one(light, colors[i, 2], pixel[2])
        pixel[3] += light
        pixel[4] += _ONE


@kernel(inline=True, borrows=True)
def _shade(tree, lights, eye, bench, skin, hits, step, textured, shadows, first, total, tx, ty):
    """Light what the rays of a tile have hit, and add it to `total`."""
    height, width = total.shape[0], total.shape[1]
    light_hits(tree, lights, eye, bench, skin, hits, step, textured, shadows)
    for j in range(RAYS):
        column, row = place_of(j)
        x, y, i = tx + column, ty + row, hits.who[j]
        if i >= 0:
            _add_ray(total, y, x, skin.colors, i, hits.words[LIGHT + j], first)
        elif first and x < width and y < height:
            total[y, x, :] = _ZERO


@kernel(borrows=True)
def _clear(total, blank, tx, ty):
    """Have nothing in a tile of `total`."""
    if blank.shape[0] > 0:
        if blank[ty // TILE, tx // TILE]:
            return
        blank[ty // TILE, tx // TILE] = 1
    width = total.shape[1]
    flat = total.reshape(-1)
    for y in range(ty, min(ty + TILE, total.shape[0])):
        for k in range(5 * (y * width + tx), 5 * (y * width + min(tx + TILE, width))):
            flat[k] = _ZERO


@kernel(borrows=True)
def draw_frame(
    tree, lights, eye, shift_x, shift_y, spacing, textured, shadows, first, skin, marks, marked, tally, total, blank, distance, ids, rays, tone, picture, bench, counter, edge
):  # fmt: skip
    """Send one ray through (x + shift_x, y + shift_y) of every pixel and add what it brings to `total`.

    Several threads may call with the same arguments at once, each with a bench of its own and on blocks of pixels that it
    draws from `counter`.

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
    marks, marked, tally
        Where this thread marks the particles that are hit, see ``seen.mark_seen``, and leaves its tally, see ``seen.tally_seen``; or (0,), then nothing is marked.
    total
        (H, W, 5) float32 sums: light times colour, light, coverage.
    blank
        (⌈H/8⌉, ⌈W/8⌉) uint8: tiles of `total` that are known to hold zeros only, which need not be written again; or (0, 0).
    distance, ids
        (H, W) float32 and int32: what this ray meets first, see ``tiles.primary_tiles``; or (0, 0), then it is not written.
    rays
        Rays a pixel in `total` after this one.
    picture
        (H, W, 3) uint8, developed by `tone`; or (0, 0, 3), then nothing is.
    counter
        (1,) int64, 0 before the first call: the first block that nobody has.
    edge
        Tiles along the side of a block.
    """
    height, width = total.shape[0], total.shape[1]
    step = _TWO * spacing / np.float32(width)
    traced, found, ready = bench.hits
    while True:
        left, top, right, bottom = block_of(take(counter, 1), edge, width, height)
        if top >= height:
            break
        columns = (right - left + TILE - 1) // TILE
        count = columns * ((bottom - top + TILE - 1) // TILE)
        # Corners of the tiles whose slots, and whose textures, are under way.
        found_x = found_y = ready_x = ready_y = -1
        for k in range(count + 2):
            tx = ty = -1
            if k < count:
                row = k // columns
                column = k - row * columns
                # There and back: what lies where a row ends is still at hand where the next one begins.
                tx, ty = left + TILE * (columns - 1 - column if row & 1 else column), top + TILE * row
                hit = trace_tile(tree, eye, bench.tile, width, height, tx, ty, shift_x, shift_y)
                if ids.shape[0] > 0:
                    note_nearest(tree, bench.tile, hit, width, height, tx, ty, distance, ids)
                if first and not hit:
                    _clear(total, blank, tx, ty)
                if not hit:
                    continue
                if blank.shape[0] > 0:
                    blank[ty // TILE, tx // TILE] = 0
                leading = collect_hits(tree, bench.tile, traced, skin, textured, width, height, tx, ty)
                if marks.shape[0] > 0:
                    mark_seen(traced.who, leading, marks, marked)
            if ready_x >= 0:
                _shade(
                    tree, lights, eye, bench, skin, ready, step, textured, shadows, first, total, ready_x, ready_y
                )  # fmt: skip
            if textured and found_x >= 0:
                find_slots(found, skin)
            traced, found, ready = ready, traced, found
            ready_x, ready_y, found_x, found_y = found_x, found_y, tx, ty
        if picture.shape[0] > 0:
            develop_block(total, 0, 0, blank, rays, tone, left, right, top, bottom, picture, bench.spare)
    if marks.shape[0] > 0:
        tally_seen(marks, marked, skin.slot, tally)
