"""Which particles can be seen from outside the data, whatever the view."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from luxel.light.world import make_world
from luxel.picture.drawing import make_eye, seen_tree, trace_primary
from luxel.scene.camera import Camera
from luxel.scene.scene import Scene
from luxel.scene.view import View
from luxel.trace.spheres import SphereSet
from luxel.trace.tree import thread_count

__all__ = ["seen_from_outside"]

_BATCH = 32  # views
_VIEWS_MAX = 512
_FEW = 1e-4  # of what is seen: a batch that adds no more is the last
_PIXELS_A_RADIUS = 2.0
_SIZE_MAX = 2048


def seen_from_outside(
    scene: Scene,
    view: View | None = None,
    *,
    threads: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> NDArray[np.int32]:
    """Return the sorted ids (M,) int32 of particles that can be seen from outside the data.

    The rays of a view from a distance leave the data along parallel lines, and so do those of every eye outside of its convex hull: what
    no parallel view sees, no such eye does. Parallel views from directions spread evenly over the sphere are drawn,
    with pixels half a small particle's radius wide, until 32 more of them add less than a ten-thousandth. An eye
    inside the data, between the particles, may see more.

    Parameters
    ----------
    scene, view
        What either hides is not seen.
    threads
        None means all that the process may use.
    progress
        Called as ``progress(done, total)``, in views; the total is the most there may be.
    """
    particles = scene.particles
    spheres = SphereSet.of(particles)
    workers = thread_count(threads)
    world = make_world(scene)._replace(tree=seen_tree(scene, view or View()).arrays)
    low, high = particles.bounds
    middle, diagonal = 0.5 * (low + high), float(np.linalg.norm(high - low))
    small = float(np.quantile(particles.radii, 0.01))
    size = int(min(_SIZE_MAX, max(64, math.ceil(_PIXELS_A_RADIUS * diagonal / small))))
    seen = np.zeros(len(particles) + 1, np.bool_)  # the last is for what hits nothing
    before = 0
    for k in range(_VIEWS_MAX):
        towards, up, shift = _direction(k)
        camera = Camera(middle + diagonal * towards, middle, up, height=1.02 * diagonal)
        seen[trace_primary(world, make_eye(camera, spheres, 1.0), size, size, shift, workers)[1]] = True
        if progress is not None:
            progress(k + 1, _VIEWS_MAX)
        if (k + 1) % _BATCH == 0:
            count = int(np.count_nonzero(seen[:-1]))
            if count - before <= _FEW * count:
                break
            before = count
    return np.flatnonzero(seen[:-1]).astype(np.int32)


def _direction(k: int) -> tuple[NDArray[np.float64], NDArray[np.float64], tuple[float, float]]:
    """Direction number k of an evenly spread sequence (Roberts 2018), an up axis for it, and where in pixels rays start."""
    # Powers of the real root of x^5 = x + 1 spread points evenly in four dimensions.
    z, turn, x, y = ((0.5 + (k + 1) / 1.1673039782614187**power) % 1.0 for power in (1, 2, 3, 4))
    z = 2 * z - 1
    rim = math.sqrt(max(0.0, 1 - z * z))
    towards = np.array([rim * math.cos(2 * math.pi * turn), rim * math.sin(2 * math.pi * turn), z])
    up = np.eye(3)[int(np.argmin(np.abs(towards)))]
    return towards, up, (x, y)
