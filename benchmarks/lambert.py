"""The yardstick of the paper's tables: Lambert with one shadow ray a pixel towards each light, in the same renderer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from luxel.kernels import tiles
from luxel.kernels.path import World
from luxel.picture.drawing import Crew, bare_table, draw_rays, make_skin

__all__ = ["draw_lambert"]


def draw_lambert(
    world: World, eye: tiles.Eye, colors: NDArray[np.float32], total: NDArray[np.float32], threads: int
) -> None:
    """Add one ray a pixel to `total` (H, W, 5), as ``picture.raytrace.draw_textures`` does."""
    crew = Crew(threads)
    skin = make_skin(bare_table(len(colors)), colors)
    try:
        draw_rays(world.tree, world.lights, eye, (0.5, 0.5), skin, total, crew, textured=False, shadows=True)
    finally:
        crew.close()
