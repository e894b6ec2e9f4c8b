"""The SIMD sphere tree: our tracer."""

from __future__ import annotations

import hashlib
import os
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxel.kernels import bundle, tree_build
from luxel.kernels.memory import lines
from luxel.kernels.simd import LANES
from luxel.kernels.tree import CHILDREN, LEAF, NODE, Tree
from luxel.trace.spheres import SphereSet

__all__ = ["SphereTree", "thread_count"]

# A batch below this many rays is not worth a second thread.
_RAYS_A_TASK = 16_384

_BUILD_LOCK = threading.Lock()
_PARTIAL_TREES_KEPT = 3  # a picture's, and those of two lights that are compared


def thread_count(threads: int | None) -> int:
    """Return `threads`, or as many as this process may use."""
    if threads is not None:
        return max(1, threads)
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1


class SphereTree:
    """A bounding volume hierarchy of sixteen-wide nodes over spheres of any radii (see ``kernels.tree_build``).

    Parameters
    ----------
    spheres
        In normalised units.
    threads
        For construction and for batches of rays; None means all that the process may use. Never changes a result.
    hidden
        (N,) bool: spheres that rays do not meet; None for none. All keep their ids.

    Attributes
    ----------
    arrays
        What kernels take.
    nbytes
        Memory of the tree.
    """

    def __init__(
        self,
        spheres: SphereSet,
        *,
        threads: int | None = None,
        hidden: NDArray[np.bool_] | None = None,
    ) -> None:
        self.spheres = spheres
        self.threads = thread_count(threads)
        count = len(spheres)
        order = np.arange(count) if hidden is None else np.flatnonzero(~hidden)
        self.arrays = _build(spheres.centers, spheres.radii, order.astype(np.int32), self.threads)

    @classmethod
    def of(cls, spheres: SphereSet, hidden: NDArray[np.bool_] | None = None) -> SphereTree:
        """Return the tree of `spheres` but the hidden ones; several threads may ask at once.

        The tree of all is built once for each `SphereSet`; of those with some hidden, the latest few are kept.
        """
        key = b"" if hidden is None else _digest(hidden)
        with _BUILD_LOCK:
            trees: dict[bytes, SphereTree] = spheres.derived.setdefault("trees", {})
            tree = trees.pop(key, None)
            if tree is None:
                tree = cls(spheres, hidden=hidden)
            trees[key] = tree
            for oldest in [each for each in trees if each][:-_PARTIAL_TREES_KEPT]:
                del trees[oldest]
            return tree

    @property
    def nbytes(self) -> int:
        """Bytes that the tree occupies beside the spheres themselves."""
        return int(self.arrays.nodes.nbytes + self.arrays.spheres.nbytes)

    def closest(
        self,
        origins: NDArray[np.float32],
        directions: NDArray[np.float32],
        limit: NDArray[np.float32] | float = 1e30,
        skip: NDArray[np.int32] | None = None,
    ) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        """Nearest hits of M rays, see :class:`luxel.trace.protocol.Tracer`."""
        return self._trace(origins, directions, limit, skip, any_hit=False)

    def occluded(
        self,
        origins: NDArray[np.float32],
        directions: NDArray[np.float32],
        limit: NDArray[np.float32] | float = 1e30,
        skip: NDArray[np.int32] | None = None,
    ) -> NDArray[np.bool_]:
        """Whether each of M rays meets a sphere, see :class:`luxel.trace.protocol.Tracer`."""
        return self._trace(origins, directions, limit, skip, any_hit=True)[1] >= 0

    def _trace(
        self, origins: Any, directions: Any, limit: Any, skip: Any, *, any_hit: bool
    ) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        origins = np.ascontiguousarray(origins, dtype=np.float32)
        directions = np.ascontiguousarray(directions, dtype=np.float32)
        count = len(origins)
        limits = np.ascontiguousarray(np.broadcast_to(np.asarray(limit, np.float32), (count,)))
        skips = np.full(count, -1, np.int32) if skip is None else np.ascontiguousarray(skip, dtype=np.int32)
        distance, ids = np.empty(count, np.float32), np.empty(count, np.int32)

        def run(part: slice) -> None:
            bundle.trace_rays(
                self.arrays,
                origins[part],
                directions[part],
                limits[part],
                skips[part],
                any_hit,
                distance[part],
                ids[part],
            )

        run_parts(run, [slice(k, k + _RAYS_A_TASK) for k in range(0, count, _RAYS_A_TASK)], self.threads)
        return distance, ids


