"""Lists of ascending particle ids: what of them is lacking, what two have in common, and how they are spread over shards."""

from __future__ import annotations

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.memory import prefetch

__all__ = ["carry_over", "list_lacking", "mark_common", "pick", "sort_by_shard"]

_AHEAD = 24  # particles: what is asked for so early is there in time


@kernel
def list_lacking(ids, state, wanting, lacking, found):
    """List those of `ids` (K,) in whose state, (N,) uint8, something is wanting, as (256,) bool tells; return how many.

    Writes ids to `lacking` (K,) int32 and their states to `found` (K,) uint8.
    """
    count = 0
    last = ids.shape[0] - 1
    for k in range(ids.shape[0]):
        prefetch(state, np.intp(ids[min(k + _AHEAD, last)]))
        now = state[ids[k]]
        lacking[count], found[count] = ids[k], now
        count += wanting[now]
    return count


@kernel
def mark_common(ids, others, common):
    """Write to `common` (K,) bool which of `ids` (K,) are among `others` (L,); both ascend."""
    at, end = 0, others.shape[0]
    for k in range(ids.shape[0]):
        while at < end and others[at] < ids[k]:
            at += 1
        common[k] = at < end and others[at] == ids[k]


@kernel
def carry_over(old_ids, old_since, ids, since, gone):
    """Copy `old_since` (L,) to `since` (K,) where particles are on both lists, which ascend; return how many are on the old one only.

    Writes to `gone` (L,) bool which these are.
    """
    at, end = 0, ids.shape[0]
    count = 0
    for k in range(old_ids.shape[0]):
        while at < end and ids[at] < old_ids[k]:
            at += 1
        again = at < end and ids[at] == old_ids[k]
        if again:
            since[at] = old_since[k]
        gone[k] = not again
        count += not again
    return count


@kernel
def pick(
    chosen, ids, seen, since, distance, pixels, some_ids, some_seen, some_since, some_distance, some_pixels
):
    """Copy the `chosen`, (K,) bool, of five columns (K,) of requests to columns that are as long as there are."""
    count = 0
    for k in range(chosen.shape[0]):
        if chosen[k]:
            some_ids[count], some_seen[count], some_since[count] = ids[k], seen[k], since[k]
            some_distance[count], some_pixels[count] = distance[k], pixels[k]
            count += 1


@kernel
def sort_by_shard(ids, shift, ends, order):
    """Put places of `ids` (K,) in the order of their shards, stable; see :func:`luxel.dynamic.sightings.shard_of`.

    Writes places to `order` (K,) intp, and to `ends` (shards,) intp where in there each shard's end.
    """
    ends[:] = 0
    for k in range(ids.shape[0]):
        ends[_shard(ids[k], shift)] += 1
    before = 0
    for shard in range(ends.shape[0]):
        here = ends[shard]
        ends[shard] = before
        before += here
    for k in range(ids.shape[0]):
        shard = _shard(ids[k], shift)
        order[ends[shard]] = k
        ends[shard] += 1


@kernel(inline=True)
def _shard(particle, shift):
    mixed = (np.uint64(particle) * np.uint64(2_654_435_769)) & np.uint64(0xFFFFFFFF)
    return np.intp(mixed >> np.uint64(shift))
