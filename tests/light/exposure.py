"""How much of each texel lies in the open, by plain geometry: needed to compare modes that treat buried points differently."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

import luxel
from luxel.kernels.jit import kernel

_FINE = 24  # points along a texel


def open_fraction(particles: luxel.Particles, ids: np.ndarray, texels: int) -> np.ndarray:
    """(K, T, T) share of each texel, uniform in (u, v), that lies in no other particle."""
    positions, radii = particles.local.astype(np.float64), particles.radii.astype(np.float64)
    fraction = np.empty((len(ids), texels, texels))
    # Searched by classes of size, so that one giant does not make every particle everyone's neighbour.
    size = np.floor(np.log2(radii))
    trees = [
        (cKDTree(positions[m]), m, radii[m].max())
        for m in (np.flatnonzero(size == s) for s in np.unique(size))
    ]
    for k, i in enumerate(ids):
        near = np.concatenate(
            [m[tree.query_ball_point(positions[i], radii[i] + largest)] for tree, m, largest in trees]
        )
        near = near[near != i]
        open_share(positions[near] - positions[i], radii[near], radii[i], fraction[k])
    return fraction


@kernel
def open_share(offsets, radii, radius, share):
    texels = share.shape[0]
    for row in range(texels):
        for column in range(texels):
            free = 0
            for s in range(_FINE * _FINE):
                polar = np.pi * (row + (s // _FINE + 0.5) / _FINE) / texels
                azimuth = 2 * np.pi * (column + (s % _FINE + 0.5) / _FINE) / texels
                z, h = radius * np.cos(polar), radius * np.sin(polar)
                x, y = h * np.cos(azimuth), h * np.sin(azimuth)
                inside = False
                for j in range(radii.shape[0]):
                    dx, dy, dz = offsets[j, 0] - x, offsets[j, 1] - y, offsets[j, 2] - z
                    if dx * dx + dy * dy + dz * dz < radii[j] * radii[j]:
                        inside = True
                        break
                if not inside:
                    free += 1
            share[row, column] = free / (_FINE * _FINE)
