"""How far compressed textures are from the originals: in codes, in luminance, and as pictures show it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxel.errors import InputError
from luxel.light.mapping import Mapping, texel_solid_angles
from luxel.textures.codecs.protocol import Codec, Codes, as_codes, parts

__all__ = ["Distortion", "DistortionSum"]


@dataclass(frozen=True)
class Distortion:
    """Mean error of a set of textures, and what it is bought with. Figures of luminance are None if it was not asked for.

    Parameters
    ----------
    d
        Mean over textures of the paper's d(x, y), the sum of squared differences of codes (3.3).
    rmse
        Root mean squared difference, in codes.
    psnr
        Peak signal-to-noise ratio in decibels, of 255; infinite without error.
    largest
        Of all differences, in codes.
    surface
        Root mean squared error of luminance over the spheres, each texel weighted by its solid angle.
    seen
        The same, each texel weighted by its luminance as well. Under a sky that is the same everywhere, without bounces,
        luminance is the share of directions that a point is seen from: so this is the error expected in the pixels of a picture
        from any side. Under other lights it leans to what is lit.
    largest_luminance
        Largest error of luminance of any texel. Pixels mix texels, so that none can be farther off.
    ratio
        Raw bytes over all bytes stored, shared arrays counted; None if no codec was given.
    """

    d: float
    rmse: float
    psnr: float
    largest: int
    surface: float | None = None
    seen: float | None = None
    largest_luminance: float | None = None
    ratio: float | None = None

    @property
    def root_d(self) -> float:
        """Square root of `d`."""
        return math.sqrt(self.d)

    def to_json(self) -> dict[str, Any]:
        """Plain values, ``root_d`` among them; an infinite ``psnr`` is None."""
        values = {**asdict(self), "root_d": self.root_d}
        if math.isinf(self.psnr):
            values["psnr"] = None
        return values

    @classmethod
    def none(cls, ratio: float | None = None) -> Distortion:
        """Return that of textures that are as they were."""
        return cls(0.0, 0.0, math.inf, 0, 0.0, 0.0, 0.0, ratio)

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
            (256,) luminance of each code; with it, errors of luminance are measured.
        mapping
            From texels to directions.
        """
        as_codes(original)
        if getattr(decoded, "shape", None) != original.shape:
            raise InputError(
                f"decoded codes must have shape {original.shape}, got {getattr(decoded, 'shape', None)}"
            )
        return _measure(original, lambda part: np.asarray(decoded[part]), decoding, mapping)

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
        return _measure(codes, lambda part: codec.decode(records[part]), decoding, mapping, stored)


class DistortionSum:
    """Adds up what :class:`Distortion` says, block by block.

    Parameters
    ----------
    texels, decoding, mapping
        See :class:`Distortion`.
    """

    def __init__(
        self, texels: int, decoding: NDArray[np.float32] | None = None, mapping: Mapping = "latlong"
    ) -> None:
        self._count, self._texels, self._squares, self._largest = 0, texels, 0, 0
        self._luminance = None if decoding is None else decoding.astype(np.float64)
        angles = texel_solid_angles(mapping, texels).astype(np.float64)
        self._weights = angles / angles.sum()
        self._surface = self._seen = self._light = self._largest_luminance = 0.0

    def add(self, original: NDArray[np.uint8], decoded: NDArray[np.uint8]) -> None:
        """Take in a block (K, T, T) and what came back of it."""
        self._count += len(original)
        difference = np.abs(original.astype(np.int32) - decoded)
        self._squares += int((difference * difference).sum(dtype=np.int64))
        self._largest = max(self._largest, int(difference.max(initial=0)))
        if self._luminance is not None:
            luminance = self._luminance[original]
            error = np.abs(luminance - self._luminance[decoded])
            squares = error * error * self._weights
            self._surface += float(squares.sum())
            self._seen += float((squares * luminance).sum())
            self._light += float((luminance * self._weights).sum())
            self._largest_luminance = max(self._largest_luminance, float(error.max(initial=0)))

    def result(self, stored: int | None = None) -> Distortion:
        """Return the means so far; `stored` bytes give the ratio.

        Raises
        ------
        InputError
            If there was no texture.
        """
        if self._count == 0:
            raise InputError("distortion needs at least one texture, got none")
        size = self._texels**2
        d = self._squares / self._count
        rmse = math.sqrt(d / size)
        lit = self._luminance is not None
        return Distortion(
            d,
            rmse,
            20 * math.log10(255 / rmse) if rmse else math.inf,
            self._largest,
            math.sqrt(self._surface / self._count) if lit else None,
            (math.sqrt(self._seen / self._light) if self._light else 0.0) if lit else None,
            self._largest_luminance if lit else None,
            None if stored is None else self._count * size / max(stored, 1),
        )


def _measure(
    codes: Codes,
    decode: Callable[[slice], NDArray[np.uint8]],
    decoding: NDArray[np.float32] | None,
    mapping: Mapping,
    stored: int | None = None,
) -> Distortion:
    total = DistortionSum(int(codes.shape[1]), decoding, mapping)
    for part in parts(len(codes)):
        total.add(np.asarray(codes[part]), decode(part))
    return total.result(stored)
