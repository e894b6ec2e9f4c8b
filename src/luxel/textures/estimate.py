"""Estimates: cheap textures that stand in for those of a bake until these are there, or where nobody would see the difference."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from luxel.light.in_view import Gaze
from luxel.light.mapping import texel_weights
from luxel.textures.bake import Baker
from luxel.textures.spec import Mode, TextureSpec
from luxel.textures.textures import encode

__all__ = ["EstimateBaker", "takes_long"]

_TEXELS, _SAMPLES = 8, 1
# From so many samples on, a texture takes at least two and a half times as long as one of a single ``fast`` sample.
_MANY_SAMPLES: dict[Mode, int] = {"fast": 4, "paper": 9}


class EstimateBaker:
    """Makes textures of the shape, scale and encoding of `baker`'s from a sample a texel, or a quarter of the texels, filtered and interpolated.

    Whatever the mode of the baker, these are ``fast``. Safe to share between threads; what a texture becomes depends on its particle, the gaze, and the gaze that was prepared for.

    Parameters
    ----------
    baker
        Whose textures are estimated; its world and coarse records are shared.
    whole
        Sample all texels instead of a quarter of them.
    """

    def __init__(self, baker: Baker, *, whole: bool = False) -> None:
        self._baker = baker
        texels = baker.spec.texels
        sampled = texels if whole else min(_TEXELS, texels)
        self._light = baker.coarser_light(sampled, _SAMPLES)
        self._whole = sampled == texels
        self._places, self._weights = texel_weights(baker.spec.mapping, sampled, texels)

    def luminance(
        self, ids: NDArray[np.int32], gaze: Gaze | None = None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return (K, T, T) luminance and (K,) the standard error expected of a sampled texel, but for what few texels blur.

        With a `gaze`, only what is looked at is sampled.
        """
        found, error = self._light.luminance(ids, gaze)
        if self._whole:
            return found, error
        flat = found.reshape(len(ids), -1)
        # Texel by texel, so that a texture does not depend on its batch by rounding.
        total = flat[:, self._places[0]] * self._weights[0]
        for place, weight in zip(self._places[1:], self._weights[1:], strict=True):
            total += flat[:, place] * weight
        texels = self._baker.spec.texels
        return total.reshape(len(ids), texels, texels), error

    def bake_into(self, ids: NDArray[np.int32], codes: NDArray[np.uint8], gaze: Gaze | None = None) -> int:
        """Write codes (K, T, T) of particles `ids` (K,); clipped texels are not counted, since better ones follow."""
        codes[...], _ = encode(self.luminance(ids, gaze)[0], self._baker.scale, self._baker.encoding)
        return 0

    def suits(self, gaze: Gaze | None) -> bool:
        """Whether what was prepared serves this picture; if not, prepare again."""
        return self._light.suits(gaze)

    def preparation(self, threads: int, gaze: Gaze | None = None) -> Iterator[None]:
        """Learn the filter, with a `gaze` from what is in the picture; with one thread in short steps."""
        yield from self._light.preparation(threads, gaze)


def takes_long(spec: TextureSpec) -> bool:
    """Whether textures take so long that it is worth to show some of a single sample first."""
    return spec.samples >= _MANY_SAMPLES[spec.mode]