def run_parts(work: Callable[[Any], Any], parts: Iterable[Any], threads: int) -> None:
    """Call `work` on every part, on `threads` threads when there are several parts; re-raises the first error."""
    todo = list(parts)
    if threads <= 1 or len(todo) <= 1:
        for part in todo:
            work(part)
        return
    pool = ThreadPoolExecutor(min(threads, len(todo)))
    try:
        for result in [pool.submit(work, part) for part in todo]:
            result.result()
    finally:  # after Ctrl-C or an error, only what is under way is waited for
        pool.shutdown(wait=True, cancel_futures=True)


def _digest(hidden: NDArray[np.bool_]) -> bytes:
    return hashlib.blake2b(np.packbits(hidden).tobytes(), digest_size=16).digest()


def _build(
    centers: NDArray[np.float32], radii: NDArray[np.float32], order: NDArray[np.int32], threads: int
) -> Tree:
    count = len(order)
    if count == 0:
        return _empty()
    top = 2 * count
    slots = top + 8192
    boxes = np.empty((slots, 6), np.float32)
    left, right, begin, end, depth = (np.empty(slots, np.int32) for _ in range(5))
    links = (boxes, left, right, begin, end, depth)
    # The cut into tasks depends on the data alone, so the tree is the same for any number of threads.
    task_size = max(count // 12, 4 * LANES)
    used = tree_build.build_subtree(centers, radii, order, 0, count, top, 0, task_size, *links)
    tasks = top + np.flatnonzero(left[top : top + used] == tree_build.OPEN)
    leaves = np.empty(slots, np.int32)

    def grow(node: int) -> None:
        root = 2 * int(begin[node])
        boxes[root] = boxes[node]
        size = tree_build.build_subtree(
            centers, radii, order, int(begin[node]), int(end[node]), root, int(depth[node]), 0, *links
        )
        tree_build.count_leaves(left, right, root, root + size, leaves)
        for array in (left, right, leaves):
            array[node] = array[root]

    run_parts(grow, sorted((int(t) for t in tasks), key=lambda t: int(begin[t] - end[t])), threads)
    _count_top(left, right, leaves, top, used, {int(t) for t in tasks})
    leaf_capacity = int(leaves[top])
    node_capacity = leaf_capacity + 1
    nodes, child = (
        np.empty((node_capacity, 6 * LANES), np.float32),
        np.empty((node_capacity, LANES), np.int32),
    )
    leaf_begin, leaf_end = np.empty(leaf_capacity, np.int32), np.empty(leaf_capacity, np.int32)
    node_count, leaf_count, levels = tree_build.collapse(
        boxes, left, right, begin, end, leaves, top, nodes, child, leaf_begin, leaf_end
    )
    leaf_data = lines((leaf_count, LEAF))
    leaf_ids = leaf_data.view(np.int32)
    chunk = max(1024, -(-leaf_count // (4 * threads)))
    run_parts(
        lambda k: tree_build.fill_leaves(
            centers, radii, order, leaf_begin, leaf_end, k, min(k + chunk, leaf_count), leaf_data, leaf_ids
        ),
        range(0, leaf_count, chunk),
        threads,
    )
    packed = lines((node_count, NODE))
    packed[:, :CHILDREN] = nodes[:node_count]
    packed[:, CHILDREN:] = child[:node_count].view(np.float32)
    packed_nodes = packed.reshape(-1)
    packed_leaves = leaf_data.reshape(-1)
    return Tree(
        packed_nodes,
        packed_nodes.view(np.int32),
        packed_leaves,
        packed_leaves.view(np.int32),
        (LANES - 1) * levels + LANES,
    )


def _empty() -> Tree:
    """Return a tree that no ray meets: one node of empty boxes."""
    node = np.zeros(NODE, np.float32)
    node[: 3 * LANES], node[3 * LANES : 6 * LANES] = 1e30, -1e30
    leaf = np.zeros(LEAF, np.float32)
    return Tree(node, node.view(np.int32), leaf, leaf.view(np.int32), LANES)


def _count_top(left: Any, right: Any, leaves: Any, top: int, used: int, tasks: set[int]) -> None:
    for node in range(top + used - 1, top - 1, -1):
        if node not in tasks:
            leaves[node] = leaves[left[node]] + leaves[right[node]] if left[node] >= 0 else 1
