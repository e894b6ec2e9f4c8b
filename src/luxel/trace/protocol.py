"""What light and pictures ask of a tracer."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from luxel.trace.spheres import SphereSet

__all__ = ["Tracer"]


class Tracer(Protocol):
    """Rays to nearest spheres, in normalised units."""

    spheres: SphereSet

    def closest(
        self,
        origins: NDArray[np.float32],
        directions: NDArray[np.float32],
        limit: NDArray[np.float32] | float = 1e30,
        skip: NDArray[np.int32] | None = None,
    ) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        """Nearest hits of M rays.

        Parameters
        ----------
        origins, directions
            (M, 3) float32; directions of unit length.
        limit
            Hits at or beyond this distance do not count; (M,) or one number.
        skip
            (M,) int32: the sphere that each ray leaves and cannot meet, -1 for none.

        Returns
        -------
        distance, id
            (M,) float32, infinite for a miss, 0 for a ray that starts inside a sphere; (M,) int32, -1 for a miss.
        """
        ...

    def occluded(
        self,
        origins: NDArray[np.float32],
        directions: NDArray[np.float32],
        limit: NDArray[np.float32] | float = 1e30,
        skip: NDArray[np.int32] | None = None,
    ) -> NDArray[np.bool_]:
        """Whether any sphere lies within `limit`, (M,) bool."""
        ...
