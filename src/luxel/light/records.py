"""Coarse records of the light on particles, made when they are first asked for: what is shown until textures come."""

from __future__ import annotations

import threading

import numpy as np
from numpy.typing import NDArray

from luxel.kernels.path import World
from luxel.light.ray_sets import texel_middles
from luxel.light.sampling import RaySets, draw_rays

__all__ = ["RecordBook"]

_ROWS, _COLUMNS = 4, 8  # of the cells that a record's rays start from
_SETS = 64
_DOUBT = 0.3  # in rays, about the slopes


class RecordBook:
    """Coarse light on the particles of one world; 17 bytes a particle. Safe to share between threads.

    A record depends on its particle alone: two threads that make it at once write the same.
    """

    def __init__(self, world: World) -> None:
        count = len(world.radii)
        self._world = world
        self._sets: RaySets | None = None
        self._lock = threading.Lock()
        self._known = np.zeros(count, np.bool_)
        self._records = np.zeros((count, 4), np.float32)

    def first_light(self, ids: NDArray[np.int32]) -> NDArray[np.float32]:
        """Return (K, 4) float32: luminance towards unit normal n is about max(0, c0 + c1 nx + c2 ny + c3 nz), c0 >= 0."""
        with self._lock:
            missing = ids[~self._known[ids]]
            if self._sets is None:
                suns = self._world.lights.suns
                self._sets = RaySets.make("latlong", (_ROWS, _COLUMNS), 1, suns, sun_samples=1, sets=_SETS)
            sets = self._sets
        if len(missing):
            made = self._make(missing, sets)
            with self._lock:
                self._records[missing] = made
                self._known[missing] = True
        return self._records[ids]

    def _make(self, ids: NDArray[np.int32], sets: RaySets) -> NDArray[np.float32]:
        """Fit c0 + c·n to a ray from every cell that is not buried, by damped least squares."""
        drawn = draw_rays(self._world, sets, ids)
        mean = drawn.rest.mean if drawn.sun is None else drawn.rest.mean + drawn.sun.mean
        basis = np.concatenate([np.ones((_ROWS * _COLUMNS, 1)), texel_middles(_ROWS, _COLUMNS)], axis=1)
        seen = drawn.rest.exposed.reshape(len(ids), -1).astype(np.float64)
        # Stacked products and solves run one record at a time inside: the same bits whatever the batch.
        matrix = (basis.T * seen[:, None, :]) @ basis
        matrix[:, range(1, 4), range(1, 4)] += _DOUBT
        matrix[:, 0, 0] += seen.sum(axis=1) == 0  # buried: all is 0
        right = basis.T @ (seen * mean.reshape(len(ids), -1))[:, :, None]
        found = np.linalg.solve(matrix, right)[:, :, 0]
        found[:, 0] = np.maximum(found[:, 0], 0.0)
        return found.astype(np.float32)
