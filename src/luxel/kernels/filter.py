"""The linear minimum-mean-square-error filter of textures (see ``light.denoise``), one texture at a time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.simd import LANES, fma, fnma, load, splat, store

__all__ = ["WIDTH", "Learned", "error_variances", "fill_unknown", "filter_textures"]

#: Room for so many directions.
WIDTH = 2 * LANES

_ZERO, _ONE = np.float32(0), np.float32(1)
_TINY = np.float32(1e-12)


class Learned(NamedTuple):
    """What training taught; D texels, r directions."""

    mean: np.ndarray  # (D,) float32
    rows: np.ndarray  # (D * 32,) float32: the r directions at each texel, then zeros
    columns: (
        np.ndarray
    )  # (r, E) float32: each direction's texels; E is D rounded up to whole blocks of sixteen
    power: np.ndarray  # (r,) float32, the signal's variance along each direction
    rest: np.ndarray  # (D,) float32, the signal's variance that the directions leave out
    weights: np.ndarray  # (D,) float32, solid angles, mean 1
    noise: np.float32  # variance of one sample
    gain: np.float32  # noise of the samples as drawn over that of independent ones
    prior: np.float32  # texels that `noise` is worth beside a texture's own estimate


@kernel(inline=True)
def _subtract_row(matrix, i, factor, k):
    """Row i minus factor times row k."""
    a, b = i * WIDTH, k * WIDTH
    scale = splat(factor)
    store(matrix, a, fnma(scale, load(matrix, b), load(matrix, a)))
    store(matrix, a + LANES, fnma(scale, load(matrix, b + LANES), load(matrix, a + LANES)))


@kernel(inline=True)
def _scale_row(matrix, i, factor):
    o = i * WIDTH
    store(matrix, o, splat(factor) * load(matrix, o))
    store(matrix, o + LANES, splat(factor) * load(matrix, o + LANES))


@kernel(borrows=True)
def _factorise(matrix, size):
    """Cholesky's U with Uᵀ U = matrix, in place above the diagonal; what is below it is lost."""
    for k in range(size):
        _scale_row(matrix, k, _ONE / np.sqrt(max(matrix[k * WIDTH + k], _TINY)))
        for i in range(k + 1, size):
            _subtract_row(matrix, i, matrix[k * WIDTH + i], k)


@kernel(borrows=True)
def _substitute(upper, right, size):
    """Solve Uᵀ X = right for all columns at once, in place."""
    for i in range(size):
        for k in range(i):
            _subtract_row(right, i, upper[k * WIDTH + i], k)
        _scale_row(right, i, _ONE / upper[i * WIDTH + i])


@kernel(borrows=True)
def _complete(matrix, size):
    """Copy the block that `_weighted_products` leaves out from its mirror image."""
    for i in range(min(size, LANES)):
        for j in range(LANES, WIDTH):
            matrix[i * WIDTH + j] = matrix[j * WIDTH + i]


@kernel(borrows=True)
def _weighted_products(rows, weights, size, matrix):
    """Write Σ weight · b bᵀ over texels, the lower part, into a matrix with rows of WIDTH; few rows at a time stay in registers."""
    texels = weights.shape[0]
    for i in range(0, min(size, LANES), 4):
        a, b, c, d = splat(_ZERO), splat(_ZERO), splat(_ZERO), splat(_ZERO)
        for t in range(texels):
            o = t * WIDTH
            low = splat(weights[t]) * load(rows, o)
            a, b = fma(splat(rows[o + i]), low, a), fma(splat(rows[o + i + 1]), low, b)
            c, d = fma(splat(rows[o + i + 2]), low, c), fma(splat(rows[o + i + 3]), low, d)
        store(matrix, i * WIDTH, a)
        store(matrix, (i + 1) * WIDTH, b)
        store(matrix, (i + 2) * WIDTH, c)
        store(matrix, (i + 3) * WIDTH, d)
    for i in range(LANES, size, 2):
        a, b, c, d = splat(_ZERO), splat(_ZERO), splat(_ZERO), splat(_ZERO)
        for t in range(texels):
            o = t * WIDTH
            low, high = load(rows, o), load(rows, o + LANES)
            first, second = splat(weights[t] * rows[o + i]), splat(weights[t] * rows[o + i + 1])
            a, b = fma(first, low, a), fma(first, high, b)
            c, d = fma(second, low, c), fma(second, high, d)
        store(matrix, i * WIDTH, a)
        store(matrix, i * WIDTH + LANES, b)
        store(matrix, (i + 1) * WIDTH, c)
        store(matrix, (i + 1) * WIDTH + LANES, d)


