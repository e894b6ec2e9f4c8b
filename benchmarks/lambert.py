"""Frames that the paper's tables compare, drawn as a frame loop does: over the last frame, by threads that are kept."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from luxel.kernels import frustum
from luxel.kernels.path import World
from luxel.picture.drawing import Crew, bare_table, draw_rays, make_skin
from luxel.textures.textures import TextureTable

__all__ = ["draw_lambert", "draw_textured"]


def draw_lambert(
    world: World,
    eye: frustum.Eye,
    colors: NDArray[np.float32],
    total: NDArray[np.float32],
    blank: NDArray[np.uint8],
    crew: Crew,
) -> None:
    """The yardstick: Lambert with one shadow ray a pixel towards each light, one ray a pixel into `total` (H, W, 5), see ``draw_frame``."""
    skin = make_skin(bare_table(len(colors)), colors)
    draw_rays(
        world.tree,
        world.lights,
        eye,
        (0.5, 0.5),
        skin,
        total,
        crew,
        textured=False,
        shadows=True,
        first=True,
        blank=blank,
    )


def draw_textured(
    world: World,
    eye: frustum.Eye,
    table: TextureTable,
    colors: NDArray[np.float32],
    total: NDArray[np.float32],
    blank: NDArray[np.uint8],
    crew: Crew,
) -> None:
    """As `draw_lambert`, with light from textures and without shadow rays."""
    draw_rays(
        world.tree,
        world.lights,
        eye,
        (0.5, 0.5),
        make_skin(table, colors),
        total,
        crew,
        first=True,
        blank=blank,
    )
