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
    """Coarse light on the particles of one world; 53 bytes a particle. Safe to share between threads.

    A record depends on its particle alone: two threads that make it at once write the same.
    """

    def __init__(self, world: World) -> None:
        count = len(world.radii)
        self._world = world
        self._table: RayTable | None = None
        self._lock = threading.Lock()
        self._known = np.zeros(count, np.bool_)
        self._arrays = kernels.Records(np.zeros((count, 4), np.float32), np.zeros((count, 9), np.float32))

    def having(self, ids: NDArray[np.int32]) -> kernels.Records:
        """Return all records, those of `ids` (any shape, negative for none) made if need be."""
        wanted = np.unique(ids[ids >= 0])
        with self._lock:
            missing = wanted[~self._known[wanted]]
            if self._table is None:
                self._table = make_ray_table("latlong", (_ROWS, _COLUMNS), 1, self._world.lights.suns, sets=_SETS)
        if len(missing):
            direct, rest = np.empty((len(missing), 4), np.float32), np.empty((len(missing), 9), np.float32)
            kernels.make_records(self._world, self._table, missing, direct, rest)
            with self._lock:
                self._arrays.direct[missing], self._arrays.rest[missing] = direct, rest
                self._known[missing] = True
        return self._arrays

    def first_light(self, ids: NDArray[np.int32]) -> NDArray[np.float32]:
        """Return (K, 4) float32: luminance towards unit normal n is about max(0, c0 + c1 nx + c2 ny + c3 nz), c0 >= 0."""
        arrays = self.having(ids)
        found = arrays.direct[ids] + arrays.rest[ids, :4]
        found[:, 0] = np.maximum(found[:, 0], 0.0)
        return np.asarray(found, dtype=np.float32)
