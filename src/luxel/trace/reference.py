"""The plain tracer: every ray against every sphere in float64 NumPy. Slow, obvious, the truth that tests compare with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from luxel.trace.spheres import SphereSet

__all__ = ["ReferenceTracer"]

_PAIRS_AT_ONCE = 4_000_000
_EXIT_TOLERANCE = 1e-4  # of a radius, as in the tree


class ReferenceTracer:
    """Implements :class:`luxel.trace.protocol.Tracer` by exhaustive search.

    Parameters
    ----------
    spheres
        In normalised units.
    """

    def __init__(self, spheres: SphereSet) -> None:
        self.spheres = spheres

    def closest(
        self,
        origins: NDArray[np.float32],
        directions: NDArray[np.float32],
        limit: NDArray[np.float32] | float = 1e30,
        skip: NDArray[np.int32] | None = None,
    ) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        """Nearest hits of M rays, see :class:`luxel.trace.protocol.Tracer`."""
        count = len(origins)
        limits = np.broadcast_to(np.asarray(limit, np.float64), (count,))
        skips = np.full(count, -1) if skip is None else np.asarray(skip)
        distance, ids = np.empty(count, np.float32), np.empty(count, np.int32)
        block = max(1, _PAIRS_AT_ONCE // len(self.spheres))
        for start in range(0, count, block):
            part = slice(start, start + block)
            t = self._distances(np.asarray(origins[part]), np.asarray(directions[part]), skips[part])
            t[t >= limits[part, None]] = np.inf
            nearest = t.argmin(axis=1)
            distance[part] = t[np.arange(len(t)), nearest]
            ids[part] = np.where(np.isfinite(distance[part]), nearest, -1)
        return distance, ids

    def occluded(
        self,
        origins: NDArray[np.float32],
        directions: NDArray[np.float32],
        limit: NDArray[np.float32] | float = 1e30,
        skip: NDArray[np.int32] | None = None,
    ) -> NDArray[np.bool_]:
        """Whether each of M rays meets a sphere, see :class:`luxel.trace.protocol.Tracer`."""
        return self.closest(origins, directions, limit, skip)[1] >= 0

    def _distances(
        self, origins: NDArray[np.float32], directions: NDArray[np.float32], skip: NDArray[np.int32]
    ) -> NDArray[np.float64]:
        """(M, N) float64 distances, infinite where a ray misses."""
        offset = self.spheres.centers[None].astype(np.float64) - origins[:, None].astype(np.float64)
        along = np.einsum("mnk,mk->mn", offset, directions.astype(np.float64))
        across = offset - along[..., None] * directions[:, None].astype(np.float64)
        radii = self.spheres.radii.astype(np.float64)
        disc = radii**2 - np.einsum("mnk,mnk->mn", across, across)
        root = np.sqrt(np.maximum(disc, 0.0))
        hit = (disc >= 0) & (along + root > _EXIT_TOLERANCE * radii)
        rows = np.flatnonzero(skip >= 0)
        hit[rows, skip[rows]] = False
        return np.where(hit, np.maximum(along - root, 0.0), np.inf)
