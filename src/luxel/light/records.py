"""The records of a scene, made when they are first asked for."""

from __future__ import annotations

import threading

import numpy as np
from numpy.typing import NDArray

from luxel.kernels import records as kernels
from luxel.kernels.path import World
from luxel.kernels.rays import RayTable
from luxel.light.ray_sets import make_ray_table

__all__ = ["RecordBook"]

_ROWS, _COLUMNS = 4, 8  # of the cells that a record's rays start from
_SETS = 256


class RecordBook:
    """Coarse light on the particles of one world; 54 bytes a particle. Safe to share between threads.

    A record depends on its particle alone: two threads that make it at once write the same.
    """

    def __init__(self, world: World) -> None:
        count = len(world.radii)
        self._world = world
        self._table: RayTable | None = None
        self._lock = threading.Lock()
        self._known = np.zeros(count, np.bool_)
        self._arrays = _records(count)

    def having(self, ids: NDArray[np.int32]) -> kernels.Records:
        """Return all records, those of `ids` (any shape, negative for none) made if need be."""
        wanted = np.unique(ids[ids >= 0])
        with self._lock:
            missing = wanted[~self._known[wanted]]
            if self._table is None:
                self._table = make_ray_table(
                    "latlong", (_ROWS, _COLUMNS), 1, self._world.lights.suns, sets=_SETS
                )
        if len(missing):
            made = _records(len(missing))
            kernels.make_records(self._world, self._table, missing, made)
            with self._lock:
                for mine, new in zip(self._arrays, made, strict=True):
                    mine[missing] = new
                self._known[missing] = True
        return self._arrays

    def first_light(self, ids: NDArray[np.int32]) -> NDArray[np.float32]:
        """Return (K, 4) float32: luminance towards unit normal n is about max(0, c0 + c1 nx + c2 ny + c3 nz), c0 >= 0."""
        found = self.having(ids).whole[ids]
        found[:, 0] = np.maximum(found[:, 0], 0.0)
        return found


def _records(count: int) -> kernels.Records:
    return kernels.Records(
        np.zeros((count, 4), np.float32), np.zeros((count, 9), np.float32), np.zeros(count, np.bool_)
    )
