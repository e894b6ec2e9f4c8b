"""Particles in an order of which every beginning is spread evenly: a page that has some of them shows all of the data, thinner."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxel.particles import Particles
from luxel.trace.spheres import SphereSet

__all__ = ["FIRST", "Order", "order_of"]

#: Pages take so many particles in at once; of more, they ask for some and then for the rest, part by part.
FIRST = 1 << 21

_BITS = 16  # of a coordinate, in a place along the curve
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
        along = np.argsort(_places(centers)).astype(np.int32)
        to_file = along[_bit_reversed(len(along))]
        to_page = np.empty_like(to_file)
        to_page[to_file] = np.arange(len(to_file), dtype=np.int32)
        return cls(to_file, to_page)


def order_of(particles: Particles) -> Order | None:
    """Return the order in which pages get particles; None for that of the file, where all are sent at once.

    Computed once for each `Particles`.
    """
    if len(particles) <= FIRST:
        return None
    spheres = SphereSet.of(particles)
    found: Order = spheres.derived.get("order") or Order.even(spheres.centers)
    spheres.derived["order"] = found
    return found


def _places(centers: NDArray[np.float32]) -> NDArray[np.uint64]:
    """(N,) places along a Morton curve through the bounds of the points."""
    low = centers.min(axis=0)
    extent = float((centers.max(axis=0) - low).max()) or 1.0
    found = np.zeros(len(centers), np.uint64)
    for start in range(0, len(centers), _BLOCK):
        part = (centers[start : start + _BLOCK] - low) * np.float32(((1 << _BITS) - 1) / extent)
        for axis in range(3):
            found[start : start + _BLOCK] |= _spread(part[:, axis].astype(np.uint64)) << np.uint64(axis)
    return found


def _spread(x: NDArray[np.uint64]) -> Any:
    """Put two zeros between all bits of numbers of 16 bits."""
    for shift, mask in (
        (32, 0xFFFF00000000FFFF),
        (16, 0x00FF0000FF0000FF),
        (8, 0xF00F00F00F00F00F),
        (4, 0x30C30C30C30C30C3),
        (2, 0x9249249249249249),
    ):
        x = (x | (x << np.uint64(shift))) & np.uint64(mask)
    return x


def _bit_reversed(count: int) -> NDArray[np.uint32]:
    """(N,) the numbers 0 .. N - 1 in the order of their bits read backwards, a van der Corput sequence."""
    bits = max(1, (count - 1).bit_length())
    x = np.arange(1 << bits, dtype=np.uint32)
    for shift, mask in ((1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF)):
        x = ((x >> np.uint32(shift)) & np.uint32(mask)) | ((x & np.uint32(mask)) << np.uint32(shift))
    x = ((x >> np.uint32(16)) | (x << np.uint32(16))) >> np.uint32(32 - bits)
    return x[x < count]
