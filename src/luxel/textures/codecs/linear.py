"""Codecs that store one 8-bit coefficient for every vector of one basis: principal components and spherical harmonics.

All shared numbers are whole multiples of a power of two, so small that sums of products are exact in float32 (decoding) and
float64 (encoding): neither the batch nor the order of additions changes a bit.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from luxel.errors import InputError
from luxel.kernels.lookup import LinearTexels, linear_rows, readable
from luxel.light.mapping import Mapping, texel_directions, texel_solid_angles
from luxel.textures.codecs.moments import Moments
from luxel.textures.codecs.protocol import (
    Codes,
    Progress,
    as_codes,
    as_payload,
    one_target,
    parts,
    setting,
    shared_array,
    shared_size,
)

__all__ = ["LinearCodec", "PCACodec", "SHCodec"]

_MIDDLE = 128
_GRID = 2.0**24  # of what textures are projected on


@dataclass(frozen=True, eq=False)
class LinearCodec:
    """Code = (offset + basis · (coefficient − 128)) / 2^shift, rounded; see :class:`luxel.textures.codecs.Codec`.

    Parameters
    ----------
    offset
        (T²,) int32.
    basis
        (T², n) int16, one step of every coefficient.
    shift
        Binary digits after the point in both.
    """

    offset: NDArray[np.int32] = field(repr=False)
    basis: NDArray[np.int16] = field(repr=False)
    shift: int
    kind = "linear"

    @classmethod
    def of(cls, mean: NDArray[np.float64], basis: NDArray[np.float64], low: Any, high: Any) -> Self:
        """Make a codec of a mean (D,) and a basis (D, n) whose coefficients lie in `low`..`high` (n,)."""
        step = np.maximum((np.asarray(high) - low) / 255, 1e-6)
        middle = low + step * _MIDDLE
        steps = basis * step
        shift = fraction_bits(math.isqrt(len(mean)))
        while np.abs(steps).max(initial=0) * 2**shift > 32_767:
            shift -= 1
        offset = (mean + basis @ middle) * 2**shift
        return cls(np.rint(offset).astype(np.int32), np.rint(steps * 2**shift).astype(np.int16), shift)

    @classmethod
    def restore(cls, description: dict[str, Any], shared: dict[str, NDArray[Any]]) -> Self:
        """Rebuild from what :meth:`describe` and :attr:`shared` gave."""
        texels = setting(description, "texels", 1, 64)
        count = setting(description, "components", 1, texels**2)
        return cls(
            shared_array(shared, "offset", np.int32, (texels**2,)),
            shared_array(shared, "basis", np.int16, (texels**2, count)),
            setting(description, "shift", 0, 16),
        )

    @property
    def texels(self) -> int:
        """Rows and columns of a texture."""
        return math.isqrt(len(self.offset))

    @property
    def components(self) -> int:
        """Coefficients a texture."""
        return int(self.basis.shape[1])

    @property
    def payload_bytes(self) -> int:
        """Bytes a texture: one a coefficient."""
        return self.components

    @property
    def shared(self) -> dict[str, NDArray[Any]]:
        """Offset and basis."""
        return {"offset": self.offset, "basis": self.basis}

    @property
    def shared_bytes(self) -> int:
        """Bytes of offset and basis."""
        return shared_size(self.shared)

    def describe(self) -> dict[str, Any]:
        """Settings fit for JSON."""
        return {
            "kind": self.kind,
            "texels": self.texels,
            "components": self.components,
            "shift": self.shift,
        }

    def encode(self, codes: Codes) -> NDArray[np.uint8]:
        """Turn (K, T, T) codes into coefficients (K, n)."""
        codes = as_codes(codes, self.texels)
        out = np.empty((len(codes), self.components), np.uint8)
        onto, less = self._projector
        for part in parts(len(codes)):
            flat = np.asarray(codes[part]).reshape(part.stop - part.start, -1)
            steps = (flat.astype(np.float64) @ onto - less) / _GRID
            out[part] = np.clip(np.rint(steps) + _MIDDLE, 0, 255)
        return out

    def decode(self, payload: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Turn coefficients (K, n) into codes (K, T, T)."""
        payload = as_payload(payload, self.components)
        out = np.empty((len(payload), self.texels, self.texels), np.uint8)
        basis = self.basis.T.astype(np.float32)
        # The half that rounds is in the offset.
        offset, unit = (self.offset + self._half).astype(np.float32), np.float32(2.0**-self.shift)
        for part in parts(len(payload)):
            steps = payload[part].astype(np.float32) - np.float32(_MIDDLE)
            value = np.floor((steps @ basis + offset) * unit)
            out[part] = np.clip(value, 0, 255).reshape(-1, self.texels, self.texels)
        return out

    def lookup(self, payload: NDArray[np.uint8]) -> LinearTexels:
        """Return what kernels read texels from; the half that rounds is in the offset."""
        records = readable(as_payload(payload, self.components))
        return LinearTexels(records, self._rows, np.int32(self.shift), self.texels)

    @cached_property
    def _rows(self) -> NDArray[np.int16]:
        """What kernels multiply coefficients by."""
        return linear_rows(self.basis, self.offset + self._half)

    @property
    def _half(self) -> int:
        return (1 << self.shift) >> 1

    @cached_property
    def _projector(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """What a row of codes is multiplied by, (D, n), and what is subtracted, (n,): in 2^-24 steps."""
        onto = np.rint(self._dual() * _GRID)
        return onto, (self.offset / 2.0**self.shift) @ onto

    def _dual(self) -> NDArray[np.float64]:
        """Least squares: what gives the coefficients of a texture, in steps, (D, n)."""
        return np.asarray(np.linalg.pinv(self.basis / 2.0**self.shift).T, np.float64)


class PCACodec(LinearCodec):
    """Principal components (paper 3.3): mean, the leading eigenvectors of the covariance, a coefficient for each."""

    kind = "pca"

    @classmethod
    def train(
        cls,
        codes: Codes | Iterable[NDArray[np.uint8]],
        components: int | None = None,
        ratio: float | None = None,
        error: float | None = None,
        progress: Progress | None = None,
    ) -> PCACodec:
        """Find the basis of `codes`, in one pass and a few hundred KiB, to exactly one of three targets.

        Parameters
        ----------
        codes
            (N, T, T) uint8, or blocks of it.
        components
            Vectors to keep.
        ratio
            Raw bytes over all bytes stored.
        error
            Root mean squared error, in codes.
        progress
            Called as ``progress(done, total)`` in textures; total is 0 where it is not known.

        Raises
        ------
        InputError
            For no target or several, or a ratio that cannot be reached.
        """
        target = one_target(components=components, ratio=ratio, error=error)
        moments = Moments()
        moments.add(codes, progress)
        return cls.from_moments(moments, *target)

    @classmethod
    def from_moments(cls, moments: Moments, target: str, value: float) -> PCACodec:
        """Make a codec of what was seen so far; `target` is ``"components"``, ``"ratio"`` or ``"error"``."""
        mean, eigenvalues, axes = moments.principal()
        size = len(mean)
        coefficients = (moments.sample - mean) @ axes
        low, high = coefficients.min(axis=0), coefficients.max(axis=0)
        slack = 0.05 * (high - low)  # the sample may have missed a little
        low, high = low - slack, high + slack
        if target == "ratio":
            fixed, each = 4 * size, 2 * size + moments.count
            count = int((moments.count * size / value - fixed) // each)
            if count < 1:
                raise InputError(
                    f"ratio {value:g} cannot be reached: one component of {moments.count} textures takes "
                    f"{fixed + each} bytes of {moments.count * size}"
                )
        elif target == "error":
            rounding = np.concatenate([[0], np.cumsum(((high - low) / 255) ** 2 / 12)])
            dropped = np.concatenate([np.cumsum(eigenvalues[::-1])[::-1], [0]])
            enough = (dropped + rounding) / size <= value**2
            if not enough.any():
                raise InputError(
                    f"error {value:g} cannot be reached with 8-bit coefficients; "
                    f"the least is {math.sqrt((dropped + rounding).min() / size):.3g}"
                )
            count = max(1, int(np.argmax(enough)))
        else:
            count = int(value)
        count = min(count, size)
        return cls.of(mean, axes[:, :count], low[:count], high[:count])


@dataclass(frozen=True, eq=False)
class SHCodec(LinearCodec):
    """Real spherical harmonics up to a degree (Ramamoorthi and Hanrahan 2001), for comparison.

    Parameters
    ----------
    offset, basis, shift
        See :class:`LinearCodec`; harmonics at the texels' centres.
    mapping
        From texels to directions.
    """

    mapping: Mapping = "latlong"
    kind = "sh"

    @classmethod
    def train(
        cls,
        codes: Codes | Iterable[NDArray[np.uint8]],
        degree: int | None = None,
        ratio: float | None = None,
        *,
        mapping: Mapping = "latlong",
        progress: Progress | None = None,
    ) -> SHCodec:
        """Find the ranges of coefficients; exactly one of `degree` and `ratio` (raw bytes over all bytes stored)."""
        target, value = one_target(degree=degree, ratio=ratio)
        moments = Moments()
        moments.add(codes, progress)
        mean = moments.principal()[0]
        size, texels = len(mean), math.isqrt(len(mean))
        if target == "ratio":
            room = (moments.count * size / value - 4 * size) / (2 * size + moments.count)
            if room < 1:
                raise InputError(
                    f"ratio {value:g} cannot be reached with {moments.count} textures; try a lower one"
                )
            value = math.isqrt(int(room)) - 1
        if not 0 <= value < texels:
            raise InputError(f"degree must be 0..{texels - 1} for {texels} x {texels} texels, got {value:g}")
        harmonics = real_harmonics(
            texel_directions(mapping, texels).reshape(-1, 3).astype(np.float64), int(value)
        )
        weights = _weights(texels, mapping)
        onto = np.linalg.pinv(harmonics * weights).T * weights
        coefficients = (moments.sample - mean) @ onto
        made = cls.of(mean, harmonics, 1.05 * coefficients.min(axis=0), 1.05 * coefficients.max(axis=0))
        return cls(made.offset, made.basis, made.shift, mapping)

    @classmethod
    def restore(cls, description: dict[str, Any], shared: dict[str, NDArray[Any]]) -> SHCodec:
        """Rebuild from what :meth:`describe` and :attr:`shared` gave."""
        made = super().restore(description, shared)
        mapping = description.get("mapping")
        if mapping not in ("latlong", "octahedral"):
            raise InputError(f"the codec's mapping must be latlong or octahedral, got {mapping!r}")
        return cls(made.offset, made.basis, made.shift, mapping)

    def describe(self) -> dict[str, Any]:
        """Settings fit for JSON."""
        return {**super().describe(), "mapping": self.mapping}

    def _dual(self) -> NDArray[np.float64]:
        """Projection on the sphere: least squares weighted by solid angle."""
        weights = _weights(self.texels, self.mapping)
        return np.linalg.pinv(self.basis / 2.0**self.shift * weights).T * weights


def _weights(texels: int, mapping: Mapping) -> NDArray[np.float64]:
    return np.sqrt(texel_solid_angles(mapping, texels).reshape(-1, 1).astype(np.float64))


def fraction_bits(texels: int) -> int:
    """Binary digits after the point that leave sums of a texture's size exact in float32."""
    return 23 - math.ceil(math.log2(255 * texels))


def real_harmonics(directions: NDArray[np.float64], degree: int) -> NDArray[np.float64]:
    """Real orthonormal spherical harmonics of unit vectors (n, 3), (n, (degree + 1)²), by degree, then order."""
    x, y, z = directions.T
    out = np.empty((len(directions), (degree + 1) ** 2))
    # (x + iy)^m carries sin^m θ, so that the Legendre recurrence needs no division by it.
    real, imaginary = np.ones_like(x), np.zeros_like(x)
    diagonal = np.full_like(x, math.sqrt(1 / (4 * math.pi)))
    for m in range(degree + 1):
        below, here = np.zeros_like(x), diagonal
        for k in range(m, degree + 1):
            if k > m:
                a = math.sqrt((4 * k * k - 1) / (k * k - m * m))
                b = math.sqrt(((k - 1) ** 2 - m * m) / (4 * (k - 1) ** 2 - 1))
                below, here = here, a * (z * here - b * below)
            if m == 0:
                out[:, k * k + k] = here
            else:
                out[:, k * k + k + m] = math.sqrt(2) * here * real
                out[:, k * k + k - m] = math.sqrt(2) * here * imaginary
        real, imaginary = x * real - y * imaginary, x * imaginary + y * real
        diagonal = diagonal * math.sqrt((2 * m + 3) / (2 * m + 2))
    return out
