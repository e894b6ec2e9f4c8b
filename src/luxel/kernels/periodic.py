"""Rays through a periodic cell: straight through its faces, back in on the other side.

The light of a periodic scene is traced through a tree of its own: the spheres wrapped into one cell, and *ghosts*,
copies of those whose surface comes within `reach` of the cell, so that rays meet every image that stands in the cell
widened by `reach`. A ray is traced to the end of that domain, shifted by a cell vector, and traced on. Callers see
only particles where the file has them, and an offset to the image that a ray has met.

Every function takes `world.cell` as its first argument: where it is None, Numba prunes all but the plain case.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.simd import FAR
from luxel.kernels.tree import MISS, Tree
from luxel.kernels.tree_trace import occluded, trace

__all__ = ["HERE", "LOST", "Periodic", "follow", "image_of", "settle", "shadowed", "surroundings"]

# What a ray hits that has crossed too many faces: nothing, and no light comes from there.
LOST = -2

_ZERO, _HALF = np.float32(0), np.float32(0.5)
HERE = (_ZERO, _ZERO, _ZERO)  # offset from a particle to itself


class Periodic(NamedTuple):
    """A periodic cell and the spheres that light meets in it; normalised units, relative to the middle of the cell.

    Images of N particles: 0 … N-1 are the particles wrapped into the cell, N … N+G-1 ghosts in order of their
    particles. All images whose surface lies within `reach` of the cell are there, hence also all whose surface lies
    within `reach` of the centre of a particle in the cell.
    """

    tree: Tree  # of all N + G images
    centers: np.ndarray  # (N + G, 3) float32
    original: np.ndarray  # (N + G,) int32, the particle of each image
    first: np.ndarray  # (N + 1,) int32, ghosts of particle i are first[i] … first[i + 1] - 1
    image: np.ndarray  # (G, 3) int16, cell vectors from the particle in the cell to the ghost
    vectors: np.ndarray  # (3, 3) float32, one a row; those that do not repeat are any that complete the basis
    inverse: np.ndarray  # (3, 3) float32, row k times a point is its coordinate along vector k
    wraps: np.ndarray  # (3,) bool
    low: np.ndarray  # (3,) float32, the domain in these coordinates; beyond it a ray is wrapped, or has left
    high: np.ndarray
    reach: np.float32
    images: int  # faces that a ray may cross


@kernel(inline=True, borrows=True)
def _coordinate(cell, k, x, y, z):
    return cell.inverse[k, 0] * x + cell.inverse[k, 1] * y + cell.inverse[k, 2] * z


@kernel(borrows=True)
def _image_id(cell, particle, a, b, c):
    """Id of the image of a particle that lies (a, b, c) cell vectors from the one in the cell; MISS if it is far away."""
    if a == 0 and b == 0 and c == 0:
        return particle
    ghosts = cell.centers.shape[0] - cell.image.shape[0]
    for g in range(cell.first[particle], cell.first[particle + 1]):
        image = cell.image[g - ghosts]
        if image[0] == a and image[1] == b and image[2] == c:
            return np.int32(g)
    return np.int32(MISS)


@kernel(borrows=True)
def _enter(cell, world, particle, px, py, pz):
    """Move a point of a particle into the domain; return it and the image of the particle, in cell vectors."""
    qx = cell.centers[particle, 0] + (px - world.centers[particle, 0])
    qy = cell.centers[particle, 1] + (py - world.centers[particle, 1])
    qz = cell.centers[particle, 2] + (pz - world.centers[particle, 2])
    a, b, c = 0, 0, 0
    for k in range(3):
        s = _coordinate(cell, k, qx, qy, qz)
        if cell.wraps[k] and (s < cell.low[k] or s > cell.high[k]):  # of a sphere larger than the reach
            n = -int(np.floor(s + _HALF))
            v, shift = cell.vectors[k], np.float32(n)
            qx, qy, qz = qx + shift * v[0], qy + shift * v[1], qz + shift * v[2]
            if k == 0:
                a = n
            elif k == 1:
                b = n
            else:
                c = n
    return qx, qy, qz, a, b, c


@kernel(borrows=True)
def _walk(cell, world, work, px, py, pz, dx, dy, dz, limit, particle, any_hit):
    """Trace a ray from a point of a particle cell by cell.

    Returns (distance, image hit or MISS or LOST, origin of the last stretch, distance along it, image that was left).
    """
    qx, qy, qz, a, b, c = _enter(cell, world, particle, px, py, pz)
    before = _ZERO
    for _ in range(cell.images + 1):
        leave, axis, step = limit - before, -1, 0
        for k in range(3):
            s, v = _coordinate(cell, k, qx, qy, qz), _coordinate(cell, k, dx, dy, dz)
            if v != 0:
                t = ((cell.high[k] if v > 0 else cell.low[k]) - s) / v
                if t < leave:
                    leave, axis, step = t, k, 1 if v > 0 else -1
        # A ray that leaves a particle can meet other images of it, but not the one that it left.
        skip = _image_id(cell, particle, a, b, c)
        t, hit = trace(cell.tree, work, qx, qy, qz, dx, dy, dz, leave, skip, any_hit)
        if hit >= 0:
            return before + t, hit, qx, qy, qz, t, a, b, c
        if axis < 0 or not cell.wraps[axis]:
            return limit, np.int32(MISS), qx, qy, qz, t, a, b, c
        v, shift = cell.vectors[axis], np.float32(step)
        qx, qy, qz = (
            qx + leave * dx - shift * v[0],
            qy + leave * dy - shift * v[1],
            qz + leave * dz - shift * v[2],
        )
        if axis == 0:
            a -= step
        elif axis == 1:
            b -= step
        else:
            c -= step
        before += leave
    return limit, np.int32(LOST), qx, qy, qz, _ZERO, a, b, c


@kernel(inline=True, borrows=True)
def image_of(cell, world, particle, image):
    """Return the particle of an image and the offset from it to the image, seen from `particle` where the file has it."""
    if cell is None:
        return image, HERE
    else:
        found = cell.original[image]
        here, there = cell.centers[particle], cell.centers[image]
        a, b = world.centers[particle], world.centers[found]
        return found, (
            there[0] - here[0] + a[0] - b[0], there[1] - here[1] + a[1] - b[1], there[2] - here[2] + a[2] - b[2],
        )  # fmt: skip


@kernel(inline=True, borrows=True)
def follow(cell, world, work, px, py, pz, offset, dx, dy, dz, limit, particle):
    """Nearest hit of a ray that leaves a particle, from a point near it, where the file has it.

    Parameters
    ----------
    cell
        ``world.cell``.
    offset
        Three numbers, from the particle to the image of it that the ray leaves; HERE where nothing repeats.
    limit, particle
        As in :func:`luxel.kernels.tree_trace.trace`.

    Returns
    -------
    distance, id, x, y, z, offset
        The particle hit, or MISS, or LOST; the point hit, on the particle where the file has it; and the offset from
        there to the image that was met.
    """
    if cell is None:
        t, hit = trace(world.tree, work, px, py, pz, dx, dy, dz, limit, particle, False)
        return t, hit, px + t * dx, py + t * dy, pz + t * dz, offset
    else:
        distance, hit, qx, qy, qz, t, a, b, c = _walk(
            cell, world, work, px, py, pz, dx, dy, dz, limit, particle, False
        )
        if hit < 0:
            return distance, hit, px, py, pz, offset
        found, step = image_of(cell, world, particle, hit)
        fa, fb, fc, v = np.float32(a), np.float32(b), np.float32(c), cell.vectors
        # The last stretch is seen from the particle's image (a, b, c), not from the particle.
        move = (
            offset[0] + step[0] - fa * v[0, 0] - fb * v[1, 0] - fc * v[2, 0],
            offset[1] + step[1] - fa * v[0, 1] - fb * v[1, 1] - fc * v[2, 1],
            offset[2] + step[2] - fa * v[0, 2] - fb * v[1, 2] - fc * v[2, 2],
        )
        center, file = cell.centers[hit], world.centers[found]
        x = file[0] + (qx + t * dx - center[0])
        y = file[1] + (qy + t * dy - center[1])
        z = file[2] + (qz + t * dz - center[2])
        return distance, found, x, y, z, move


@kernel(inline=True, borrows=True)
def shadowed(cell, world, work, px, py, pz, dx, dy, dz, limit, particle):
    """Whether any image but that of `particle` itself meets the ray before `limit`, or the ray is lost."""
    if cell is None:
        return occluded(world.tree, work, px, py, pz, dx, dy, dz, limit, particle)
    else:
        return _walk(cell, world, work, px, py, pz, dx, dy, dz, limit, particle, True)[1] != MISS


@kernel(borrows=True, inner=True)
def settle(cell, world, px, py, pz, particle):
    """Return the tree that holds everything near a point of a particle, the point there, and what to leave out."""
    if cell is None:
        return world.tree, px, py, pz, particle
    else:
        qx, qy, qz, a, b, c = _enter(cell, world, particle, px, py, pz)
        return cell.tree, qx, qy, qz, _image_id(cell, particle, a, b, c)


@kernel(borrows=True, inner=True)
def surroundings(cell, world, particle):
    """Return the tree of what light meets around a particle, its centre there, and how far around that the tree is complete."""
    if cell is None:
        c = world.centers[particle]
        return world.tree, c[0], c[1], c[2], FAR
    else:
        c = cell.centers[particle]
        return cell.tree, c[0], c[1], c[2], cell.reach
