"""Which texels of a particle an eye sees: those that face it and that no neighbour hides."""

from __future__ import annotations

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.memory import float_lines
from luxel.kernels.near import RAY, near_scratch, nearest
from luxel.kernels.rays import neighbours
from luxel.kernels.simd import LANES, bits, fma, load, splat, store, vsqrt
from luxel.kernels.tree_trace import scratch

__all__ = ["texels_in_view"]

_ZERO, _ONE = np.float32(0), np.float32(1)
_ALL = (1 << LANES) - 1


@kernel(borrows=True)
def _towards(middles, o, rays, far, ex, ey, ez):
    """Aim rays from the sixteen points of the unit sphere at word `o` at an eye, `far` away; returns the bits of those that face it."""
    ax, ay, az = load(middles, o), load(middles, o + LANES), load(middles, o + 2 * LANES)
    dx, dy, dz = splat(ex) - ax, splat(ey) - ay, splat(ez) - az
    length = vsqrt(fma(dx, dx, fma(dy, dy, dz * dz)))
    scale = splat(_ONE) / length
    dx, dy, dz = dx * scale, dy * scale, dz * scale
    w = fma(ax, dx, fma(ay, dy, az * dz))
    store(rays, 0, ax)
    store(rays, LANES, ay)
    store(rays, 2 * LANES, az)
    store(rays, 3 * LANES, dx)
    store(rays, 4 * LANES, dy)
    store(rays, 5 * LANES, dz)
    store(rays, 6 * LANES, w)
    store(far, 0, length)
    return bits(w > splat(_ZERO))


@kernel(borrows=True)
def _choose_shown(near, known, shown):
    """Choose the neighbours that are in the picture; returns their number."""
    found = 0
    for k in range(known):
        if shown[near.id[k]] != 0:
            near.chosen[found] = k
            found += 1
    return found


@kernel(borrows=True)
def _unhidden(near, found, rays, far):
    """Which of sixteen rays nothing chosen meets before they have come so far, as bits."""
    nearest(near, found, rays, 0, 1, 0)
    return bits(load(near.hit_t, 0) >= load(far, 0))


@kernel(borrows=True)
def _widen(beside, before, after):
    """Add to the texels that are marked those beside them, corners too."""
    for t in range(before.shape[0]):
        after[t] = before[t] | before[beside[2, t]] | before[beside[3, t]]
    for t in range(before.shape[0]):
        before[t] = after[t] | after[beside[0, t]] | after[beside[1, t]]


@kernel
def texels_in_view(world, middles, beside, ids, eyes, shown, wanted):
    """Mark the texels (K, T·T) of particles whose middles some eye sees, and those beside them; if it sees none, all that face it.

    Parameters
    ----------
    middles
        (blocks * 48,) float32 unit vectors of texels: sixteen x, sixteen y, sixteen z.
    beside
        (4, T·T) int32, see ``light.mapping.texel_neighbours``.
    ids
        (K,) int32 particles.
    eyes
        (E, 3) float32 in normalised units.
    shown
        (N,) uint8: particles that may hide others. Only those near a particle are asked.
    """
    work = scratch(world.tree.stack_size)
    near = near_scratch(LANES)
    rays, far = float_lines(RAY), float_lines(LANES)
    after = np.zeros(wanted.shape[1], np.uint8)
    texels = wanted.shape[1]
    for k in range(ids.shape[0]):
        i = ids[k]
        known, _ = neighbours(world, work, near, i)
        if world.cell is None:
            known = _choose_shown(near, known, shown)
        else:
            known = 0  # images hide nothing in pictures
        marked = wanted[k]
        for t in range(marked.shape[0]):
            marked[t] = 0
        inverse = _ONE / world.radii[i]
        for e in range(eyes.shape[0]):
            ex = (eyes[e, 0] - world.centers[i, 0]) * inverse
            ey = (eyes[e, 1] - world.centers[i, 1]) * inverse
            ez = (eyes[e, 2] - world.centers[i, 2]) * inverse
            any_seen = False
            # What shows only slivers of texels is taken to show all that faces the eye; what the eye is inside of, everything.
            for turn in range(3):
                if any_seen:
                    break
                for first in range(0, texels, LANES):
                    facing = _towards(middles, first * 3, rays, far, ex, ey, ez)
                    if turn == 0 and facing != 0:
                        facing &= _unhidden(near, known, rays, far)
                    elif turn == 2:
                        facing = _ALL
                    for lane in range(min(LANES, texels - first)):
                        if facing >> lane & 1 != 0:
                            marked[first + lane] = 1
                            any_seen = True
        _widen(beside, marked, after)
