"""Ray sets that particles share, and the frames of texels that the near field culls by.

A set covers a particle's surface, cell by cell of its texels along a Morton curve, and gives the k-th cell the k-th
point of a scrambled Sobol sequence as direction: any run of cells, a patch of the sphere, has directions that are spread
evenly (after Ahmed and Wonka 2020, "Screen-space blue-noise diffusion of Monte Carlo sampling error via hierarchical
ordering of pixels"). Particles take turns among many sets, so that neighbours do not err alike. Small texels are not
worth as many samples as others: near the poles of a latitude-longitude map, many of their cells have no ray.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from luxel.kernels import mapping as maps
from luxel.kernels.memory import lines
from luxel.kernels.near import RAY
from luxel.kernels.rays import RayTable
from luxel.kernels.simd import LANES
from luxel.kernels.sunlight import SunTable
from luxel.light.mapping import Mapping, mapping_code, square_directions

__all__ = ["make_ray_table", "make_sun_table", "texel_frames", "texel_middles"]

Float = NDArray[np.float64]

_TABLE_BYTES = 4 << 20  # all sets together stay in the last-level cache
_FEWEST_SETS, _MOST_SETS = 16, 64
_PATCH_RAYS = 32
_GOLDEN = (math.sqrt(5) - 1) / 2
# No part of the sphere has more than so many times the samples that the equator has: four fifths of the rays for 0 to 5 % more error, where fewer everywhere
# would cost 5 %.
_DENSEST = 1.5


@lru_cache(maxsize=8)
def texel_frames(mapping: Mapping, texels: int) -> NDArray[np.float32]:
    """(T·T, 4) float32: middle of every texel and the largest chord from it to a point of the texel."""
    fine = 8
    grid = square_directions(mapping, np.linspace(0, 1, texels * fine + 1)).astype(np.float64)
    frames = np.empty((texels * texels, 4), np.float32)
    for row in range(texels):
        for column in range(texels):
            block = grid[row * fine : (row + 1) * fine + 1, column * fine : (column + 1) * fine + 1]
            frames[row * texels + column] = _frame(block.reshape(-1, 3))
    frames.setflags(write=False)
    return frames


def texel_middles(rows: int, columns: int) -> Float:
    """Return the mean (rows * columns, 3) of the directions of each cell of a latitude-longitude map."""
    phi, theta = np.linspace(0, 2 * np.pi, columns + 1), np.linspace(0, np.pi, rows + 1)
    # Means over (azimuth, polar angle), as samples are drawn.
    x = (np.diff(np.sin(phi)) / np.diff(phi))[None, :]
    y = (-np.diff(np.cos(phi)) / np.diff(phi))[None, :]
    ring, height = -np.diff(np.cos(theta)) / np.diff(theta), np.diff(np.sin(theta)) / np.diff(theta)
    ones = np.ones((1, columns))
    return np.stack([ring[:, None] * x, ring[:, None] * y, height[:, None] * ones], axis=-1).reshape(-1, 3)


def make_ray_table(
    mapping: Mapping,
    shape: tuple[int, int],
    samples: int,
    *,
    seed: int = 0,
    sets: int | None = None,
    every_cell: bool = False,
) -> RayTable:
    """Make ray sets with `samples` starts a texel, fewer near poles unless `every_cell`, and directions about the normal, cosine-weighted.

    `shape` is rows and columns of the map; `sets` defaults to as many as fit a cache.
    """
    layout = _Layout(mapping, shape, samples, math.inf if every_cell else _DENSEST)
    sets = sets or int(np.clip(_TABLE_BYTES // layout.set_bytes, _FEWEST_SETS, _MOST_SETS))
    rays = lines((sets, layout.blocks * RAY))
    starts = np.empty((sets, layout.blocks * LANES, 3))
    for k in range(sets):
        rng = np.random.default_rng((seed, k, *shape, samples))
        starts[k] = layout.starts(rng)
        s, t = _scrambled_sobol(layout.index, rng)
        height, turn = 1 - 2 * s, 2 * np.pi * t
        ring = np.sqrt(np.maximum(0.0, 1 - height * height))
        # A normal plus a uniform point of the unit sphere has the density cosθ/π.
        direction = starts[k] + np.stack([ring * np.cos(turn), ring * np.sin(turn), height], axis=-1)
        direction /= np.maximum(_lengths(direction), 1e-9)[..., None]
        rays[k] = _pack(starts[k], direction)
    return RayTable(rays, layout.texel, layout.patches(starts), layout.width)


def make_sun_table(
    mapping: Mapping, shape: tuple[int, int], samples: int, suns: NDArray[np.float32], *, seed: int = 0
) -> SunTable:
    """As :func:`make_ray_table` with every cell, directions towards the disc of each sun; `suns` is (S, 6) as in ``kernels.light.Lights``."""
    layout = _Layout(mapping, shape, samples)
    rays = lines((len(suns), _FEWEST_SETS, layout.blocks * RAY))
    starts = np.zeros((_FEWEST_SETS, layout.blocks * LANES, 3))
    for k in range(_FEWEST_SETS if len(suns) else 0):
        rng = np.random.default_rng((seed, k, *shape, samples, 1))
        starts[k] = layout.starts(rng)
        for q, sun in enumerate(suns):
            s, t = _scrambled_sobol(layout.index, rng)
            rays[q, k] = _pack(starts[k], _disc(sun.astype(np.float64), s, t))
    whole = samples % LANES == 0
    return SunTable(rays, layout.texel, layout.patches(starts), layout.width, whole)


class _Layout:
    """Where the starts of a set lie, and in which order."""

    def __init__(
        self, mapping: Mapping, shape: tuple[int, int], samples: int, densest: float = math.inf
    ) -> None:
        self._mapping, self._shape = mapping, shape
        self._grid = _grid(samples)
        row, column = _morton_cells(shape, self._grid)
        if mapping == "latlong":
            size = np.sin((row // self._grid[0] + 0.5) * np.pi / shape[0])
            kept = _spread(row, column, densest * size)
            row, column = row[kept], column[kept]
        self._row, self._column = row, column
        count = len(self._row)
        self.blocks = -(-count // LANES)
        self.index = np.arange(self.blocks * LANES)
        self.width = _PATCH_RAYS // LANES
        self.set_bytes = 4 * self.blocks * RAY
        self.texel = np.full(self.blocks * LANES, -1, np.int32)
        self.texel[:count] = (self._row // self._grid[0]) * shape[1] + self._column // self._grid[1]

    def starts(self, rng: np.random.Generator) -> Float:
        """(blocks * 16, 3) jittered starts, one in every cell."""
        jitter = rng.random((2, len(self._row)))
        u = (self._column + jitter[0]) / (self._shape[1] * self._grid[1])
        v = (self._row + jitter[1]) / (self._shape[0] * self._grid[0])
        found = _points(self._mapping, u, v)
        return np.concatenate([found, np.repeat(found[-1:], len(self.index) - len(found), axis=0)])

    def patches(self, starts: Float) -> NDArray[np.float32]:
        """(patches, 4) middle of the starts of each patch, over all sets, and the largest chord from it."""
        spans = [
            slice(b * LANES, min(b + self.width, self.blocks) * LANES)
            for b in range(0, self.blocks, self.width)
        ]
        return np.array([_frame(starts[:, span].reshape(-1, 3)) for span in spans], np.float32)


def _points(mapping: Mapping, u: Float, v: Float) -> Float:
    found = np.empty((len(u), 3), np.float32)
    maps.point_directions(mapping_code(mapping), u.astype(np.float32), v.astype(np.float32), found)
    points = found.astype(np.float64)
    return np.asarray(points / _lengths(points)[..., None])


def _frame(points: Float) -> tuple[float, ...]:
    middle = points.mean(axis=0)
    middle /= max(float(np.linalg.norm(middle)), 1e-9)
    # Between a grid's points a texel's edges bulge by less than the slack.
    chord = float(_lengths(points - middle).max()) * 1.001 + 1e-4
    return (*middle, chord)


def _dots(a: Float, b: Float) -> Float:
    """Return the dot products (...,) of vectors (..., 3): numpy's own sums over so short an axis take five times as long."""
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2])


