"""The nearest codeword of textures, exact: bounds rule out almost all of them (``kernels.codewords``)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxel.kernels.codewords import EMPTY, nearest_codewords
from luxel.kernels.simd import LANES
from luxel.textures.codecs.merging import SAMPLE, principal_axes
from luxel.textures.codecs.protocol import parts

__all__ = ["CodewordSearch"]


class CodewordSearch:
    """Finds the nearest codeword; immutable, safe to share between threads.

    Parameters
    ----------
    words
        (C, D) uint8.
    """

    def __init__(self, words: NDArray[np.uint8]) -> None:
        self._words = words
        # Some words are enough: any orthonormal axes give right answers, good ones give them fast.
        some = words[:: max(1, len(words) // SAMPLE)]
        self._mean, axes = principal_axes(some.astype(np.float32))
        self._axes = axes[:, : LANES - 1]
        self._blocks, self._low, self._high, self._order = _blocks(
            np.concatenate([self._bounds(words[part]) for part in parts(len(words))])
        )

    def nearest(self, codes: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Return the nearest word (n,) of each row of `codes` (n, D); the lowest of several."""
        codes = np.ascontiguousarray(codes)
        bounds = self._bounds(codes)
        starts = np.searchsorted(self._low[1:], bounds[:, 0])
        found = np.empty(len(codes), np.int64)
        nearest_codewords(
            codes, bounds, starts, self._blocks, self._low, self._high, self._order, self._words, found
        )
        return found

    def _bounds(self, codes: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Coordinates along the axes and the length of the rest, (n, 16)."""
        centred = codes - self._mean
        out = np.zeros((len(codes), LANES), np.float32)
        lead = centred @ self._axes
        out[:, : lead.shape[1]] = lead
        rest = np.einsum("nd,nd->n", centred, centred) - np.einsum("nd,nd->n", lead, lead)
        out[:, -1] = np.sqrt(np.maximum(rest, 0))
        return out


def _blocks(bounds: NDArray[np.float32]) -> tuple[NDArray[Any], ...]:
    """Sort bounds (n, 16) by their first coordinate into blocks.

    Returns
    -------
    blocks, low, high, order
        Flat float32; the range of the first coordinate in each block, float32; the row of every lane, int32, which is 0 in empty lanes.
    """
    count = len(bounds)
    room = -(-count // LANES) * LANES
    order = np.zeros(room, np.int32)
    order[:count] = np.argsort(bounds[:, 0], kind="stable")
    table = np.full((room, LANES), EMPTY, np.float32)
    table[:count] = bounds[order[:count]]
    low = table[::LANES, 0].copy()
    high = table[np.minimum(np.arange(LANES - 1, room, LANES), count - 1), 0].copy()
    return table.reshape(-1, LANES, LANES).transpose(0, 2, 1).ravel(), low, high, order
