"""Texel frames: what the near field must know of every texel."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from luxel.light.mapping import Mapping, square_directions

__all__ = ["texel_frames"]


@cache
def texel_frames(mapping: Mapping, texels: int) -> NDArray[np.float32]:
    """(T·T, 4) float32: middle of every texel and the largest chord from it to a point of the texel."""
    fine = 8
    grid = square_directions(mapping, np.linspace(0, 1, texels * fine + 1)).astype(np.float64)
    frames = np.empty((texels * texels, 4), np.float32)
    for row in range(texels):
        for column in range(texels):
            block = grid[row * fine : (row + 1) * fine + 1, column * fine : (column + 1) * fine + 1]
            middle = block.reshape(-1, 3).mean(axis=0)
            middle /= np.linalg.norm(middle)
            # Between the grid's points a texel's corners bulge by less than the slack.
            chord = np.linalg.norm(block - middle, axis=-1).max() * 1.001 + 1e-4
            frames[row * texels + column] = (*middle, chord)
    frames.setflags(write=False)
    return frames
