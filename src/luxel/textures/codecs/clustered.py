"""Clustered principal components: a small basis for every kind of texture, and bits where the variance is.

Local PCA (Kambhatla and Leen 1997) with coefficients of 1 to 8 bits: bits go where they lower the error most, which is
reverse water-filling (Cover and Thomas, 10.3.3) with the errors of real quantisers (Lloyd 1982, Max 1960) in place of ideal ones. Records
have a fixed size and no entropy code, so that a renderer reads any texel of any texture at once.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxel.errors import InputError
from luxel.kernels.clustered import encode_clustered, read_codes
from luxel.kernels.lookup import ClusteredTexels, readable
from luxel.kernels.simd import LANES
from luxel.textures.codecs.linear import fraction_bits
from luxel.textures.codecs.protocol import (
    Codes,
    Progress,
    as_codes,
    as_payload,
    parts,
    setting,
    shared_array,
    shared_size,
)
from luxel.textures.codecs.quantisers import WIDEST
from luxel.trace.tree import run_parts, thread_count

__all__ = ["CENTER_UNIT", "ClusteredPCACodec"]

#: Of stored centres, in codes.
CENTER_UNIT = 2.0**-6
_TRIES = 4


@dataclass(frozen=True, eq=False)
class ClusteredPCACodec:
    """A record is the index of a cluster and the bits of its coefficients; see :class:`luxel.textures.codecs.Codec`.

    Parameters
    ----------
    payload_bytes
        Bytes of a record.
    center
        (K, T²) int16, in 1/64 codes; K <= 256.
    count
        (K,) uint16 coefficients of every cluster.
    basis
        (S, T²) int8, rows of all clusters one after the other; S is the sum of `count`.
    scale
        (S,) float32: steps of a coefficient of 1.
    width
        (S,) uint8 bits, 1..8.
    levels
        (510,) float32 levels of the quantisers of 1, 2 … 8 bits, one after the other.
    texels
        T.
    """

    payload_bytes: int
    center: NDArray[np.int16] = field(repr=False)
    count: NDArray[np.uint16] = field(repr=False)
    basis: NDArray[np.int8] = field(repr=False)
    scale: NDArray[np.float32] = field(repr=False)
    width: NDArray[np.uint8] = field(repr=False)
    levels: NDArray[np.float32] = field(repr=False)
    texels: int = 16
    kind = "cpca"

    @classmethod
    def train(
        cls,
        codes: Codes,
        ratio: float | None = None,
        payload_bytes: int | None = None,
        clusters: int | None = None,
        error: float | None = None,
        seed: int = 0,
        progress: Progress | None = None,
    ) -> ClusteredPCACodec:
        """Find clusters, bases and quantisers, to exactly one of three targets.

        Parameters
        ----------
        codes
            (N, T, T) uint8, or blocks of it.
        ratio
            Raw bytes over all bytes stored.
        payload_bytes
            Bytes of a record.
        error
            Root mean squared error, in codes; the smallest record that reaches it is taken.
        clusters
            1 to 256; None tries several numbers and takes the best.
        seed
            Of the sample that is learned from.
        progress
            Called as ``progress(done, total)`` in steps of the work.

        Raises
        ------
        InputError
            For no target or several, or a target that cannot be reached.
        """
        from luxel.textures.codecs.clustering import train

        return train(
            codes,
            ratio=ratio,
            payload_bytes=payload_bytes,
            error=error,
            clusters=clusters,
            seed=seed,
            progress=progress,
        )

    @classmethod
    def restore(cls, description: dict[str, Any], shared: dict[str, NDArray[Any]]) -> ClusteredPCACodec:
        """Rebuild from what :meth:`describe` and :attr:`shared` gave."""
        texels = setting(description, "texels", 2, 64)
        size = setting(description, "payload_bytes", 1, 2**16)
        clusters = setting(description, "clusters", 1, 256)
        count = shared_array(shared, "count", np.uint16, (clusters,))
        total = max(1, int(count.sum(dtype=np.int64)))
        codec = cls(
            size,
            shared_array(shared, "center", np.int16, (clusters, texels**2)),
            count,
            shared_array(shared, "basis", np.int8, (total, texels**2)),
            shared_array(shared, "scale", np.float32, (total,)),
            shared_array(shared, "width", np.uint8, (total,)),
            shared_array(shared, "levels", np.float32, (2 ** (WIDEST + 1) - 2,)),
            texels,
        )
        codec._check()
        return codec

    def _check(self) -> None:
        if self.width.min() < 1 or self.width.max() > WIDEST:
            raise InputError(
                f"the codec's widths must be 1..{WIDEST} bits, got {self.width.min()}..{self.width.max()}; "
                "the file is damaged"
            )
        if not np.isfinite(self.scale).all() or not np.isfinite(self.levels).all():
            raise InputError("the codec's scales and levels must be finite; the file is damaged")
        used = int(self._tables.width.sum(axis=1, dtype=np.int64).max()) + 8 * self.lead
        if used > 8 * self.payload_bytes:
            raise InputError(
                f"the codec's records need {used} bits, payload_bytes is {self.payload_bytes}; the file is damaged"
            )

    @property
    def clusters(self) -> int:
        """How many clusters there are."""
        return len(self.center)

    @property
    def lead(self) -> int:
        """Bytes of the cluster's index in a record: 0 for a lone cluster."""
        return int(self.clusters > 1)

    @property
    def shared(self) -> dict[str, NDArray[Any]]:
        """Centres, bases, scales, widths and levels."""
        names = ("center", "count", "basis", "scale", "width", "levels")
        return {name: getattr(self, name) for name in names}

    @property
    def shared_bytes(self) -> int:
        """Bytes of all shared arrays."""
        return shared_size(self.shared)

    def describe(self) -> dict[str, Any]:
        """Settings fit for JSON."""
        return {
            "kind": self.kind,
            "texels": self.texels,
            "payload_bytes": self.payload_bytes,
            "clusters": self.clusters,
        }

    def encode(self, codes: Codes) -> NDArray[np.uint8]:
        """Turn (K, T, T) codes into records (K, B)."""
        return self.quantized(codes)[0]

    def quantized(self, codes: Codes) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.float32]]:
        """Records (K, B), squared errors (K,), and normalised coefficients (K, most) before they were quantised."""
        codes = as_codes(codes, self.texels)
        count, tables = len(codes), self._tables
        records = np.empty((count, self.payload_bytes), np.uint8)
        errors, values = np.empty(count, np.float32), np.zeros((count, int(self.count.max())), np.float32)
        rows, gain = self._rows

        def work(part: slice) -> None:
            flat = np.ascontiguousarray(codes[part]).reshape(part.stop - part.start, -1)
            encode_clustered(
                flat,
                self.center * np.float32(CENTER_UNIT),
                rows,
                gain,
                tables.scale,
                tables.width,
                tables.counts,
                tables.levels,
                tables.unit,
                self.lead,
                _TRIES,
                records[part],
                errors[part],
                values[part],
            )

        run_parts(work, parts(count), thread_count(None))
        return records, errors, values

    def decode(self, payload: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Turn records (K, B) into codes (K, T, T)."""
        out = np.empty((len(payload), self.texels, self.texels), np.uint8)
        whole = self.lookup(payload)

        def work(part: slice) -> None:
            read_codes(whole._replace(records=readable(whole.records[part])), out[part])

        run_parts(work, parts(len(out)), thread_count(None))
        return out

    def lookup(self, payload: NDArray[np.uint8]) -> ClusteredTexels:
        """Return what kernels read texels from."""
        payload = as_payload(payload, self.payload_bytes)
        if self.lead and len(payload) and payload[:, 0].max() >= self.clusters:
            raise InputError(
                f"payload names cluster {payload[:, 0].max()}, the codec has {self.clusters}; the file is damaged"
            )
        return self._tables._replace(records=readable(payload))

    @cached_property
    def _tables(self) -> ClusteredTexels:
        most = max(1, -(-int(self.count.max()) // LANES)) * LANES
        basis = np.zeros((self.clusters, self.texels**2, most), np.int8)
        scale, width = np.zeros((self.clusters, most), np.float32), np.zeros((self.clusters, most), np.uint8)
        for k, (first, n) in enumerate(self._spans()):
            rows = slice(first, first + n)
            basis[k, :, :n], scale[k, :n], width[k, :n] = (
                self.basis[rows].T,
                self.scale[rows],
                self.width[rows],
            )
        digits = 2 ** fraction_bits(self.texels)
        # Half a code is added before rounding down.
        offset = (self.center.astype(np.float32) * np.float32(CENTER_UNIT) + np.float32(0.5)) * digits
        levels = np.zeros((WIDEST + 1, 2**WIDEST), np.float32)
        for bits in range(1, WIDEST + 1):
            levels[bits, : 2**bits] = self.levels[2**bits - 2 : 2 ** (bits + 1) - 2]
        return ClusteredTexels(
            np.empty((0, self.payload_bytes), np.uint8),
            basis,
            np.rint(offset).astype(np.float32),
            scale,
            width,
            self.count.astype(np.int32),
            levels,
            self.lead,
            np.float32(1 / digits),
            self.texels,
        )

    @cached_property
    def _rows(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Basis (K, most, T²) and gain (K, most) for the encoder."""
        tables = self._tables
        rows = np.ascontiguousarray(tables.basis.transpose(0, 2, 1), dtype=np.float32)
        power = (rows.astype(np.float64) ** 2).sum(axis=2) * tables.scale * tables.unit
        return rows, np.divide(1, power, out=np.zeros_like(power), where=power > 0).astype(np.float32)

    def _spans(self) -> list[tuple[int, int]]:
        ends = np.cumsum(self.count, dtype=np.int64)
        return [(int(end - n), int(n)) for end, n in zip(ends, self.count, strict=True)]
