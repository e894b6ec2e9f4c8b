"""Mean and covariance of textures as they arrive, exact, and the principal components of what has been seen.

Incremental methods (Ross, Lim, Lin and Yang 2008) update a truncated basis because their vectors are long. Ours have 256
entries: all second moments fit into half a MiB, cost less than such updates, and lose nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sized
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from luxel.errors import InputError
from luxel.textures.codecs.protocol import Codes, Progress, as_codes, blocks_of

if TYPE_CHECKING:
    from luxel.textures.codecs.linear import PCACodec

__all__ = ["IncrementalPCA", "Moments"]

_SAMPLE = 4096
_EXACT = 256  # products of so many pairs of codes sum without rounding in float32


class Moments:
    """Sums over textures, and an even sample of them. Not safe to share between threads.

    Attributes
    ----------
    count
        Textures seen.
    sample
        (at most 8192, D) uint8: every 2^k-th texture seen.
    """

    def __init__(self) -> None:
        self.count = 0
        self.sample: NDArray[np.uint8] = np.empty((0, 0), np.uint8)
        self._sum: Any = 0
        self._products: Any = 0
        self._stride = 1

    def add(self, codes: Codes | Iterable[NDArray[np.uint8]], progress: Progress | None = None) -> None:
        """Take in textures (K, T, T) uint8, or blocks of them.

        Raises
        ------
        InputError
            For another shape or dtype than those before.
        """
        total = self.count + (len(codes) if isinstance(codes, Sized) else 0)
        for block in blocks_of(codes):
            known = math.isqrt(self.sample.shape[1]) or None
            flat = np.asarray(as_codes(block, known)).reshape(len(block), -1)
            self._add(flat)
            if progress is not None:
                progress(self.count, total)

    def _add(self, flat: NDArray[np.uint8]) -> None:
        first = -self.count % self._stride
        kept = flat[first :: self._stride]
        self.sample = np.concatenate([self.sample, kept]) if self.sample.size else kept.copy()
        while len(self.sample) > 2 * _SAMPLE:
            self.sample, self._stride = self.sample[::2].copy(), 2 * self._stride
        self.count += len(flat)
        self._sum = self._sum + flat.sum(axis=0, dtype=np.int64)
        for k in range(0, len(flat), _EXACT):
            part = flat[k : k + _EXACT].astype(np.float32)
            self._products = self._products + (part.T @ part).astype(np.float64)

    def principal(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Mean (D,), eigenvalues (D,) of the covariance, falling, and eigenvectors (D, D) in columns.

        Raises
        ------
        InputError
            If nothing has been seen.
        """
        if self.count == 0:
            raise InputError("principal components need at least one texture, got none")
        mean = self._sum / self.count
        covariance = self._products / self.count - np.outer(mean, mean)
        values, vectors = np.linalg.eigh(covariance)
        return mean, np.maximum(values[::-1], 0), vectors[:, ::-1].copy()


class IncrementalPCA:
    """Principal components of textures that arrive bit by bit. Not safe to share between threads."""

    def __init__(self) -> None:
        self._moments = Moments()

    @property
    def count(self) -> int:
        """Textures seen."""
        return self._moments.count

    def partial_fit(self, codes: Codes | Iterable[NDArray[np.uint8]]) -> IncrementalPCA:
        """Take in textures (K, T, T) uint8; return self."""
        self._moments.add(codes)
        return self

    def codec(self, components: int) -> PCACodec:
        """Return a codec for what has been seen so far, with so many components."""
        from luxel.textures.codecs.linear import PCACodec

        return PCACodec.from_moments(self._moments, "components", components)
