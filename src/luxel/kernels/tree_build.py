"""Sphere tree, construction: binned-SAH binary tree, collapsed to nodes of sixteen children and leaves of up to sixteen spheres.

The SAH counts a leaf's cost in SIMD blocks, since sixteen spheres cost as much as one. Binary nodes of the range
[first, last) live in slots 2·first …, so that subtrees are built by any number of threads with one result.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.simd import LANES

__all__ = ["LEAF", "OPEN", "build_subtree", "collapse", "count_leaves", "fill_leaves"]

LEAF = -1
OPEN = -2  # a range left for another task
BINS = 16
# Deeper than this, ranges are halved: positions that crowd exponentially cannot make the stack overflow.
_MEDIAN_DEPTH = 64
_BIG = np.float32(3e38)


class _Work(NamedTuple):
    bins: np.ndarray
    counts: np.ndarray
    right_cost: np.ndarray


@kernel
def _bound(centers, radii, order, first, last, box, inner):
    """Write the bounds of the spheres of a range to `box` and those of their centres to `inner` (6,)."""
    for a in range(3):
        box[a] = inner[a] = _BIG
        box[3 + a] = inner[3 + a] = -_BIG
    for k in range(first, last):
        i = order[k]
        r = radii[i]
        for a in range(3):
            v = centers[i, a]
            inner[a], inner[3 + a] = min(inner[a], v), max(inner[3 + a], v)
            box[a], box[3 + a] = min(box[a], v - r), max(box[3 + a], v + r)


@kernel(inline=True)
def _half_area(box):
    x, y, z = box[3] - box[0], box[4] - box[1], box[5] - box[2]
    return x * y + y * z + z * x


@kernel(inline=True)
def _grow(box, other):
    for a in range(3):
        box[a], box[3 + a] = min(box[a], other[a]), max(box[3 + a], other[3 + a])


@kernel(inline=True)
def _clear(box):
    for a in range(3):
        box[a], box[3 + a] = _BIG, -_BIG


@kernel(inline=True)
def _bin(v, start, scale):
    return min(BINS - 1, max(0, int((v - start) * scale)))


@kernel
def _cut(centers, radii, order, first, last, bounds, work, left_box, right_box):
    """Partition a range at the cheapest of fifteen planes across `bounds`; return where the right part starts, or -1.

    The children's boxes fall out of the bins, which saves a pass over the spheres at every level.
    """
    bins, counts, right_cost = work.bins, work.counts, work.right_cost
    axis = 0
    for a in range(1, 3):
        if bounds[3 + a] - bounds[a] > bounds[3 + axis] - bounds[axis]:
            axis = a
    start = bounds[axis]
    width = bounds[3 + axis] - start
    if not width > 0:
        return -1
    scale = np.float32(BINS) / width
    if not scale < _BIG:
        return -1
    for b in range(BINS):
        counts[b] = 0
        _clear(bins[b])
    for k in range(first, last):
        i = order[k]
        b = _bin(centers[i, axis], start, scale)
        r = radii[i]
        counts[b] += 1
        for a in range(3):
            v = centers[i, a]
            bins[b, a] = min(bins[b, a], v - r)
            bins[b, 3 + a] = max(bins[b, 3 + a], v + r)
    count = last - first
    total = 0
    _clear(right_box)
    for b in range(BINS - 1, 0, -1):
        _grow(right_box, bins[b])
        total += counts[b]
        right_cost[b] = (
            _half_area(right_box) * np.float32((total + LANES - 1) // LANES) if total > 0 else np.float32(0)
        )
    total = 0
    _clear(left_box)
    best, cut = _BIG, -1
    for b in range(BINS - 1):
        _grow(left_box, bins[b])
        total += counts[b]
        if total == 0 or total == count:
            continue
        cost = _half_area(left_box) * np.float32((total + LANES - 1) // LANES) + right_cost[b + 1]
        if cost < best:
            best, cut = cost, b
    if cut < 0:
        return -1
    _clear(left_box)
    _clear(right_box)
    for b in range(BINS):
        _grow(left_box if b <= cut else right_box, bins[b])
    low, high = first, last - 1
    while True:
        while low <= high and _bin(centers[order[low], axis], start, scale) <= cut:
            low += 1
        while low <= high and _bin(centers[order[high], axis], start, scale) > cut:
            high -= 1
        if low >= high:
            break
        order[low], order[high] = order[high], order[low]
        low += 1
        high -= 1
    return low


@kernel
def build_subtree(
    centers, radii, order, first, last, root, start_depth, task_size, boxes, left, right, begin, end, depth
):
    """Build the binary tree of [first, last) at slot `root`; ranges of at most `task_size` stay OPEN (0: none).

    A depth of 0 means that the root's box is not known yet. Returns the number of slots used.
    """
    work = _Work(np.empty((BINS, 6), np.float32), np.empty(BINS, np.int32), np.empty(BINS, np.float32))
    inner = np.empty(6, np.float32)
    stack = np.empty(_MEDIAN_DEPTH + 70, np.int64)
    begin[root], end[root], depth[root] = first, last, start_depth
    if start_depth == 0:
        _bound(centers, radii, order, first, last, boxes[root], inner)
    stack[0] = root
    height, used = 1, 1
    while height > 0:
        height -= 1
        node = stack[height]
        s, e = begin[node], end[node]
        if e - s <= LANES:
            left[node] = LEAF
            continue
        if task_size > 0 and e - s <= task_size:
            left[node] = OPEN
            continue
        a, b = root + used, root + used + 1
        used += 2
        middle = -1
        if depth[node] < _MEDIAN_DEPTH:
            middle = _cut(centers, radii, order, s, e, boxes[node], work, boxes[a], boxes[b])
            if middle < 0:  # one huge sphere can hide the spread of the centres: look at those alone
                _bound(centers, radii, order, s, e, boxes[node], inner)
                middle = _cut(centers, radii, order, s, e, inner, work, boxes[a], boxes[b])
        if middle < 0:  # coincident, or crowded beyond reason
            middle = (s + e) // 2
            _bound(centers, radii, order, s, middle, boxes[a], inner)
            _bound(centers, radii, order, middle, e, boxes[b], inner)
        left[node], right[node] = a, b
        begin[a], end[a], depth[a] = s, middle, depth[node] + 1
        begin[b], end[b], depth[b] = middle, e, depth[node] + 1
        stack[height], stack[height + 1] = a, b
        height += 2
    return used


@kernel
def count_leaves(left, right, low, high, leaves):
    """Write the number of leaves below each binary node in slots [low, high); children have higher slots."""
    for node in range(high - 1, low - 1, -1):
        if left[node] >= 0:
            leaves[node] = leaves[left[node]] + leaves[right[node]]
        elif left[node] == LEAF:
            leaves[node] = 1


@kernel
def collapse(boxes, left, right, begin, end, leaves, root, nodes, child, leaf_begin, leaf_end):
    """Turn the binary tree into sixteen-wide nodes; return (nodes used, leaves used, depth).

    A node's children are opened by leaf count towards full bottom nodes, then small ones that fit entirely.
    Row k of `nodes` holds low x, y, z and high x, y, z of its children, sixteen each; unused lanes are empty boxes.
    `child` is the index of an inner node, or ~leaf.
    """
    source = np.empty(nodes.shape[0], np.int64)
    level = np.empty(nodes.shape[0], np.int32)
    open_nodes = np.empty(LANES, np.int64)
    source[0], level[0] = root, 1
    used, leaf_count, k, depth = 1, 0, 0, 1
    while k < used:
        top = source[k]
        depth = max(depth, level[k])
        open_nodes[0] = top
        count = 1
        full = 1
        while full * LANES < leaves[top]:
            full *= LANES
        while count < LANES:
            pick, most = -1, full
            for q in range(count):
                c = open_nodes[q]
                if left[c] >= 0 and leaves[c] > most:
                    pick, most = q, leaves[c]
            if pick < 0:
                largest = np.float32(-1)
                for q in range(count):
                    c = open_nodes[q]
                    if left[c] >= 0 and leaves[c] - 1 <= LANES - count:
                        ex, ey, ez = (
                            boxes[c, 3] - boxes[c, 0],
                            boxes[c, 4] - boxes[c, 1],
                            boxes[c, 5] - boxes[c, 2],
                        )
                        area = ex * ey + ey * ez + ez * ex
                        if area > largest:
                            largest, pick = area, q
            if pick < 0:
                break
            c = open_nodes[pick]
            open_nodes[pick], open_nodes[count] = left[c], right[c]
            count += 1
        for q in range(LANES):
            if q < count:
                c = open_nodes[q]
                for a in range(6):
                    nodes[k, a * LANES + q] = boxes[c, a]
                if left[c] >= 0:
                    child[k, q] = used
                    source[used], level[used] = c, level[k] + 1
                    used += 1
                else:
                    child[k, q] = ~leaf_count
                    leaf_begin[leaf_count], leaf_end[leaf_count] = begin[c], end[c]
                    leaf_count += 1
            else:
                for a in range(3):
                    nodes[k, a * LANES + q] = np.float32(1e30)
                    nodes[k, (3 + a) * LANES + q] = np.float32(-1e30)
                child[k, q] = 0
        k += 1
    return used, leaf_count, depth


@kernel
def fill_leaves(centers, radii, order, leaf_begin, leaf_end, low, high, spheres, ids):
    """Write leaves [low, high): x, y, z, r² and, through the int32 view `ids`, particle ids; sixteen each, -1 if unused."""
    for leaf in range(low, high):
        first, count = leaf_begin[leaf], leaf_end[leaf] - leaf_begin[leaf]
        for q in range(LANES):
            if q < count:
                i = order[first + q]
                for a in range(3):
                    spheres[leaf, a * LANES + q] = centers[i, a]
                spheres[leaf, 3 * LANES + q] = radii[i] * radii[i]
                ids[leaf, 4 * LANES + q] = i
            else:
                for a in range(3):
                    spheres[leaf, a * LANES + q] = np.float32(1e15)
                spheres[leaf, 3 * LANES + q] = np.float32(-1)
                ids[leaf, 4 * LANES + q] = -1
