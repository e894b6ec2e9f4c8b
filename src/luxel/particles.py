"""Particles: what the data is, whatever file it came from."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from luxel.arrays import as_points, as_radii, as_vector
from luxel.errors import InputError, ScalarError

__all__ = ["Cell", "Particles", "estimate_radius"]

_COMPONENTS: Mapping[int, tuple[str, ...]] = MappingProxyType(
    {
        2: ("x", "y"),
        3: ("x", "y", "z"),
        6: ("xx", "yy", "zz", "xy", "xz", "yz"),
        9: ("xx", "xy", "xz", "yx", "yy", "yz", "zx", "zy", "zz"),
    }
)
# A data set this many times its own size away from zero keeps a float64 origin of its own.
_FAR_FROM_ZERO = 16.0
_SPACING_SAMPLE_COUNT = 20_000


@dataclass(frozen=True)
class Cell:
    """A simulation cell.

    Parameters
    ----------
    vectors
        (3, 3) float64, one cell vector a row, in file units.
    origin
        (3,) float64, the corner that the vectors start from.
    periodic
        Whether the cell repeats along each vector.
    """

    vectors: NDArray[np.float64]
    origin: NDArray[np.float64]
    periodic: tuple[bool, bool, bool] = (True, True, True)

    def __post_init__(self) -> None:
        vectors = np.array(self.vectors, dtype=np.float64)
        if vectors.shape != (3, 3) or not np.isfinite(vectors).all():
            raise InputError(f"a cell needs three finite vectors of shape (3, 3), got {vectors.shape}")
        object.__setattr__(self, "vectors", vectors)
        object.__setattr__(self, "origin", as_vector(self.origin, "the cell's origin"))


class Particles:
    """Spheres with named scalars at one moment in time.

    Parameters
    ----------
    positions
        (N, 3) float, in the units of the file. N may be 0; what draws or lights particles refuses that.
    radii
        One number or (N,), in the same units; None estimates one radius from the spacing of neighbours
        (see :func:`estimate_radius`).
    scalars
        Name to (N,) or, for vectors and tensors, (N, k) numbers. NaN means "no data".
    cell
        The simulation cell, if there is one.
    time
        The moment in the simulation's own unit, if known.
    categories
        For scalars that are codes: name to the label of code 0, 1, 2 ...
    radii_source
        Where the radii come from, for people: ``"given"``, ``"column radius"``, ``"estimated …"``.

    Attributes
    ----------
    origin
        (3,) float64. Zero unless the data lies far from it.
    local
        (N, 3) float32, positions relative to `origin`: large offsets lose no digits.
    radii
        (N,) float32.
    radius_scale
        Factor by which :meth:`scaled` has scaled the radii.

    Raises
    ------
    InputError
        For wrong shapes, NaN or infinite positions, radii that are not positive.
    """

    def __init__(
        self,
        positions: ArrayLike,
        radii: ArrayLike | None = None,
        scalars: Mapping[str, ArrayLike] | None = None,
        *,
        cell: Cell | None = None,
        time: float | None = None,
        categories: Mapping[str, tuple[str, ...]] | None = None,
        radii_source: str | None = None,
    ) -> None:
        points = as_points(positions)
        self.origin = _origin(points)
        with np.errstate(over="ignore"):  # what does not fit is reported below
            # A copy, never the caller's own array: it is frozen below.
            self.local: NDArray[np.float32] = np.array(
                points if not self.origin.any() else points - self.origin, dtype=np.float32
            )
        if not np.isfinite(self.local).all():
            raise InputError("positions span more than a 32-bit float can hold — rescale the length unit")
        count = len(points)
        if radii is None:
            self.radii = np.full(count, estimate_radius(self.local), dtype=np.float32)
            self.radii_source = radii_source or "estimated from neighbour spacing"
        else:
            self.radii = as_radii(radii, count)
            self.radii_source = radii_source or "given"
        self.scalars: Mapping[str, NDArray[Any]] = MappingProxyType(
            {name: _as_scalar(name, values, count) for name, values in (scalars or {}).items()}
        )
        self.categories: Mapping[str, tuple[str, ...]] = MappingProxyType(dict(categories or {}))
        self.cell = cell
        self.time = None if time is None else float(time)
        self.radius_scale = 1.0
        self._base: Particles | None = None
        arrays: list[NDArray[Any]] = [self.local, self.radii, self.origin, *self.scalars.values()]
        for array in arrays:
            array.flags.writeable = False

    @classmethod
    def from_local(
        cls, local: NDArray[np.float32], origin: ArrayLike, radii: ArrayLike, **options: Any
    ) -> Particles:
        """Return particles with exactly this `local` (N, 3) and `origin` (3,): what was stored comes back bit for bit.

        Parameters
        ----------
        local, origin, radii
            As the attributes.
        **options
            The other arguments of :class:`Particles`.
        """
        made = cls(local, radii, **options)
        made.local = np.array(local, dtype=np.float32)
        made.origin = as_vector(origin, "the particles' origin")
        made.local.flags.writeable = made.origin.flags.writeable = False
        return made

    def __len__(self) -> int:
        return len(self.local)

    def __repr__(self) -> str:
        time = "" if self.time is None else f", time={self.time:g}"
        return f"Particles({len(self)}, scalars={sorted(self.scalars)}, radii={self.radii_source!r}{time})"

    @property
    def positions(self) -> NDArray[np.float64]:
        """(N, 3) float64 positions in file units, computed from `origin` and `local`."""
        return self.local + self.origin

    @property
    def bounds(self) -> NDArray[np.float64]:
        """(2, 3) float64: the lowest and highest corner of all spheres, radii included.

        Raises
        ------
        InputError
            If there are no particles.
        """
        if len(self) == 0:
            raise InputError("no particles: they have no bounds")
        radii = self.radii[:, None]
        return np.stack([(self.local - radii).min(axis=0), (self.local + radii).max(axis=0)]) + self.origin

    def names(self) -> list[str]:
        """List every name that :meth:`scalar` takes, components included."""
        found = []
        for name, values in self.scalars.items():
            found.append(name)
            if values.ndim == 2:
                found += [f"{name}.{component}" for component in _components(values.shape[1])]
        return found

    def scalar(self, name: str) -> NDArray[Any]:
        """(N,) values of a scalar, a component (``velocity.x``) or a vector's magnitude (``velocity``).

        Raises
        ------
        ScalarError
            If there is no such scalar; the message says which there are.
        """
        if name in self.scalars:
            values = self.scalars[name]
            return values if values.ndim == 1 else np.linalg.norm(values, axis=1)
        base, _, component = name.rpartition(".")
        if base in self.scalars and self.scalars[base].ndim == 2:
            labels = _components(self.scalars[base].shape[1])
            if component in labels:
                return self.scalars[base][:, labels.index(component)]
        known = ", ".join(self.names()) or "none at all"
        raise ScalarError(f"no scalar {name!r} — these particles have: {known}")

    @property
    def unscaled(self) -> Particles:
        """The particles whose radii :meth:`scaled` scaled; these ones, where it did not."""
        return self._base or self

    def scaled(self, factor: float) -> Particles:
        """Return the same particles with all radii `factor` times those of :attr:`unscaled`; arrays are shared.

        Raises
        ------
        InputError
            For a factor that is not positive, or radii that leave the range of float32.
        """
        base = self.unscaled
        if not (math.isfinite(factor) and factor > 0):
            raise InputError(f"the radius scale must be a positive number, got {factor!r}")
        if factor == 1:
            return base
        made = copy.copy(base)
        with np.errstate(over="ignore", under="ignore"):
            radii = base.radii * np.float32(factor)
        made.radii = as_radii(radii, len(base))
        made.radii.flags.writeable = False
        made.radii_source = f"{base.radii_source}, times {factor:g}"
        made.radius_scale = float(factor)
        made._base = base
        return made

    def with_radii(self, radii: ArrayLike | None) -> Particles:
        """Return the same particles with other radii; None estimates them from the spacing."""
        return Particles(
            self.positions if self.origin.any() else self.local,
            radii,
            self.scalars,
            cell=self.cell,
            time=self.time,
            categories=self.categories,
        )


def estimate_radius(points: NDArray[np.floating[Any]]) -> float:
    """Estimate one radius for points that carry none: half the median distance to the nearest neighbour.

    On a lattice the spheres touch. Coincident points are left out, and the radius never falls below a tenth of
    the mean spacing, so that strongly clustered sets (haloes, galaxies) stay visible. A single point gets radius 1.

    Parameters
    ----------
    points
        (N, 3), any unit; the result has the same.
    """
    from scipy.spatial import cKDTree

    count = len(points)
    if count < 2:
        return 1.0
    extent = points.max(axis=0).astype(np.float64) - points.min(axis=0)
    size = float(np.linalg.norm(extent))
    if size == 0.0:
        return 1.0
    step = max(1, count // _SPACING_SAMPLE_COUNT)
    tree = cKDTree(points, balanced_tree=False, compact_nodes=False)
    distance = tree.query(points[::step], k=min(8, count))[0][:, 1:]
    distance[distance <= 1e-6 * size] = np.inf
    nearest = distance.min(axis=1)
    nearest = nearest[np.isfinite(nearest)]
    volume = float(np.prod(np.maximum(extent, 1e-3 * size)))
    spacing = float((volume / count) ** (1 / 3))
    half = 0.5 * float(np.median(nearest)) if len(nearest) else 0.25 * spacing
    return max(half, 0.1 * spacing)


def _origin(points: NDArray[Any]) -> NDArray[np.float64]:
    if len(points) == 0:
        return np.zeros(3)
    low, high = points.min(axis=0).astype(np.float64), points.max(axis=0).astype(np.float64)
    centre = 0.5 * low + 0.5 * high
    far = np.abs(centre).max() > _FAR_FROM_ZERO * max(float((high - low).max()), np.finfo(np.float64).tiny)
    return centre if far else np.zeros(3)


def _components(count: int) -> tuple[str, ...]:
    return _COMPONENTS.get(count) or tuple(str(k) for k in range(count))


def _as_scalar(name: str, values: ArrayLike, count: int) -> NDArray[Any]:
    array = np.array(values)  # a copy: the particles own what they hold
    if array.dtype.kind == "b":
        array = array.astype(np.uint8)
    if array.dtype.kind not in "fiu":
        raise InputError(f"scalar {name!r} must be numbers, got dtype {array.dtype}")
    if array.ndim > 2 and array.shape[0] == count:
        array = array.reshape(count, -1)
    if array.ndim not in (1, 2) or array.shape[0] != count:
        raise InputError(f"scalar {name!r} must have shape ({count},) or ({count}, k), got {array.shape}")
    return array
