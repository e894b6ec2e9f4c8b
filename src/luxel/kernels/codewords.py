"""Vector quantisation: nearest codewords, and merging of nearest pairs.

Both search through *bounds*: sixteen numbers a vector, fifteen coordinates along orthonormal axes and the length of what
is left. The squared distance of two bounds is never more than that of the vectors, and usually close to it, so that few
candidates need the whole distance. Sixteen vectors make a block of 256 numbers, (coordinate, lane).
"""

from __future__ import annotations

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.simd import LANES, any_lane, bits, fma, load, splat, trailing_zeros

__all__ = [
    "BLOCK",
    "EMPTY",
    "add_members",
    "code_distance",
    "merge_pairs",
    "nearest_codewords",
    "row_hashes",
    "same_rows",
]

BLOCK = LANES * LANES
#: A coordinate of lanes that hold no vector.
EMPTY = np.float32(1e15)
_EXACT = 256  # so many squared differences of codes sum without rounding in float32
_ZERO = np.float32(0)
# Bounds are rounded: they rule out nothing that is closer than these.
_SHARE, _SLACK = np.float32(0.999), np.float32(1)


@kernel(inline=True)
def code_distance(a, b):
    """Squared distance of two rows of 8-bit codes, exact."""
    total = 0
    for first in range(0, len(a), _EXACT):
        part = _ZERO
        for k in range(first, min(first + _EXACT, len(a))):
            d = np.float32(a[k]) - np.float32(b[k])
            part += d * d
        total += int(part)
    return total


@kernel
def row_hashes(codes, hashes):
    """Write a number for every row of `codes` (n, D) to `hashes` (n,) uint64: different ones say that rows differ (FNV-1a)."""
    for n in range(len(codes)):
        value = np.uint64(0xCBF29CE484222325)
        for k in range(codes.shape[1]):
            value = (value ^ np.uint64(codes[n, k])) * np.uint64(0x100000001B3)
        hashes[n] = value


@kernel
def same_rows(codes, others, same):
    """Write to `same` (n,) whether every row of `codes` (n, D) equals row `others[n]`."""
    for n in range(len(codes)):
        equal = True
        for k in range(codes.shape[1]):
            equal = equal and codes[n, k] == codes[others[n], k]
        same[n] = equal


@kernel
def add_members(codes, rows, copies, members, starts, which, means, weights):
    """Write means (k, D) and numbers of textures (k,) of clusters `which` (k,), float32; sums are exact.

    See ``textures.codecs.merging.Clusters`` for the other arguments.
    """
    total = np.empty(codes.shape[1], np.float64)
    for n in range(len(which)):
        total[:] = 0
        count = 0
        for m in range(starts[which[n]], starts[which[n] + 1]):
            row, times = rows[members[m]], copies[members[m]]
            count += times
            for k in range(codes.shape[1]):
                total[k] += times * np.float64(codes[row, k])
        for k in range(codes.shape[1]):
            means[n, k] = total[k] / count
        weights[n] = count


@kernel(inline=True)
def _bounds(blocks, block, query):
    """Squared distances between one bound (16,) and those of a block."""
    d = load(blocks, block * BLOCK) - query[0]
    total = d * d
    for k in range(1, LANES):
        d = load(blocks, block * BLOCK + k * LANES) - query[k]
        total = fma(d, d, total)
    return total


@kernel
def nearest_codewords(codes, queries, starts, blocks, low, high, order, codebook, found):
    """Write the index of the nearest codeword of every row of `codes` (n, D) to `found` (n,); the lowest of several.

    Parameters
    ----------
    queries
        (n, 16) float32 bounds of the rows.
    starts
        (n,) the block to begin with.
    blocks
        Bounds of the codewords, sorted by their first coordinate.
    low, high
        (blocks,) range of that coordinate in every block.
    order
        Codeword of every lane.
    codebook
        (C, D) uint8.
    """
    last = len(low) - 1
    for n in range(len(codes)):
        query = queries[n]
        best, index = 2**62, -1
        up, down = starts[n], starts[n] - 1
        while up <= last or down >= 0:
            limit = (np.float32(best) + _SLACK) / _SHARE
            # Outwards from the start, the nearer side first; a side ends where its first coordinate alone is too far.
            above = max(_ZERO, low[up] - query[0]) if up <= last else EMPTY
            below = max(_ZERO, query[0] - high[down]) if down >= 0 else EMPTY
            if min(above, below) * min(above, below) > limit:
                break
            if above <= below:
                block, up = up, up + 1
            else:
                block, down = down, down - 1
            near = _bounds(blocks, block, query) <= splat(limit)
            if any_lane(near):
                left = bits(near)
                while left:
                    lane = trailing_zeros(left)
                    left &= left - 1
                    candidate = order[block * LANES + lane]
                    distance = code_distance(codes[n], codebook[candidate])
                    if distance < best or (distance == best and candidate < index):
                        best, index = distance, candidate
        found[n] = index


