"""What frames have seen: lists and digests of particles by where their textures lie."""

from __future__ import annotations

import numpy as np

from luxel.kernels import FIRST_LIGHT, STALE
from luxel.kernels.jit import kernel

__all__ = ["gather_seen", "slots_digest"]


@kernel(inline=True)
def _mixed(particle, slot):
    """Hash of one particle's slot; sums of them tell whether any of many slots has changed."""
    h = (np.uint64(particle) << np.uint64(32)) ^ np.uint64(slot + 8)
    h = (h ^ (h >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
    return (h ^ (h >> np.uint64(32))) * np.uint64(0x94D049BB133111EB)


@kernel
def gather_seen(seen, slot, found):
    """List the particles marked in `seen`, ascending, into `found` (N,) int32.

    Returns how many, how many of them have a texture, how many only first light, how many a texture of another light, and the digest of their
    slots. `seen` is (N',) uint8 with N' a multiple of 8 and at least N.
    """
    words = seen.view(np.uint64)
    count = textured = dim = stale = 0
    digest = np.uint64(0)
    for w in range(words.shape[0]):
        if words[w] == 0:
            continue
        for i in range(8 * w, 8 * w + 8):
            if seen[i]:
                s = slot[i]
                found[count] = i
                count += 1
                textured += 0 <= s < STALE
                dim += s == FIRST_LIGHT
                stale += s >= STALE
                digest += _mixed(i, s)
    return count, textured, dim, stale, digest


@kernel
def slots_digest(ids, slot):
    """Sum of hashes of the slots of particles: what `gather_seen` returns last."""
    digest = np.uint64(0)
    for k in range(ids.shape[0]):
        digest += _mixed(ids[k], slot[ids[k]])
    return digest
