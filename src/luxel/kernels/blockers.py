"""What has blocked rays like this one, looked at before the tree is.

Rays of a particle that leave its near field at about the same place in about the same direction are mostly blocked by the same few
spheres. So each kind of them has a leaf of its own, with the last sixteen spheres that have blocked one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.memory import float_lines, index
from luxel.kernels.simd import LANES, any_lane, splat, store
from luxel.kernels.tree import IDS, LEAF, meet_leaf

__all__ = ["KINDS", "Blockers", "blocked_again", "blockers_scratch", "forget", "note_blocker", "ray_kind"]

_SIDE = 4
#: Kinds of rays: cells of a cube.
KINDS = _SIDE * _SIDE * _SIDE
_COUNTS = KINDS * LEAF
_ONE, _NO_SPHERE = np.float32(1), np.float32(-1e30)
_HALF_A_SIDE, _MIDDLE = np.float32(0.2499 * _SIDE), np.float32(0.5 * _SIDE)


class Blockers(NamedTuple):
    """Spheres that have blocked rays; working memory of one thread."""

    spheres: np.ndarray  # float32, a leaf of a tree for every kind
    ids: np.ndarray  # int32 view of the same memory; behind all leaves, how many spheres each has been given


@kernel(inner=True)
def blockers_scratch():
    """Allocate; there are none yet."""
    spheres = float_lines(_COUNTS + KINDS)
    blockers = Blockers(spheres, spheres.view(np.int32))
    forget(blockers)
    return blockers


@kernel(inline=True, borrows=True)
def forget(blockers):
    """Forget all of them."""
    for kind in range(KINDS):
        store(blockers.spheres, kind * LEAF + 3 * LANES, splat(_NO_SPHERE))
        blockers.ids[_COUNTS + kind] = 0


@kernel(inline=True, borrows=True)
def ray_kind(x, y, z, reach, dx, dy, dz):
    """Tell rays apart by their directions and by where within `reach` of the origin they leave: one of `KINDS`."""
    scale = _HALF_A_SIDE / reach
    a = int(scale * x + _HALF_A_SIDE * dx + _MIDDLE)
    b = int(scale * y + _HALF_A_SIDE * dy + _MIDDLE)
    c = int(scale * z + _HALF_A_SIDE * dz + _MIDDLE)
    return (_cell(a) * _SIDE + _cell(b)) * _SIDE + _cell(c)


@kernel(inline=True, borrows=True)
def _cell(a):
    return min(max(a, 0), _SIDE - 1)


@kernel(inline=True, borrows=True)
def blocked_again(blockers, kind, x, y, z, dx, dy, dz, limit, skip):
    """Whether a sphere, but not `skip`, that has blocked a ray of this kind blocks this one, too; see ``tree_trace.trace``."""
    hits, _, _ = meet_leaf(blockers, index(kind) * LEAF, x, y, z, dx, dy, dz, limit, skip)
    return any_lane(hits)


@kernel(inline=True, borrows=True)
def note_blocker(blockers, kind, tree, word):
    """Note that the sphere whose first number is a word of the tree's leaves has blocked a ray of this kind."""
    kind, word = index(kind), index(word)
    seen = index(blockers.ids[_COUNTS + kind])
    blockers.ids[_COUNTS + kind] = seen + 1
    to = kind * LEAF + seen % LANES
    for line in range(0, IDS, LANES):
        blockers.spheres[to + line] = tree.spheres[word + line]
    blockers.ids[to + IDS] = tree.ids[word + IDS]
