"""Sphere tree, single rays: nearest hit and occlusion, sixteen boxes or spheres at a time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels.blockers import Blockers, blockers_scratch
from luxel.kernels.jit import kernel
from luxel.kernels.memory import float_lines, prefetch
from luxel.kernels.simd import (
    LANES,
    any_lane,
    bits,
    fma,
    lane_min,
    load,
    popcount,
    splat,
    store,
    trailing_zeros,
    vmax,
    vmin,
)
from luxel.kernels.tree import CHILDREN, IDS, LEAF, MISS, NODE, entries, meet_leaf

__all__ = ["Scratch", "ask_for", "find", "occluded", "scratch", "trace"]

_TINY = np.float32(1e-12)
_FAR = np.float32(1e30)


class Scratch(NamedTuple):
    """Working memory of one thread."""

    node: np.ndarray
    near: np.ndarray
    lanes: np.ndarray
    blockers: Blockers


@kernel
def scratch(stack_size):
    """Allocate working memory for one thread's rays."""
    return Scratch(
        np.empty(stack_size, np.int32),
        np.empty(stack_size, np.float32),
        float_lines(8 * LANES),
        blockers_scratch(),
    )


@kernel(inline=True, borrows=True)
def ask_for(nodes, spheres, link):
    """Ask for the memory of a node or leaf that is put on the stack."""
    if link < 0:
        for line in range(0, LEAF, LANES):
            prefetch(spheres, 4 * (~link * LEAF + line))
    else:
        for line in range(0, NODE, LANES):
            prefetch(nodes, 4 * (link * NODE + line))


@kernel(borrows=True)
def trace(tree, work, ox, oy, oz, dx, dy, dz, limit, skip, any_hit):
    """Follow one ray from (ox, oy, oz) along the unit vector (dx, dy, dz) for at most `limit`.

    Returns (distance, particle id), id -1 for a miss. A ray that starts inside a sphere hits it at distance 0.
    Sphere `skip` is left out: a ray leaving a convex surface never meets it again. With `any_hit`, the first
    sphere found will do and the distance means nothing.
    """
    distance, hit = find(tree, work, ox, oy, oz, dx, dy, dz, limit, skip, any_hit)
    return distance, tree.ids[hit] if hit >= 0 else np.int32(MISS)


@kernel(borrows=True, inner=True)
def find(tree, work, ox, oy, oz, dx, dy, dz, limit, skip, any_hit):
    """As `trace`, with the word that holds the particle's id instead of the id."""
    nodes, child, spheres = tree.nodes, tree.child, tree.spheres
    stack, near, lanes = work.node, work.near, work.lanes
    one = np.float32(1)
    ix = one / (dx if abs(dx) > _TINY else _TINY)
    iy = one / (dy if abs(dy) > _TINY else _TINY)
    iz = one / (dz if abs(dz) > _TINY else _TINY)
    near_x = 0 if ix >= 0 else 3 * LANES
    near_y = LANES if iy >= 0 else 4 * LANES
    near_z = 2 * LANES if iz >= 0 else 5 * LANES
    far_x, far_y, far_z = 3 * LANES - near_x, 5 * LANES - near_y, 7 * LANES - near_z
    vix, viy, viz = splat(ix), splat(iy), splat(iz)
    vox, voy, voz = splat(-ox * ix), splat(-oy * iy), splat(-oz * iz)
    zero = splat(np.float32(0))
    limit = min(limit, _FAR)
    hit = MISS
    height = 0
    current = 0
    while True:
        if current >= 0:
            o = current * NODE
            enter = vmax(
                vmax(fma(load(nodes, o + near_x), vix, vox), fma(load(nodes, o + near_y), viy, voy)),
                vmax(fma(load(nodes, o + near_z), viz, voz), zero),
            )
            leave = vmin(
                vmin(fma(load(nodes, o + far_x), vix, vox), fma(load(nodes, o + far_y), viy, voy)),
                vmin(fma(load(nodes, o + far_z), viz, voz), splat(limit)),
            )
            m = bits(enter <= leave)
            if m != 0:
                base = o + CHILDREN
                if m & (m - 1) == 0:
                    current = child[base + trailing_zeros(m)]
                    continue
                store(lanes, 0, enter)
                rest = m
                while rest != 0:  # nearest on top; by rank, since a sort's branches cannot be predicted
                    k = trailing_zeros(rest)
                    rest &= rest - 1
                    t = lanes[k]
                    farther = bits(enter > t) & m
                    level = bits(enter >= t) & m & ~farther & ((1 << k) - 1)
                    j = height + popcount(farther) + popcount(level)
                    link = child[base + k]
                    stack[j], near[j] = link, t
                    ask_for(nodes, spheres, link)
                height += popcount(m) - 1
                current = stack[height]
                continue
        else:
            o = ~current * LEAF
            hits, b, disc = meet_leaf(tree, o, ox, oy, oz, dx, dy, dz, limit, skip)
            if any_lane(hits):
                if any_hit:
                    return np.float32(0), o + IDS + trailing_zeros(bits(hits))
                t = entries(hits, b, disc)
                limit = lane_min(t)
                hit = o + IDS + trailing_zeros(bits(t <= limit))
        while True:
            height -= 1
            if height < 0:
                return limit, hit
            if near[height] < limit:
                break
        current = stack[height]


@kernel(borrows=True)
def occluded(tree, work, ox, oy, oz, dx, dy, dz, limit, skip):
    """Whether any sphere but `skip` meets the ray before `limit`."""
    return trace(tree, work, ox, oy, oz, dx, dy, dz, limit, skip, True)[1] >= 0
