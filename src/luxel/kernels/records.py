"""Coarse records of the light on particles: a few numbers each, fitted to a few paths, made when first asked for."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.launch import launch
from luxel.kernels.near import Near, near_scratch
from luxel.kernels.rays import RayTable, Site, neighbours
from luxel.kernels.sunlight import SunScratch, SunTable, sun_scratch, sunlight
from luxel.kernels.tree_trace import scratch
from luxel.kernels.waves import Waves, follow_paths, wave_scratch

__all__ = [
    "RECORD",
    "Book",
    "BookScratch",
    "book_scratch",
    "ensure_record",
    "is_black",
    "make_records",
    "record_towards",
]

#: Numbers of a record: light linear in the normal.
RECORD = 4
_DOUBT = 0.3  # in rays, about the slopes
_ZERO = np.float32(0)


class Book(NamedTuple):
    """Records of all particles of a world, and what they are made with. Threads may fill it together.

    A record depends on its particle alone. A number that is not known yet is NaN, and each is written at once; so
    whoever reads a record that another thread is writing finds it whole or makes it again, the same.
    """

    records: np.ndarray  # (N, RECORD) float32
    table: RayTable
    suns: SunTable
    basis: np.ndarray  # (cells, 4) float64: 1 and the middle of each cell


class BookScratch(NamedTuple):
    """Working memory of one thread."""

    near: Near
    waves: Waves
    suns: SunScratch
    values: np.ndarray  # (rays,) float32
    sun: np.ndarray  # (cells,) float32
    sun2: np.ndarray
    sun_seen: np.ndarray  # (cells,) uint32
    every: np.ndarray  # (cells,) uint8, ones
    system: np.ndarray  # (4, 5) float64


@kernel(inner=True)
def book_scratch(tree, book):
    """Allocate for the rays of a book."""
    rays, cells = book.table.texel.shape[0], book.basis.shape[0]
    return BookScratch(
        near_scratch(rays), wave_scratch(tree, rays), sun_scratch(tree, book.suns),
        np.zeros(rays, np.float32), np.zeros(cells, np.float32),
        np.zeros(cells, np.float32), np.zeros(cells, np.uint32),
        np.ones(cells, np.uint8), np.zeros((RECORD, RECORD + 1)),
    )  # fmt: skip


@kernel(borrows=True)
def _solve(m):
    """Solve the symmetric positive system of `RECORD` rows in place; the right side is the last column."""
    for k in range(RECORD):
        for i in range(RECORD):
            if i != k:
                factor = m[i, k] / m[k, k]
                for j in range(k, RECORD + 1):
                    m[i, j] -= factor * m[k, j]
    for k in range(RECORD):
        m[k, RECORD] /= m[k, k]


@kernel(borrows=True)
def _launch_record(world, work, book, pad, particle):
    """Send a ray from every cell; returns (neighbours, site, paths) for `_finish_record`, which must follow."""
    known, reach = neighbours(world, work, pad.near, particle)
    x, y, z = world.centers[particle, 0], world.centers[particle, 1], world.centers[particle, 2]
    site = Site(particle, x, y, z, world.radii[particle], reach)
    paths = launch(world, work, pad.near, known, site, book.table, pad.every, pad.values, pad.waves)
    return known, site, paths


@kernel(borrows=True)
def _finds_light(book, pad):
    """Whether rays of `_launch_record` bring light themselves: then the record will not be black."""
    for s in range(pad.values.shape[0]):  # noqa: SIM110 — kernels know no generators
        if book.table.texel[s] >= 0 and pad.values[s] > 0:
            return True
    return False


@kernel(borrows=True)
def _finish_record(world, work, book, pad, known, site, paths):
    """Fit c0 + c·n to what the rays bring that are not buried, by damped least squares."""
    values, m = pad.values, pad.system
    follow_paths(world, work, pad.near, known, site, pad.waves, paths, values)
    for c in range(pad.sun.shape[0]):
        pad.sun[c] = pad.sun2[c] = _ZERO
        pad.sun_seen[c] = 0
    if book.suns.rays.shape[0] > 0:
        sunlight(
            world,
            work,
            pad.near,
            known,
            site,
            book.suns,
            pad.every,
            pad.suns,
            pad.sun,
            pad.sun2,
            pad.sun_seen,
        )
    for i in range(RECORD):
        for j in range(RECORD + 1):
            m[i, j] = 0.0
        m[i, i] = _DOUBT if i > 0 else 0.0
    seen = 0
    for s in range(values.shape[0]):
        cell = book.table.texel[s]
        if cell < 0 or values[s] < 0:
            continue
        seen += 1
        light = np.float64(values[s] + pad.sun[cell])
        for i in range(RECORD):
            b = book.basis[cell, i]
            for j in range(RECORD):
                m[i, j] += b * book.basis[cell, j]
            m[i, RECORD] += b * light
    if seen > 0:
        _solve(m)
        m[0, RECORD] = max(m[0, RECORD], 0.0)
    for i in range(RECORD):
        book.records[site.sphere, i] = m[i, RECORD]


@kernel(inline=True, borrows=True)
def _known(records, particle):
    known = True
    for c in range(RECORD):
        known &= not np.isnan(records[particle, c])
    return known


@kernel(inline=True, borrows=True)
def record_towards(world, records, particle, point):
    """Luminance of a particle at a point of its surface, by its record."""
    record = records[particle]
    x = point[0] - world.centers[particle, 0]
    y = point[1] - world.centers[particle, 1]
    z = point[2] - world.centers[particle, 2]
    slope = (record[1] * x + record[2] * y + record[3] * z) / world.radii[particle]
    return max(_ZERO, record[0] + slope)


@kernel(borrows=True, inner=True)
def ensure_record(world, work, book, pad, particle):
    """Make the record of a particle where there is none yet."""
    if not _known(book.records, particle):
        known, site, paths = _launch_record(world, work, book, pad, particle)
        _finish_record(world, work, book, pad, known, site, paths)


@kernel(borrows=True, inner=True)
def is_black(world, work, book, pad, particle):
    """Whether the record of a particle finds no light; it is made only if following its paths is what tells."""
    if not _known(book.records, particle):
        known, site, paths = _launch_record(world, work, book, pad, particle)
        if _finds_light(book, pad):
            return False
        _finish_record(world, work, book, pad, known, site, paths)
    record = book.records[particle]
    return record[0] == 0 and record[1] == 0 and record[2] == 0 and record[3] == 0


@kernel(borrows=True)
def _make_all(world, work, book, pad, ids):
    """As :func:`make_records`; without reference counts, which of some dozens of arrays would cost a tenth of the time."""
    for k in range(ids.shape[0]):
        ensure_record(world, work, book, pad, ids[k])


@kernel
def make_records(world, book, ids):
    """Make the records of particles that have none."""
    work = scratch(world.tree.stack_size)
    pad = book_scratch(world.tree, book)
    _make_all(world, work, book, pad, ids)
