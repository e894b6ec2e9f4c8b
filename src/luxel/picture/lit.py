"""What frames are drawn of: a scene and the textures that belong to it, though another thread may change both."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from luxel.errors import InputError
from luxel.picture.drawing import Crew, bare_table
from luxel.scene.scene import Scene
from luxel.textures.textures import TextureSource, TextureTable

__all__ = ["Bare", "Lit", "Still", "lit_now"]

_TRIES = 16  # to read scene and textures of a session that another thread changes again and again


class Lit(Protocol):
    """What frames are drawn of: a :class:`luxel.Session`, or anything like it."""

    @property
    def scene(self) -> Scene:
        """What to draw now."""
        ...

    @property
    def source(self) -> TextureSource:
        """Its textures."""
        ...

    def run_for(self, budget_s: float, helpers: Crew | None = None) -> object:
        """Work on light for about so many seconds, on the caller's thread and its helpers'."""
        ...

    def take_in(self) -> None:
        """Take in what was sighted."""
        ...


def lit_now(target: Lit) -> tuple[Scene, TextureSource, TextureTable]:
    """Return scene, textures and their table that belong together, though another thread may change them now.

    Raises
    ------
    InputError
        If the textures are of other particles.
    """
    for _ in range(_TRIES):
        source, scene = target.source, target.scene
        key = source.key
        table = source.snapshot(key)
        if target.scene is scene and source.key == key and len(table.slot) == len(scene.particles):
            return scene, source, table
    raise InputError(f"the textures are of {len(table.slot)} particles, the scene has {len(scene.particles)}")


@dataclass(frozen=True, eq=False)
class Still:
    """A scene whose light changes no more; a :class:`Lit`.

    Parameters
    ----------
    scene
        What to draw.
    source
        A bake of it.
    """

    scene: Scene
    source: TextureSource

    def run_for(self, budget_s: float, helpers: Crew | None = None) -> None:
        """There is nothing to do."""

    def take_in(self) -> None:
        """There is nothing to do."""


class Bare:
    """No textures at all; a :class:`luxel.textures.textures.TextureSource`."""

    key = ""

    def __init__(self, count: int) -> None:
        self._table = bare_table(count)

    def snapshot(self, key: str) -> TextureTable:
        """Return the table of nothing."""
        return self._table

    def sighted(self, ids: NDArray[np.int32], eye: NDArray[np.float64]) -> None:
        """Nothing comes."""
