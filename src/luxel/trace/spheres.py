"""Spheres in normalised units: what kernels, tree and browser work on."""

from __future__ import annotations

import logging
import math
import threading
import weakref
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from luxel.particles import Particles

__all__ = ["SphereSet"]

_CACHE: weakref.WeakKeyDictionary[Particles, SphereSet] = weakref.WeakKeyDictionary()
_CACHE_LOCK = threading.Lock()
_log = logging.getLogger(__name__)
# Single precision places a sphere of this radius, in units, to within a sixteenth of it.
_FINEST = 1e-6


@dataclass(frozen=True, eq=False)
class SphereSet:
    """Spheres moved to the origin and scaled to about unit size.

    Scaling by a power of two is exact, so that a data set and its scaled copy have the same light bit for bit, and
    squares of coordinates stay in range whatever the length unit (nanometres, centimetres of a galaxy).

    Attributes
    ----------
    centers
        (N, 3) float32, (position - center) / unit.
    radii
        (N,) float32, radius / unit.
    center
        (3,) float64 in file units.
    unit
        A power of two near half the diagonal of the bounds, in file units.
    derived
        What was computed from these spheres and lives as long as they do (the tree).
    """

    centers: NDArray[np.float32]
    radii: NDArray[np.float32]
    center: NDArray[np.float64]
    unit: float
    derived: dict[str, Any] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, particles: Particles) -> SphereSet:
        """Return the spheres of `particles`, computed once for each `Particles`.

        Particles with scaled radii are normalised as the unscaled ones are, and share their centres.
        """
        base = None if particles.unscaled is particles else cls.of(particles.unscaled)
        with _CACHE_LOCK:
            found = _CACHE.get(particles)
            if found is None:
                found = cls._normalised(particles) if base is None else base._with_radii_of(particles)
                _CACHE[particles] = found
            return found

    @classmethod
    def _normalised(cls, particles: Particles) -> SphereSet:
        low, high = particles.bounds
        half = 0.5 * float(np.linalg.norm(high - low))
        unit = 2.0 ** round(math.log2(half)) if half > 0 else 1.0
        center = 0.5 * (low + high)
        shift = (center - particles.origin).astype(np.float32)
        # The shift is rounded to the particles' own precision, so subtracting it loses nothing more.
        center = particles.origin + shift.astype(np.float64)
        centers = np.ascontiguousarray((particles.local - shift) * np.float32(1 / unit))
        if unit > 2.0**100 or unit < 2.0**-100:  # 1/unit itself would leave float32
            centers = ((particles.local.astype(np.float64) - shift) / unit).astype(np.float32)
        radii = (particles.radii.astype(np.float64) / unit).astype(np.float32)
        _warn_of_tiny(particles, unit)
        return cls(centers, radii, center, unit)

    def _with_radii_of(self, particles: Particles) -> SphereSet:
        radii = (particles.radii.astype(np.float64) / self.unit).astype(np.float32)
        return SphereSet(self.centers, radii, self.center, self.unit)

    def __len__(self) -> int:
        return len(self.centers)

    def to_unit(self, points: ArrayLike) -> NDArray[np.float64]:
        """Move points (…, 3) from file units to normalised ones."""
        return np.asarray((np.asarray(points, dtype=np.float64) - self.center) / self.unit)

    def length_to_unit(self, length: float) -> float:
        """Scale a length from file units to normalised ones."""
        return length / self.unit

    def bounds(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Lowest and highest corner of the spheres in normalised units, (3,) each."""
        radii = self.radii[:, None]
        return (self.centers - radii).min(axis=0), (self.centers + radii).max(axis=0)


def _warn_of_tiny(particles: Particles, unit: float) -> None:
    tiny = int(np.count_nonzero(particles.radii < _FINEST * unit))
    if tiny:
        smallest = int(np.argmin(particles.radii))
        _log.warning(
            "%d of %d particles have radii below a millionth of the scene (particle %d: %g in a scene of %g): "
            "light and pictures of them are rough; keep fewer of what is far away, or enlarge the radii",
            tiny, len(particles), smallest, particles.radii[smallest], 2 * unit,
        )  # fmt: skip
