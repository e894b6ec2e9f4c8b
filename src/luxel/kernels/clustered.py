"""Clustered principal components: coding a texture with the cluster that fits it best."""

from __future__ import annotations

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.lookup import read_codes

__all__ = ["encode_clustered", "nearest_level", "read_codes"]

_ZERO = np.float32(0)
_FAR = np.float32(3e38)


@kernel(inline=True)
def nearest_level(levels, count, value):
    """Index of the nearest of `count` rising levels."""
    low, high = 0, count - 1
    while low < high:
        middle = (low + high) >> 1
        if value > np.float32(0.5) * (levels[middle] + levels[middle + 1]):
            low = middle + 1
        else:
            high = middle
    return low


@kernel
def encode_clustered(
    codes, center, rows, gain, scale, width, count, levels, unit, lead, tries, records, errors, values
):
    """Write records (n, B) of rows of codes (n, D), squared errors (n,), and the coefficients found (n, most).

    Coefficients are found one after the other in what the earlier ones, as quantised, have left: so the basis need not
    be quite orthonormal.

    Parameters
    ----------
    center
        (K, D) float32, in codes.
    rows
        (K, most, D) float32 basis.
    gain
        (K, most) float32: from a dot product with a row to normalised coefficients.
    scale, width, count, levels, unit, lead
        See ``lookup.ClusteredTexels``.
    tries
        How many of the nearest clusters are tried.
    """
    clusters, size = center.shape
    distance = np.empty(clusters, np.float32)
    rest = np.empty(size, np.float32)
    most = rows.shape[1]
    chosen, symbols, found = np.zeros(most, np.int64), np.zeros(most, np.int64), np.zeros(most, np.float32)
    for n in range(len(codes)):
        for k in range(clusters):
            total = _ZERO
            for t in range(size):
                d = np.float32(codes[n, t]) - center[k, t]
                total += d * d
            distance[k] = total
        best, cluster = _FAR, 0
        for _ in range(min(tries, clusters)):
            k, nearest = 0, _FAR
            for j in range(clusters):
                if distance[j] < nearest:
                    k, nearest = j, distance[j]
            distance[k] = _FAR
            for t in range(size):
                rest[t] = np.float32(codes[n, t]) - center[k, t]
            for i in range(count[k]):
                dot = _ZERO
                for t in range(size):
                    dot += rest[t] * rows[k, i, t]
                found[i] = dot * gain[k, i]
                symbols[i] = nearest_level(levels[width[k, i]], 1 << width[k, i], found[i])
                step = np.rint(scale[k, i] * levels[width[k, i], symbols[i]]) * unit
                for t in range(size):
                    rest[t] -= step * rows[k, i, t]
            error = _ZERO
            for t in range(size):
                error += rest[t] * rest[t]
            if error < best:
                best, cluster = error, k
                for i in range(count[k]):
                    chosen[i] = symbols[i]
                    values[n, i] = found[i]
        errors[n] = best
        records[n] = 0
        if lead > 0:
            records[n, 0] = cluster
        bit = 8 * lead
        for i in range(count[cluster]):
            word = chosen[i] << (bit & 7)
            records[n, bit >> 3] |= np.uint8(word & 255)
            if (bit & 7) + width[cluster, i] > 8:
                records[n, (bit >> 3) + 1] |= np.uint8(word >> 8)
            bit += width[cluster, i]
