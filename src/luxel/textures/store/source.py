"""Stored textures where an engine expects a baker: the cache then keeps what is looked at, as it does for light."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from luxel.light.mapping import texel_directions, texel_solid_angles
from luxel.textures.store.reader import BakedFrame
from luxel.textures.textures import decode

__all__ = ["StoredBaker"]


class StoredBaker:
    """Hands out the textures of a stored frame; a :class:`luxel.dynamic.work.TileBaker`.

    The compressed textures of the whole frame are in memory. Safe to share between threads.
    """

    def __init__(self, frame: BakedFrame) -> None:
        self._frame = frame
        self._codec, self._payload = frame.codec, frame.payload
        settings = frame.settings
        mapping, texels = settings.spec.mapping, settings.spec.texels
        angles = texel_solid_angles(mapping, texels)
        weights = (angles / angles.sum())[..., None]
        # Luminance linear in the normal n: its mean, and three times the mean of luminance · n.
        self._moments = np.concatenate([weights, 3 * weights * texel_directions(mapping, texels)], axis=-1)

    def preparation(self, threads: int) -> Iterator[None]:
        """Nothing is left to do once the frame has been read."""
        yield from ()

    def bake_into(self, ids: NDArray[np.int32], codes: NDArray[np.uint8]) -> int:
        """Fill (K, T, T) `codes` of (K,) `ids`; what was clipped is counted in the store."""
        codes[...] = self._codec.decode(self._payload[ids])
        return 0

    def first_light(self, ids: NDArray[np.int32]) -> NDArray[np.float32]:
        """Return (K, 4) coarse records of (K,) `ids`: the textures' own first moments."""
        codes = self._codec.decode(self._payload[ids])
        luminance = decode(codes, self._frame.scale, self._frame.encoding)
        return np.asarray(np.einsum("kij,ijm->km", luminance, self._moments), np.float32)
