"""What frames have seen: lists and digests of particles by where their textures lie."""

from __future__ import annotations

import numpy as np

from luxel.kernels import FIRST_LIGHT, STALE
from luxel.kernels.jit import kernel
from luxel.kernels.memory import prefetch
from luxel.kernels.simd import trailing_zeros

__all__ = ["are_rising", "count_slots", "distances", "list_seen", "note_sighting", "slot_hash"]

_AHEAD = 24  # particles: what is asked for so early is there in time


@kernel(inline=True)
def slot_hash(particle, slot):
    """Hash of one particle's slot; sums of them tell whether any of many slots has changed."""
    h = (np.uint64(particle) << np.uint64(32)) ^ np.uint64(slot + 8)
    h = (h ^ (h >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
    return np.int64((h ^ (h >> np.uint64(32))) * np.uint64(0x94D049BB133111EB))


@kernel
def list_seen(seen, found):
    """List the particles marked in `seen`, ascending, into `found` (N,) int32; return how many.

    `seen` is (N',) uint8, 0 or 1, with N' a multiple of 8 and at least N.
    """
    words = seen.view(np.int64)
    count = 0
    for w in range(words.shape[0]):
        left = words[w]
        while left != 0:
            found[count] = 8 * w + (trailing_zeros(left) >> 3)
            count += 1
            left &= left - 1
    return count


@kernel
def are_rising(ids, count):
    """Whether `ids` (K,) ascend, each once, and all lie in [0, count)."""
    before = np.int64(-1)
    rising = True
    for k in range(ids.shape[0]):
        rising &= ids[k] > before
        before = ids[k]
    return rising and before < count


@kernel
def count_slots(ids, slot):
    """Of particles `ids` (K,), count those with a texture, with first light only, with a texture of another light; and add up hashes of their slots."""
    textured = dim = stale = 0
    digest = np.int64(0)
    for k in range(ids.shape[0]):
        s = slot[ids[k]]
        textured += (s >= 0) & (s < STALE)
        dim += s == FIRST_LIGHT
        stale += s >= STALE
        digest += slot_hash(ids[k], s)
    return textured, dim, stale, digest


@kernel
def note_sighting(ids, slot, state, stored, wanting, stamps, number):
    """Write `number` to the stamps of the slots that particles have.

    Parameters
    ----------
    ids
        (K,) int32.
    slot, state
        (N,) int32, negative for none; (N,) uint8.
    stored, wanting
        (256,) bool, of each state: whether there is a slot, as far as it tells; whether something is wanted.
    stamps
        int64, one a slot.
    number
        To write.

    Returns
    -------
    hits, lacking
        How many have a slot, and how many want something.
    """
    hits = lacking = 0
    last = ids.shape[0] - 1
    for k in range(ids.shape[0]):
        prefetch(state, np.intp(ids[min(k + _AHEAD, last)]))
        i = ids[k]
        now = state[i]
        lacking += wanting[now]
        if stored[now]:
            s = slot[i]
            if s >= 0:
                stamps[s] = number
                hits += 1
    return hits, lacking


@kernel
def distances(centers, ids, eye, scale, found):
    """Write to `found` (K,) float64 how far the centres of particles `ids` (K,) are from `eye` (3,), times `scale`; `centers` is (N, 3)."""
    last = ids.shape[0] - 1
    for k in range(ids.shape[0]):
        prefetch(centers, np.intp(ids[min(k + _AHEAD, last)]) * centers.strides[0])
        i = ids[k]
        x, y, z = centers[i, 0] - eye[0], centers[i, 1] - eye[1], centers[i, 2] - eye[2]
        found[k] = scale * np.sqrt(x * x + y * y + z * z)
