"""The pictures of a movie, drawn one after the other: light is computed once a time step, and kept while the view moves."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxel.picture.bands import draw_bands
from luxel.picture.colorbar import draw_colorbar
from luxel.picture.drawing import bare_table
from luxel.picture.raytrace import render, shown_ids
from luxel.scene.scene import Scene
from luxel.scene.view import View
from luxel.textures.bake import Baker
from luxel.textures.growing import GrowingTextures
from luxel.textures.spec import TextureSpec
from luxel.textures.store.reader import BakedFrame
from luxel.textures.textures import TextureTable

__all__ = ["Brush", "Shot", "pictures"]

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Shot:
    """One picture: which time step, and how it is looked at."""

    step: int
    view: View


@dataclass(frozen=True)
class Brush:
    """How pictures are drawn.

    Parameters
    ----------
    size, antialias, colorbar, threads
        See :func:`luxel.render`.
    spec
        Of textures. None path traces every pixel with `options`, which :func:`luxel.render` takes.
    options
        See `spec`.
    """

    size: tuple[int, int]
    antialias: int = 3
    colorbar: bool = True
    threads: int | None = None
    spec: TextureSpec | None = None
    options: dict[str, Any] | None = None

    def lit(self, scene: Scene) -> _Step:
        """Return what draws pictures of a scene."""
        return _Step(self, scene, None)

    def baked(self, frame: BakedFrame) -> _Step:
        """Return what draws pictures of stored light."""
        return _Step(self, frame.scene, frame.compressed.snapshot(frame.key))


class _Step:
    """One time step, with the light that pictures of it have needed so far."""

    def __init__(self, brush: Brush, scene: Scene, table: TextureTable | None) -> None:
        self._brush, self._scene, self._table = brush, scene, table
        self._textures: GrowingTextures | None = None
        if table is None and brush.spec is not None:
            if scene.model == "lambertian":
                self._table = bare_table(len(scene.particles))
            else:
                self._textures = GrowingTextures(Baker(scene, brush.spec), brush.threads)

    def draw(self, view: View, progress: Progress | None) -> NDArray[np.uint8]:
        """Draw what :func:`luxel.render` draws of this view; `progress` is called while light is computed."""
        brush, scene, table = self._brush, self._scene, self._table
        if self._textures is not None:
            ids = shown_ids(scene, view, brush.size, antialias=brush.antialias, threads=brush.threads)
            self._textures.grow(ids, progress)
            table = self._textures.snapshot(self._textures.key)
        if table is None:
            return render(
                scene,
                view,
                size=brush.size,
                light="pixel",
                antialias=brush.antialias,
                threads=brush.threads,
                colorbar=brush.colorbar,
                **(brush.options or {}),
            ).pixels
        pixels = draw_bands(scene, view, table, brush.size, antialias=brush.antialias, threads=brush.threads)
        return draw_colorbar(pixels, view, scene.particles) if brush.colorbar else pixels


def pictures(
    shots: Sequence[Shot],
    wanted: Iterable[int],
    open_step: Callable[[int], _Step],
    progress: Progress | None = None,
) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Yield those pictures that are wanted, ascending, with their numbers.

    Parameters
    ----------
    shots
        All pictures.
    wanted
        Numbers of those to draw.
    open_step
        Returns what draws a time step, see :class:`Brush`; called whenever the step changes.
    progress
        Called as ``progress(done, total)`` in particles, while light is computed.
    """
    number, step = -1, None
    for k in wanted:
        shot = shots[k]
        if step is None or shot.step != number:
            step = None  # one at a time is in memory
            number, step = shot.step, open_step(shot.step)
        yield k, step.draw(shot.view, progress)
