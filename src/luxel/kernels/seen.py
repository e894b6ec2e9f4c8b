"""What frames have seen: marks, lists, and digests of particles by where their textures lie."""

from __future__ import annotations

import numpy as np

from luxel.kernels import FIRST_LIGHT, STALE
from luxel.kernels.jit import kernel
from luxel.kernels.memory import prefetch
from luxel.kernels.simd import trailing_zeros

__all__ = [
    "are_rising",
    "clear_seen",
    "count_slots",
    "distances",
    "join_tallies",
    "list_seen",
    "mark_seen",
    "note_sighting",
    "tally_seen",
]

_AHEAD = 24  # particles: what is asked for so early is there in time


@kernel(inline=True)
def _slot_hash(particle, slot):
    """Hash of one particle's slot; sums of them tell whether any of many slots has changed."""
    h = (np.uint64(particle) << np.uint64(32)) ^ np.uint64(slot + 8)
    h ^= h >> np.uint64(29)  # else particles that swap slots would not be noticed
    h *= np.uint64(0x94D049BB133111EB)
    return np.int64(h ^ (h >> np.uint64(32)))


@kernel(inline=True)
def _kinds(particle, slot):
    """Whether a slot is that of a texture, of first light only, or of a texture of another light; and a hash of it."""
    return (slot >= 0) & (slot < STALE), slot == FIRST_LIGHT, slot >= STALE, _slot_hash(particle, slot)


@kernel(inline=True, borrows=True)
def mark_seen(who, rays, marks, marked):
    """Mark the particles that some rays hit.

    Parameters
    ----------
    who
        (K,) int32 particle of each ray.
    rays
        A bit for each ray that counts, all of which hit something.
    marks
        (W,) int64, a bit a particle; of one thread.
    marked
        (W / 64,) int64, a bit for every word of `marks` that is not 0.
    """
    while rays != 0:
        i = who[trailing_zeros(rays)]
        rays &= rays - 1
        word = i >> 6
        marks[word] |= np.int64(1) << np.int64(i & 63)
        marked[word >> 6] |= np.int64(1) << np.int64(word & 63)  # each time: no branch could be predicted


@kernel(borrows=True)
def tally_seen(marks, marked, slot, tally):
    """Write to `tally` what :func:`count_slots` finds of all that one thread has marked, and how many particles these are before it.

    `marks` and `marked` are rows of those of :func:`list_seen`; `tally` is (5,) int64.
    """
    count = textured = dim = stale = 0
    digest = np.int64(0)
    for block in range(marked.shape[0]):
        words = marked[block]
        while words != 0:
            word = 64 * block + trailing_zeros(words)
            words &= words - 1
            left = marks[word]
            while left != 0:
                i = 64 * word + trailing_zeros(left)
                left &= left - 1
                a, b, c, h = _kinds(i, slot[i])
                count, textured, dim, stale, digest = count + 1, textured + a, dim + b, stale + c, digest + h
    tally[0], tally[1], tally[2], tally[3], tally[4] = count, textured, dim, stale, digest


@kernel
def join_tallies(marks, marked, slot, tallies):
    """Return the tally of all threads together: what several have marked counts once.

    `marks` and `marked` are as :func:`list_seen` takes them, `tallies` (T, 5) int64 as :func:`tally_seen` makes them.
    """
    threads = marks.shape[0]
    count = textured = dim = stale = 0
    digest = np.int64(0)
    for t in range(threads):
        count, textured, dim = count + tallies[t, 0], textured + tallies[t, 1], dim + tallies[t, 2]
        stale, digest = stale + tallies[t, 3], digest + tallies[t, 4]
    for block in range(marked.shape[1]):
        some = words = np.int64(0)
        for t in range(threads):
            words |= some & marked[t, block]
            some |= marked[t, block]
        while words != 0:
            word = 64 * block + trailing_zeros(words)
            words &= words - 1
            known = np.int64(0)
            for t in range(threads):
                again = known & marks[t, word]
                known |= marks[t, word]
                while again != 0:
                    i = 64 * word + trailing_zeros(again)
                    again &= again - 1
                    a, b, c, h = _kinds(i, slot[i])
                    count, textured, dim, stale, digest = (
                        count - 1,
                        textured - a,
                        dim - b,
                        stale - c,
                        digest - h,
                    )
    return count, textured, dim, stale, digest


@kernel
def list_seen(marks, marked, found):
    """List what any thread has marked, ascending, into `found` (N,) int32; return how many.

    `marks` is (T, W) and `marked` (T, W / 64), a row a thread; what nobody has marked costs next to nothing.
    """
    threads = marks.shape[0]
    count = 0
    for block in range(marked.shape[1]):
        words = np.int64(0)
        for t in range(threads):
            words |= marked[t, block]
        while words != 0:
            word = 64 * block + trailing_zeros(words)
            words &= words - 1
            left = np.int64(0)
            for t in range(threads):
                left |= marks[t, word]
            while left != 0:
                i = 64 * word + trailing_zeros(left)
                found[count] = i
                count += 1
                left &= left - 1
    return count


@kernel
def clear_seen(marks, marked):
    """Unmark all; see :func:`list_seen`."""
    for t in range(marked.shape[0]):
        for block in range(marked.shape[1]):
            words = marked[t, block]
            marked[t, block] = 0
            while words != 0:
                marks[t, 64 * block + trailing_zeros(words)] = 0
                words &= words - 1


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
    for k in range(ids.shape[0]):  # without asking ahead: sixteen at a time where the processor can
        i = ids[k]
        a, b, c, h = _kinds(i, slot[i])
        textured, dim, stale, digest = textured + a, dim + b, stale + c, digest + h
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
