"""The linear minimum-mean-square-error filter of textures (see ``light.denoise``), one texture at a time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.memory import index
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
def _weighted_products(rows, known, weights, shares, size, matrix, inner):
    """Write Σ weight · b bᵀ over known texels, the lower part, into `matrix` with rows of WIDTH, and the same of their shares into `inner`.

    Few rows at a time stay in registers.
    """
    for i in range(0, min(size, LANES), 4):
        a, b, c, d = splat(_ZERO), splat(_ZERO), splat(_ZERO), splat(_ZERO)
        e, f, g, h = splat(_ZERO), splat(_ZERO), splat(_ZERO), splat(_ZERO)
        for n in range(known.shape[0]):
            t = index(known[n])
            o = t * WIDTH
            base = load(rows, o)
            low, part = splat(weights[t]) * base, splat(shares[t]) * base
            p, q, r, s = (
                splat(rows[o + i]),
                splat(rows[o + i + 1]),
                splat(rows[o + i + 2]),
                splat(rows[o + i + 3]),
            )
            a, b, c, d = fma(p, low, a), fma(q, low, b), fma(r, low, c), fma(s, low, d)
            e, f, g, h = fma(p, part, e), fma(q, part, f), fma(r, part, g), fma(s, part, h)
        _store_rows(matrix, i, a, b, c, d)
        _store_rows(inner, i, e, f, g, h)
    for i in range(LANES, size, 2):
        a, b, c, d = splat(_ZERO), splat(_ZERO), splat(_ZERO), splat(_ZERO)
        e, f, g, h = splat(_ZERO), splat(_ZERO), splat(_ZERO), splat(_ZERO)
        for n in range(known.shape[0]):
            t = index(known[n])
            o = t * WIDTH
            low, high = load(rows, o), load(rows, o + LANES)
            first, second = rows[o + i], rows[o + i + 1]
            p, q = splat(weights[t] * first), splat(weights[t] * second)
            r, s = splat(shares[t] * first), splat(shares[t] * second)
            a, b, c, d = fma(p, low, a), fma(p, high, b), fma(q, low, c), fma(q, high, d)
            e, f, g, h = fma(r, low, e), fma(r, high, f), fma(s, low, g), fma(s, high, h)
        _store_halves(matrix, i, a, b, c, d)
        _store_halves(inner, i, e, f, g, h)


@kernel(inline=True)
def _store_rows(matrix, i, a, b, c, d):
    """Write the first halves of four rows."""
    o = i * WIDTH
    store(matrix, o, a)
    store(matrix, o + WIDTH, b)
    store(matrix, o + 2 * WIDTH, c)
    store(matrix, o + 3 * WIDTH, d)


@kernel(inline=True)
def _store_halves(matrix, i, a, b, c, d):
    """Write both halves of two rows."""
    o = i * WIDTH
    store(matrix, o, a)
    store(matrix, o + LANES, b)
    store(matrix, o + WIDTH, c)
    store(matrix, o + WIDTH + LANES, d)


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
    listed = np.zeros(texels, np.int32)
    for n in range(mean.shape[0]):
        total, votes = learned.prior * learned.noise, learned.prior
        seen = 0
        for t in range(texels):
            listed[seen] = t
            seen += exposed[n, t] > 0
            if exposed[n, t] > 1:
                total += variance[n, t]
                votes += _ONE
        if seen == 0:
            filtered[n] = _ZERO
            predicted[n] = _ZERO
            continue
        noise = max(learned.gain * total / votes, _TINY)
        known = listed[:seen]
        right[:] = _ZERO
        area = left_out = _ZERO
        for k in range(seen):
            t = index(known[k])
            count = np.float32(exposed[n, t])
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
        _weighted_products(rows, known, weights, shares, size, matrix, inner)
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
def _fill(row, exposed, beside, ring, total, votes):
    """Give the texels (D,) of one texture that have no exposed sample the mean of their known neighbours, ring by ring.

    Each ring tells the next, so neighbours have to be mutual, as those of both mappings are.
    """
    texels = row.shape[0]
    last = 0
    for t in range(texels):
        known = exposed[t] > 0
        ring[last] = t
        last += known
        row[t] = row[t] if known else _ZERO
        total[t] = _ZERO
        votes[t] = -_ONE if known else _ZERO
    first = 0
    while first < last < texels:
        end = last
        for k in range(first, end):
            t = index(ring[k])
            for side in range(beside.shape[0]):
                u = index(beside[side, t])
                if votes[u] >= 0:
                    if votes[u] == 0:
                        ring[last] = u
                        last += 1
                    total[u] += row[t]
                    votes[u] += _ONE
        for k in range(end, last):
            t = index(ring[k])
            row[t] = total[t] / votes[t]
            votes[t] = -_ONE
        first = end


@kernel
def fill_unknown(values, exposed, beside):
    """Fill texels (K, D) in place that have no exposed sample from their neighbours, ring by ring.

    `beside` is (4, D) int32, see ``light.mapping.texel_neighbours``. Textures with no exposed texel become 0.
    """
    texels = values.shape[1]
    ring = np.zeros(texels, np.int32)
    total, votes = np.zeros(texels, np.float32), np.zeros(texels, np.float32)
    for n in range(values.shape[0]):
        _fill(values[n], exposed[n], beside, ring, total, votes)


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
