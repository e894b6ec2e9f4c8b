"""Samples of luminance over a whole particle, added up for a least-squares fit that is linear in the normal."""

from __future__ import annotations

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.path import luminance_at
from luxel.kernels.rng import PURPOSE_COARSE, path_key, uniform
from luxel.kernels.tree_trace import scratch
from luxel.kernels.warp import turn

__all__ = ["sample_moments"]

_ZERO, _ONE, _TWO = np.float32(0), np.float32(1), np.float32(2)


@kernel
def sample_moments(world, ids, grid, moments, right):
    """Sample particles `ids` at grid × grid points, jittered and uniform in solid angle; buried points do not count.

    Parameters
    ----------
    moments
        (K, 4, 4) float64: mean over all points of b bᵀ, where b = (1, nx, ny, nz), 0 for buried points.
    right
        (K, 4) float64: mean of luminance times b, likewise.
    """
    work = scratch(world.tree.stack_size)
    share = 1.0 / (grid * grid)
    step = _ONE / np.float32(grid)
    b = np.ones(4)
    for k in range(ids.shape[0]):
        sphere = ids[k]
        r = world.radii[sphere]
        moments[k] = 0.0
        right[k] = 0.0
        for s in range(grid * grid):
            state = path_key(world.seed, sphere, s, 0, PURPOSE_COARSE)
            u, v = uniform(state)
            nz = _ONE - _TWO * (np.float32(s // grid) + v) * step
            c, d = turn((np.float32(s % grid) + u) * step)
            across = np.sqrt(max(_ZERO, _ONE - nz * nz))
            nx, ny = across * c, across * d
            px, py, pz = (
                world.centers[sphere, 0] + r * nx,
                world.centers[sphere, 1] + r * ny,
                world.centers[sphere, 2] + r * nz,
            )
            value = luminance_at(world, work, sphere, px, py, pz, nx, ny, nz, state)
            if value < 0:
                continue
            b[1], b[2], b[3] = nx, ny, nz
            for i in range(4):
                right[k, i] += share * value * b[i]
                for j in range(4):
                    moments[k, i, j] += share * b[i] * b[j]
