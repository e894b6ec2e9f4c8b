"""What is looked at of particles: light is sampled there first, and needs fewer than half as many samples."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from luxel.kernels.in_view import texels_in_view
from luxel.kernels.memory import lines
from luxel.kernels.path import World
from luxel.kernels.simd import LANES
from luxel.light.mapping import Mapping, texel_directions, texel_neighbours

__all__ = ["Gaze", "texels_looked_at"]


class Gaze(NamedTuple):
    """Who looks, from where.

    Parameters
    ----------
    eyes
        (E, 3) float32 in normalised units.
    shown
        (N,) uint8, not 0 for particles that hide what is behind them.
    """

    eyes: NDArray[np.float32]
    shown: NDArray[np.uint8]


def texels_looked_at(
    world: World, mapping: Mapping, texels: int, ids: NDArray[np.int32], gaze: Gaze
) -> NDArray[np.uint8]:
    """Return (K, T·T), not 0 for the texels that a picture from one of the eyes looks up, as far as particles near by tell.

    In periodic cells, texels that face an eye: which images hide them there, pictures do not tell.
    """
    wanted = np.empty((len(ids), texels * texels), np.uint8)
    texels_in_view(world, _middles(mapping, texels), _beside(mapping, texels), ids, *gaze, wanted)
    return wanted


@lru_cache(maxsize=8)
def _middles(mapping: Mapping, texels: int) -> NDArray[np.float32]:
    """(blocks * 48,) the middles of all texels, sixteen x, sixteen y, sixteen z; the last is repeated."""
    points = texel_directions(mapping, texels).reshape(-1, 3)
    blocks = -(-len(points) // LANES)
    padded = points[np.minimum(np.arange(blocks * LANES), len(points) - 1)]
    found = lines((blocks * 3 * LANES,))
    found[:] = padded.reshape(blocks, LANES, 3).swapaxes(1, 2).ravel()
    return found


@lru_cache(maxsize=8)
def _beside(mapping: Mapping, texels: int) -> NDArray[np.int32]:
    return texel_neighbours(mapping, texels)
