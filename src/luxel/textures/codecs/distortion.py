"""How far compressed textures are from the originals."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from luxel.errors import InputError
from luxel.light.mapping import Mapping, texel_solid_angles
from luxel.textures.codecs.protocol import Codec, Codes, as_codes, parts

__all__ = ["Distortion"]


@dataclass(frozen=True)
class Distortion:
    """Mean error of a set of textures, and what it is bought with.

    Parameters
    ----------
    d
        Mean over textures of the paper's d(x, y), the sum of squared differences of codes (3.3).
    rmse
        Root mean squared difference, in codes.
    psnr
        Peak signal-to-noise ratio in decibels, of 255; infinite without error.
    surface
        Root mean squared error of luminance over the sphere, each texel weighted by its solid angle; None if luminance
        was not asked for.
    ratio
        Raw bytes over all bytes stored, shared arrays counted; None if no codec was given.
    """

    d: float
    rmse: float
    psnr: float
    surface: float | None = None
    ratio: float | None = None

    @property
    def root_d(self) -> float:
        """Square root of `d`."""
        return math.sqrt(self.d)

    @classmethod
    def between(
        cls,
        original: Codes,
        decoded: Codes,
        *,
        decoding: NDArray[np.float32] | None = None,
        mapping: Mapping = "latlong",
    ) -> Distortion:
        """Compare codes (N, T, T) with codes (N, T, T).

        Parameters
        ----------
        decoding
            (256,) luminance of each code; with it, `surface` is computed.
        mapping
            From texels to directions.
        """
        as_codes(original)
        if getattr(decoded, "shape", None) != original.shape:
            raise InputError(
                f"decoded codes must have shape {original.shape}, got {getattr(decoded, 'shape', None)}"
            )
        return _measure(original, lambda part: np.asarray(decoded[part]), decoding, mapping, None)

    @classmethod
    def of(
        cls,
        codec: Codec,
        codes: Codes,
        payload: NDArray[np.uint8] | None = None,
        *,
        decoding: NDArray[np.float32] | None = None,
        mapping: Mapping = "latlong",
    ) -> Distortion:
        """Measure what `codec` makes of `codes` (N, T, T), decoded block by block; `payload` saves encoding them."""
        as_codes(codes, codec.texels)
        records = codec.encode(codes) if payload is None else payload
        stored = records.nbytes + codec.shared_bytes
        size = len(codes) * codec.texels**2
        return _measure(
            codes, lambda part: codec.decode(records[part]), decoding, mapping, size / max(stored, 1)
        )


def _measure(
    codes: Codes,
    decode: Callable[[slice], NDArray[np.uint8]],
    decoding: NDArray[np.float32] | None,
    mapping: Mapping,
    ratio: float | None,
) -> Distortion:
    count, texels = len(codes), codes.shape[1]
    if count == 0:
        raise InputError("distortion needs at least one texture, got none")
    total, surface = 0, 0.0
    weights = texel_solid_angles(mapping, texels).astype(np.float64) / (4 * math.pi)
    for part in parts(count):
        a, b = np.asarray(codes[part]), decode(part)
        difference = a.astype(np.int32) - b
        total += int((difference * difference).sum(dtype=np.int64))
        if decoding is not None:
            light = decoding[a].astype(np.float64) - decoding[b]
            surface += float((light * light * weights).sum())
    d = total / count
    rmse = math.sqrt(d / texels**2)
    return Distortion(
        d,
        rmse,
        20 * math.log10(255 / rmse) if rmse else math.inf,
        None if decoding is None else math.sqrt(surface / count),
        ratio,
    )
