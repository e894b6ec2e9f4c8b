"""Textures that are baked as they are needed, and kept: for many pictures of one scene."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from luxel.textures.bake import Baker, Progress, bake_with
from luxel.textures.textures import TextureTable, decoding_table

__all__ = ["GrowingTextures"]


class GrowingTextures:
    """Textures of those particles of a scene that somebody asked for; a :class:`luxel.textures.textures.TextureSource`.

    Each texture is that which :func:`luxel.bake` makes, whatever is baked with it.

    Parameters
    ----------
    baker
        Makes them.
    threads
        None means all that the process may use.
    """

    def __init__(self, baker: Baker, threads: int | None = None) -> None:
        self._baker = baker
        self._threads = threads
        self._slot = np.full(len(baker.scene.particles), -1, np.int32)
        self._codes = np.empty((0, baker.spec.texels, baker.spec.texels), np.uint8)
        self._count = 0

    @property
    def key(self) -> str:
        """The light key."""
        return self._baker.key

    def __len__(self) -> int:
        return self._count

    def grow(self, ids: NDArray[np.int32], progress: Progress | None = None) -> None:
        """Bake those of `ids` (K,), each once, that are not there yet."""
        missing = ids[self._slot[ids] < 0]
        if not len(missing):
            return
        baked = bake_with(self._baker, missing, progress=progress, threads=self._threads)
        count = self._count + len(missing)
        if count > len(self._codes):
            # By halves: pictures of a moving camera add a little each.
            room = min(max(count, self._count + self._count // 2), len(self._slot))
            grown = np.empty((room, *self._codes.shape[1:]), np.uint8)
            grown[: self._count] = self._codes[: self._count]
            self._codes = grown
        self._codes[self._count : count] = baked.codes
        self._slot[missing] = np.arange(self._count, count, dtype=np.int32)
        self._count = count

    def snapshot(self, key: str) -> TextureTable:
        """Return the table for renderers; empty when `key` is not the light key."""
        slot = self._slot.copy() if key == self.key else np.full_like(self._slot, -1)
        baker = self._baker
        decoding = decoding_table(baker.scale, baker.encoding)
        return TextureTable(slot, self._codes, decoding, baker.spec.mapping)

    def sighted(self, ids: NDArray[np.int32], eye: NDArray[np.float64]) -> None:
        """Who wants textures calls :meth:`grow`."""
