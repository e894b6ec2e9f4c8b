"""Look: how far and how large the particles are that a client sees."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxel.arrays import as_ids
from luxel.dynamic.sightings import Ids
from luxel.kernels.seen import are_rising, distances
from luxel.trace.spheres import SphereSet

__all__ = ["Look"]


@dataclass(frozen=True, eq=False)
class Look:
    """Measures particles as one client sees them; a :data:`luxel.dynamic.sightings.Measure`.

    Parameters
    ----------
    spheres
        All particles.
    eye
        (3,) in file units.
    diagonal
        Of the scene, in normalised units.
    visible
        (K,) ids, ascending, each once.
    pixels
        (K,) how wide they are on the screen, beside `visible`; None if nobody knows.
    """

    spheres: SphereSet
    eye: NDArray[np.float64]
    diagonal: float
    visible: Ids
    pixels: NDArray[np.float32] | None

    @classmethod
    def at(
        cls,
        spheres: SphereSet,
        eye: NDArray[np.float64],
        diagonal: float,
        ids: NDArray[Any],
        pixels: NDArray[np.float32] | None,
    ) -> Look:
        """Make a look of ids in any order, with repetitions; `ids` may change afterwards.

        Raises
        ------
        InputError
            For ids that are not those of particles.
        """
        count = len(spheres.centers)
        plain = ids.dtype == np.int32 and ids.ndim == 1 and ids.flags.c_contiguous
        if plain and are_rising(ids, count):
            return cls(spheres, eye, diagonal, ids.copy(), pixels)
        ids = as_ids(ids, count)
        order = np.argsort(ids, kind="stable")
        ids = ids[order]
        first = np.ones(len(ids), np.bool_)
        first[1:] = ids[1:] > ids[:-1]
        return cls(spheres, eye, diagonal, ids[first], None if pixels is None else pixels[order[first]])

    @property
    def unit_eye(self) -> NDArray[np.float32]:
        """(3,) the eye in normalised units."""
        return self.spheres.to_unit(self.eye).astype(np.float32)

    def __call__(self, ids: Ids) -> tuple[NDArray[np.floating], NDArray[np.floating] | None]:
        """Return (K,) distances from the eye in diagonals, and (K,) widths in pixels, of some of the visible particles."""
        distance = np.empty(len(ids))
        distances(self.spheres.centers, ids, self.spheres.to_unit(self.eye), 1 / self.diagonal, distance)
        if self.pixels is None:
            return distance, None
        return distance, self.pixels[np.searchsorted(self.visible, ids)]
