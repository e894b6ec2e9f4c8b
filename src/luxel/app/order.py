"""Particles in an order of which every beginning is spread evenly: a page that has some of them shows all of the data, thinner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from luxel.particles import Particles
from luxel.trace.spheres import SphereSet

__all__ = ["FIRST", "Order", "order_of"]

#: Pages take so many particles in at once; of more, they ask for some and then for the rest, part by part.
FIRST = 1 << 21

_BITS = 12  # of a coordinate, in a place along the curve
_ID_BITS = 28
_BLOCK = 1 << 20  # particles at a time, so that temporaries stay small


@dataclass(frozen=True, eq=False)
class Order:
    """Numbers that pages give particles.

    Parameters
    ----------
    to_file
        (N,) int32: the particle of the file that has number k on a page.
    to_page
        (N,) int32: the inverse.
    """

    to_file: NDArray[np.int32]
    to_page: NDArray[np.int32]

    @classmethod
    def even(cls, centers: NDArray[np.float32]) -> Order:
        """Return the order of (N, 3) points: neighbours along a space-filling curve are as far apart in it as can be.

        Any beginning holds every so-many-th point along the curve, thus the same part of every region, dense or not.
        """
        keys = _places(centers) << np.uint64(_ID_BITS) | np.arange(len(centers), dtype=np.uint64)
        keys.sort()  # many times as fast as an argsort
        along = (keys & np.uint64((1 << _ID_BITS) - 1)).astype(np.int32)
        to_file = along[_bit_reversed(len(along))]
        to_page = np.empty_like(to_file)
        to_page[to_file] = np.arange(len(to_file), dtype=np.int32)
        return cls(to_file, to_page)


def order_of(particles: Particles) -> Order | None:
    """Return the order in which pages get particles; None for that of the file, where all are sent at once.

    Computed once for each `Particles`.
    """
    spheres = SphereSet.of(particles)
    if len(spheres) <= FIRST:
        return None
    found: Order = spheres.derived.get("order") or Order.even(spheres.centers)
    spheres.derived["order"] = found
    return found


def _places(centers: NDArray[np.float32]) -> NDArray[np.uint64]:
    """(N,) places along a Morton curve through the bounds of the points."""
    low = centers.min(axis=0)
    extent = float((centers.max(axis=0) - low).max()) or 1.0
    cells = np.arange(1 << _BITS, dtype=np.uint64)
    spread = np.zeros_like(cells)  # two zeros between all bits
    for bit in range(_BITS):
        spread |= (cells >> np.uint64(bit) & np.uint64(1)) << np.uint64(3 * bit)
    found = np.zeros(len(centers), np.uint64)
    for start in range(0, len(centers), _BLOCK):
        part = ((centers[start : start + _BLOCK] - low) * np.float32(len(cells) / extent)).astype(np.int32)
        for axis in range(3):
            found[start : start + _BLOCK] |= spread[np.minimum(part[:, axis], len(cells) - 1)] << np.uint64(
                axis
            )
    return found


def _bit_reversed(count: int) -> NDArray[np.int32]:
    """(N,) the numbers 0 .. N - 1 in the order of their bits read backwards, a van der Corput sequence."""
    found = np.zeros(1, np.int32)
    while len(found) < count:
        found = np.concatenate([2 * found, 2 * found + 1])
    return found[found < count]
