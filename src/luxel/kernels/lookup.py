"""Texels out of stored records: the four that a bilinear lookup reads, whatever the codec.

What a kernel reads from is an array (M, T, T) of raw codes, or one of the tuples below; Numba picks the branch by type, so that
only what is used is compiled. A texture is opened first (`open_texture`), which gives a handle, and is read then as often as needed: what all
its texels share is worked out once. Reconstruction calculates with whole numbers small enough for float32: no order
of additions changes a bit, and pictures show what the codec's ``decode`` gives.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import overload
from numpy.typing import NDArray

from luxel.kernels.dots import dot8, eight_bytes, floors, floors_of_lanes, load_bytes, load_four, store_four
from luxel.kernels.jit import kernel
from luxel.kernels.memory import item, prefetch
from luxel.kernels.simd import LANES, fma, load, splat, store, vrint

__all__ = [
    "PLACES",
    "ClusteredTexels",
    "CodewordTexels",
    "LearntTexels",
    "LinearTexels",
    "linear_rows",
    "open_texture",
    "opened_words",
    "opens_freely",
    "prefetch_opened",
    "prefetch_texels",
    "read_four",
    "readable",
    "side_of",
]

#: Textures that may be open at a time: one for each ray of a tile.
PLACES = 64

_ZERO = np.float32(0)
_INLINE = {"forceinline": True, "_nrt": False}  # as ``kernel(inline=True, borrows=True)``


class CodewordTexels(NamedTuple):
    """Vector quantisation: `words` (M, B) uint8, little-endian, into `codebook` (C, T, T) uint8."""

    words: np.ndarray
    codebook: np.ndarray


class LinearTexels(NamedTuple):
    """Coefficients of one basis: code = (offset + basis · coefficient) / 2^shift, rounded down.

    `coefficients` (M, n) uint8; `rows` (T², 8 + 8 ⌈n/8⌉) int16: the eight bytes of the offset, an int32 and zeros, then the
    basis and zeros, see :func:`linear_rows`.
    """

    coefficients: np.ndarray
    rows: np.ndarray
    shift: np.int32
    side: int


class LearntTexels(NamedTuple):
    """Coefficients of one of several bases, which came one after the other; `records` (M, 1 + n) uint8: the basis, then coefficients.

    `rows` (V, T², 8 + 8 ⌈n/8⌉) int16, `shift` (V,) int32, each as in :class:`LinearTexels`.
    """

    records: np.ndarray
    rows: np.ndarray
    shift: np.ndarray
    side: int


class ClusteredTexels(NamedTuple):
    """A basis for every cluster; `records` (M, B) uint8: the cluster's index, then coefficients of cluster-specific widths.

    `basis` (K, T², W) int8, W a multiple of 16; `offset` (K, T²), `scale` (K, W) float32; `width` (K, W) uint8 bits; `counts` (K,) int32
    coefficients; `levels` (9, 256) float32, values of the quantisers of 0..8 bits; `lead` bytes of the index, 0 or 1. Zeros fill up.
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


