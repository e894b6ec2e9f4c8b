"""Filtering noisy textures where the light lives: a linear minimum-mean-square-error estimate in texture space.

Textures of one data set resemble each other. Their mean and covariance, learned from a training subset, tell which
differences between texels are light and which are noise (Wiener 1949; for textures: lighting patterns span few
dimensions, paper 3.3). Independent of the camera, so it cannot shimmer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from luxel.light.mapping import Mapping, texel_neighbours

__all__ = ["TextureFilter", "dilate"]

_BASIS_COUNT = 20
# Fewer textures than this teach nothing: samples are taken as they are, and gaps filled from their rims.
_LEAST_TEXTURES = 64
# A texture's own noise estimate is blended with the data set's, as if the latter came from this many texels.
_PRIOR_TEXELS = 32.0


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
    mapping
        Of the textures.
    """

    mean: NDArray[np.float64]
    basis: NDArray[np.float64]
    power: NDArray[np.float64]
    rest: NDArray[np.float64]
    noise: float
    mapping: Mapping

    @classmethod
    def learn(
        cls,
        mean: NDArray[np.float32],
        variance: NDArray[np.float32],
        exposed: NDArray[np.uint32],
        mapping: Mapping,
    ) -> TextureFilter:
        """Learn from (K, T, T) training textures; arguments as from ``kernels.path.sample_texels``.

        The noise of the training textures themselves is subtracted from their covariance.
        """
        count = len(mean)
        samples = dilate(mean, exposed > 0, mapping).reshape(count, -1).astype(np.float64)
        weight = exposed.reshape(count, -1).astype(np.float64)
        noise = float((variance.reshape(count, -1) * (weight > 1)).sum() / max(1.0, (weight > 1).sum()))
        center = samples.mean(axis=0)
        offset = samples - center
        covariance = offset.T @ offset / max(1, count - 1)
        texel_noise = (variance.reshape(count, -1) / np.maximum(weight, 1)).mean(axis=0)
        covariance[np.diag_indices_from(covariance)] -= texel_noise
        signal = covariance.diagonal().copy()
        power, vectors = np.linalg.eigh(covariance)
        keep = min(_BASIS_COUNT, len(power)) if count >= _LEAST_TEXTURES else 0
        power, vectors = power[::-1][:keep], vectors[:, ::-1][:, :keep]
        # A direction with less signal than the uncertainty of its own estimate would only add noise.
        floor = 1e-6 * max(float(signal.max()), 1e-12)
        power = np.maximum(power, floor)
        rest = np.maximum(signal - (vectors**2) @ power, floor)
        return cls(center, np.ascontiguousarray(vectors.T), power, rest, noise, mapping)

    def apply(
        self, mean: NDArray[np.float32], variance: NDArray[np.float32], exposed: NDArray[np.uint32]
    ) -> NDArray[np.float32]:
        """Return filtered (K, T, T) luminance; texels with no exposed sample are predicted from the others.

        Every texture is treated alone: what it becomes does not depend on its batch.
        """
        if len(self.power) == 0:
            return dilate(mean, exposed > 0, self.mapping)
        shape = mean.shape
        count, size = shape[0], shape[1] * shape[2]
        samples = mean.reshape(count, size).astype(np.float64)
        weight = exposed.reshape(count, size).astype(np.float64)
        spread = variance.reshape(count, size).astype(np.float64)
        known = weight > 1
        noise = (np.where(known, spread, 0.0).sum(axis=1) + _PRIOR_TEXELS * self.noise) / (
            known.sum(axis=1) + _PRIOR_TEXELS
        )
        noise = np.maximum(noise, 1e-12)[:, None]
        # What the basis cannot express counts as noise for its coefficients, and is kept texel by texel afterwards.
        gain = weight * self.rest / (noise + weight * self.rest)
        weight /= noise + weight * self.rest
        # Stacked products and solves run one texture at a time inside: the same bits whatever the batch.
        projected = self.basis[None] * weight[:, None, :]
        matrix = projected @ self.basis.T
        diagonal = np.arange(len(self.power))
        matrix[:, diagonal, diagonal] += 1.0 / self.power
        coefficients = np.linalg.solve(matrix, projected @ (samples - self.mean)[:, :, None])
        estimate = self.mean + (coefficients.swapaxes(1, 2) @ self.basis)[:, 0]
        estimate = np.maximum(estimate + gain * (samples - estimate), 0.0)
        seen = weight > 0
        # What no sample saw is predicted, but never beyond what was seen elsewhere on the same particle.
        low = np.where(seen, estimate, np.inf).min(axis=1, keepdims=True)
        high = np.where(seen, estimate, -np.inf).max(axis=1, keepdims=True)
        estimate = np.where(seen | (high < low), estimate, np.minimum(np.maximum(estimate, low), high))
        estimate[~seen.any(axis=1)] = 0.0
        return np.asarray(estimate.reshape(shape), dtype=np.float32)


def dilate(
    textures: NDArray[np.float32], known: NDArray[np.bool_], mapping: Mapping = "latlong"
) -> NDArray[np.float32]:
    """Fill unknown texels of (K, T, T) textures from their known neighbours, ring by ring.

    Textures with no known texel become 0.
    """
    filled = np.where(known, textures, np.float32(0)).astype(np.float32).reshape(len(textures), -1)
    have = known.reshape(filled.shape).copy()
    neighbours = texel_neighbours(mapping, textures.shape[2])
    while True:
        open_ones = ~have & have.any(axis=1, keepdims=True)
        if not open_ones.any():
            return filled.reshape(textures.shape)
        masked = np.where(have, filled, np.float32(0))
        total = np.zeros_like(filled)
        weight = np.zeros_like(filled)
        for beside in neighbours:
            total += masked[:, beside]
            weight += have[:, beside]
        grown = open_ones & (weight > 0)
        filled[grown] = total[grown] / weight[grown]
        have |= grown
