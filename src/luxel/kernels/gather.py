"""Samples of luminance for ``fast`` mode: path tracing as in ``texels``, from rays that particles share, spread evenly."""

from __future__ import annotations

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.launch import launch
from luxel.kernels.near import near_scratch
from luxel.kernels.rays import Site, neighbours
from luxel.kernels.simd import LANES
from luxel.kernels.sunlight import sun_scratch, sunlight
from luxel.kernels.tree_trace import scratch
from luxel.kernels.waves import follow_paths, wave_scratch

__all__ = ["gather_texels"]

_ZERO, _ONE = np.float32(0), np.float32(1)


@kernel
def gather_texels(
    world, table, sun_table, ids, wanted, mean, variance, exposed, sun, sun_variance, sun_exposed
):
    """As ``texels.sample_texels``, with the rays of `table`; sunlight apart, with those of `sun_table`.

    Only texels whose `wanted` (K, T·T) is not 0; the others have no exposed sample.

    The last three are as the three before them; where there is no sun they are not written.
    """
    work = scratch(world.tree.stack_size)
    near = near_scratch(table.width * LANES)
    rays = table.texel.shape[0]
    waves = wave_scratch(rays)
    suns = sun_scratch(sun_table)
    values = np.zeros(rays, np.float32)
    for k in range(ids.shape[0]):
        i = ids[k]
        x, y, z, r = world.centers[i, 0], world.centers[i, 1], world.centers[i, 2], world.radii[i]
        known, reach = neighbours(world, work, near, i)
        site = Site(i, x, y, z, r, reach)
        paths = launch(world, work, near, known, site, table, wanted[k], values, waves)
        follow_paths(world, work, near, known, site, waves, paths, values)
        total, total2, seen = mean[k].reshape(-1), variance[k].reshape(-1), exposed[k].reshape(-1)
        _clear(total, total2, seen)
        for s in range(rays):
            texel, value = table.texel[s], values[s]
            if texel >= 0 and value >= 0:
                total[texel] += value
                total2[texel] += value * value
                seen[texel] += 1
        _average(total, total2, seen)
        if sun_table.rays.shape[0] > 0:
            total, total2, seen = sun[k].reshape(-1), sun_variance[k].reshape(-1), sun_exposed[k].reshape(-1)
            _clear(total, total2, seen)
            sunlight(world, work, near, known, site, sun_table, wanted[k], suns, total, total2, seen)
            _average(total, total2, seen)


@kernel(inline=True)
def _clear(total, total2, seen):
    total[:] = _ZERO
    total2[:] = _ZERO
    seen[:] = 0


@kernel(inline=True)
def _average(total, total2, seen):
    """Turn sums into means and variances of one sample."""
    for texel in range(total.shape[0]):
        n = np.float32(seen[texel])
        if n > 0:
            total[texel] /= n
        spread = total2[texel] - n * total[texel] * total[texel]
        total2[texel] = max(_ZERO, spread) / (n - _ONE) if n > 1 else _ZERO
