"""From sums of light to what is displayed: tone curve on luminance, then colour, then sRGB (paper 3.1)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.memory import float_lines
from luxel.kernels.simd import LANES, fma, load, select, splat, store, vmax, vmin
from luxel.kernels.tiles import TILE

__all__ = ["SRGB_CELLS", "Tone", "develop", "develop_block", "develop_rows"]

SRGB_CELLS = 4096  # sRGB gains at most one of 255 levels over such a part of linear light
_ZERO, _ONE = np.float32(0), np.float32(1)
_DARK = np.float32(1e-30)


class Tone(NamedTuple):
    """How sums become pixels."""

    exposure: np.float32
    white: np.float32  # luminance that displays as white
    top: np.ndarray  # (3,) float32, linear colour of the background at the picture's top
    bottom: np.ndarray
    cells: np.ndarray  # (SRGB_CELLS + 1,) uint8: sRGB level at the start of each cell of linear light
    steps: np.ndarray  # (257,) float32: where each level begins


@kernel(inline=True)
def _gain(luminance, hits, cover, exposure, white, toe):
    """Factor on the sums: Reinhard's extended curve (2002) after a factor of white^-0.6; linear where white <= 1.

    It acts on luminance alone, so that a pixel keeps the chromaticity of its colours however bright it is lit.
    """
    if luminance <= 0:
        return _ZERO
    v = luminance / hits * exposure
    if white > _ONE:
        v *= toe
        v = v * (_ONE + v / (toe * white * toe * white)) / (_ONE + v)
    return min(v, _ONE) * cover / luminance


@kernel(inline=True)
def _level(tone, value):
    """Nearest sRGB level, 0 … 255, of linear light."""
    cell = int(min(max(value, _ZERO), _ONE) * np.float32(SRGB_CELLS))
    level = tone.cells[cell]
    return level + np.uint8(value >= tone.steps[level + 1])  # no branch: it could not be predicted


@kernel
def develop(total, rays, exposure, white, background, picture):
    """Turn `total` (H, W, 5) of `rays` rays a pixel into linear colours (H, W, 3) before one background."""
    scale = _ONE / np.float32(rays)
    toe = white ** np.float32(-0.6)  # keeps contrast in the shade of a strong sun
    for y in range(total.shape[0]):
        for x in range(total.shape[1]):
            cover = total[y, x, 4] * scale
            gain = _gain(total[y, x, 3], total[y, x, 4], cover, exposure, white, toe)
            for c in range(3):
                picture[y, x, c] = total[y, x, c] * gain + background[c] * (_ONE - cover)


@kernel(borrows=True)
def _collect(total, row, first, last, before, words):
    """Copy the sums of pixels [first, last) of a row, `last` at most sixteen behind `first`, to lanes: `words` (5 · 16,); returns whether anything is there."""
    any_hit = False
    for k in range(LANES):
        x = first + k
        if x < last:
            sums = total[row, x - before]
            for c in range(5):
                words[c * LANES + k] = sums[c]
            any_hit |= sums[4] > 0
        else:
            for c in range(5):
                words[c * LANES + k] = _ZERO
    return any_hit


@kernel(borrows=True)
def _develop_lanes(words, scale, tone, toe, red, green, blue):
    """Turn the sums of sixteen pixels in `words` into linear colours before a background, as `develop` does."""
    zero, one = splat(_ZERO), splat(_ONE)
    hits, luminance = load(words, 4 * LANES), load(words, 3 * LANES)
    cover = hits * scale
    v = luminance / vmax(hits, one) * tone.exposure
    if tone.white > _ONE:
        v = v * toe
        v = v * (one + v / splat(toe * tone.white * toe * tone.white)) / (one + v)
    gain = select(luminance > zero, vmin(v, one) * cover / vmax(luminance, splat(_DARK)), zero)
    clear = one - cover
    store(words, 0, fma(load(words, 0), gain, red * clear))
    store(words, LANES, fma(load(words, LANES), gain, green * clear))
    store(words, 2 * LANES, fma(load(words, 2 * LANES), gain, blue * clear))


@kernel(borrows=True, inner=True)
def develop_block(
    total, above, before, blank, rays, tone, first_column, last_column, first_row, last_row, picture, words
):
    """As `develop_rows`, of columns [first_column, last_column) only; `blank` as in ``frame.draw_frame``.

    `total` lacks so many rows `above` and columns `before`. `words` (80,) is memory to work in.
    """
    height = picture.shape[0]
    scale = _ONE / np.float32(rays)
    toe = tone.white ** np.float32(-0.6)
    for y in range(first_row, last_row):
        rise = _ONE - (np.float32(y) + np.float32(0.5)) / np.float32(height)
        r = tone.bottom[0] + (tone.top[0] - tone.bottom[0]) * rise
        g = tone.bottom[1] + (tone.top[1] - tone.bottom[1]) * rise
        b = tone.bottom[2] + (tone.top[2] - tone.bottom[2]) * rise
        red, green, blue = _level(tone, r), _level(tone, g), _level(tone, b)
        begin = first_column
        while begin < last_column:
            end = min(begin + TILE, last_column)
            empty = blank.shape[0] > 0 and blank[y // TILE, begin // TILE] != 0
            if not empty:
                # Sixteen at a time, if the next tile is not blank either.
                if end < last_column and not (blank.shape[0] > 0 and blank[y // TILE, end // TILE]):
                    end = min(begin + 2 * TILE, last_column)
                empty = not _collect(total, y - above, begin, end, before, words)
            if empty:
                for x in range(begin, end):
                    picture[y, x, 0], picture[y, x, 1], picture[y, x, 2] = red, green, blue
            else:
                _develop_lanes(words, scale, tone, toe, r, g, b)
                for x in range(begin, end):
                    k = x - begin
                    picture[y, x, 0] = _level(tone, words[k])
                    picture[y, x, 1] = _level(tone, words[LANES + k])
                    picture[y, x, 2] = _level(tone, words[2 * LANES + k])
            begin = end


@kernel
def develop_rows(total, blank, rays, tone, first_row, last_row, picture):
    """Turn rows [first_row, last_row) of `total` (H, W, 5) into sRGB (H, W, 3) uint8; the background runs from top to bottom."""
    words = float_lines(5 * LANES)
    develop_block(total, 0, 0, blank, rays, tone, 0, picture.shape[1], first_row, last_row, picture, words)
