"""The linear minimum-mean-square-error filter of textures (see ``light.denoise``), one texture at a time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels.jit import kernel

__all__ = ["Learned", "filter_textures"]

_ZERO, _ONE = np.float32(0), np.float32(1)
_TINY = np.float32(1e-12)


class Learned(NamedTuple):
    """What training taught; D texels, r directions."""

    mean: np.ndarray  # (D,) float32
    basis: np.ndarray  # (D, r) float32
    power: np.ndarray  # (r,) float32, the signal's variance along each direction
    rest: np.ndarray  # (D,) float32, the signal's variance that the directions leave out
    weights: np.ndarray  # (D,) float32, solid angles, mean 1
    noise: np.float32  # variance of one sample
    gain: np.float32  # noise of the samples as drawn over that of independent ones
    prior: np.float32  # texels that `noise` is worth beside a texture's own estimate


@kernel
def _invert(matrix, inverse, size):
    """Invert a symmetric positive definite matrix by Cholesky's L; `matrix` is overwritten."""
    for i in range(size):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = np.sqrt(max(total, _TINY)) if i == j else total / matrix[j, j]
    for column in range(size):
        for i in range(column, size):  # L y = e
            total = _ONE if i == column else _ZERO
            for k in range(column, i):
                total -= matrix[i, k] * inverse[k, column]
            inverse[i, column] = total / matrix[i, i]
    for column in range(size):
        for i in range(size - 1, -1, -1):  # Lᵀ x = y; only the lower part is needed
            total = inverse[i, column] if i >= column else _ZERO
            for k in range(i + 1, size):
                total -= matrix[k, i] * inverse[k, column]
            inverse[i, column] = total / matrix[i, i]


@kernel
def filter_textures(learned, mean, variance, exposed, filtered, predicted):
    """Filter textures (K, D); writes luminance (K, D) and the mean predicted error variance of exposed texels (K,).

    Texels with no exposed sample are predicted from the others, within the range of these.
    """
    texels, size = learned.basis.shape
    matrix, inner = np.zeros((size, size), np.float32), np.zeros((size, size), np.float32)
    inverse = np.zeros((size, size), np.float32)
    right, found = np.zeros(size, np.float32), np.zeros(size, np.float32)
    gains = np.zeros(texels, np.float32)
    for n in range(mean.shape[0]):
        total, known = learned.prior * learned.noise, learned.prior
        any_seen = False
        for t in range(texels):
            any_seen |= exposed[n, t] > 0
            if exposed[n, t] > 1:
                total += variance[n, t]
                known += _ONE
        if not any_seen:
            filtered[n] = _ZERO
            predicted[n] = _ZERO
            continue
        noise = max(learned.gain * total / known, _TINY)
        matrix[:] = _ZERO
        inner[:] = _ZERO
        right[:] = _ZERO
        area = left_out = _ZERO
        for t in range(texels):
            count = np.float32(exposed[n, t])
            gains[t] = _ZERO
            if count == 0:
                continue
            # What the directions cannot express counts as noise for them, and is kept texel by texel afterwards.
            spread = noise + count * learned.rest[t]
            gains[t] = count * learned.rest[t] / spread
            b = learned.basis[t]
            weight = count / spread
            loss = _ONE - gains[t]
            share = learned.weights[t] * loss * loss
            value = weight * (mean[n, t] - learned.mean[t])
            for i in range(size):
                right[i] += value * b[i]
                wb, sb = weight * b[i], share * b[i]
                for j in range(size):
                    matrix[i, j] += wb * b[j]
                    inner[i, j] += sb * b[j]
            area += learned.weights[t]
            left_out += learned.weights[t] * learned.rest[t] * loss
        for i in range(size):
            matrix[i, i] += _ONE / learned.power[i]
        _invert(matrix, inverse, size)
        error = left_out
        for i in range(size):
            value = _ZERO
            for j in range(size):
                value += inverse[i, j] * right[j]
                error += inverse[i, j] * inner[i, j]
            found[i] = value
        predicted[n] = error / area
        low, high = np.float32(3e38), _ZERO
        for t in range(texels):
            estimate = learned.mean[t]
            b = learned.basis[t]
            for i in range(size):
                estimate += b[i] * found[i]
            if exposed[n, t] > 0:
                estimate = max(_ZERO, estimate + gains[t] * (mean[n, t] - estimate))
                low, high = min(low, estimate), max(high, estimate)
            filtered[n, t] = estimate
        for t in range(texels):  # never beyond what was seen elsewhere on the same particle
            if exposed[n, t] == 0:
                filtered[n, t] = min(max(filtered[n, t], low), high)
