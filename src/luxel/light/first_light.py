"""First light: a coarse record of each particle's luminance, shown until its texture is there.

A record is four numbers (c0, c1, c2, c3): luminance towards the unit normal n is max(0, c0 + c1 nx + c2 ny + c3 nz),
in the scene's units, as textures are. c0 >= 0 always; c0 < 0 marks a particle that has none yet.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from luxel.kernels.path import World, sample_texels

__all__ = ["first_light"]

_TEXELS = 8
# Slopes of a particle of which little is exposed are badly known: they are drawn towards 0 as if by this much more of
# the sphere, seen without any.
_SLOPE_WEIGHT = 0.01


def first_light(world: World, ids: NDArray[np.int32]) -> NDArray[np.float32]:
    """Return the records (K, 4) float32 of particles `ids` (K,), from 64 paths each.

    A least-squares fit, weighted by solid angle, over what is not buried in a neighbour. Every particle is fitted
    alone, so that its record does not depend on the batch; safe from several threads. Entirely buried ones are black.
    """
    shape = (len(ids), _TEXELS, _TEXELS)
    mean, variance, exposed = (
        np.empty(shape, np.float32),
        np.empty(shape, np.float32),
        np.empty(shape, np.uint32),
    )
    sample_texels(world, ids, 1, mean, variance, exposed)
    basis, weight = _quadrature()
    weights = (exposed.reshape(len(ids), -1) > 0) * weight
    # Stacked products and solves run one particle at a time inside: the same bits whatever the batch.
    moments = (basis.T * weights[:, None, :]) @ basis
    right = (basis.T * weights[:, None, :]) @ mean.reshape(len(ids), -1, 1).astype(np.float64)
    diagonal = np.arange(1, 4)
    moments[:, diagonal, diagonal] += _SLOPE_WEIGHT
    seen = weights.any(axis=1)
    moments[~seen] = np.eye(4)
    found = np.linalg.solve(moments, right)[:, :, 0]
    # c0 < 0 is taken: where the best fit wants it, the best one with c0 = 0 stands in.
    low = np.flatnonzero(found[:, 0] < 0)
    found[low, 0] = 0.0
    found[low, 1:] = np.linalg.solve(moments[low, 1:, 1:], right[low, 1:])[:, :, 0]
    return np.asarray(found, dtype=np.float32)


def _quadrature() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(64, 4) basis functions 1, x, y, z at texel centres, and (64,) their shares of the sphere."""
    edges = np.cos(np.arange(_TEXELS + 1) * math.pi / _TEXELS)
    polar = (np.arange(_TEXELS) + 0.5) * math.pi / _TEXELS
    azimuth = (np.arange(_TEXELS) + 0.5) * 2 * math.pi / _TEXELS
    x = np.sin(polar)[:, None] * np.cos(azimuth)
    y = np.sin(polar)[:, None] * np.sin(azimuth)
    z = np.repeat(np.cos(polar)[:, None], _TEXELS, axis=1)
    basis = np.stack([np.ones_like(x), x, y, z], axis=-1).reshape(-1, 4)
    return basis, np.repeat((edges[:-1] - edges[1:]) / (2 * _TEXELS), _TEXELS)
