"""Many rays through the tree, four of them under way at a time.

A ray alone mostly waits: for memory, for the nearest of sixteen boxes, for a branch to be told. So the processor is given four that do not depend on each other,
and each takes one step in turn; whoever is done is replaced. To have few branches that cannot be predicted, children are not sorted: a node that
a ray enters stays with the distances and a bit for each child that is left, and every step looks for the nearest of these anew.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels.blockers import blocked_again, note_blocker
from luxel.kernels.jit import kernel
from luxel.kernels.memory import float_lines, index, int_lines
from luxel.kernels.simd import (
    FAR,
    LANES,
    any_lane,
    bits,
    fma,
    lane_min,
    lane_number,
    load,
    mask_from_bits,
    select,
    splat,
    store,
    trailing_zeros,
    vmax,
    vmin,
    with_lane_numbers,
)
from luxel.kernels.tree import CHILDREN, IDS, LEAF, MISS, NODE, entries, meet_leaf
from luxel.kernels.tree_trace import find, scratch

__all__ = [
    "ROOM", "Bundle", "bundle_scratch", "first_met", "line_of", "meets", "put", "trace_bundle", "trace_rays", "whose",
]  # fmt: skip

#: Rays of a bundle.
ROOM = 256
_CREW, _FEW = 4, 12  # so many under way at once; fewer than those go one by one
_ZERO, _ONE = np.float32(0), np.float32(1)
_TINY = np.float32(1e-12)
# Instead of 0, whose bits with a lane's number among them would be a denormal: a thread that flushes those would lose it.
_HERE = np.float32(1e-30)
# Words of a ray: origin, direction, limit, and in the end the distance; what it is worth. Its integers: whom it leaves, its kind, in the end
# what it meets, sixteen to a leaf, and whose it is.
_RAY, _LIMIT, _WORTH = 8, 6, 7
_WORDS, _SKIP, _KIND, _MET, _WHO = 4, 0, 1, 2, 3
# Words of a ray under way: reciprocal direction, origin times that, negative. Its integers: words of the near sides of a node's boxes; where it
# goes next; frames on its stack; its number.
_REAL = 8
_WHOLE, _NEXT, _HEIGHT, _NUMBER = 8, 3, 4, 5
_IDLE = np.int32(-1)
# Where the crew's words begin, and where their frames do: where a ray enters the children of a node; bits of the children that are left, and the
# first word of their links.
_UNDER_WAY, _FRAMES = ROOM * _RAY, ROOM * _RAY + _CREW * _REAL
_NUMBERS, _LINKS = ROOM * _WORDS, ROOM * _WORDS + _CREW * _WHOLE


class Bundle(NamedTuple):
    """Rays that are to be traced together; working memory of one thread, in two arrays, since every array that a call hands on costs."""

    real: np.ndarray  # float32
    whole: np.ndarray  # int32


@kernel(inner=True)
def bundle_scratch(tree):
    """Allocate for rays through a tree."""
    frames = _CREW * (tree.stack_size // (LANES - 1) + 1)
    return Bundle(float_lines(_FRAMES + frames * LANES), int_lines(_LINKS + frames * 2))


@kernel(inline=True, borrows=True)
def put(bundle, k, who, worth, x, y, z, dx, dy, dz, limit, skip, kind):
    """Make ray k of a bundle, whose number and worth the caller gets back from :func:`whose`; see ``tree_trace.trace``.

    Where any hit will do, what has blocked rays of its `kind`, one of ``blockers.KINDS`` or MISS, is looked at first.
    """
    k = index(k)
    ray, o = bundle.real, k * _RAY
    ray[o], ray[o + 1], ray[o + 2] = x, y, z
    ray[o + 3], ray[o + 4], ray[o + 5] = dx, dy, dz
    # Nothing is farther than no child at all.
    ray[o + _LIMIT], ray[o + _WORTH] = min(limit, FAR), worth
    word, w = bundle.whole, k * _WORDS
    word[w + _SKIP], word[w + _KIND], word[w + _MET], word[w + _WHO] = skip, kind, MISS, who


@kernel(inline=True, borrows=True)
def whose(bundle, k):
    """Number and worth of ray k."""
    return bundle.whole[index(k) * _WORDS + _WHO], bundle.real[index(k) * _RAY + _WORTH]


@kernel(inline=True, borrows=True)
def line_of(bundle, k):
    """Origin and direction of ray k."""
    ray, o = bundle.real, index(k) * _RAY
    return ray[o], ray[o + 1], ray[o + 2], ray[o + 3], ray[o + 4], ray[o + 5]


@kernel(inline=True, borrows=True)
def first_met(bundle, tree, k):
    """Distance and particle that ray k has met; its limit and MISS for none."""
    met = np.int64(bundle.whole[k * _WORDS + _MET])
    particle = tree.ids[met // LANES * LEAF + IDS + met % LANES] if met >= 0 else np.int32(MISS)
    return bundle.real[k * _RAY + _LIMIT], particle


@kernel(inline=True, borrows=True)
def meets(bundle, k):
    """Whether ray k has met anything."""
    return bundle.whole[k * _WORDS + _MET] >= 0


@kernel(inline=True, borrows=True)
def _blocked_again(blockers, bundle, k):
    """Whether one of those that have blocked rays of its kind blocks ray k, which then is done."""
    whole, w = bundle.whole, index(k) * _WORDS
    kind = whole[w + _KIND]
    if kind < 0:
        return False
    x, y, z, dx, dy, dz = line_of(bundle, k)
    limit = bundle.real[index(k) * _RAY + _LIMIT]
    if not blocked_again(blockers, kind, x, y, z, dx, dy, dz, limit, whole[w + _SKIP]):
        return False
    whole[w + _MET] = 0
    return True


@kernel(inline=True, borrows=True)
def _note(tree, blockers, bundle, k):
    """Note what has blocked ray k, if anything."""
    met, kind = np.int64(bundle.whole[index(k) * _WORDS + _MET]), bundle.whole[index(k) * _WORDS + _KIND]
    if met >= 0 and kind >= 0:
        note_blocker(blockers, kind, tree, met // LANES * LEAF + met % LANES)


@kernel(borrows=True)
def _begin(tree, blockers, bundle, m, waiting, count, any_hit, frames):
    """Put the next ray on its way that is not done at once; return how many have been."""
    real, whole = bundle.real, bundle.whole
    a, b = _UNDER_WAY + m * _REAL, _NUMBERS + m * _WHOLE
    while waiting < count:
        k = index(waiting)
        waiting += 1
        if any_hit and _blocked_again(blockers, bundle, k):
            continue
        x, y, z, dx, dy, dz = line_of(bundle, k)
        ix = _ONE / (dx if abs(dx) > _TINY else _TINY)
        iy = _ONE / (dy if abs(dy) > _TINY else _TINY)
        iz = _ONE / (dz if abs(dz) > _TINY else _TINY)
        real[a], real[a + 1], real[a + 2] = ix, iy, iz
        real[a + 3], real[a + 4], real[a + 5] = -x * ix, -y * iy, -z * iz
        whole[b] = 0 if ix >= 0 else 3 * LANES
        whole[b + 1] = LANES if iy >= 0 else 4 * LANES
        whole[b + 2] = 2 * LANES if iz >= 0 else 5 * LANES
        whole[b + _NEXT], whole[b + _HEIGHT], whole[b + _NUMBER] = 0, m * frames, k
        return waiting
    whole[b + _NUMBER] = _IDLE
    return waiting


@kernel(inline=True, borrows=True)
def _step(tree, bundle, m, k, any_hit, floor):
    """Take ray k to the node or leaf where it goes next, and find out where it goes then; whether it is done."""
    nodes, child, real, whole = tree.nodes, tree.child, bundle.real, bundle.whole
    a, b = _UNDER_WAY + m * _REAL, _NUMBERS + m * _WHOLE
    q, w = index(k) * _RAY, index(k) * _WORDS
    now, height, limit = np.int64(whole[b + _NEXT]), index(whole[b + _HEIGHT]), real[q + _LIMIT]
    if now >= 0:
        near_x, near_y, near_z = np.int64(whole[b]), np.int64(whole[b + 1]), np.int64(whole[b + 2])
        ix, iy, iz = splat(real[a]), splat(real[a + 1]), splat(real[a + 2])
        ox, oy, oz = splat(real[a + 3]), splat(real[a + 4]), splat(real[a + 5])
        o = now * NODE
        enter = vmax(
            vmax(fma(load(nodes, o + near_x), ix, ox), fma(load(nodes, o + near_y), iy, oy)),
            vmax(fma(load(nodes, o + near_z), iz, oz), splat(_HERE)),
        )
        far_x, far_y, far_z = o + 3 * LANES - near_x, o + 5 * LANES - near_y, o + 7 * LANES - near_z
        leave = vmin(
            vmin(fma(load(nodes, far_x), ix, ox), fma(load(nodes, far_y), iy, oy)),
            vmin(fma(load(nodes, far_z), iz, oz), splat(limit)),
        )
        entered = bits(enter <= leave)
        # Distances that tell their lanes err by fifteen units in the last place: no more than boxes do by rounding.
        store(real, _FRAMES + height * LANES, with_lane_numbers(enter))
        whole[_LINKS + 2 * height], whole[_LINKS + 2 * height + 1] = entered, o + CHILDREN
        height += entered != 0
    else:
        o = ~now * LEAF
        x, y, z, dx, dy, dz = real[q], real[q + 1], real[q + 2], real[q + 3], real[q + 4], real[q + 5]
        hits, middle, disc = meet_leaf(tree, o, x, y, z, dx, dy, dz, limit, whole[w + _SKIP])
        if any_lane(hits):
            if any_hit:
                whole[w + _MET] = ~now * LANES + trailing_zeros(bits(hits))
                return True
            t = entries(hits, middle, disc)
            limit = lane_min(t)
            real[q + _LIMIT] = limit
            whole[w + _MET] = ~now * LANES + trailing_zeros(bits(t <= limit))
    while height > floor:
        top = index(height - 1)
        left = np.int64(whole[_LINKS + 2 * top])
        enter = load(real, _FRAMES + top * LANES)
        nearest = lane_min(select(mask_from_bits(left), enter, splat(FAR)))
        lane = lane_number(nearest)
        left &= ~(np.int64(1) << lane)
        whole[_LINKS + 2 * top] = left
        height -= left == 0
        if nearest < limit:
            whole[b + _NEXT] = child[index(whole[_LINKS + 2 * top + 1]) + lane]
            whole[b + _HEIGHT] = height
            return False
        height = top
    return True


@kernel(inline=True, borrows=True)
def _left(bundle, waiting, count):
    """How many rays are not done."""
    left = count - waiting
    for m in range(_CREW):
        left += bundle.whole[_NUMBERS + m * _WHOLE + _NUMBER] >= 0
    return left


@kernel(inline=True, borrows=True)
def _turn(tree, blockers, bundle, m, waiting, count, left, any_hit, frames):
    """Let one of the crew take a step; returns how many rays have been put on their way, and how many are not done."""
    k = np.int64(bundle.whole[_NUMBERS + m * _WHOLE + _NUMBER])
    if k >= 0 and _step(tree, bundle, m, k, any_hit, m * frames):
        if any_hit:
            _note(tree, blockers, bundle, k)
        waiting = _begin(tree, blockers, bundle, m, waiting, count, any_hit, frames)
        left = _left(bundle, waiting, count)
    return waiting, left


@kernel(borrows=True, inner=True)
def trace_bundle(tree, work, bundle, count, any_hit):
    """Trace the first `count` rays of a bundle, for :func:`first_met`; or, with `any_hit`, for :func:`meets` alone."""
    blockers = work.blockers
    if count < _FEW:
        for k in range(count):
            if not (any_hit and _blocked_again(blockers, bundle, k)):
                x, y, z, dx, dy, dz = line_of(bundle, k)
                limit, skip = bundle.real[k * _RAY + _LIMIT], bundle.whole[k * _WORDS + _SKIP]
                limit, word = find(tree, work, x, y, z, dx, dy, dz, limit, skip, any_hit)
                if word >= 0:
                    bundle.real[k * _RAY + _LIMIT] = limit
                    bundle.whole[k * _WORDS + _MET] = word // LEAF * LANES + word % LEAF - IDS
                    if any_hit:
                        _note(tree, blockers, bundle, k)
        return
    frames = tree.stack_size // (LANES - 1) + 1
    waiting = 0
    for m in range(_CREW):
        waiting = _begin(tree, blockers, bundle, m, waiting, count, any_hit, frames)
    left = _left(bundle, waiting, count)
    while left > 0:
        waiting, left = _turn(tree, blockers, bundle, 0, waiting, count, left, any_hit, frames)
        waiting, left = _turn(tree, blockers, bundle, 1, waiting, count, left, any_hit, frames)
        waiting, left = _turn(tree, blockers, bundle, 2, waiting, count, left, any_hit, frames)
        waiting, left = _turn(tree, blockers, bundle, 3, waiting, count, left, any_hit, frames)


@kernel
def trace_rays(tree, origins, directions, limit, skip, any_hit, distance, ids):
    """Trace (M, 3) rays; write distances (infinite for a miss) and particle ids (-1 for a miss)."""
    work, bundle = scratch(tree.stack_size), bundle_scratch(tree)
    for first in range(0, origins.shape[0], ROOM):
        count = min(ROOM, origins.shape[0] - first)
        for j in range(count):
            k = first + j
            x, y, z = origins[k, 0], origins[k, 1], origins[k, 2]
            dx, dy, dz = directions[k, 0], directions[k, 1], directions[k, 2]
            put(bundle, j, k, _ZERO, x, y, z, dx, dy, dz, limit[k], skip[k], MISS)
        trace_bundle(tree, work, bundle, count, any_hit)
        for j in range(count):
            t, i = first_met(bundle, tree, j)
            distance[first + j], ids[first + j] = t if i >= 0 else np.float32(np.inf), i
