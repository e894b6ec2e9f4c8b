"""Coarse records of the light on every particle: what fast textures gather from, and the first light that is shown."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from luxel.kernels import records as kernels
from luxel.kernels.path import World
from luxel.kernels.rays import RayTable
from luxel.light.ray_sets import make_ray_table
from luxel.trace.tree import run_parts

__all__ = ["first_records", "no_records", "solve_records"]

_ROWS, _COLUMNS = 4, 8  # of the cells that link rays start from
_SETS = 256
_CHUNK = 2048
_TOLERANCE = 2e-3  # of the luminance scale, for the mean of any record
_MOST_STEPS = 64


def solve_records(world: World, scale: float, threads: int) -> kernels.Records:
    """Return the records of all particles, all bounces included; the same for any number of threads."""
    count = len(world.radii)
    table = _table(world)
    links = _links(count, table, scale)
    direct = np.empty((count, 4), np.float32)
    order = np.arange(count, dtype=np.int32)
    parts = [slice(k, min(k + _CHUNK, count)) for k in range(0, count, _CHUNK)]
    run_parts(
        lambda p: kernels.trace_links(world, table, order[p], _rows(links, p), direct[p]), parts, threads
    )
    run_parts(lambda p: kernels.light_links(world, order[p], _rows(links, p), direct), parts, threads)
    change = np.empty(len(parts), np.float32)

    def step(old: NDArray[np.float32], new: NDArray[np.float32]) -> float:
        def part(k: int) -> None:
            p = parts[k]
            change[k] = kernels.relax(world, table, p.start, _rows(links, p), old, new[p])

        run_parts(part, range(len(parts)), threads)
        return float(change.max())

    old, new = np.zeros((count, 4), np.float32), np.empty((count, 4), np.float32)
    for _ in range(_MOST_STEPS):
        moved = step(old, new)
        old, new = new, old
        if moved < _TOLERANCE * scale:
            break
    rest = np.empty((count, 9), np.float32)
    step(old, rest)
    return kernels.Records(direct, rest)


def first_records(world: World, scale: float, ids: NDArray[np.int32], threads: int = 1) -> NDArray[np.float32]:
    """Return records (K, 4) of particles `ids` alone: direct light and sky, bounces guessed; for a first picture.

    A ray that meets another particle brings home what its own particle shows on average.
    """
    table = _table(world)
    records = np.empty((len(ids), 4), np.float32)
    size = _CHUNK // 8

    def part(p: slice) -> None:
        count = len(ids[p])
        direct = np.empty((count, 4), np.float32)
        kernels.first_light(world, table, ids[p], _links(count, table, scale), direct, records[p])

    run_parts(part, [slice(k, k + size) for k in range(0, len(ids), size)], threads)
    return records


def no_records() -> kernels.Records:
    """Return what stands for records where light does not bounce."""
    return kernels.Records(np.zeros((1, 4), np.float32), np.zeros((1, 9), np.float32))


def _table(world: World) -> RayTable:
    suns = world.lights.suns
    return _cached_table(suns.tobytes(), len(suns))


@lru_cache(maxsize=4)
def _cached_table(suns: bytes, count: int) -> RayTable:
    packed = np.frombuffer(suns, np.float32).reshape(count, 6)
    return make_ray_table("latlong", (_ROWS, _COLUMNS), 1, packed, sets=_SETS)


def _rows(links: kernels.Links, part: slice) -> kernels.Links:
    return kernels.Links(links.particle[part], links.normal[part], links.direct[part], links.scale)


def _links(count: int, table: RayTable, scale: float) -> kernels.Links:
    shape = (count, len(table.texel))
    return kernels.Links(
        np.empty(shape, np.int32), np.empty(shape, np.uint16), np.empty(shape, np.uint16), np.float32(scale)
    )
