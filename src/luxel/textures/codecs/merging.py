"""Codebooks by merging the pair that costs least, again and again (paper 3.3; Equitz 1989).

The tree of all merges is independent of where it is cut, and its costs add up to the squared error: a number of
codewords and an error are both read off the sorted costs. Large sets are merged in buckets, neighbours along the principal axes,
and cut at one cost for all buckets; what is left is merged again in other buckets, so that no border stays.

Clusters are lists of textures: their means are calculated for a bucket at a time, so that all of it takes a fraction of
the memory of the textures themselves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from luxel.kernels.codewords import BLOCK, add_members, merge_pairs, row_hashes, same_rows
from luxel.kernels.simd import LANES
from luxel.textures.codecs.protocol import parts
from luxel.trace.tree import run_parts, thread_count

__all__ = ["BUCKET", "SAMPLE", "Clusters", "principal_axes", "reduce_to_count", "reduce_to_error"]

#: Vectors that are merged as one bucket. Time grows with its square, the loss at its borders falls.
BUCKET = 16_384
# A round of merging in buckets leaves at least this share of its clusters to the next, which has other borders.
_KEEP = 0.4
#: Vectors that axes are found from.
SAMPLE = 20_000


@dataclass(frozen=True, eq=False)
class Clusters:
    """Disjoint sets of textures.

    Parameters
    ----------
    codes
        (N, D) uint8, all textures.
    rows, copies
        (U,) int64 which of them are distinct, and (U,) int64 how often each occurs.
    members
        (U,) int64 indices into `rows`, cluster after cluster.
    starts
        (n + 1,) int64 where in `members` each cluster begins, and the end.
    """

    codes: NDArray[np.uint8]
    rows: NDArray[np.int64]
    copies: NDArray[np.int64]
    members: NDArray[np.int64]
    starts: NDArray[np.int64]

    @classmethod
    def distinct(cls, codes: NDArray[np.uint8]) -> Clusters:
        """One cluster for each different row of `codes` (N, D): what merging would do first, at no cost."""
        hashes = np.empty(len(codes), np.uint64)
        row_hashes(codes, hashes)
        _, first, label = np.unique(hashes, return_index=True, return_inverse=True)
        stands = first[label]
        same = np.empty(len(codes), bool)
        same_rows(codes, stands, same)
        stands[~same] = np.flatnonzero(~same)  # other rows of the same hash
        rows, copies = np.unique(stands, return_counts=True)
        return cls(codes, rows, copies, np.arange(len(rows)), np.arange(len(rows) + 1))

    def __len__(self) -> int:
        return len(self.starts) - 1

    def means(self, which: NDArray[np.int64]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Means (k, D) float32 of clusters `which` (k,), and how many textures each stands for, (k,) float32."""
        vectors = np.empty((len(which), self.codes.shape[1]), np.float32)
        weights = np.empty(len(which), np.float32)
        add_members(self.codes, self.rows, self.copies, self.members, self.starts, which, vectors, weights)
        return vectors, weights

    def joined(self, label: NDArray[np.int64]) -> Clusters:
        """Clusters of all clusters that share a label (n,)."""
        each = np.repeat(label, np.diff(self.starts))
        order = np.argsort(each, kind="stable")
        starts = np.append(np.flatnonzero(np.diff(each[order], prepend=-1)), len(order))
        return replace(self, members=self.members[order], starts=starts)

    def relabelled(self, label: NDArray[np.int64]) -> Clusters:
        """Clusters of the distinct textures that share a label (U,), whatever they were in before."""
        each = np.arange(len(self.rows) + 1)
        return replace(self, members=each[:-1], starts=each).joined(label)


def principal_axes(vectors: NDArray[np.float32]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean (D,) and orthonormal axes (D, D) in columns, of falling variance, of `vectors` (n, D)."""
    mean = vectors.mean(axis=0, dtype=np.float64)
    centred = vectors - mean
    return mean, np.linalg.eigh(centred.T @ centred)[1][:, ::-1].copy()


def reduce_to_count(clusters: Clusters, count: int, *, bucket: int = BUCKET, seed: int = 0) -> Clusters:
    """Merge until `count` clusters are left."""
    while len(clusters) > count:
        here = len(clusters)
        target = count if here <= bucket else max(count, int(_KEEP * here))
        pairs, _, names = _merges(clusters, bucket, seed)
        clusters = _cut(clusters, pairs, names, here - target)
        seed += 1
    return clusters


def reduce_to_error(clusters: Clusters, error: float, *, bucket: int = BUCKET, seed: int = 0) -> Clusters:
    """Merge while the sum of squared errors stays within `error`."""
    left = error
    while True:
        here = len(clusters)
        pairs, costs, names = _merges(clusters, bucket, seed)
        spent = np.cumsum(costs, dtype=np.float64)
        affordable = int(np.searchsorted(spent, left, side="right"))
        done = min(affordable, here if here <= bucket else int((1 - _KEEP) * here))
        clusters = _cut(clusters, pairs, names, done)
        if done == affordable:
            return clusters
        left -= float(spent[done - 1])
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
    count, size = len(clusters), clusters.codes.shape[1]
    drawn = np.arange(count)
    if count > SAMPLE:
        drawn = np.sort(np.random.default_rng(seed).choice(count, SAMPLE, replace=False))
    mean, axes = principal_axes(clusters.means(drawn)[0])
    # The mean would only cost digits.
    middle, turn = mean.astype(np.float32), axes.astype(np.float32)
    groups = _buckets(_leads(clusters, middle, turn), bucket, seed)
    found: list[tuple[NDArray[np.int64], NDArray[np.float32]]] = [None] * len(groups)  # type: ignore[list-item]

    def merge(k: int) -> None:
        members = groups[k]
        vectors, weights = clusters.means(members)
        turned = np.zeros((len(members), max(size, LANES)), np.float32)
        turned[:, :size] = (vectors - middle) @ turn
        del vectors
        room = -(-len(members) // LANES)
        pairs = np.empty((len(members) - 1, 2), np.int32)
        costs = np.empty(len(members) - 1, np.float32)
        merge_pairs(
            turned,
            weights,
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


def _leads(clusters: Clusters, middle: NDArray[np.float32], turn: NDArray[np.float32]) -> NDArray[np.float32]:
    """Coordinates (n, 15) of all clusters along the first axes."""
    leads = np.empty((len(clusters), min(LANES - 1, turn.shape[1])), np.float32)
    for part in parts(len(clusters)):
        vectors, _ = clusters.means(np.arange(part.start, part.stop))
        leads[part] = (vectors - middle) @ turn[:, : leads.shape[1]]
    return leads


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


def _cut(clusters: Clusters, pairs: NDArray[np.int64], names: NDArray[np.int64], merges: int) -> Clusters:
    """Do the first `merges` merges."""
    count = len(clusters)
    parent = np.arange(2 * count)
    parent[pairs[:merges, 0]] = names[:merges]
    parent[pairs[:merges, 1]] = names[:merges]
    while True:  # every step doubles how far up a name points
        above = parent[parent]
        if np.array_equal(above, parent):
            break
        parent = above
    return clusters.joined(parent[:count])
