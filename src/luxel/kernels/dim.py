"""How dark particles are that see no light themselves: by the coarse records of what they do see."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.launch import launch
from luxel.kernels.near import Near, near_scratch
from luxel.kernels.path import LAMBERTIAN
from luxel.kernels.rays import Site, neighbours
from luxel.kernels.records import BookScratch, book_scratch, ensure_record, is_black, record_towards
from luxel.kernels.sunlight import SunScratch, sun_scratch, sunlight
from luxel.kernels.tree_trace import scratch
from luxel.kernels.waves import Waves, wave_scratch

__all__ = ["LIT", "dim_levels"]

#: Level of particles that light reaches by at most one bounce as far as a few rays can tell, or that are not asked about.
LIT = np.float32(-1)
_ZERO = np.float32(0)


class _Pad(NamedTuple):
    """Working memory of one thread."""

    near: Near
    waves: Waves
    suns: SunScratch
    values: np.ndarray  # (rays,) float32
    every: np.ndarray  # (texels,) uint8, ones
    light: np.ndarray  # (texels,) float32
    light2: np.ndarray
    seen: np.ndarray  # (texels,) uint32
    book: BookScratch


@kernel(borrows=True)
def _sees_light(world, work, pad, known, site, sun_table):
    """Whether any ray finds a light, without bounces."""
    for s in range(pad.values.shape[0]):
        if pad.values[s] > 0:
            return True
    if sun_table.rays.shape[0] == 0:
        return False
    light, light2, seen = pad.light, pad.light2, pad.seen
    light[:] = _ZERO
    light2[:] = _ZERO
    seen[:] = 0
    sunlight(world, work, pad.near, known, site, sun_table, pad.every, pad.suns, light, light2, seen)
    # Not `light.max()`: kernels without reference counts cannot compile it, unless another has before them.
    for texel in range(light.shape[0]):  # noqa: SIM110
        if light[texel] > 0:
            return True
    return False


@kernel(borrows=True)
def _level(world, work, book, pad, table, sun_table, i):
    """Level of one particle, see :func:`dim_levels`."""
    if world.model == LAMBERTIAN or not is_black(world, work, book, pad.book, i):
        return LIT
    waves, values = pad.waves, pad.values
    known, reach = neighbours(world, work, pad.near, i)
    site = Site(i, world.centers[i, 0], world.centers[i, 1], world.centers[i, 2], world.radii[i], reach)
    paths = launch(world, work, pad.near, known, site, table, pad.every, values, waves)
    if _sees_light(world, work, pad, known, site, sun_table):
        return LIT
    exposed = 0
    for s in range(values.shape[0]):
        if table.texel[s] >= 0 and values[s] >= 0:
            exposed += 1
    total = _ZERO
    for path in range(paths):
        other = waves.sphere[path]
        ensure_record(world, work, book, pad.book, other)
        total += record_towards(world, book.records, other, waves.point[path])
    return world.albedo * total / np.float32(exposed) if exposed > 0 else _ZERO


@kernel(borrows=True)
def _levels(world, work, book, pad, table, sun_table, ids, levels):
    """As :func:`dim_levels`; without reference counts, which of a hundred arrays would cost as much as what is done."""
    for k in range(ids.shape[0]):
        levels[k] = _level(world, work, book, pad, table, sun_table, ids[k])


@kernel
def dim_levels(world, book, table, sun_table, texels, ids, levels):
    """Mean luminance of particles whose record is black and from which no ray of the tables, of so many texels, finds a light.

    It is what the rays find in the records of the particles that they meet; `LIT` for all other particles. Makes what
    it needs of the records that are missing. Unshadowed light has no use for records: there all are `LIT`.
    """
    work = scratch(world.tree.stack_size)
    rays = table.texel.shape[0]
    pad = _Pad(
        near_scratch(rays), wave_scratch(world.tree, rays), sun_scratch(world.tree, sun_table),
        np.zeros(rays, np.float32), np.ones(texels, np.uint8), np.zeros(texels, np.float32),
        np.zeros(texels, np.float32), np.zeros(texels, np.uint32), book_scratch(world.tree, book),
    )  # fmt: skip
    _levels(world, work, book, pad, table, sun_table, ids, levels)
