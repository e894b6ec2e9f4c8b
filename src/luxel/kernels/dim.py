"""How dark particles are that see no light themselves: by the coarse records of what they do see."""

from __future__ import annotations

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.launch import launch
from luxel.kernels.near import near_scratch
from luxel.kernels.path import LAMBERTIAN
from luxel.kernels.rays import Site, neighbours
from luxel.kernels.records import book_scratch, ensure_record, is_black, record_towards
from luxel.kernels.simd import LANES
from luxel.kernels.sunlight import sun_scratch, sunlight
from luxel.kernels.tree_trace import scratch
from luxel.kernels.waves import wave_scratch

__all__ = ["LIT", "dim_levels"]

#: Level of particles that light reaches by at most one bounce as far as a few rays can tell, or that are not asked about.
LIT = np.float32(-1)
_ZERO = np.float32(0)


@kernel(borrows=True)
def _sees_light(world, work, near, known, site, sun_table, every, suns, values, light, light2, seen):
    """Whether any ray finds a light, without bounces."""
    for s in range(values.shape[0]):
        if values[s] > 0:
            return True
    if sun_table.rays.shape[0] == 0:
        return False
    light[:] = _ZERO
    light2[:] = _ZERO
    seen[:] = 0
    sunlight(world, work, near, known, site, sun_table, every, suns, light, light2, seen)
    # Not `light.max()`: kernels without reference counts cannot compile it, unless another has before them.
    for cell in range(light.shape[0]):  # noqa: SIM110
        if light[cell] > 0:
            return True
    return False


@kernel
def dim_levels(world, book, table, sun_table, ids, levels):
    """Mean luminance of particles whose record is black and from which no ray of the tables finds a light.

    It is what the rays find in the records of the particles that they meet; `LIT` for all other particles. Makes what
    it needs of the records that are missing. Unshadowed light has no use for records: there all are `LIT`.
    """
    work = scratch(world.tree.stack_size)
    pad = book_scratch(book)
    rays = table.texel.shape[0]
    near, waves, suns = near_scratch(table.width * LANES), wave_scratch(rays), sun_scratch(sun_table)
    values = np.zeros(rays, np.float32)
    cells = sun_table.texel.shape[0]
    every = np.ones(cells, np.uint8)
    light, light2, seen = np.zeros(cells, np.float32), np.zeros(cells, np.float32), np.zeros(cells, np.uint32)
    for k in range(ids.shape[0]):
        i = ids[k]
        levels[k] = LIT
        if world.model == LAMBERTIAN:
            continue
        if not is_black(world, work, book, pad, i):
            continue
        known, reach = neighbours(world, work, near, i)
        site = Site(i, world.centers[i, 0], world.centers[i, 1], world.centers[i, 2], world.radii[i], reach)
        paths = launch(world, work, near, known, site, table, every, values, waves)
        if _sees_light(world, work, near, known, site, sun_table, every, suns, values, light, light2, seen):
            continue
        exposed = 0
        for s in range(rays):
            if table.texel[s] >= 0 and values[s] >= 0:
                exposed += 1
        total = _ZERO
        for path in range(paths):
            other = waves.sphere[path]
            ensure_record(world, work, book, pad, other)
            total += record_towards(world, book.records, other, waves.point[path])
        levels[k] = world.albedo * total / np.float32(exposed) if exposed > 0 else _ZERO
