"""What a codec does to textures, side by side (paper figure 3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from luxel.errors import InputError
from luxel.picture.image import Image

__all__ = ["codec_figure"]

_GAP = 6  # pixels between textures
_LABEL = 112  # pixels for the names of the rows
_INK, _PAPER = 0, 255


def codec_figure(
    original: NDArray[np.uint8], decoded: NDArray[np.uint8], *, zoom: int = 6, gain: float = 4.0
) -> Image:
    """Draw textures, what a codec makes of them, and the difference (paper figure 3).

    Parameters
    ----------
    original, decoded
        (K, T, T) uint8 codes, one column of the figure each.
    zoom
        Pixels along the side of a texel.
    gain
        What differences are multiplied by, about middle grey.

    Raises
    ------
    InputError
        If there are no textures or the two do not match.
    """
    from PIL import Image as Pillow
    from PIL import ImageDraw, ImageFont

    if original.shape != decoded.shape or original.ndim != 3 or len(original) == 0:
        raise InputError(
            f"original and decoded textures must be (K, T, T) alike, got {original.shape} and {decoded.shape}"
        )
    difference = np.clip(128 + gain * (decoded.astype(np.float64) - original), 0, 255).astype(np.uint8)
    side = original.shape[1] * zoom
    step = side + _GAP
    page = Pillow.new("L", (_LABEL + step * len(original), 3 * step + _GAP), _PAPER)
    draw = ImageDraw.Draw(page)
    font = ImageFont.load_default(15)
    rows = (("original", original), ("compressed", decoded), (f"difference\n× {gain:g}", difference))
    for row, (name, textures) in enumerate(rows):
        top = _GAP + row * step
        draw.text((8, top + side / 2), name, fill=_INK, font=font, anchor="lm")
        for column, texture in enumerate(textures):
            tile = Pillow.fromarray(texture).resize((side, side), Pillow.Resampling.NEAREST)
            page.paste(tile, (_LABEL + column * step, top))
    return Image(np.asarray(page.convert("RGB")))