@kernel
def filter_textures(learned, mean, variance, exposed, filtered, predicted):
    """Filter textures (K, D); writes luminance (K, D) and the mean predicted error variance of exposed texels (K,).

    Texels with no exposed sample are predicted from the others, within the range of these.
    """
    texels, size = learned.mean.shape[0], learned.columns.shape[0]
    rows, columns = learned.rows, learned.columns
    matrix, inner = np.zeros(WIDTH * WIDTH, np.float32), np.zeros(WIDTH * WIDTH, np.float32)
    half = np.zeros(WIDTH * WIDTH, np.float32)  # of the inverse: halfᵀ half
    right, found = np.zeros(WIDTH, np.float32), np.zeros(WIDTH, np.float32)
    weights, shares = np.zeros(texels, np.float32), np.zeros(texels, np.float32)
    gains, smooth = np.zeros(texels, np.float32), np.zeros(columns.shape[1], np.float32)
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
        right[:] = _ZERO
        weights[:] = _ZERO
        shares[:] = _ZERO
        area = left_out = _ZERO
        for t in range(texels):
            count = np.float32(exposed[n, t])
            gains[t] = _ZERO
            if count == 0:
                continue
            # What the directions cannot express counts as noise for them, and is kept texel by texel afterwards.
            spread = noise + count * learned.rest[t]
            gains[t] = count * learned.rest[t] / spread
            weight = count / spread
            loss = _ONE - gains[t]
            value = splat(weight * (mean[n, t] - learned.mean[t]))
            for c in range(0, WIDTH, LANES):
                store(right, c, fma(value, load(rows, t * WIDTH + c), load(right, c)))
            weights[t], shares[t] = weight, learned.weights[t] * loss * loss
            area += learned.weights[t]
            left_out += learned.weights[t] * learned.rest[t] * loss
        _weighted_products(rows, weights, size, matrix)
        _weighted_products(rows, shares, size, inner)
        _complete(matrix, size)
        _complete(inner, size)
        half[:] = _ZERO
        for i in range(size):
            matrix[i * WIDTH + i] += _ONE / learned.power[i]
            half[i * WIDTH + i] = _ONE
        _factorise(matrix, size)
        _substitute(matrix, half, size)
        _substitute(matrix, inner, size)
        found[:] = _ZERO
        error = left_out
        for i in range(size):
            value = _ZERO
            for j in range(size):
                value += half[i * WIDTH + j] * right[j]
                error += half[i * WIDTH + j] * inner[i * WIDTH + j]
            for j in range(size):
                found[j] += half[i * WIDTH + j] * value
        predicted[n] = error / area
        for c in range(0, columns.shape[1], LANES):
            estimates = splat(_ZERO)
            for i in range(size):
                estimates = fma(splat(found[i]), load(columns[i], c), estimates)
            store(smooth, c, estimates)
        low, high = np.float32(3e38), _ZERO
        for t in range(texels):
            estimate = learned.mean[t] + smooth[t]
            if exposed[n, t] > 0:
                estimate = max(_ZERO, estimate + gains[t] * (mean[n, t] - estimate))
                low, high = min(low, estimate), max(high, estimate)
            filtered[n, t] = estimate
        for t in range(texels):  # never beyond what was seen elsewhere on the same particle
            if exposed[n, t] == 0:
                filtered[n, t] = min(max(filtered[n, t], low), high)


@kernel(inline=True, borrows=True)
def _fill(row, have, beside, ring):
    """Give the texels (D,) of one texture that are not known the mean of their known neighbours, ring by ring."""
    texels = row.shape[0]
    left = 0
    for t in range(texels):
        if not have[t]:
            row[t] = _ZERO
            left += 1
    while 0 < left < texels:
        found = 0
        for t in range(texels):
            if have[t]:
                continue
            total, count = _ZERO, _ZERO
            for k in range(beside.shape[0]):
                if have[beside[k, t]]:
                    total += row[beside[k, t]]
                    count += _ONE
            if count > 0:
                row[t] = total / count
                ring[found] = t
                found += 1
        for k in range(found):
            have[ring[k]] = True
        left -= found


@kernel
def fill_unknown(values, exposed, beside):
    """Fill texels (K, D) in place that have no exposed sample from their neighbours, ring by ring.

    `beside` is (4, D) int32, see ``light.mapping.texel_neighbours``. Textures with no exposed texel become 0.
    """
    texels = values.shape[1]
    ring, have = np.zeros(texels, np.int32), np.zeros(texels, np.bool_)
    for n in range(values.shape[0]):
        for t in range(texels):
            have[t] = exposed[n, t] > 0
        _fill(values[n], have, beside, ring)


@kernel
def error_variances(variance, exposed, areas, found):
    """Write the error variance (K,) of plain means of samples (K, D): the mean over texels (D,) of such areas, those of several exposed samples."""
    for n in range(variance.shape[0]):
        total = area = 0.0
        for t in range(areas.shape[0]):
            if exposed[n, t] > 1:
                total += areas[t] * variance[n, t] / exposed[n, t]
                area += areas[t]
        found[n] = total / max(area, 1e-9)
