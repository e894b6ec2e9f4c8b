"""Sphere tree: the arrays that hold it, and which spheres of a leaf a ray meets."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.simd import LANES, fma, fnma, load, select, splat, splat_int, vmax, vsqrt

__all__ = ["CHILDREN", "IDS", "LEAF", "MISS", "NODE", "Tree", "entries", "meet_leaf"]

MISS = -1
# Words of a node and of a leaf, and where the integers start: what is read together lies together.
NODE, CHILDREN = 7 * LANES, 6 * LANES
LEAF, IDS = 5 * LANES, 4 * LANES
# A sphere that a ray is about to leave does not block it: coincident and just-touching spheres stay lit.
_EXIT_TOLERANCE = np.float32(1e-8)  # (1e-4 radii)²
_INSIDE = np.float32(2e-4)  # of r²: what starts so far below the surface leaves 1e-4 radii on at the earliest
_FAR = np.float32(1e30)


class Tree(NamedTuple):
    """The arrays of a sphere tree, flat, as kernels take them (see ``tree_build``)."""

    nodes: np.ndarray  # float32, NODE words a node: boxes of its children, then their indices
    child: np.ndarray  # int32 view of the same memory
    spheres: np.ndarray  # float32, LEAF words a leaf: x, y, z, r², then particle ids
    ids: np.ndarray  # int32 view of the same memory
    stack_size: int


@kernel(inline=True, borrows=True)
def meet_leaf(tree, o, ox, oy, oz, dx, dy, dz, limit, skip):
    """Which spheres of the leaf at word `o` a ray meets, and for :func:`entries` where the middles of its chords are, and half their squares.

    Said without a root, which takes as long as all else.
    """
    spheres, ids = tree.spheres, tree.ids
    zero = splat(np.float32(0))
    cx, cy, cz = load(spheres, o) - ox, load(spheres, o + LANES) - oy, load(spheres, o + 2 * LANES) - oz
    vdx, vdy, vdz = splat(dx), splat(dy), splat(dz)
    r2 = load(spheres, o + 3 * LANES)
    b = fma(cx, vdx, fma(cy, vdy, cz * vdz))
    # Distance of the ray's line to the centre first: no cancellation for far spheres.
    px, py, pz = fnma(b, vdx, cx), fnma(b, vdy, cy), fnma(b, vdz, cz)
    disc = fnma(px, px, fnma(py, py, fnma(pz, pz, r2)))
    b2, past = b * b, b - splat(limit)
    ahead = (b > zero) & (vmax(b2, disc) > r2 * _EXIT_TOLERANCE)
    inside = disc > fma(r2, splat(_INSIDE), b2)
    hits = (ahead | inside) & (past * vmax(past, zero) < disc)
    return hits & (load(ids, o + IDS) != splat_int(skip)), b, disc


@kernel(inline=True, borrows=True)
def entries(hits, b, disc):
    """Where a ray enters the spheres that it meets; far away for others."""
    zero = splat(np.float32(0))
    return select(hits, vmax(b - vsqrt(vmax(disc, zero)), zero), splat(_FAR))
