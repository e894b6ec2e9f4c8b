"""Codebooks by merging the pair that costs least, again and again (paper 3.3; Equitz 1989), then by moving centroids.

The tree of all merges is independent of where it is cut, and its costs add up to the squared error: a number of
codewords and an error are both read off the sorted costs. Large sets are merged in buckets, neighbours along the principal axes,
and cut at one cost for all buckets; what is left is merged again in other buckets, so that no border stays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxel.kernels.codewords import BLOCK, EMPTY, merge_pairs
from luxel.kernels.simd import LANES
from luxel.trace.tree import run_parts, thread_count

__all__ = ["Clusters", "principal_axes", "reduce_to_count", "reduce_to_error"]

#: Vectors that are merged as one bucket. Time grows with its square, the loss at its borders falls.
BUCKET = 16_384
# A round of merging in buckets leaves at least this share of its vectors to the next, which has other borders.
_KEEP = 0.4


@dataclass(frozen=True, eq=False)
class Clusters:
    """Weighted vectors.

    Parameters
    ----------
    vectors
        (n, D) float32.
    weights
        (n,) float32 number of textures.
    """

    vectors: NDArray[np.float32]
    weights: NDArray[np.float32]

    @classmethod
    def distinct(cls, codes: NDArray[np.uint8]) -> Clusters:
        """Clusters of equal rows of `codes` (N, D): what merging would do first, at no cost."""
        rows = np.ascontiguousarray(codes).view(np.dtype((np.void, codes.shape[1]))).ravel()
        unique, counts = np.unique(rows, return_counts=True)
        return cls(
            unique.view(np.uint8).reshape(len(unique), -1).astype(np.float32), counts.astype(np.float32)
        )


def principal_axes(vectors: NDArray[np.float32], seed: int = 0) -> tuple[NDArray[np.float64], ...]:
    """Mean (D,) and orthonormal axes (D, D) in columns, of falling variance over a sample of `vectors`."""
    if len(vectors) > 20_000:
        vectors = vectors[np.random.default_rng(seed).choice(len(vectors), 20_000, replace=False)]
    mean = vectors.mean(axis=0, dtype=np.float64)
    centred = vectors - mean
    return mean, np.linalg.eigh(centred.T @ centred)[1][:, ::-1].copy()


def reduce_to_count(clusters: Clusters, count: int, *, bucket: int = BUCKET, seed: int = 0) -> Clusters:
    """Merge until `count` clusters are left."""
    while len(clusters.weights) > count:
        here = len(clusters.weights)
        target = count if here <= bucket else max(count, int(_KEEP * here))
        clusters = _cut(clusters, *_merges(clusters, bucket, seed), here - target)
        seed += 1
    return clusters


def reduce_to_error(clusters: Clusters, error: float, *, bucket: int = BUCKET, seed: int = 0) -> Clusters:
    """Merge while the sum of squared errors stays within `error`."""
    left = error
    while True:
        here = len(clusters.weights)
        pairs, costs, bases = _merges(clusters, bucket, seed)
        spent = np.cumsum(costs, dtype=np.float64)
        most = int(np.searchsorted(spent, left, side="right"))
        if here <= bucket or most <= (1 - _KEEP) * here:
            return _cut(clusters, pairs, costs, bases, most)
        most = int((1 - _KEEP) * here)
        clusters = _cut(clusters, pairs, costs, bases, most)
        left -= float(spent[most - 1])
        seed += 1


def _merges(
    clusters: Clusters, bucket: int, seed: int
) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.int64]]:
    """All merges within buckets, cheapest first.

    Returns
    -------
    pairs, costs, names
        (m, 2) the clusters joined, (m,) float32, and (m,) the cluster made: numbers from n on.
    """
    vectors, weights = clusters.vectors, clusters.weights
    count, size = vectors.shape
    _, axes = principal_axes(vectors, seed)
    turned = np.zeros((count, max(size, LANES)), np.float32)
    # The mean would only cost digits.
    turned[:, :size] = (vectors - vectors.mean(axis=0)) @ axes.astype(np.float32)
    groups = _buckets(turned[:, : LANES - 1], bucket, seed)
    found: list[tuple[NDArray[np.int64], NDArray[np.float32]]] = [None] * len(groups)  # type: ignore[list-item]

    def merge(k: int) -> None:
        members = groups[k]
        room = -(-len(members) // LANES)
        pairs = np.empty((len(members) - 1, 2), np.int32)
        costs = np.empty(len(members) - 1, np.float32)
        merge_pairs(
            turned[members],
            weights[members],
            np.empty(room * BLOCK, np.float32),
            np.empty(room * LANES, np.float32),
            pairs,
            costs,
        )
        for m, (a, b) in enumerate(pairs - len(members)):  # rounding must not put a merge before its parts
            costs[m] = max(costs[m], costs[a] if a >= 0 else 0, costs[b] if b >= 0 else 0)
        found[k] = pairs.astype(np.int64), costs

    run_parts(merge, range(len(groups)), thread_count(None))
    pairs, names, first = [], [], count
    for members, (joined, _) in zip(groups, found, strict=True):
        n = len(members)
        old = joined < n
        pairs.append(np.where(old, members[np.where(old, joined, 0)], joined - n + first))
        names.append(np.arange(first, first + n - 1))
        first += n - 1
    costs = np.concatenate([c for _, c in found])
    order = np.argsort(costs, kind="stable")
    return np.concatenate(pairs)[order], costs[order], np.concatenate(names)[order]


def _buckets(leads: NDArray[np.float32], most: int, seed: int) -> list[NDArray[np.int64]]:
    """Split vectors at medians of their widest axes into groups of at most `most`."""
    rng = np.random.default_rng(seed)
    todo, done = [np.arange(len(leads))], []
    while todo:
        members = todo.pop()
        if len(members) <= most:
            done.append(members)
            continue
        own = leads[members]
        axis = int(np.argmax(own.var(axis=0)))
        # Off the middle by chance: another seed puts borders elsewhere.
        at = int(len(members) * rng.uniform(0.35, 0.65))
        order = np.argpartition(own[:, axis], at)
        todo += [members[order[:at]], members[order[at:]]]
    return done


def _cut(
    clusters: Clusters,
    pairs: NDArray[np.int64],
    costs: NDArray[np.float32],
    names: NDArray[np.int64],
    merges: int,
) -> Clusters:
    """Do the first `merges` merges."""
    del costs
    count = len(clusters.weights)
    parent = np.arange(2 * count)
    parent[pairs[:merges, 0]] = names[:merges]
    parent[pairs[:merges, 1]] = names[:merges]
    while True:  # every step doubles how far up a name points
        above = parent[parent]
        if np.array_equal(above, parent):
            break
        parent = above
    _, label = np.unique(parent[:count], return_inverse=True)
    return Clusters(*centroids(clusters, label, int(label.max()) + 1))


def centroids(
    clusters: Clusters, label: NDArray[np.int64], count: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Weighted means (count, D) and weights (count,) of the clusters that share a label; every label must occur."""
    order = np.argsort(label, kind="stable")
    starts = np.searchsorted(label[order], np.arange(count))
    weights = np.add.reduceat(clusters.weights[order], starts)
    sums = np.empty((count, clusters.vectors.shape[1]), np.float32)
    for first in range(0, count, BUCKET):  # in parts, for a copy of everything would double the memory
        last = min(first + BUCKET, count)
        begin = starts[first]
        end = starts[last] if last < count else len(order)
        rows = order[begin:end]
        weighted = clusters.vectors[rows].astype(np.float64) * clusters.weights[rows, None]
        sums[first:last] = (
            np.add.reduceat(weighted, starts[first:last] - begin, axis=0) / weights[first:last, None]
        )
    return sums, weights


