"""Filtering noisy textures where the light lives: a linear minimum-mean-square-error estimate in texture space.

Textures of one data set resemble each other. Their mean and covariance, learned from a training subset, tell which
differences between texels are light and which are noise (Wiener 1949; for textures: lighting patterns span few
dimensions, paper 3.3). Independent of the camera, so it cannot shimmer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxel.kernels.filter import (
    WIDTH,
    Learned,
    error_variances,
    fill_unknown,
    filter_textures,
)
from luxel.kernels.simd import LANES
from luxel.light.mapping import Mapping, texel_neighbours, texel_solid_angles
from luxel.light.poles import polar_rows, smooth_poles
from luxel.light.sampling import Drawn, Samples

__all__ = ["TextureFilter", "dilate", "standard_error"]

# Directions of the covariance that are kept: more only pay with more samples.
_FEW_BASIS, _MORE_BASIS = 20, 32
# Fewer textures than this teach nothing: samples are taken as they are, and gaps filled from their rims.
_LEAST_TEXTURES = 64
# A texture's own noise estimate is blended with the data set's, as if the latter came from this many texels.
_PRIOR_TEXELS = 32.0
# Predicted errors are corrected bin by bin; a bin has at least so many training textures.
_BIN_TEXTURES = 64
# Rows near poles of which a smaller share has been sampled are not smoothed: what others tell would tell on them.
_SEEN = 0.75

Float = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class TextureFilter:
    """Mean, principal directions and noise of the textures of one data set.

    Parameters
    ----------
    mean
        (D,) float64, D texels.
    basis
        (r, D) float64, orthonormal rows.
    power
        (r,) float64, the signal's variance along each row.
    rest
        (D,) float64, the signal's variance in each texel that the basis leaves out.
    noise
        Variance of one sample, averaged over the training set.
    gain
        Noise of the samples as drawn, together, over that of as many independent ones: below 1 for ray sets.
    sun_gain
        As `gain`, for sunlight, which is not filtered but at the poles.
    bins, factors
        (b,) predicted error variances and what to multiply them by, learned from the training set.
    weights
        (D,) solid angles of the texels, mean 1.
    mapping
        Of the textures.
    smoothed
        Rows near the poles that err less when they are smoothed along themselves, see ``light.poles``.
    """

    mean: Float
    basis: Float
    power: Float
    rest: Float
    noise: float
    gain: float
    sun_gain: float
    bins: Float
    factors: Float
    weights: Float
    mapping: Mapping
    smoothed: NDArray[np.int32]

    @classmethod
    def learn(cls, first: Drawn, second: Drawn, drawn: Drawn, mapping: Mapping) -> TextureFilter:
        """Learn from three independent samplings of the same training textures.

        `first` and `second` are sampled well: products of the two are free of noise bias, whatever the noise is like
        (Lehtinen et al. 2018, "Noise2Noise", use the same fact). `drawn` is sampled as textures to be filtered will be.
        """
        rest = drawn.rest
        count, texels = len(rest.mean), rest.mean.shape[1]
        a, b = (_dilated(d.rest, mapping) for d in (first, second))
        center = 0.5 * (a + b).mean(axis=0)
        covariance = (a - center).T @ (b - center) / max(1, count - 1)
        covariance = 0.5 * (covariance + covariance.T)
        signal = np.maximum(covariance.diagonal(), 0.0)
        power, vectors = np.linalg.eigh(covariance)
        least = float(np.median(rest.exposed[rest.exposed > 0])) if rest.exposed.any() else 1.0
        keep = min(_FEW_BASIS if least < 4 else _MORE_BASIS, len(power)) if count >= _LEAST_TEXTURES else 0
        power, vectors = power[::-1][:keep], vectors[:, ::-1][:, :keep]
        # A direction with less signal than the uncertainty of its own estimate would only add noise.
        floor = 1e-6 * max(float(signal.max()), 1e-12)
        power = np.maximum(power, floor)
        left = np.maximum(signal - (vectors**2) @ power, floor)
        spread, weight = (_flat(x) for x in (first.rest.variance, first.rest.exposed))
        noise = float((spread * (weight > 1)).sum() / max(1.0, (weight > 1).sum()))
        gain = _noise_gain(rest, a, b, np.full_like(a, noise))
        sun_gain = 1.0
        if first.sun is not None and second.sun is not None and drawn.sun is not None:
            sun_a, sun_b = (_dilated(s, mapping) for s in (first.sun, second.sun))
            sun_gain = _noise_gain(drawn.sun, sun_a, sun_b, _flat(drawn.sun.variance))
            a, b = a + sun_a, b + sun_b
        angles = texel_solid_angles(mapping, texels).ravel()
        raw = cls(
            center, np.ascontiguousarray(vectors.T), power, left, noise, gain, sun_gain, np.ones(1),
            np.ones(1), angles / angles.mean(), mapping, np.empty(0, np.int32),
        )  # fmt: skip
        if not keep:
            return raw
        open_ = _flat(first.rest.exposed) > 0
        steady = replace(raw, smoothed=raw._better_smooth(a, b, drawn, open_))
        return steady._calibrated(a, b, drawn, open_)

    def _better_smooth(self, a: Float, b: Float, drawn: Drawn, open_: NDArray[np.bool_]) -> NDArray[np.int32]:
        """Return the rows near poles that err less on the training set, over texels in the `open_`, when they are smoothed."""
        plain, _ = self.apply(drawn)
        smooth, rows = plain.copy(), polar_rows(self.mapping, plain.shape[1])
        smooth_poles(smooth, rows, drawn.rest.exposed)

        def error(textures: NDArray[np.float32]) -> Float:
            flat = textures.reshape(a.shape).astype(np.float64)
            products = ((flat - a) * (flat - b) * open_).sum(axis=0)
            return np.asarray(products.reshape(plain.shape[1:]).sum(axis=1)[rows])

        return rows[error(smooth) < error(plain)]

    def _calibrated(self, a: Float, b: Float, drawn: Drawn, open_: NDArray[np.bool_]) -> TextureFilter:
        """Compare predicted errors with those found on the training set, over texels in the `open_`, be they sampled or not."""
        found, predicted = self.apply(drawn)
        estimate = found.reshape(a.shape).astype(np.float64)
        weights = self.weights * open_
        total = np.maximum(weights.sum(axis=1), 1e-9)
        actual = ((estimate - a) * (estimate - b) * weights).sum(axis=1) / total
        variance = predicted.astype(np.float64) ** 2
        order = np.argsort(variance, kind="stable")
        parts = np.array_split(order, max(1, len(order) // _BIN_TEXTURES))
        bins = np.array([variance[p].mean() for p in parts])
        factors = np.array([actual[p].mean() for p in parts]) / np.maximum(bins, 1e-20)
        return replace(self, bins=bins, factors=np.clip(factors, 0.02, 50.0))

    def apply(self, drawn: Drawn, partly: bool = False) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return filtered (K, T, T) luminance and (K,) the standard error expected of an exposed texel.

        Texels with no exposed sample are predicted from the others; rows near the poles may be smoothed, where textures are sampled `partly`
        only such as are. Every texture is treated alone: what it becomes does not depend on its batch.
        """
        found, variance = self._filtered(drawn.rest)
        if drawn.sun is not None:
            sun = _rows(drawn.sun)
            plain = sun.mean.copy()
            fill_unknown(plain, sun.exposed, self._beside)
            found += plain
            variance += np.float32(self.sun_gain) * _error_variance(sun, self.weights)
        luminance = found.reshape(drawn.rest.mean.shape)
        seen = (drawn.rest if drawn.sun is None else drawn.sun).exposed
        smooth_poles(luminance, self.smoothed, seen, _SEEN if partly else 0.0)
        if len(self.power) == 0:
            return luminance, np.sqrt(variance)
        variance = np.maximum(variance, 1e-20)
        factors = np.interp(np.log(variance), self._log_bins, self.factors)
        return luminance, np.asarray(np.sqrt(variance * factors), dtype=np.float32)

    def _filtered(self, samples: Samples) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        rows = _rows(samples)
        if len(self.power) == 0:
            plain = rows.mean.copy()
            fill_unknown(plain, rows.exposed, self._beside)
            return plain, _error_variance(rows, self.weights)
        found, variance = np.empty_like(rows.mean), np.empty(len(rows.mean), np.float32)
        filter_textures(self._packed, *rows, found, variance)
        return found, variance

    @cached_property
    def _beside(self) -> NDArray[np.int32]:
        return texel_neighbours(self.mapping, math.isqrt(len(self.mean)))

    @cached_property
    def _log_bins(self) -> Float:
        return np.log(np.maximum(self.bins, 1e-20))

    @cached_property
    def _packed(self) -> Learned:
        def single(values: Float) -> NDArray[np.float32]:
            return np.ascontiguousarray(values, dtype=np.float32)

        count, texels = self.basis.shape
        rows = np.zeros((texels, WIDTH))
        rows[:, :count] = self.basis.T
        columns = np.zeros((count, -(-texels // LANES) * LANES))
        columns[:, :texels] = self.basis
        return Learned(
            single(self.mean), single(rows.ravel()), single(columns), single(self.power), single(self.rest),
            single(self.weights), np.float32(self.noise), np.float32(self.gain), np.float32(_PRIOR_TEXELS),
        )  # fmt: skip


def _flat(textures: NDArray[Any]) -> Float:
    return textures.reshape(len(textures), -1).astype(np.float64)


def _dilated(samples: Samples, mapping: Mapping) -> Float:
    return _flat(dilate(samples.mean, samples.exposed, mapping))


def _noise_gain(samples: Samples, a: Float, b: Float, variance: Float) -> float:
    """Noise of samples against two independent estimates, over that of as many independent samples of that variance."""
    mean, count = _flat(samples.mean), _flat(samples.exposed)
    seen = count > 0
    expected = float((variance * seen / np.maximum(count, 1)).sum())
    if expected <= 0:
        return 1.0
    return float(np.clip(((mean - a) * (mean - b) * seen).sum() / expected, 0.02, 1.5))


def standard_error(samples: Samples, mapping: Mapping) -> NDArray[np.float32]:
    """Return (K,) the standard error of an exposed texel's plain mean, root mean square over the sphere."""
    areas = texel_solid_angles(mapping, samples.mean.shape[1]).ravel()
    return np.sqrt(_error_variance(_rows(samples), areas))


def dilate(
    textures: NDArray[np.float32], exposed: NDArray[np.uint32], mapping: Mapping = "latlong"
) -> NDArray[np.float32]:
    """Return (K, T, T) textures with what has no exposed sample filled in from the texels around, ring by ring.

    Textures with no exposed texel become 0.
    """
    filled = np.array(textures, np.float32)
    flat = filled.reshape(len(filled), -1)
    fill_unknown(flat, exposed.reshape(flat.shape), texel_neighbours(mapping, textures.shape[1]))
    return filled


def _error_variance(rows: Samples, areas: Float) -> NDArray[np.float32]:
    found = np.empty(len(rows.mean), np.float32)
    error_variances(rows.variance, rows.exposed, areas, found)
    return found


def _rows(samples: Samples) -> Samples:
    """Return samples as (K, D) arrays."""

    def flat(values: NDArray[Any]) -> NDArray[Any]:
        return np.ascontiguousarray(values).reshape(len(values), values.shape[1] * values.shape[2])

    return Samples(*map(flat, samples))
