"""First light: a coarse record of each particle's luminance, shown until its texture is there.

A record is four numbers (c0, c1, c2, c3): luminance towards the unit normal n is max(0, c0 + c1 nx + c2 ny + c3 nz),
in the scene's units, as textures are. c0 >= 0 always; c0 < 0 marks a particle that has none yet.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from luxel.kernels.coarse import sample_moments
from luxel.kernels.path import World

__all__ = ["first_light"]

_GRID = 8
# Slopes of a particle of which little is exposed are badly known: they are drawn towards 0 as if by this much more of
# the sphere, seen without any.
_SLOPE_WEIGHT = 0.01


def first_light(world: World, ids: NDArray[np.int32]) -> NDArray[np.float32]:
    """Return the records (K, 4) float32 of particles `ids` (K,), from 64 paths each.

    A least-squares fit over what is not buried in a neighbour. Every particle is fitted alone, so that its record
    does not depend on the batch; safe from several threads. Entirely buried ones are black.
    """
    moments, right = np.empty((len(ids), 4, 4)), np.empty((len(ids), 4))
    sample_moments(world, ids, _GRID, moments, right)
    diagonal = np.arange(1, 4)
    moments[:, diagonal, diagonal] += _SLOPE_WEIGHT
    moments[moments[:, 0, 0] == 0] = np.eye(4)  # entirely buried: nothing on the right-hand side either
    found = np.linalg.solve(moments, right[:, :, None])[:, :, 0]
    # c0 < 0 is taken: where the best fit wants it, the best one with c0 = 0 stands in.
    low = np.flatnonzero(found[:, 0] < 0)
    found[low, 0] = 0.0
    found[low, 1:] = np.linalg.solve(moments[low, 1:, 1:], right[low, 1:, None])[:, :, 0]
    return np.asarray(found, dtype=np.float32)
