"""From sums of light to what is displayed: tone curve on luminance, then colour, then sRGB (paper 3.1)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.tiles import TILE

__all__ = ["SRGB_CELLS", "Tone", "develop", "develop_block", "develop_rows"]

SRGB_CELLS = 4096  # sRGB gains at most one of 255 levels over such a part of linear light
_ZERO, _ONE, _TOP = np.float32(0), np.float32(1), np.float32(255)


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
    return level + np.uint8(1) if value >= tone.steps[level + 1] else level


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


@kernel(borrows=True, inner=True)
def develop_block(
    total, above, before, blank, rays, tone, first_column, last_column, first_row, last_row, picture
):
    """As `develop_rows`, of columns [first_column, last_column) only; `blank` as in ``frame.draw_frame``.

    `total` lacks so many rows `above` and columns `before`.
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
        for begin in range(first_column, last_column, TILE):
            end = min(begin + TILE, last_column)
            if blank.shape[0] > 0 and blank[y // TILE, begin // TILE]:
                for x in range(begin, end):
                    picture[y, x, 0], picture[y, x, 1], picture[y, x, 2] = red, green, blue
                continue
            for x in range(begin, end):
                sums = total[y - above, x - before]
                hits = sums[4]
                if hits == 0:
                    picture[y, x, 0], picture[y, x, 1], picture[y, x, 2] = red, green, blue
                    continue
                cover = hits * scale
                gain = _gain(sums[3], hits, cover, tone.exposure, tone.white, toe)
                clear = _ONE - cover
                picture[y, x, 0] = _level(tone, sums[0] * gain + r * clear)
                picture[y, x, 1] = _level(tone, sums[1] * gain + g * clear)
                picture[y, x, 2] = _level(tone, sums[2] * gain + b * clear)


@kernel(borrows=True)
def develop_rows(total, blank, rays, tone, first_row, last_row, picture):
    """Turn rows [first_row, last_row) of `total` (H, W, 5) into sRGB (H, W, 3) uint8; the background runs from top to bottom."""
    develop_block(total, 0, 0, blank, rays, tone, 0, picture.shape[1], first_row, last_row, picture)
