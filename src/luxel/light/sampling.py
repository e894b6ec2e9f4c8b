"""Samples of textures: paths to the letter of the paper, or rays that particles share."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from luxel.kernels.gather import gather_texels
from luxel.kernels.path import World
from luxel.kernels.rays import RayTable
from luxel.kernels.sunlight import SunTable
from luxel.kernels.texels import sample_texels
from luxel.light.mapping import Mapping, mapping_code
from luxel.light.ray_sets import make_ray_table, make_sun_table, texel_frames

__all__ = ["Drawn", "RaySets", "Samples", "draw_paths", "draw_rays"]


class Samples(NamedTuple):
    """Sampled textures, as ``kernels.gather`` and ``kernels.texels`` write them."""

    mean: NDArray[np.float32]  # (K, T, T) over exposed samples, 0 where there are none
    variance: NDArray[np.float32]  # (K, T, T) of one sample
    exposed: NDArray[np.uint32]  # (K, T, T) number of samples that are not buried

    @classmethod
    def empty(cls, *shape: int) -> Samples:
        """Room for samples of textures of shape (K, T, T)."""
        return cls(np.empty(shape, np.float32), np.empty(shape, np.float32), np.empty(shape, np.uint32))


class Drawn(NamedTuple):
    """Light that comes straight from suns, and the rest of it; None where there is no sun, or both were drawn together."""

    rest: Samples
    sun: Samples | None


class RaySets(NamedTuple):
    """Rays for light from all around, and for sunlight."""

    around: RayTable
    suns: SunTable
    shape: tuple[int, int]  # rows and columns of the textures

    @classmethod
    def make(
        cls,
        mapping: Mapping,
        shape: tuple[int, int],
        samples: int,
        suns: NDArray[np.float32],
        *,
        sun_samples: int,
        seed: int = 0,
        sets: int | None = None,
        every_cell: bool = False,
    ) -> RaySets:
        """Make ray sets with so many samples a texel; but for sunlight fewer near poles, unless `every_cell`; see ``light.ray_sets``."""
        return cls(
            make_ray_table(mapping, shape, samples, seed=seed, sets=sets, every_cell=every_cell),
            make_sun_table(mapping, shape, sun_samples if len(suns) else 1, suns, seed=seed),
            shape,
        )


def draw_paths(world: World, mapping: Mapping, texels: int, samples: int, ids: NDArray[np.int32]) -> Samples:
    """Path-traced samples of textures, to the letter of the paper."""
    found = Samples.empty(len(ids), texels, texels)
    frames = texel_frames(mapping, texels)
    sample_texels(world, mapping_code(mapping), ids, round(samples**0.5), frames, *found)
    return found


def draw_rays(
    world: World, sets: RaySets, ids: NDArray[np.int32], wanted: NDArray[np.uint8] | None = None
) -> Drawn:
    """Samples by shared rays, of all texels or of those whose `wanted` (K, T·T) is not 0."""
    if wanted is None:
        wanted = np.ones((len(ids), sets.shape[0] * sets.shape[1]), np.uint8)
    rest = Samples.empty(len(ids), *sets.shape)
    lit = len(world.lights.suns) > 0
    sun = Samples.empty(len(ids) if lit else 0, *sets.shape)
    gather_texels(world, sets.around, sets.suns, ids, wanted, *rest, *sun)
    return Drawn(rest, sun if lit else None)
