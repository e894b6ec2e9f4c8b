"""Pictures of any size, drawn a band of rows at a time: what is kept besides the picture itself stays small."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from luxel.kernels.tiles import TILE
from luxel.light.lights import pack_lights
from luxel.picture.drawing import (
    Crew,
    checked_size,
    draw_folded,
    draw_rays,
    make_eye,
    make_skin,
    make_tone,
    part_of,
    seen_tree,
)
from luxel.scene.scene import Scene
from luxel.scene.view import View
from luxel.textures.textures import TextureTable
from luxel.trace.spheres import SphereSet

__all__ = ["draw_bands"]

_BAND_BYTES = 64 << 20
_SUM_BYTES = 20  # of a pixel


def draw_bands(
    scene: Scene,
    view: View,
    table: TextureTable,
    size: tuple[int, int],
    *,
    antialias: int = 3,
    threads: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> NDArray[np.uint8]:
    """Draw what :func:`luxel.render` draws of the same textures, without a colour bar.

    Parameters
    ----------
    scene, view, table
        What to draw.
    size, antialias, threads
        See :func:`luxel.render`.
    progress
        Called as ``progress(done, total)`` in rows; what it raises ends the work.

    Returns
    -------
    pixels
        (H, W, 3) uint8 sRGB. Rays of pictures of more than one band may differ from those of ``render`` by rounding.

    Raises
    ------
    InputError
        For a size out of range, or textures of other particles.
    """
    width, height = checked_size(size)
    spheres = SphereSet.of(scene.particles)
    tree, lights = seen_tree(scene, view).arrays, pack_lights(scene, spheres)
    eye = make_eye(view.camera_for(scene.particles, (width, height)), spheres, width / height)
    skin, tone = make_skin(table, view.colors(scene.particles)), make_tone(scene, view)
    rows = min(height, max(1, _BAND_BYTES // (_SUM_BYTES * width * TILE)) * TILE)
    sums = np.empty((rows if antialias == 1 else 0, width, 5), np.float32)
    pixels = np.empty((height, width, 3), np.uint8)
    crew = Crew(threads)
    try:
        for top in range(0, height, rows):
            picture = pixels[top : top + rows]
            part, corner = part_of(eye, (width, height), (0, top), (width, len(picture)))
            if antialias > 1:
                draw_folded(
                    tree,
                    lights,
                    part,
                    antialias,
                    skin,
                    crew,
                    corner=corner,
                    tone=tone,
                    picture=picture,
                )
            else:
                total = sums[: len(picture)]
                total[:] = 0
                shift = (corner[0] + 0.5, corner[1] + 0.5)
                draw_rays(
                    tree, lights, part, shift, skin, total, crew, spacing=1.0, tone=tone, picture=picture
                )
            if progress is not None:
                progress(top + len(picture), height)
    finally:
        crew.close()
    return pixels
