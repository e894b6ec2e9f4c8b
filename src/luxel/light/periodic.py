"""Periodic cells made ready for light kernels: wrapped particles, their ghosts, and a tree of both."""

from __future__ import annotations

import math
import threading

import numpy as np
from numpy.typing import NDArray

from luxel.errors import InputError
from luxel.kernels.periodic import Periodic
from luxel.scene.periodic import checked_cell
from luxel.scene.scene import Scene
from luxel.trace.spheres import SphereSet
from luxel.trace.tree import SphereTree

__all__ = ["make_periodic"]

# Ghosts reach this many mean radii into the neighbouring cells. Rays are as fast from 1 to 8.
_REACH = 4.0
_MOST_IMAGES = 200_000_000
_LOCK = threading.Lock()


def make_periodic(scene: Scene, ghost_reach: float | None = None) -> Periodic:
    """Return the cell of a periodic scene as kernels take it, made once for each `Particles`, axes and reach.

    A particle takes 48 bytes more than in a scene that does not repeat, and each ghost 50.

    Parameters
    ----------
    scene
        With some periodic axes.
    ghost_reach
        All images whose surface lies within this distance of the cell are held, in file units. None means four mean
        radii. Light is right for any positive reach.

    Raises
    ------
    InputError
        For a reach that is not positive, and where radii are so much larger than the cell that the ghosts of the
        particles are too many.
    """
    if ghost_reach is not None and not (math.isfinite(ghost_reach) and ghost_reach > 0):
        raise InputError(f"ghost_reach must be positive, got {ghost_reach}")
    spheres = SphereSet.of(scene.particles)
    with _LOCK:
        # Only the latest is kept: it weighs as much as the particles' own tree.
        hidden = None if scene.hidden is None else np.packbits(scene.hidden).tobytes()
        key, made = spheres.derived.get("periodic", (None, None))
        if key != (scene.axes, ghost_reach, hidden):
            made = _make(scene, spheres, ghost_reach)
            spheres.derived["periodic"] = (scene.axes, ghost_reach, hidden), made
    cell: Periodic = made
    return cell._replace(images=scene.periodic_images)


def _make(scene: Scene, spheres: SphereSet, ghost_reach: float | None) -> Periodic:
    cell = checked_cell(scene.particles, scene.axes)
    wraps = np.array([axis in scene.axes for axis in "xyz"])
    vectors = _complete(cell.vectors / spheres.unit, wraps)
    inverse = np.linalg.inv(vectors).T
    middle = spheres.to_unit(cell.origin) + 0.5 * vectors[wraps].sum(axis=0)
    radii = spheres.radii.astype(np.float64)
    reach = _REACH * float(radii.mean()) if ghost_reach is None else spheres.length_to_unit(ghost_reach)

    place = spheres.centers - middle
    place -= np.rint(place @ inverse[wraps].T) @ vectors[wraps]
    coordinates = place @ inverse.T
    # How far a sphere, and the reach, extend along each coordinate.
    slope = np.linalg.norm(inverse, axis=1)
    low = np.where(wraps, -0.5 - reach * slope, (coordinates - radii[:, None] * slope).min(axis=0))
    high = np.where(wraps, 0.5 + reach * slope, (coordinates + radii[:, None] * slope).max(axis=0))
    owner, image = _ghosts(coordinates, (radii[:, None] + reach) * slope, wraps)

    count = len(spheres)
    original = np.concatenate([np.arange(count, dtype=np.int32), owner])
    first = (count + np.searchsorted(owner, np.arange(count + 1))).astype(np.int32)
    centers = np.concatenate([place, place[owner] + image @ vectors]).astype(np.float32)
    images = SphereSet(centers, spheres.radii[original], np.zeros(3), spheres.unit)
    return Periodic(
        SphereTree(images, hidden=None if scene.hidden is None else scene.hidden[original]).arrays,
        centers,
        original,
        first,
        image,
        vectors.astype(np.float32),
        np.ascontiguousarray(inverse, dtype=np.float32),
        wraps,
        low.astype(np.float32),
        high.astype(np.float32),
        np.float32(reach),
        scene.periodic_images,
    )


def _complete(vectors: NDArray[np.float64], wraps: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Replace the vectors that do not repeat, which a flat cell may lack, by unit vectors across the others."""
    complete = vectors.copy()
    across = np.linalg.svd(vectors[wraps])[2][int(wraps.sum()) :]
    complete[~wraps] = across
    return complete


def _ghosts(
    coordinates: NDArray[np.float64], extent: NDArray[np.float64], wraps: NDArray[np.bool_]
) -> tuple[NDArray[np.int32], NDArray[np.int16]]:
    """Return the particle (G,) and the image (G, 3), in cell vectors, of every ghost, ordered by particle.

    Parameters
    ----------
    coordinates
        (N, 3) of the centres, -½ … ½ along axes that wrap.
    extent
        (N, 3) coordinates that each sphere takes on either side of its centre.
    """
    first = np.ceil(-0.5 - extent - coordinates)
    last = np.floor(0.5 + extent - coordinates)
    total = float(np.prod((last - first + 1)[:, wraps], axis=1).sum())
    if total > max(_MOST_IMAGES, 4 * len(coordinates)) or total >= 2**31:
        raise InputError(
            f"{total:.3g} images of {len(coordinates):,} particles would reach into the periodic cell: its radii are"
            " too large for it — give smaller radii, or repeat along fewer axes"
        )
    near_face = (first[:, wraps] < 0).any(axis=1) | (last[:, wraps] > 0).any(axis=1)
    owner: NDArray[np.int32] = np.flatnonzero(near_face).astype(np.int32)
    image = np.zeros((len(owner), 3), np.int16)
    for axis in np.flatnonzero(wraps):
        start, stop = first[owner, axis], last[owner, axis]
        owners, images = [owner], [image]
        for n in range(int(start.min(initial=0)), int(stop.max(initial=0)) + 1):
            chosen = (start <= n) & (n <= stop)
            if n != 0 and chosen.any():
                shifted = image[chosen]
                shifted[:, axis] = n
                owners.append(owner[chosen])
                images.append(shifted)
        owner, image = np.concatenate(owners, dtype=np.int32), np.concatenate(images, dtype=np.int16)
    ghost = image.any(axis=1)
    order = np.argsort(owner[ghost], kind="stable")
    return owner[ghost][order], image[ghost][order]