def _lengths(vectors: Float) -> Float:
    return np.asarray(np.sqrt(_dots(vectors, vectors)))


def _grid(samples: int) -> tuple[int, int]:
    """Return rows and columns of the cells of one texel: as near to a square as `samples` can be parted."""
    rows = next(rows for rows in range(math.isqrt(samples), 0, -1) if samples % rows == 0)
    return rows, samples // rows


def _morton_cells(
    shape: tuple[int, int], grid: tuple[int, int]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of all cells, texel by texel along a Morton curve, and along another within each texel."""
    row, column = (a.ravel() for a in np.indices((shape[0] * grid[0], shape[1] * grid[1])))
    inner = _interleave(row % grid[0], column % grid[1])
    outer = _interleave(row // grid[0], column // grid[1])
    order = np.lexsort((inner, outer))
    return row[order], column[order]


def _spread(row: NDArray[np.int64], column: NDArray[np.int64], share: Float) -> NDArray[np.bool_]:
    """Choose such a share of the cells of each row, spread evenly, and not below one another."""
    part = np.minimum(share, 1.0)
    shift = row * _GOLDEN % 1.0
    chosen: NDArray[np.bool_] = np.floor((column + 1) * part + shift) > np.floor(column * part + shift)
    return chosen


def _interleave(a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.int64]:
    code = np.zeros_like(a)
    for bit in range(10):
        code |= ((b >> bit) & 1) << (2 * bit) | ((a >> bit) & 1) << (2 * bit + 1)
    return code


def _scrambled_sobol(index: NDArray[np.int64], rng: np.random.Generator) -> tuple[Float, Float]:
    """Owen-scrambled (0, 2)-sequence by hashing (Laine and Karras 2011; Burley 2020)."""
    seeds = rng.integers(0, 2**32, 2, dtype=np.uint32)
    u, v = (_scramble(a, s) for a, s in zip(_sobol(len(index)), seeds, strict=True))
    return u / 2.0**32, v / 2.0**32


@lru_cache(maxsize=8)
def _sobol(count: int) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Return the first points of the sequence, bits reversed."""
    first = np.arange(count, dtype=np.uint32)
    second = np.zeros_like(first)
    column = np.uint32(1 << 31)
    for bit in range(count.bit_length()):
        second ^= np.where((first >> np.uint32(bit)) & np.uint32(1), column, np.uint32(0)).astype(np.uint32)
        column ^= column >> np.uint32(1)
    return first, _reverse(second)


def _scramble(x: NDArray[np.uint32], seed: np.uint32) -> NDArray[np.uint32]:
    """Scramble what has its bits reversed; return it the right way round."""
    with np.errstate(over="ignore"):
        x = x + seed
        for factor in (0x6C50B47C, 0xB82F1E52, 0xC7AFE638, 0x8D22F6E6):
            x ^= x * np.uint32(factor)
    return _reverse(x)


def _reverse(x: NDArray[np.uint32]) -> NDArray[np.uint32]:
    for shift, mask in ((1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF)):
        s, m = np.uint32(shift), np.uint32(mask)
        x = ((x >> s) & m) | ((x & m) << s)
    return (x >> np.uint32(16)) | (x << np.uint32(16))


def _disc(sun: Float, s: Float, t: Float) -> Float:
    axis, cosine = sun[:3], sun[5]
    side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    side /= np.linalg.norm(side)
    other = np.cross(axis, side)
    height = 1 - s * (1 - cosine)
    ring = np.sqrt(np.maximum(0.0, 1 - height * height))
    turn = 2 * np.pi * t
    x, y = ring * np.cos(turn), ring * np.sin(turn)
    return np.stack([height * axis[k] + x * side[k] + y * other[k] for k in range(3)], axis=-1)


def _pack(start: Float, direction: Float) -> NDArray[np.float32]:
    words = np.concatenate([start, direction, _dots(start, direction)[:, None]], axis=1)
    return words.reshape(-1, LANES, 7).swapaxes(1, 2).astype(np.float32).ravel()
