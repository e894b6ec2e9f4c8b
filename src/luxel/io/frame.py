"""What a reader hands over, and how it becomes Particles."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from luxel.errors import FormatError, InputError
from luxel.particles import Cell, Particles

__all__ = ["Frame", "Radius", "axes_to_radius", "encode_labels", "to_particles"]

Radius = float | str | None


@dataclass(frozen=True)
class Frame:
    """One decoded time step, not yet checked.

    Parameters
    ----------
    positions
        (N, 3) float, file units.
    scalars
        Name to (N,) or (N, k) numbers.
    radii
        (N,) float, file units, or None where the file has none.
    radii_source
        Where `radii` comes from, for people.
    categories
        Scalar name to the labels of its codes.
    """

    positions: NDArray[Any]
    scalars: Mapping[str, NDArray[Any]]
    radii: NDArray[Any] | None = None
    radii_source: str | None = None
    categories: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    cell: Cell | None = None
    time: float | None = None


def to_particles(frame: Frame, path: str | os.PathLike[str], index: int, radius: Radius) -> Particles:
    """Build Particles, choosing radii: `radius` if it is a number, else the file's, else an estimate.

    Raises
    ------
    FormatError
        If the frame's numbers cannot be particles; the message names the file and the frame.
    """
    radii: ArrayLike | None = frame.radii
    source = frame.radii_source
    if isinstance(radius, str):  # "auto": the file's radii are not wanted
        radii, source = None, None
    elif radius is not None:
        radii, source = radius, "given"
    try:
        return Particles(
            frame.positions,
            radii,
            frame.scalars,
            cell=frame.cell,
            time=frame.time,
            categories=frame.categories,
            radii_source=source,
        )
    except InputError as error:
        raise FormatError(path, str(error), place=f"frame {index}") from error


def axes_to_radius(name: str, values: NDArray[Any], *, diameter: bool = False) -> tuple[NDArray[Any], str]:
    """Return (N,) radii and their source from a column of radii or diameters, or of an ellipsoid's axes."""
    source = f"column {name}"
    if values.ndim == 2:
        axes = values.shape[1]
        values = values.mean(axis=1)
        source = f"column {name}, mean of its {axes} axes" if axes > 1 else source
    if diameter:
        return np.asarray(values) / 2, f"half of {source}"
    return values, source


def encode_labels(values: NDArray[Any]) -> tuple[NDArray[np.int32], tuple[str, ...]]:
    """Turn text into integer codes and the labels of code 0, 1, 2 ..., sorted."""
    labels, codes = np.unique(values, return_inverse=True)
    texts = (label.decode("utf-8", "replace") if isinstance(label, bytes) else str(label) for label in labels)
    return codes.reshape(-1).astype(np.int32), tuple(texts)
