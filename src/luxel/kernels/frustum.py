"""The part of space that a rectangle of the picture shows, and the nodes of the sphere tree that reach into it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.memory import float_lines
from luxel.kernels.simd import LANES, bits, fma, load, popcount, splat, trailing_zeros, vmin
from luxel.kernels.tree import CHILDREN, NODE

__all__ = [
    "Cut",
    "Eye",
    "Frustum",
    "cut_tree",
    "depth_inside",
    "height_above",
    "look_through",
    "make_cut",
    "make_frustum",
]

_FAR = np.float32(1e30)
_ZERO, _HALF, _ONE, _TWO = (np.float32(x) for x in (0, 0.5, 1, 2))


class Eye(NamedTuple):
    """A camera in normalised units.

    Perspective rays leave `origin` towards forward + sx·right + sy·up; orthographic rays leave
    origin + sx·right + sy·up along forward. (sx, sy) run over [-1, 1] from the left and from the bottom.
    right, up and forward are perpendicular, and forward has length 1.
    """

    origin: np.ndarray  # (3,) float32
    right: np.ndarray
    up: np.ndarray
    forward: np.ndarray
    orthographic: bool


class Frustum(NamedTuple):
    """Six planes through the eye and a line of the picture, see `look_through`."""

    planes: np.ndarray  # (6 · 4,) float32 normals and offsets: left, right, top, bottom, the two middles
    sides: np.ndarray  # (12,) int64 which face of a box lies farthest inside of each of the first four


class Cut(NamedTuple):
    """Up to sixteen nodes and leaves below which all that a rectangle shows is to be found, as if they were the children of one node."""

    node: np.ndarray  # (NODE,) float32 boxes, then links
    link: np.ndarray  # int32 view of the same memory
    frustum: Frustum
    places: np.ndarray  # (2 · 16,) int64: where the boxes are among the tree's words


@kernel
def make_frustum():
    """Allocate."""
    return Frustum(float_lines(6 * 4), np.empty(12, np.int64))


@kernel
def make_cut():
    """Allocate."""
    node = float_lines(NODE)
    return Cut(node, node.view(np.int32), make_frustum(), np.empty(2 * LANES, np.int64))


@kernel(borrows=True)
def _put_planes(planes, eye, left, top, wide, high):
    """Write the planes that `look_through` puts."""
    for p in range(6):
        upright = p < 2 or p == 4
        axis = eye.right if upright else eye.up
        part = _HALF if p >= 4 else np.float32(p & 1)
        line = left + part * wide if upright else top - part * high
        scale = _ONE / (axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2])
        tilt = _ZERO if eye.orthographic else line
        nx = axis[0] * scale - tilt * eye.forward[0]
        ny = axis[1] * scale - tilt * eye.forward[1]
        nz = axis[2] * scale - tilt * eye.forward[2]
        norm = (-_ONE if p == 1 or p == 2 else _ONE) / np.sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz = nx * norm, ny * norm, nz * norm
        planes[4 * p], planes[4 * p + 1], planes[4 * p + 2] = nx, ny, nz
        planes[4 * p + 3] = (
            -(nx * eye.origin[0] + ny * eye.origin[1] + nz * eye.origin[2]) - (line - tilt) * norm
        )


@kernel(inline=True, borrows=True)
def height_above(planes, p, x, y, z):
    """Signed distances of sixteen points from plane p."""
    o = 4 * p
    return fma(
        x, splat(planes[o]), fma(y, splat(planes[o + 1]), fma(z, splat(planes[o + 2]), splat(planes[o + 3])))
    )


@kernel(inline=True, borrows=True)
def look_through(eye, frustum, left, top, wide, high):
    """Put six planes through the eye and a line of the rectangle that goes from sx = `left` and sy = `top` over `wide` and `high`: left, right, top, bottom, and its two middles.

    The first four are positive inside, the middles to the right and above. Returns by how much rounding may move them.
    """
    planes, sides = frustum.planes, frustum.sides
    _put_planes(planes, eye, left, top, wide, high)
    for c in range(4):
        for a in range(3):
            sides[3 * c + a] = ((3 if planes[4 * c + a] > 0 else 0) + a) * LANES
    # It grows with the distance of the eye.
    return splat(np.float32(-1e-6) * (_TWO + abs(eye.origin[0]) + abs(eye.origin[1]) + abs(eye.origin[2])))


@kernel(inline=True, borrows=True)
def depth_inside(frustum, nodes, o):
    """How far sixteen boxes reach inside of the four sides of a rectangle; negative for those outside of one."""
    planes, sides = frustum.planes, frustum.sides
    inside = splat(_FAR)
    for c in range(4):
        x, y, z = (
            load(nodes, o + sides[3 * c]),
            load(nodes, o + sides[3 * c + 1]),
            load(nodes, o + sides[3 * c + 2]),
        )
        inside = vmin(inside, height_above(planes, c, x, y, z))
    return inside


@kernel(borrows=True, inner=True)
def cut_tree(tree, eye, cut, left, top, wide, high):
    """Find what of the tree reaches into a rectangle of the picture, see `look_through`; returns whether anything does.

    Level by level, each node is replaced by those of its children that do, as long as there is room for them.
    """
    nodes, child, places = tree.nodes, tree.child, cut.places
    slack = look_through(eye, cut.frustum, left, top, wide, high)
    now, then = 0, LANES
    count = 0
    m = bits(depth_inside(cut.frustum, nodes, 0) >= slack)
    while m != 0:
        places[count] = trailing_zeros(m)
        count += 1
        m &= m - 1
    grew = count > 0
    while grew:
        grew = False
        found = 0
        for k in range(count):
            at = places[now + k]
            link = child[at + CHILDREN]
            if link >= 0:
                o = link * NODE
                m = bits(depth_inside(cut.frustum, nodes, o) >= slack)
                if found + popcount(m) + (count - 1 - k) <= LANES:
                    grew = True
                    while m != 0:
                        places[then + found] = o + trailing_zeros(m)
                        found += 1
                        m &= m - 1
                    continue
            places[then + found] = at
            found += 1
        now, then = then, now
        count = found
    for k in range(count):
        at = places[now + k]
        for c in range(6):
            cut.node[c * LANES + k] = nodes[at + c * LANES]
        cut.link[CHILDREN + k] = child[at + CHILDREN]
    for k in range(count, LANES):
        for c in range(6):
            cut.node[c * LANES + k] = _FAR if c < 3 else -_FAR
    return count > 0
