"""The data set that comes with luxel: a piece of open-cell foam, crushed from above (see README.md beside this file)."""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxel.particles import Particles
from luxel.scene.camera import Camera
from luxel.scene.view import View

__all__ = ["demo_particles", "demo_view"]


@cache
def demo_particles() -> Particles:
    """Return about 75,000 particles of a crushed open-cell foam with stress, plastic_strain, velocity and pressure."""
    with files(__name__).joinpath("foam.npz").open("rb") as file, np.load(file, allow_pickle=False) as stored:
        names = [name for name in stored.files if not name.endswith("_ends")]
        values = {name: _restored(stored[name], stored[f"{name}_ends"]) for name in names}
    return Particles(values.pop("position"), values.pop("radius"), values, radii_source="column radius")


def demo_view() -> View:
    """Return the view that shows the data set at its best: into the cavities, on a map that is pale where nothing happens."""
    return View(
        camera=Camera(eye=(-0.623, -0.912, 1.239), target=(0.51, 0.52, 0.425), fov=18.0),
        color_by="stress",
        colormap="YlOrRd",
    )


def _restored(codes: NDArray[Any], ends: NDArray[np.float64]) -> NDArray[np.float32]:
    low, high = ends
    return np.asarray(low + (high - low) * (codes / np.iinfo(codes.dtype).max), dtype=np.float32)
