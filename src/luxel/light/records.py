"""Coarse records of the light on particles, made when they are first asked for: what is shown until textures come."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from luxel.kernels.dim import dim_levels
from luxel.kernels.path import World
from luxel.kernels.records import RECORD, Book, make_records
from luxel.light.ray_sets import texel_middles
from luxel.light.sampling import RaySets

__all__ = ["RecordBook"]

_ROWS, _COLUMNS = 4, 8  # of the cells that a record's rays start from
_SETS = 64


class RecordBook:
    """Coarse light on the particles of one world; 16 bytes a particle. Safe to share between threads.

    A record depends on its particle alone: two threads that make it at once write the same.
    """

    def __init__(self, world: World) -> None:
        suns = world.lights.suns
        shape = _ROWS, _COLUMNS
        sets = RaySets.make("latlong", shape, 1, suns, sun_samples=1, sets=_SETS, every_cell=True)
        basis = np.concatenate([np.ones((_ROWS * _COLUMNS, 1)), texel_middles(_ROWS, _COLUMNS)], axis=1)
        records = np.full((len(world.radii), RECORD), np.nan, np.float32)
        self._world = world
        self._book = Book(records, sets.around, sets.suns, basis)

    def first_light(self, ids: NDArray[np.int32]) -> NDArray[np.float32]:
        """Return (K, 4) float32: luminance towards unit normal n is about max(0, c0 + c1 nx + c2 ny + c3 nz), c0 >= 0."""
        make_records(self._world, self._book, ids)
        return self._book.records[ids]

    def dim_levels(self, ids: NDArray[np.int32], sets: RaySets) -> NDArray[np.float32]:
        """Return (K,) float32 mean luminance of particles that light reaches by further bounces at most; negative for others.

        Which these are, and what the particles around them show, is asked with the rays of `sets`.
        """
        levels = np.empty(len(ids), np.float32)
        texels = sets.shape[0] * sets.shape[1]
        dim_levels(self._world, self._book, sets.around, sets.suns, texels, ids, levels)
        return levels
