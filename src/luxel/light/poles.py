"""Latitude-longitude maps near their poles: no finer along a row than elsewhere.

The texels around a pole are a tenth as wide as those of the equator, and as noisy alone. Light rarely changes faster there than
elsewhere, so most of what no texel of the equator could show is noise: harmonics of a row are kept up to the frequency that texels of the
equator resolve, halved at twice that and gone at thrice (as weather models filter theirs along circles of latitude, Arakawa and Lamb 1977).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from luxel.kernels.poles import smooth_rows
from luxel.light.mapping import Mapping

__all__ = ["polar_rows", "smooth_poles"]

Float = NDArray[np.float64]

# Rows that keep so much of their finest harmonic are not worth smoothing.
_NEXT_TO_ALL = 0.75


def polar_rows(mapping: Mapping, texels: int) -> NDArray[np.int32]:
    """Rows that can be smoothed; there are none in other than latitude-longitude maps."""
    kept = np.array([_kept(row, texels)[-1] for row in range(texels)])
    return np.flatnonzero((kept < _NEXT_TO_ALL) & (mapping == "latlong")).astype(np.int32)


def smooth_poles(
    textures: NDArray[np.float32], rows: NDArray[np.int32], exposed: NDArray[np.uint32], share: float = 0.0
) -> None:
    """Smooth such rows of (K, T, T) textures in place, if such a share of a row's texels has samples that are `exposed` (K, T, T)."""
    if len(rows):
        texels = textures.shape[1]
        smooth_rows(textures, exposed, round(share * texels), rows, _shares(texels))


def _kept(row: int, texels: int) -> Float:
    """Share of each harmonic of a row that is kept."""
    # A row always keeps how it leans, which is what a lamp from the side does to a pole.
    finest = max(1.0, texels / 2 * np.sin((row + 0.5) * np.pi / texels))
    return np.asarray(np.clip(1.5 - np.arange(texels // 2 + 1) / (2 * finest), 0, 1))


@lru_cache(maxsize=8)
def _shares(texels: int) -> NDArray[np.float32]:
    """(T, T, T): what each texel of each row gives to each."""
    unit = np.fft.rfft(np.eye(texels), axis=1)
    shares = [np.fft.irfft(unit * _kept(row, texels), n=texels, axis=1) for row in range(texels)]
    return np.array(shares, np.float32)
