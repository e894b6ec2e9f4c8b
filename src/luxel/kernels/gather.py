"""Samples of luminance for ``fast`` mode: path tracing as in ``texels``, from rays that particles share, spread evenly."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.launch import launch
from luxel.kernels.near import Near, near_scratch
from luxel.kernels.rays import Site, neighbours
from luxel.kernels.sunlight import SunScratch, sun_scratch, sunlight
from luxel.kernels.tree_trace import scratch
from luxel.kernels.waves import Waves, follow_paths, wave_scratch

__all__ = ["gather_texels"]

_ZERO, _ONE = np.float32(0), np.float32(1)


class _Pad(NamedTuple):
    """Working memory of one thread."""

    near: Near
    waves: Waves
    suns: SunScratch
    values: np.ndarray  # (rays,) float32


@kernel(inline=True, borrows=True)
def _clear(total, total2, seen):
    total[:] = _ZERO
    total2[:] = _ZERO
    seen[:] = 0


@kernel(inline=True, borrows=True)
def _average(total, total2, seen):
    """Turn sums into means and variances of one sample."""
    for texel in range(total.shape[0]):
        n = np.float32(seen[texel])
        if n > 0:
            total[texel] /= n
        spread = total2[texel] - n * total[texel] * total[texel]
        total2[texel] = max(_ZERO, spread) / (n - _ONE) if n > 1 else _ZERO


@kernel(borrows=True)
def _gather(world, work, pad, known, site, table, wanted, mean, variance, exposed):
    """Light from all around on one particle."""
    paths = launch(world, work, pad.near, known, site, table, wanted, pad.values, pad.waves)
    follow_paths(world, work, pad.near, known, site, pad.waves, paths, pad.values)
    _clear(mean, variance, exposed)
    for s in range(table.texel.shape[0]):
        texel, value = table.texel[s], pad.values[s]
        if texel >= 0 and value >= 0:
            mean[texel] += value
            variance[texel] += value * value
            exposed[texel] += 1
    _average(mean, variance, exposed)


@kernel(borrows=True)
def _gather_sunlight(world, work, pad, known, site, table, wanted, mean, variance, exposed):
    _clear(mean, variance, exposed)
    sunlight(world, work, pad.near, known, site, table, wanted, pad.suns, mean, variance, exposed)
    _average(mean, variance, exposed)


@kernel(borrows=True)
def _surround(world, work, pad, particle):
    """Collect the neighbours of a particle; returns (number, site)."""
    x, y, z = world.centers[particle, 0], world.centers[particle, 1], world.centers[particle, 2]
    known, reach = neighbours(world, work, pad.near, particle)
    return known, Site(particle, x, y, z, world.radii[particle], reach)


@kernel(borrows=True)
def _gather_all(
    world, work, pad, table, sun_table, ids, wanted, mean, variance, exposed, sun, sun_variance, sun_exposed
):
    """As :func:`gather_texels`; without reference counts, which of some dozens of arrays would cost a tenth of the time."""
    for k in range(ids.shape[0]):
        known, site = _surround(world, work, pad, ids[k])
        _gather(world, work, pad, known, site, table, wanted[k], mean[k], variance[k], exposed[k])
        if sun_table.rays.shape[0] > 0:
            _gather_sunlight(
                world, work, pad, known, site, sun_table, wanted[k], sun[k], sun_variance[k], sun_exposed[k]
            )


@kernel
def gather_texels(
    world, table, sun_table, ids, wanted, mean, variance, exposed, sun, sun_variance, sun_exposed
):
    """As ``texels.sample_texels``, with the rays of `table`; sunlight apart, with those of `sun_table`.

    Only texels whose `wanted` (K, T·T) is not 0; the others have no exposed sample.

    The last three are as the three before them; where there is no sun they are not written.
    """
    rays = table.texel.shape[0]
    work = scratch(world.tree.stack_size)
    pad = _Pad(
        near_scratch(rays), wave_scratch(world.tree, rays), sun_scratch(world.tree, sun_table),
        np.zeros(rays, np.float32),
    )  # fmt: skip
    texels = mean.shape[1] * mean.shape[2]
    _gather_all(
        world, work, pad, table, sun_table, ids, wanted, mean.reshape(-1, texels), variance.reshape(-1, texels),
        exposed.reshape(-1, texels), sun.reshape(-1, texels), sun_variance.reshape(-1, texels),
        sun_exposed.reshape(-1, texels),
    )  # fmt: skip