def linear_rows(basis: NDArray[Any], offset: NDArray[Any]) -> NDArray[np.int16]:
    """Rows of :class:`LinearTexels` of a basis (D, n) int16 and offsets (D,) int32, which take a coefficient of 128 for nothing; not a kernel."""
    size, count = basis.shape
    rows = np.zeros((size, 8 + -(-count // 8) * 8), np.int16)
    rows[:, 8 : 8 + count] = basis
    start = np.zeros((size, 4), np.int32)
    start[:, 0] = offset - 128 * basis.sum(axis=1, dtype=np.int64)
    rows[:, :8] = start.view(np.int16)
    return rows


def readable(records: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return records (M, B) uint8 with rows of zeros behind them if they are less than eight bytes, which kernels read at a time; not a kernel."""
    missing = 8 - records.size
    if missing <= 0:
        return records
    size = records.shape[1]
    return np.concatenate([records, np.zeros((-(-missing // size), size), np.uint8)])


@kernel(inline=True, borrows=True)
def _eight(array, at):
    """Eight bytes from `at` on, the first in the lowest bits; anything for those behind the end of the array."""
    last = array.size - 8
    if at <= last:
        return eight_bytes(array, at)
    return eight_bytes(array, last) >> (8 * (at - last))


@kernel(inline=True, borrows=True)
def _open_raw(codes, slot, opened, place):
    return np.intp(slot) * (codes.shape[1] * codes.shape[2])


@kernel(inline=True, borrows=True)
def _open_codeword(texels, slot, opened, place):
    size = texels.words.shape[1]
    word = 0
    for k in range(size):
        word |= int(item(texels.words, np.intp(slot) * size + k)) << (8 * k)
    return word * (texels.codebook.shape[1] * texels.codebook.shape[2])


@kernel(inline=True, borrows=True)
def _open_linear(texels, slot, opened, place):
    return np.intp(slot) * texels.coefficients.shape[1]


@kernel(inline=True, borrows=True)
def _open_learnt(texels, slot, opened, place):
    return np.intp(slot) * texels.records.shape[1]


@kernel(inline=True, borrows=True)
def _open_clustered(texels, slot, opened, place):
    """Unpack the coefficients to row `place` of `opened`."""
    most = texels.width.shape[1]
    begin = np.intp(slot) * texels.records.shape[1]
    cluster = int(item(texels.records, begin)) if texels.lead else 0
    count, of, to = int(item(texels.counts, cluster)), cluster * most, place * most
    bit, i = 8 * texels.lead, 0
    while i < count:
        word = _eight(texels.records, begin + (bit >> 3)) >> (bit & 7)
        left = 64 - (bit & 7)
        while i < count:
            width = int(item(texels.width, of + i))
            if width > left:
                break
            opened[to + i] = item(texels.levels, (width << 8) + (word & ((1 << width) - 1)))
            word >>= width
            left -= width
            bit += width
            i += 1
    for i in range(0, count, LANES):
        store(opened, to + i, vrint(load(opened, to + i) * load(texels.scale, of + i)))
    return cluster * PLACES + place


@kernel(inline=True, borrows=True)
def _four_raw(texels, at, opened, p, q, r, s, codes, to):
    codes[to], codes[to + 1] = item(texels, at + p), item(texels, at + q)
    codes[to + 2], codes[to + 3] = item(texels, at + r), item(texels, at + s)


@kernel(inline=True, borrows=True)
def _four_codeword(texels, at, opened, p, q, r, s, codes, to):
    _four_raw(texels.codebook, at, opened, p, q, r, s, codes, to)


@kernel(inline=True, borrows=True)
def _four_sums(rows, begin, stride, shift, record, at, p, q, r, s, codes, to):
    if stride == 2 * 8:  # the usual case, as straight code
        p, q, r, s = begin + p * 16, begin + q * 16, begin + r * 16, begin + s * 16
        word = _eight(record, at)
        a, b = dot8(load_four(rows, p), rows, p + 8, word), dot8(load_four(rows, q), rows, q + 8, word)
        c, d = dot8(load_four(rows, r), rows, r + 8, word), dot8(load_four(rows, s), rows, s + 8, word)
        store_four(codes, to, floors(a, b, c, d, shift))
        return
    p, q, r, s = begin + p * stride, begin + q * stride, begin + r * stride, begin + s * stride
    a, b, c, d = load_four(rows, p), load_four(rows, q), load_four(rows, r), load_four(rows, s)
    for k in range(8, stride, 8):
        word = _eight(record, at + k - 8)
        a, b = dot8(a, rows, p + k, word), dot8(b, rows, q + k, word)
        c, d = dot8(c, rows, r + k, word), dot8(d, rows, s + k, word)
    store_four(codes, to, floors(a, b, c, d, shift))


@kernel(inline=True, borrows=True)
def _four_linear(texels, at, opened, p, q, r, s, codes, to):
    stride = texels.rows.shape[1]
    _four_sums(texels.rows, 0, stride, texels.shift, texels.coefficients, at, p, q, r, s, codes, to)


@kernel(inline=True, borrows=True)
def _four_learnt(texels, at, opened, p, q, r, s, codes, to):
    size, stride = texels.rows.shape[1], texels.rows.shape[2]
    v = int(item(texels.records, at))
    shift = item(texels.shift, v)
    _four_sums(texels.rows, v * size * stride, stride, shift, texels.records, at + 1, p, q, r, s, codes, to)


@kernel(inline=True, borrows=True)
def _four_clustered(texels, handle, opened, p, q, r, s, codes, to):
    most = texels.width.shape[1]
    cluster, place = handle // PLACES, handle % PLACES
    begin = cluster * texels.offset.shape[1]
    p, q, r, s = begin + p, begin + q, begin + r, begin + s
    a, b, c, d = splat(_ZERO), splat(_ZERO), splat(_ZERO), splat(_ZERO)
    for k in range(0, int(item(texels.counts, cluster)), LANES):
        values = load(opened, place * most + k)
        a = fma(load_bytes(texels.basis, p * most + k), values, a)
        b = fma(load_bytes(texels.basis, q * most + k), values, b)
        c = fma(load_bytes(texels.basis, r * most + k), values, c)
        d = fma(load_bytes(texels.basis, s * most + k), values, d)
    start = item(texels.offset, p), item(texels.offset, q), item(texels.offset, r), item(texels.offset, s)
    store_four(codes, to, floors_of_lanes(a, b, c, d, start, texels.unit))


def open_texture(texels, slot, opened, place):
    """Return a handle for `read_four` to read texture `slot` with; for kernels only.

    `opened` (at least (place + 1) · `opened_words`) float32 holds what the handle stands for until another texture is opened in the same `place` of `PLACES`.
    """
    raise NotImplementedError


def read_four(texels, handle, opened, p, q, r, s, codes, to):
    """Write the codes of four texels of an opened texture, each row · side + column, to int32 `codes` from `to` on; for kernels only."""
    raise NotImplementedError


def opened_words(texels: Any) -> int:
    """Words that an opened texture takes in memory."""
    return texels.width.shape[1] if isinstance(texels, ClusteredTexels) else 0


def side_of(texels):
    """Rows and columns of a texture; for kernels only."""
    raise NotImplementedError


def prefetch_texels(texels, slot, texel):
    """Ask for what `read_four` will read of texture `slot`, around this texel; for kernels only."""
    raise NotImplementedError


def prefetch_opened(texels, handle, p, r):
    """Ask for what `read_four` will read beside the record, for texels p and r and those to the right; for kernels only."""
    raise NotImplementedError


_READ = {
    CodewordTexels: (_open_codeword, _four_codeword),
    LinearTexels: (_open_linear, _four_linear),
    ClusteredTexels: (_open_clustered, _four_clustered),
    LearntTexels: (_open_learnt, _four_learnt),
}


def _how(texels, step):
    if isinstance(texels, types.Array):
        return (_open_raw, _four_raw)[step]
    if isinstance(texels, types.NamedTuple) and texels.instance_class in _READ:
        return _READ[texels.instance_class][step]
    return None


@overload(open_texture, jit_options=_INLINE)
def _open_texture(texels, slot, opened, place):
    if (read := _how(texels, 0)) is None:
        return None
    return lambda texels, slot, opened, place: read(texels, slot, opened, place)


@overload(read_four, jit_options=_INLINE)
def _read_four(texels, handle, opened, p, q, r, s, codes, to):
    if (read := _how(texels, 1)) is None:
        return None
    return lambda texels, handle, opened, p, q, r, s, codes, to: read(
        texels, handle, opened, p, q, r, s, codes, to
    )


def opens_freely(texels):
    """Whether opening a texture takes no more than looking where it lies; for kernels only."""
    raise NotImplementedError


@overload(opens_freely, jit_options=_INLINE)
def _opens_freely(texels):
    freely = not (isinstance(texels, types.NamedTuple) and texels.instance_class is ClusteredTexels)
    return lambda texels: freely


@overload(opened_words)
def _opened_words(texels):
    if isinstance(texels, types.NamedTuple) and texels.instance_class is ClusteredTexels:
        return lambda texels: texels.width.shape[1]
    return lambda texels: 0


@kernel(inline=True, borrows=True)
def _prefetch_rows(texels, handle, p, r):
    most = texels.width.shape[1]
    begin = (handle // PLACES) * texels.offset.shape[1]
    for k in range(0, 2 * most, 64):
        prefetch(texels.basis, (begin + p) * most + k)
        prefetch(texels.basis, (begin + r) * most + k)


@kernel(inline=True, borrows=True)
def _prefetch_codeword(texels, handle, p, r):
    prefetch(texels.codebook, handle + p)
    prefetch(texels.codebook, handle + r)


@overload(prefetch_opened, jit_options=_INLINE)
def _prefetch_opened(texels, handle, p, r):
    if isinstance(texels, types.NamedTuple) and texels.instance_class is ClusteredTexels:
        return lambda texels, handle, p, r: _prefetch_rows(texels, handle, p, r)
    if isinstance(texels, types.NamedTuple) and texels.instance_class is CodewordTexels:
        return lambda texels, handle, p, r: _prefetch_codeword(texels, handle, p, r)
    return lambda texels, handle, p, r: None


@overload(side_of, jit_options=_INLINE)
def _side_of(texels):
    if isinstance(texels, types.Array):
        return lambda texels: texels.shape[1]
    if texels.instance_class is CodewordTexels:
        return lambda texels: texels.codebook.shape[1]
    return lambda texels: texels.side


@overload(prefetch_texels, jit_options=_INLINE)
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
    opened, codes = np.zeros(LANES * opened_words(texels), np.float32), np.zeros(4, np.int32)
    for slot in range(out.shape[0]):
        handle = open_texture(texels, slot, opened, 0)
        for t in range(0, count, 4):
            last = min(3, count - 1 - t)
            read_four(texels, handle, opened, t, t + min(1, last), t + min(2, last), t + last, codes, 0)
            for k in range(last + 1):
                flat[slot * count + t + k] = codes[k]
