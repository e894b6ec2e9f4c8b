"""Vector quantisation: a texture is the index of a codeword (paper 3.3)."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxel.errors import InputError
from luxel.kernels.lookup import CodewordTexels
from luxel.textures.codecs import merging
from luxel.textures.codecs.merging import Clusters
from luxel.textures.codecs.nearest import CodewordSearch
from luxel.textures.codecs.protocol import (
    Codes,
    Progress,
    as_codes,
    as_payload,
    gathered,
    one_target,
    parts,
    setting,
    shared_array,
    shared_size,
)
from luxel.trace.tree import run_parts, thread_count

__all__ = ["VQCodec"]

# Up to so many textures, merging is exact: no buckets, no moving of centroids.
_EXACT = 20_000
_REFINEMENTS = 3


@dataclass(frozen=True, eq=False)
class VQCodec:
    """Records are indices of 1 to 4 bytes, little-endian; see :class:`luxel.textures.codecs.Codec`.

    Parameters
    ----------
    codebook
        (C, T, T) uint8 codewords.
    """

    codebook: NDArray[np.uint8] = field(repr=False)
    kind = "vq"

    @classmethod
    def train(
        cls,
        codes: Codes,
        codewords: int | None = None,
        error: float | None = None,
        ratio: float | None = None,
        seed: int = 0,
        progress: Progress | None = None,
        *,
        exact: bool | None = None,
    ) -> VQCodec:
        """Make a codebook by pairwise merging, to exactly one of three targets.

        Parameters
        ----------
        codes
            (N, T, T) uint8, or blocks of it.
        codewords
            How many to keep.
        error
            Root mean squared error, in codes, that merging may cause.
        ratio
            Raw bytes over all bytes stored: codebook and indices.
        seed
            Of the borders between buckets.
        progress
            Called as ``progress(done, total)`` in steps of the work.
        exact
            Pairwise merging of all textures at once, as in the paper; False merges in buckets and then moves every
            codeword to the mean of the textures nearest to it (Lloyd). By default by the number of textures.

        Raises
        ------
        InputError
            For no target or several, or a ratio that no codebook reaches.
        """
        codes = gathered(codes)
        count, texels = len(codes), int(codes.shape[1])
        target, value = one_target(codewords=codewords, error=error, ratio=ratio)
        exact = count <= _EXACT if exact is None else exact
        flat = np.asarray(codes[:]).reshape(count, -1)
        clusters = Clusters.distinct(flat)
        bucket = len(clusters) if exact else merging.BUCKET
        steps = 1 + (0 if exact else _REFINEMENTS)
        if target == "error":
            clusters = merging.reduce_to_error(
                clusters, _merging_error(float(value)) * flat.size, bucket=bucket, seed=seed
            )
        else:
            most = int(value) if target == "codewords" else codewords_for(count, texels, float(value))
            clusters = merging.reduce_to_count(clusters, most, bucket=bucket, seed=seed)
        if progress is not None:
            progress(1, steps)
        codec = cls._of(clusters, texels)
        for step in range(1, steps):
            codec = cls._of(clusters.relabelled(codec.indices(flat, clusters.rows)), texels)
            if progress is not None:
                progress(step + 1, steps)
        return codec

    @classmethod
    def _of(cls, clusters: Clusters, texels: int) -> VQCodec:
        """Codewords are the means of clusters, rounded."""
        words = np.empty((len(clusters), texels**2), np.uint8)
        for part in parts(len(words)):
            words[part] = clusters.means(np.arange(part.start, part.stop))[0] + np.float32(0.5)
        return cls(np.unique(words, axis=0).reshape(-1, texels, texels))

    @classmethod
    def restore(cls, description: dict[str, Any], shared: dict[str, NDArray[Any]]) -> VQCodec:
        """Rebuild from what :meth:`describe` and :attr:`shared` gave."""
        texels = setting(description, "texels", 1, 64)
        count = setting(description, "codewords", 1, 2**32)
        return cls(shared_array(shared, "codebook", np.uint8, (count, texels, texels)))

    @property
    def texels(self) -> int:
        """Rows and columns of a texture."""
        return int(self.codebook.shape[1])

    @property
    def codewords(self) -> int:
        """How many codewords there are."""
        return len(self.codebook)

    @property
    def payload_bytes(self) -> int:
        """Bytes of an index."""
        return index_bytes(self.codewords)

    @property
    def shared(self) -> dict[str, NDArray[Any]]:
        """The codebook."""
        return {"codebook": self.codebook}

    @property
    def shared_bytes(self) -> int:
        """Bytes of the codebook."""
        return shared_size(self.shared)

    def describe(self) -> dict[str, Any]:
        """Settings fit for JSON."""
        return {"kind": self.kind, "texels": self.texels, "codewords": self.codewords}

    def encode(self, codes: Codes) -> NDArray[np.uint8]:
        """Turn (K, T, T) codes into the indices (K, B) of their nearest codewords; the lowest of several."""
        codes, search = as_codes(codes, self.texels), self._search
        out = np.empty((len(codes), self.payload_bytes), np.uint8)

        def work(part: slice) -> None:
            block = np.asarray(codes[part]).reshape(part.stop - part.start, -1)
            out[part] = index_records(search.nearest(block), self.payload_bytes)

        run_parts(work, parts(len(codes)), thread_count(None))
        return out

    def decode(self, payload: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Turn indices (K, B) into codes (K, T, T)."""
        return self.codebook[self._checked(payload)[1]]

    def lookup(self, payload: NDArray[np.uint8]) -> CodewordTexels:
        """Return what kernels read texels from."""
        return CodewordTexels(self._checked(payload)[0], self.codebook)

    def indices(self, flat: NDArray[np.uint8], rows: NDArray[np.int64] | None = None) -> NDArray[np.int64]:
        """Return the nearest codeword (n,) of codes (n, T²), or of some rows of them."""
        out, search = np.empty(len(flat) if rows is None else len(rows), np.int64), self._search

        def work(part: slice) -> None:
            out[part] = search.nearest(flat[part if rows is None else rows[part]])

        run_parts(work, parts(len(out)), thread_count(None))
        return out

    @cached_property
    def _search(self) -> CodewordSearch:
        return CodewordSearch(self.codebook.reshape(self.codewords, -1))

    def _checked(self, payload: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        payload = as_payload(payload, self.payload_bytes)
        index = record_indices(payload, self.payload_bytes)
        if len(index) and index.max() >= self.codewords:
            raise InputError(
                f"payload names codeword {index.max()}, the codebook has {self.codewords}; the file is damaged"
            )
        return payload, index


def _merging_error(error: float) -> float:
    """Mean squared error that merging may cause for `error` to hold after codewords are rounded.

    Rounding adds a twelfth where means lie evenly between whole numbers, and never more than merging itself has caused.
    """
    return max(error**2 / 2, error**2 - 1 / 12)


def index_bytes(count: int) -> int:
    """Bytes that tell `count` things apart."""
    return max(1, -(-(count - 1).bit_length() // 8))


def index_records(index: NDArray[np.int64], size: int) -> NDArray[np.uint8]:
    """Little-endian records (n, size) of whole numbers (n,)."""
    return (index[:, None] >> (8 * np.arange(size))).astype(np.uint8)


def record_indices(payload: NDArray[np.uint8], size: int) -> NDArray[np.int64]:
    """Inverse of :func:`index_records`, from the first `size` bytes of records."""
    index = np.zeros(len(payload), np.int64)
    for k in range(size):
        index |= payload[:, k].astype(np.int64) << (8 * k)
    return index


def codewords_for(count: int, texels: int, ratio: float) -> int:
    """Most codewords with which `count` textures reach `ratio`, the indices counted.

    Raises
    ------
    InputError
        If not even one fits.
    """
    size = texels * texels
    best = max(min(int(count * (size / ratio - b) // size), 256**b) for b in (1, 2, 3, 4))
    if best < 1:
        raise InputError(
            f"ratio {ratio:g} cannot be reached: {count} textures of {size} bytes leave no room for a codeword"
        )
    return best
