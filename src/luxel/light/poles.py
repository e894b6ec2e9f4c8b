"""Latitude-longitude maps near their poles: no finer along a row than elsewhere.

The texels around a pole are a tenth as wide as those of the equator, and as noisy alone. Light does not change faster there than
elsewhere, so what no texel of the equator could show is noise: harmonics of a row are kept up to the frequency that texels of the equator
resolve, and fade out up to twice that (as weather models filter theirs along circles of latitude, Arakawa and Lamb 1977).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from luxel.kernels.poles import smooth_rows
from luxel.light.mapping import Mapping

__all__ = ["smooth_poles"]


def smooth_poles(textures: NDArray[np.float32], mapping: Mapping) -> None:
    """Smooth (K, T, T) textures near the poles in place; others than latitude-longitude maps are left as they are."""
    if mapping == "latlong":
        smooth_rows(textures, *_shares(textures.shape[1]))


@lru_cache(maxsize=8)
def _shares(texels: int) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Rows that are smoothed, and (rows, T, T) what each of their texels gives to each."""
    harmonics = np.arange(texels // 2 + 1)
    rows, shares = [], []
    for row in range(texels):
        # A row always keeps how it leans, which is what a lamp from the side does to a pole.
        finest = max(1.0, texels / 2 * np.sin((row + 0.5) * np.pi / texels))
        kept = np.clip(2 - harmonics / finest, 0, 1)
        if kept[-1] < 0.5:
            rows.append(row)
            shares.append(np.fft.irfft(np.fft.rfft(np.eye(texels), axis=1) * kept, n=texels, axis=1))
    return np.array(rows, np.int32), np.array(shares, np.float32).reshape(-1, texels, texels)
