"""Luminance textures as stored: 8-bit codes, one square a particle, and the tables that renderers read."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from luxel.kernels import FIRST_LIGHT, STALE
from luxel.kernels.codes import pack_codes
from luxel.kernels.lookup import LearntTexels
from luxel.light.mapping import Mapping

__all__ = [
    "FIRST_LIGHT",
    "NO_COARSE",
    "STALE",
    "LuminanceTextures",
    "TextureSource",
    "TextureTable",
    "decode",
    "encode",
]

Encoding = Literal["linear", "sqrt"]

#: The `coarse` of a table that has no coarse records at all.
NO_COARSE: NDArray[np.float32] = np.empty((0, 4), dtype=np.float32)


def encode(luminance: NDArray[np.float32], scale: float, encoding: Encoding) -> tuple[NDArray[np.uint8], int]:
    """Return luminance as 8-bit codes, and how many values are above `scale` and clip.

    Linear codes are luminance / scale · 255; square-root codes spend more of the 255 steps on the dark.
    """
    codes = np.empty(luminance.shape, np.uint8)
    unit = np.float32(1.0 / scale)
    clipped = pack_codes(luminance.ravel(), np.float32(scale), unit, encoding == "sqrt", codes.reshape(-1))
    return codes, int(clipped)


def decode(codes: NDArray[np.uint8], scale: float, encoding: Encoding) -> NDArray[np.float32]:
    """Inverse of :func:`encode` up to rounding; float32 of the same shape."""
    return decoding_table(scale, encoding)[codes]


def decoding_table(scale: float, encoding: Encoding) -> NDArray[np.float32]:
    """(256,) float32: the luminance of every code."""
    unit = np.arange(256, dtype=np.float32) / np.float32(255.0)
    return np.asarray((unit * unit if encoding == "sqrt" else unit) * np.float32(scale), dtype=np.float32)


@dataclass(frozen=True, eq=False)
class TextureTable:
    """What a renderer's kernels read for one frame; immutable.

    Parameters
    ----------
    slot
        (N,) int32 for every particle of the scene: its texture, or a negative number where there is no texture yet:
        `FIRST_LIGHT` where there is a coarse record, else -1. With the bit `STALE` it is a texture of the light before, see :meth:`with_stale`.
    codes
        (M, texels, texels) uint8, or M compressed textures as ``kernels.lookup`` describes them.
    decoding
        (256,) float32: luminance of each code; or (512,), the latter half for those that are stale.
    mapping
        From texels to directions, see :class:`luxel.TextureSpec`.
    coarse
        (N, 4) float32, shown where `slot` is `FIRST_LIGHT` and true there alone: luminance towards the unit normal n is
        max(0, c0 + c1 nx + c2 ny + c3 nz). What has no record either is Lambert. (0, 4) if none has one.
    """

    slot: NDArray[np.int32]
    codes: Any
    decoding: NDArray[np.float32]
    mapping: Mapping = "latlong"
    coarse: NDArray[np.float32] = field(default_factory=lambda: NO_COARSE)

    def with_stale(self, before: TextureTable) -> TextureTable:
        """Return a table that shows what has nothing under this light under the light `before`, marked by `STALE`.

        Both tables must have their codes in the same memory; else, and where there is nothing to show, this is returned.
        """
        shared = before.codes is self.codes or (
            isinstance(before.codes, LearntTexels)
            and isinstance(self.codes, LearntTexels)
            and before.codes.records is self.codes.records
            and before.codes.rows is self.codes.rows
        )
        if not shared or before.mapping != self.mapping or len(before.slot) != len(self.slot):
            return self
        bare = (self.slot == -1) & (before.slot >= 0)
        if not bare.any():
            return self
        slot = np.where(bare, before.slot | np.int32(STALE), self.slot)
        return replace(self, slot=slot, decoding=np.concatenate([self.decoding, before.decoding]))


@dataclass(frozen=True, eq=False)
class LuminanceTextures:
    """A bake: textures of some particles of one scene.

    Parameters
    ----------
    ids
        (M,) int32 particle ids, ascending order not required.
    codes
        (M, texels, texels) uint8.
    scale, encoding
        How codes become luminance, see :func:`decode`.
    count
        Number of particles in the scene.
    key
        The light key.
    clipped_count
        Texels whose luminance exceeded `scale`.
    mapping
        From texels to directions, see :class:`luxel.TextureSpec`.
    errors
        (M,) float32: expected standard error of a texel in linear luminance, root mean square over the exposed part
        of the sphere, rounding to 8 bits not counted; None where it is not known.
    """

    ids: NDArray[np.int32]
    codes: NDArray[np.uint8]
    scale: float
    encoding: Encoding
    count: int
    key: str
    clipped_count: int = 0
    mapping: Mapping = "latlong"
    errors: NDArray[np.float32] | None = None

    @property
    def luminance(self) -> NDArray[np.float32]:
        """(M, texels, texels) float32 decoded luminance."""
        return decode(self.codes, self.scale, self.encoding)

    @property
    def nbytes(self) -> int:
        """Bytes stored for texels: one each."""
        return self.codes.nbytes

    def snapshot(self, key: str) -> TextureTable:
        """Return the table for renderers; empty when `key` is not this bake's light key."""
        slot = self._slot if key == self.key else np.full(self.count, -1, dtype=np.int32)
        return TextureTable(slot, self.codes, decoding_table(self.scale, self.encoding), self.mapping)

    @cached_property
    def _slot(self) -> NDArray[np.int32]:
        slot = np.full(self.count, -1, dtype=np.int32)
        slot[self.ids] = np.arange(len(self.ids), dtype=np.int32)
        return slot

    def sighted(self, ids: NDArray[np.int32], eye: NDArray[np.float64]) -> None:
        """Textures of a bake are all there: nothing to request."""


class TextureSource(Protocol):
    """Where a renderer gets textures from: a finished bake, or the dynamic cache."""

    @property
    def key(self) -> str:
        """The light key of the textures that it makes or holds now."""
        ...

    def snapshot(self, key: str) -> TextureTable:
        """Return a consistent, immutable table for one frame."""
        ...

    def sighted(self, ids: NDArray[np.int32], eye: NDArray[np.float64]) -> None:
        """Tell the source once a frame which particles were seen, (K,) int32, and from where, (3,) file units."""
        ...
