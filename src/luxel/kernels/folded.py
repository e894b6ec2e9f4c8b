"""Several rays a pixel at once: the rays of a fine picture, folded into a coarse one.

With fold², say nine, rays a pixel, tiles of 8 × 8 rays are smaller, and their rays meet the same few spheres: the picture costs two thirds of nine
pictures with one ray a pixel each. Light is kept until all rays of 8 × 8 pixels are there and is added up in a given order, so that the sums are those
of `frame.draw_frame`, bit for bit, but where a ray meets two spheres at the very same distance.
"""

from __future__ import annotations

import numpy as np

from luxel.kernels.frame import collect_hits, find_slots, light_hits
from luxel.kernels.frustum import cut_tree
from luxel.kernels.jit import kernel
from luxel.kernels.memory import take
from luxel.kernels.simd import fma_one
from luxel.kernels.textured import LIGHT, T
from luxel.kernels.tiles import RAYS, TILE, block_of, place_of, trace_points
from luxel.kernels.tone import develop_block

__all__ = ["draw_folded"]

_ZERO, _HALF, _ONE, _TWO = (np.float32(x) for x in (0, 0.5, 1, 2))


@kernel(borrows=True)
def _lay_out(fold, order, place):
    """Note where the light of ray j of tile q is kept: by pixels, for each of fold² rays in the order in which they are added up."""
    for q in range(fold * fold):
        for j in range(RAYS):
            column, row = place_of(j)
            x, y = q % fold * TILE + column, q // fold * TILE + row
            k = order[y % fold * fold + x % fold]
            place[q * RAYS + j] = k * RAYS + y // fold * TILE + x // fold


