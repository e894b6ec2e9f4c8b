"""Luminance textures that stay compressed: renderers unpack the four texels that they need."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from luxel.light.mapping import Mapping
from luxel.textures.codecs import Codec
from luxel.textures.textures import Encoding, LuminanceTextures, TextureTable, decoding_table

__all__ = ["CompressedTextures"]


@dataclass(frozen=True, eq=False)
class CompressedTextures:
    """Textures of some particles of one scene, a record each; a :class:`luxel.textures.textures.TextureSource`.

    Parameters
    ----------
    ids
        (M,) int32 particle ids.
    payload
        (M, B) uint8 records.
    codec
        What the records mean.
    scale, encoding, count, key, mapping
        See :class:`luxel.LuminanceTextures`.
    """

    ids: NDArray[np.int32]
    payload: NDArray[np.uint8]
    codec: Codec
    scale: float
    encoding: Encoding
    count: int
    key: str
    mapping: Mapping = "latlong"

    @classmethod
    def of(cls, textures: LuminanceTextures, codec: Codec) -> CompressedTextures:
        """Compress a bake."""
        return cls(
            textures.ids,
            codec.encode(textures.codes),
            codec,
            textures.scale,
            textures.encoding,
            textures.count,
            textures.key,
            textures.mapping,
        )

    @property
    def nbytes(self) -> int:
        """Bytes of all records and of what they share."""
        return self.payload.nbytes + self.codec.shared_bytes

    def snapshot(self, key: str) -> TextureTable:
        """Return the table for renderers; empty when `key` is not the light key."""
        table = self._table
        return table if key == self.key else replace(table, slot=np.full_like(table.slot, -1))

    @cached_property
    def _table(self) -> TextureTable:
        slot = np.full(self.count, -1, dtype=np.int32)
        slot[self.ids] = np.arange(len(self.ids), dtype=np.int32)
        codes = self.codec.lookup(self.payload)
        return TextureTable(slot, codes, decoding_table(self.scale, self.encoding), self.mapping)

    def sighted(self, ids: NDArray[np.int32], eye: NDArray[np.float64]) -> None:
        """All textures are there: nothing to request."""
