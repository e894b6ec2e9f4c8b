"""Texels out of stored records: the four that a bilinear lookup reads, whatever the codec.

What a kernel reads from is an array (M, T, T) of raw codes, or one of the tuples below; Numba picks the branch by type, so that
only what is used is compiled. Reconstruction calculates with whole numbers small enough for float32: no order
of additions changes a bit, and pictures show what the codec's ``decode`` gives.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types
from numba.extending import overload

from luxel.kernels.jit import kernel
from luxel.kernels.memory import item, prefetch

__all__ = [
    "ClusteredTexels",
    "CodewordTexels",
    "LearntTexels",
    "LinearTexels",
    "four_codes",
    "prefetch_texels",
    "side_of",
    "unpacked",
]

_ZERO, _WHITE = np.float32(0), np.float32(255)
_MIDDLE = np.float32(128)


class CodewordTexels(NamedTuple):
    """Vector quantisation: `words` (M, B) uint8, little-endian, into `codebook` (C, T, T) uint8."""

    words: np.ndarray
    codebook: np.ndarray


class LinearTexels(NamedTuple):
    """Coefficients of one basis: code = (offset + basis · (coefficient − 128)) · unit, rounded down.

    `coefficients` (M, n) uint8; `basis` (T², n) and `offset` (T²,) float32, whole numbers; `unit` a power of two.
    """

    coefficients: np.ndarray
    basis: np.ndarray
    offset: np.ndarray
    unit: np.float32
    side: int


class ClusteredTexels(NamedTuple):
    """A basis for every cluster; `records` (M, B) uint8: the cluster's index, then coefficients of cluster-specific widths.

    `basis` (K, T², n) int8; `offset` (K, T²), `scale` (K, n) float32; `width` (K, n) uint8 bits; `counts` (K,) int32
    coefficients; `levels` (9, 256) float32, values of the quantisers of 0..8 bits; `lead` bytes of the index.
    """

    records: np.ndarray
    basis: np.ndarray
    offset: np.ndarray
    scale: np.ndarray
    width: np.ndarray
    counts: np.ndarray
    levels: np.ndarray
    lead: int
    unit: np.float32
    side: int


class LearntTexels(NamedTuple):
    """Coefficients of one of several bases, which came one after the other; `records` (M, 1 + n) uint8: the basis, then coefficients.

    `basis` (V, T², n) and `offset` (V, T²) float32, `unit` (V,) float32, each as in :class:`LinearTexels`.
    """

    records: np.ndarray
    basis: np.ndarray
    offset: np.ndarray
    unit: np.ndarray
    side: int


@kernel(inline=True)
def _little_endian(record, size):
    value = 0
    for k in range(size):
        value |= int(record[k]) << (8 * k)
    return value


@kernel(inline=True)
def _code(value, unit):
    return int(min(max(np.floor(value * unit), _ZERO), _WHITE))


@kernel(inline=True)
def _four_raw(codes, slot, p, q, r, s):
    base = np.intp(slot) * (codes.shape[1] * codes.shape[2])
    return item(codes, base + p), item(codes, base + q), item(codes, base + r), item(codes, base + s)


@kernel(inline=True)
def _four_codeword(texels, slot, p, q, r, s):
    word = _little_endian(texels.words[slot], texels.words.shape[1])
    return _four_raw(texels.codebook, word, p, q, r, s)


@kernel(inline=True)
def _four_linear(texels, slot, p, q, r, s):
    a, b, c, d = texels.offset[p], texels.offset[q], texels.offset[r], texels.offset[s]
    for k in range(texels.basis.shape[1]):
        x = np.float32(texels.coefficients[slot, k]) - _MIDDLE
        a += texels.basis[p, k] * x
        b += texels.basis[q, k] * x
        c += texels.basis[r, k] * x
        d += texels.basis[s, k] * x
    return _code(a, texels.unit), _code(b, texels.unit), _code(c, texels.unit), _code(d, texels.unit)


@kernel(inline=True)
def _four_learnt(texels, slot, p, q, r, s):
    record = texels.records[slot]
    v = int(record[0])
    basis, offset, unit = texels.basis[v], texels.offset[v], texels.unit[v]
    a, b, c, d = offset[p], offset[q], offset[r], offset[s]
    for k in range(basis.shape[1]):
        x = np.float32(record[1 + k]) - _MIDDLE
        a += basis[p, k] * x
        b += basis[q, k] * x
        c += basis[r, k] * x
        d += basis[s, k] * x
    return _code(a, unit), _code(b, unit), _code(c, unit), _code(d, unit)


@kernel(inline=True)
def unpacked(record, bit, width):
    """Whole number of `width` <= 8 bits that begins at `bit`."""
    at = bit >> 3
    word = int(record[at])
    if (bit & 7) + width > 8:
        word |= int(record[at + 1]) << 8
    return (word >> (bit & 7)) & ((1 << width) - 1)


@kernel(inline=True)
def _four_clustered(texels, slot, p, q, r, s):
    record = texels.records[slot]
    k = _little_endian(record, texels.lead)
    basis, offset = texels.basis[k], texels.offset[k]
    a, b, c, d = offset[p], offset[q], offset[r], offset[s]
    bit = 8 * texels.lead
    for i in range(texels.counts[k]):
        width = int(texels.width[k, i])
        value = np.rint(texels.scale[k, i] * texels.levels[width, unpacked(record, bit, width)])
        bit += width
        a += np.float32(basis[p, i]) * value
        b += np.float32(basis[q, i]) * value
        c += np.float32(basis[r, i]) * value
        d += np.float32(basis[s, i]) * value
    return _code(a, texels.unit), _code(b, texels.unit), _code(c, texels.unit), _code(d, texels.unit)


def four_codes(texels, slot, p, q, r, s):
    """Codes of four texels of texture `slot`, each row · side + column; for kernels only."""
    raise NotImplementedError


def side_of(texels):
    """Rows and columns of a texture; for kernels only."""
    raise NotImplementedError


def prefetch_texels(texels, slot, texel):
    """Ask for what `four_codes` will read of texture `slot`, around this texel; for kernels only."""
    raise NotImplementedError


_FOUR = {
    CodewordTexels: _four_codeword,
    LinearTexels: _four_linear,
    ClusteredTexels: _four_clustered,
    LearntTexels: _four_learnt,
}


@overload(four_codes, jit_options={"forceinline": True})
def _four_codes(texels, slot, p, q, r, s):
    if isinstance(texels, types.Array):
        read = _four_raw
    elif isinstance(texels, types.NamedTuple) and texels.instance_class in _FOUR:
        read = _FOUR[texels.instance_class]
    else:
        return None
    return lambda texels, slot, p, q, r, s: read(texels, slot, p, q, r, s)


@overload(side_of, jit_options={"forceinline": True})
def _side_of(texels):
    if isinstance(texels, types.Array):
        return lambda texels: texels.shape[1]
    if texels.instance_class is CodewordTexels:
        return lambda texels: texels.codebook.shape[1]
    return lambda texels: texels.side


@overload(prefetch_texels, jit_options={"forceinline": True})
def _prefetch_texels(texels, slot, texel):
    if isinstance(texels, types.Array):
        return lambda texels, slot, texel: prefetch(
            texels, np.intp(slot) * (texels.shape[1] * texels.shape[2]) + texel
        )
    if texels.instance_class is CodewordTexels:
        return lambda texels, slot, texel: prefetch(texels.words, slot * texels.words.shape[1])
    if texels.instance_class is LinearTexels:
        return lambda texels, slot, texel: prefetch(texels.coefficients, slot * texels.coefficients.shape[1])
    return lambda texels, slot, texel: prefetch(texels.records, slot * texels.records.shape[1])


@kernel
def read_codes(texels, out):
    """Every texel of every texture, as lookups see them, to `out` (M, T, T) uint8."""
    flat = out.reshape(-1)
    count = out.shape[1] * out.shape[2]
    for slot in range(out.shape[0]):
        for t in range(0, count, 2):
            a, b, _, _ = four_codes(texels, slot, t, t + 1, t, t)
            flat[slot * count + t], flat[slot * count + t + 1] = a, b