@kernel(borrows=True)
def _point(tile, fold, q, tx, ty, shifts_x, shifts_y):
    """Put the points of tile q, rounded as those of `tiles.trace_tile` are."""
    lines = tile.lanes
    for c in range(TILE):
        x, y = q % fold * TILE + c, q // fold * TILE + c
        lines[c] = np.float32(x // fold) + (np.float32(tx) + shifts_x[x % fold])
        lines[TILE + c] = np.float32(y // fold) + (np.float32(ty) + shifts_y[y % fold])
    for j in range(RAYS):
        column, row = place_of(j)
        tile.points[j], tile.points[RAYS + j] = lines[column], lines[TILE + row]


@kernel(inline=True, borrows=True)
def _keep(kept, q, hits):
    for j in range(RAYS):
        at = kept.place[q * RAYS + j]
        kept.who[at], kept.light[at], kept.far[at] = hits.who[j], hits.words[LIGHT + j], hits.words[T + j]


@kernel(inline=True, borrows=True)
def _keep_nothing(kept, q):
    for j in range(RAYS):
        kept.who[kept.place[q * RAYS + j]] = -1


@kernel(borrows=True)
def _fold(kept, rays, colors, total, x, y):
    """Add up what is kept of 8 × 8 pixels, in `total` from column x and row y on."""
    for j in range(RAYS):
        red = green = blue = light = hits = _ZERO
        for at in range(j, rays * RAYS, RAYS):
            i = kept.who[at]
            if i >= 0:
                brings = kept.light[at]
                # In this order whatever the compiler would rather add first, as in `frame`.
                red = fma_one(brings, colors[i, 0], red)
                green = fma_one(brings, colors[i, 1], green)
                blue = fma_one(brings, colors[i, 2], blue)
                light = fma_one(brings, _ONE, light)
                hits += _ONE
        row, column = y + j // TILE, x + j % TILE
        if row < total.shape[0] and column < total.shape[1]:
            pixel = total[row, column]
            pixel[0], pixel[1], pixel[2], pixel[3], pixel[4] = red, green, blue, light, hits


@kernel(borrows=True)
def _note_centres(kept, met, centre, width, height, tx, ty, distance, ids):
    """Write what the rays through the middles of 8 × 8 pixels have hit, as ``tiles.note_nearest`` does."""
    for row in range(min(TILE, height - ty)):
        for column in range(min(TILE, width - tx)):
            at = centre * RAYS + row * TILE + column
            hit = met and kept.who[at] >= 0
            distance[ty + row, tx + column] = kept.far[at] if hit else np.float32(np.inf)
            ids[ty + row, tx + column] = kept.who[at] if hit else np.int32(-1)


@kernel(borrows=True)
def _draw_pixels(tree, lights, eye, shifts_x, shifts_y, left, top, skin, width, height, tx, ty, bench):
    """Trace and light the rays of 8 × 8 pixels, and keep what they bring; returns whether any came near a sphere."""
    fold = shifts_x.shape[0]
    columns, rows = fold * width, fold * height
    across, down = _TWO / np.float32(columns), _TWO / np.float32(rows)
    traced, found, ready = bench.hits
    found_q = ready_q = -1
    met = False
    for q in range(fold * fold + 2):
        now = -1
        if q < fold * fold:
            x, y = q % fold * TILE, q // fold * TILE
            _point(bench.tile, fold, q, tx, ty, shifts_x, shifts_y)
            if not trace_points(
                tree, bench.cut.node, bench.cut.link, eye, bench.tile, width, height, left + np.float32(x) * across,
                top - np.float32(y) * down, np.float32(TILE) * across, np.float32(TILE) * down,
            ):  # fmt: skip
                _keep_nothing(bench.kept, q)
                continue
            met = True
            now = q
            collect_hits(tree, bench.tile, traced, skin, True, columns, rows, fold * tx + x, fold * ty + y)
        if ready_q >= 0:
            light_hits(tree, lights, eye, bench, skin, ready, _ZERO, True, False)
            _keep(bench.kept, ready_q, ready)
        if found_q >= 0:
            find_slots(found, skin)
        traced, found, ready = ready, traced, found
        ready_q, found_q = found_q, now
    return met


@kernel(borrows=True)
def draw_folded(
    tree, lights, eye, shifts_x, shifts_y, order, skin, total, blank, distance, ids, tone, picture, bench, counter, edge
):  # fmt: skip
    """Send rays through (x + shifts_x[a], y + shifts_y[b]) of every pixel, all a and b, and add what they bring to `total`.

    Textures are looked up without a filter. Several threads may call at once, see `frame.draw_frame`.

    Parameters
    ----------
    shifts_x, shifts_y
        (fold,) float32, evenly spaced by 1 / fold, the first one half of that away from the side of a pixel.
    order
        (fold²,) int32: when the ray through shifts_x[a] and shifts_y[b] is added, at b · fold + a.
    total
        (H, W, 5) float32 sums, zeros before; or (0, 0, 5), then they are kept only until they are developed.
    blank, tone, picture, counter, edge
        See `frame.draw_frame`.
    distance, ids
        As there, of the rays through the middles of pixels, with an odd fold only.
    bench
        Of one thread, with room for the rays of 8 × 8 pixels.
    """
    fold = shifts_x.shape[0]
    height, width = max(total.shape[0], picture.shape[0]), max(total.shape[1], picture.shape[1])
    base_x = shifts_x[0] - _HALF / np.float32(fold)
    base_y = shifts_y[0] - _HALF / np.float32(fold)
    wide, high = _TWO / np.float32(width), _TWO / np.float32(height)
    centre = order[order.shape[0] // 2]
    _lay_out(fold, order, bench.kept.place)
    while True:
        x, y, right, bottom = block_of(take(counter, 1), edge, width, height)
        if y >= height:
            break
        sums, above, before = total, 0, 0
        if total.shape[0] == 0:
            sums, above, before = bench.kept.sums, y, x
        for ty in range(y, bottom, TILE):
            for tx in range(x, right, TILE):
                left = (np.float32(tx) + base_x) * wide - _ONE
                top = _ONE - (np.float32(ty) + base_y) * high
                met = cut_tree(
                    tree, eye, bench.cut, left, top, np.float32(TILE) * wide, np.float32(TILE) * high
                ) and _draw_pixels(
                    tree, lights, eye, shifts_x, shifts_y, left, top, skin, width, height, tx, ty, bench
                )  # fmt: skip
                if met:
                    blank[ty // TILE, tx // TILE] = 0
                    _fold(bench.kept, fold * fold, skin.colors, sums, tx - before, ty - above)
                if ids.shape[0] > 0:
                    _note_centres(bench.kept, met, centre, width, height, tx, ty, distance, ids)
        if picture.shape[0] > 0:
            develop_block(
                sums, above, before, blank, fold * fold, tone, x, right, y, bottom, picture, bench.spare
            )
