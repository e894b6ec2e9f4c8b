"""Particles in few bytes, for pages that are files. What is left out is smaller than anybody can see.

Every particle has a row of whole numbers, the columns; how they become positions, radii and scalars is in a JSON description beside
them. ``client/unpacking.js`` is the reader.

=========  =====  ================================================================================================================
column     bytes  meaning
=========  =====  ================================================================================================================
x, y, z    2, 3   steps from the lowest coordinate; the bits on top that the finest step does not need hold the radius
radius     0-2    where those bits are too few: steps of the logarithm, or a number in a list of all radii there are
scalars    1-3    whole numbers as they are, others in steps of their range, or of their logarithm where it spans decades
=========  =====  ================================================================================================================

Positions and radii are kept to a two-hundredth of the smallest radius each: half a pixel for a sphere 200 pixels wide.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxel.particles import Particles
from luxel.scene.view import View
from luxel.trace.spheres import SphereSet

__all__ = ["Column", "PackedParticles", "pack_particles"]

_PRECISION = 1 / 200  # of a radius
_DECADES = 1000.0  # largest over least positive value, from which on logarithms are stored
_SPAN = 1e-20  # of the largest value: what lies below is shown as this, or steps would show at the other end
_WHOLE_MAX = 1 << 24  # what float32 holds exactly


@dataclass(frozen=True, eq=False)
class Column:
    """Whole numbers of all particles.

    Parameters
    ----------
    values
        (N,) uint32.
    nbytes
        Bytes of each.
    """

    values: NDArray[np.uint32]
    nbytes: int

    def pack(self, part: slice) -> bytes:
        """Return the part as differences from one particle to the next, low bytes first: what packs well."""
        values = self.values[part]
        steps = np.diff(values, prepend=np.uint32(0))
        return b"".join(((steps >> (8 * k)) & 255).astype(np.uint8).tobytes() for k in range(self.nbytes))


@dataclass(frozen=True, eq=False)
class PackedParticles:
    """Columns, and what they mean.

    Parameters
    ----------
    count
        Number of particles.
    columns
        In the order of the description's.
    description
        For the reader, fit for JSON.
    """

    count: int
    columns: tuple[Column, ...]
    description: dict[str, Any]

    @property
    def bytes_each(self) -> dict[str, int]:
        """Bytes a particle, by what they are for."""
        found = {"positions": sum(column.nbytes for column in self.columns[:3])}
        rest = iter(self.columns[3:])
        if self.description["radii"]["column"]:
            found["radii"] = next(rest).nbytes
        for scalar in self.description["scalars"]:
            found[scalar["name"]] = next(rest).nbytes
        if self.description["ids"]:
            found["ids"] = next(rest).nbytes
        return found

    def pack(self, part: slice) -> bytes:
        """Return the columns of a part of the particles, one after the other."""
        return b"".join(column.pack(part) for column in self.columns)


def pack_particles(
    particles: Particles, names: Sequence[str], ids: NDArray[np.int32] | None = None
) -> PackedParticles:
    """Pack particles with some of their scalars.

    Parameters
    ----------
    particles
        All of them: they fix the units and ranges.
    names
        Scalars to keep; of vectors that are colours, all three components are.
    ids
        (K,) those to keep; None keeps all. A reader knows their ids.
    """
    spheres = SphereSet.of(particles)
    kept = slice(None) if ids is None else ids
    centers, radii = spheres.centers[kept].astype(np.float64), spheres.radii[kept].astype(np.float64)
    low = centers.min(axis=0)
    extent = float((centers.max(axis=0) - low).max())
    least = float(radii.min())
    bits = max(1, math.ceil(math.log2(max(2.0, extent / (2 * _PRECISION * least) + 1))))
    nbytes = 2 if bits <= 16 else 3
    bits = min(bits, 8 * nbytes)
    steps = (1 << bits) - 1
    step = extent / steps if extent > 0 else 1.0
    axes = np.rint((centers - low) / step).astype(np.uint32)
    radius, codes, radius_bits = _pack_radii(radii)
    spare = 8 * nbytes - bits
    radius["column"] = radius_bits > 3 * spare
    more: list[Column] = []
    if radius["column"]:
        more.append(Column(codes, -(-radius_bits // 8)))
    elif radius_bits:
        for axis in range(3):
            axes[:, axis] |= ((codes >> (axis * spare)) & ((1 << spare) - 1)) << bits
    scalars = []
    for name in names:
        about, column = _pack_scalar(particles, name, kept)
        scalars.append(about)
        more.append(column)
    if ids is not None:
        more.append(Column(ids.astype(np.uint32), 4))
    columns = (*(Column(np.ascontiguousarray(axes[:, k]), nbytes) for k in range(3)), *more)
    description = {
        "count": len(centers),
        "positions": {"low": low.tolist(), "step": step, "bits": bits},
        "radii": radius,
        "scalars": scalars,
        "ids": ids is not None,
        "columns": [column.nbytes for column in columns],
    }
    return PackedParticles(len(centers), columns, description)


def _pack_radii(radii: NDArray[np.float64]) -> tuple[dict[str, Any], NDArray[np.uint32], int]:
    """Return what codes mean, the codes, and how many bits they have."""
    low, high = float(radii.min()), float(radii.max())
    none = np.zeros(len(radii), np.uint32)
    if high <= low * (1 + 1e-6):
        return {"low": low, "step": 0.0}, none, 0
    known = np.unique(radii[: 1 << 16])
    if len(known) <= 256:
        known = np.unique(radii)
    if len(known) <= 256:
        codes = np.searchsorted(known, radii).astype(np.uint32)
        return {"list": known.tolist()}, codes, max(1, math.ceil(math.log2(len(known))))
    span = math.log(high / low)
    bits = max(1, math.ceil(math.log2(span / (2 * _PRECISION) + 1)))
    step = span / ((1 << bits) - 1)
    codes = np.rint(np.log(radii / low) / step).astype(np.uint32)
    return {"low": low, "step": step}, codes, bits


def _pack_scalar(particles: Particles, name: str, kept: Any) -> tuple[dict[str, Any], Column]:
    values = particles.scalar(name)
    view = View(color_by=name)
    about: dict[str, Any] = {
        "name": name,
        "range": view.scalar_range(particles),
        "log_range": view.with_changes(log=True).scalar_range(particles),
        "whole": values.dtype.kind in "iu",
    }
    values = values[kept]
    if about["whole"] and int(values.max()) - int(values.min()) < _WHOLE_MAX:
        least = int(values.min())
        span = int(values.max()) - least
        about |= {"low": least, "step": 1}
        return about, Column(
            (values.astype(np.int64) - least).astype(np.uint32),
            1 if span < 1 << 8 else 2 if span < 1 << 16 else 3,
        )
    # The last code says that there is no value; values without bounds are shown as the last of those that have some.
    most = (1 << 16) - 2
    values = np.asarray(values, np.float64)
    finite = values[np.isfinite(values)]
    positive = finite[finite > 0]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    if low >= 0 and len(positive) and high / float(positive.min()) > _DECADES:
        # Code 0 is 0 itself, which has no logarithm.
        low = max(float(positive.min()), _SPAN * high)
        step = math.log(high / low) / (most - 1)
        about |= {"log": True, "low": low, "step": step}
        with np.errstate(divide="ignore", invalid="ignore"):
            codes = np.where(values > 0, 1 + np.log(np.clip(values, low, high) / low) / step, 0)
    else:
        step = (high - low) / most
        about |= {"low": low, "step": step}
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            codes = (np.clip(values, low, high) - low) / step if step > 0 else np.zeros(len(values))
    codes = np.where(np.isnan(values), most + 1, np.rint(codes))
    about["missing"] = most + 1
    return about, Column(codes.astype(np.uint32), 2)