def bounds_of(
    codes: NDArray[np.uint8], mean: NDArray[np.float64], axes: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Bounds (n, 16) float32 of rows of `codes` (n, D), see ``kernels.codewords``; `axes` (D, <= 15)."""
    centred = codes - mean
    out = np.zeros((len(codes), LANES), np.float32)
    lead = centred @ axes
    out[:, : axes.shape[1]] = lead
    rest = np.einsum("nd,nd->n", centred, centred) - np.einsum("nd,nd->n", lead, lead)
    out[:, -1] = np.sqrt(np.maximum(rest, 0))
    return out


def blocks_from(bounds: NDArray[np.float32]) -> tuple[NDArray[Any], ...]:
    """Sort bounds (n, 16) by their first coordinate into blocks.

    Returns
    -------
    blocks, low, high, order
        Flat float32; the range of the first coordinate in each block, float32; the row of every lane, int32, which is 0 in empty lanes.
    """
    count = len(bounds)
    room = -(-count // LANES) * LANES
    order = np.zeros(room, np.int32)
    order[:count] = np.argsort(bounds[:, 0], kind="stable")
    table = np.full((room, LANES), EMPTY, np.float32)
    table[:count] = bounds[order[:count]]
    low = table[::LANES, 0].copy()
    high = table[np.minimum(np.arange(LANES - 1, room, LANES), count - 1), 0].copy()
    return table.reshape(-1, LANES, LANES).transpose(0, 2, 1).ravel(), low, high, order