@kernel(inline=True)
def _cost(vectors, weights, a, b):
    """By how much merging two clusters raises the sum of squared errors (Equitz 1989, equation 4; Ward 1963)."""
    total = _ZERO
    for k in range(vectors.shape[1]):
        d = vectors[a, k] - vectors[b, k]
        total += d * d
    return weights[a] * weights[b] / (weights[a] + weights[b]) * total


@kernel(inline=True)
def _put(vectors, weights, blocks, lanes, slot):
    """Write the bound and the weight of a slot into its lane."""
    at = (slot // LANES) * BLOCK + slot % LANES
    for k in range(LANES - 1):
        blocks[at + k * LANES] = vectors[slot, k]
    rest = _ZERO
    for k in range(LANES - 1, vectors.shape[1]):
        rest += vectors[slot, k] * vectors[slot, k]
    blocks[at + (LANES - 1) * LANES] = np.sqrt(rest)
    lanes[slot] = weights[slot]


@kernel
def merge_pairs(vectors, weights, blocks, lanes, pairs, costs):
    """Merge the cheapest pairs of clusters until one is left: the whole tree of merges, by nearest-neighbour chains.

    For this cost the chain (Benzécri 1982) finds the very merges that always taking the cheapest pair does, in another
    order: sort them by cost. Cluster n + m is what merge m makes.

    Parameters
    ----------
    vectors
        (n, D) float32, D >= 16, coordinates along orthonormal axes of falling variance; overwritten.
    weights
        (n,) float32 textures a vector stands for; overwritten.
    blocks, lanes
        Room for bounds and weights: 256 and 16 float32 for every sixteen vectors.
    pairs, costs
        (n - 1, 2) int32 clusters that each merge joins, and (n - 1,) float32 what it costs.
    """
    total = count = len(vectors)
    blocks[:] = EMPTY
    lanes[:] = np.float32(1)
    names, chain = np.arange(total), np.empty(total + 1, np.int64)
    query = np.empty(LANES, np.float32)
    for slot in range(total):
        _put(vectors, weights, blocks, lanes, slot)
    length = merge = 0
    while count > 1:
        if length == 0:
            chain[0], length = 0, 1
        a = chain[length - 1]
        # The chain turns back unless something is strictly nearer: so it ends.
        b, best = -1, np.float32(3e38)
        if length > 1:
            b = chain[length - 2]
            best = _cost(vectors, weights, a, b)
        at = (a // LANES) * BLOCK + a % LANES
        for k in range(LANES):
            query[k] = blocks[at + k * LANES]
        own = weights[a]
        for block in range((count + LANES - 1) // LANES):
            w = load(lanes, block * LANES)
            near = _bounds(blocks, block, query) * w * (own * _SHARE) < (w + own) * best
            if any_lane(near):
                left = bits(near)
                while left:
                    slot = block * LANES + trailing_zeros(left)
                    left &= left - 1
                    if slot != a and slot < count:
                        cost = _cost(vectors, weights, a, slot)
                        if cost < best:
                            b, best = slot, cost
        if length < 2 or b != chain[length - 2]:
            chain[length] = b
            length += 1
            continue
        length -= 2
        a, b = min(a, b), max(a, b)
        pairs[merge, 0], pairs[merge, 1], costs[merge] = names[a], names[b], best
        share = weights[b] / (weights[a] + weights[b])
        for k in range(vectors.shape[1]):
            vectors[a, k] += share * (vectors[b, k] - vectors[a, k])
        weights[a] += weights[b]
        names[a] = total + merge
        merge += 1
        _put(vectors, weights, blocks, lanes, a)
        count -= 1
        if b < count:  # the last takes the freed place
            vectors[b], weights[b], names[b] = vectors[count], weights[count], names[count]
            _put(vectors, weights, blocks, lanes, b)
            for k in range(length):
                if chain[k] == count:
                    chain[k] = b
        at = (count // LANES) * BLOCK + count % LANES
        for k in range(LANES):
            blocks[at + k * LANES] = EMPTY
        lanes[count] = np.float32(1)
