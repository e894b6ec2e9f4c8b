"""Which cell vectors a scene repeats along, and whether its particles have a cell that can."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from luxel.errors import InputError
from luxel.particles import Cell, Particles

__all__ = ["checked_cell", "parse_axes"]

# The volume of the parallelepiped of the unit vectors along the repeated axes: below this they lie in one plane or line.
_FLAT = 1e-4


def parse_axes(given: str | Sequence[bool]) -> str:
    """Return the axes in order, such as ``"xy"``; they name the first, second and third cell vector.

    Parameters
    ----------
    given
        Any of the letters x, y and z, or three flags.

    Raises
    ------
    InputError
        For anything else.
    """
    if isinstance(given, str):
        letters = given.lower()
        if set(letters) <= set("xyz") and len(set(letters)) == len(letters):
            return "".join(sorted(letters))
    elif len(given) == 3 and all(isinstance(flag, bool | np.bool_) for flag in given):
        return "".join(axis for axis, flag in zip("xyz", given, strict=True) if flag)
    raise InputError(f"periodic must name axes such as 'xyz' or 'xy', or be three flags; got {given!r}")


def checked_cell(particles: Particles, axes: str) -> Cell:
    """Return the cell of particles that are to repeat along `axes`.

    Raises
    ------
    InputError
        For no cell, or one whose vectors along `axes` are zero or span too little.
    """
    cell = particles.cell
    if cell is None:
        raise InputError(
            f"periodic={axes!r} needs a simulation cell, and these particles have none"
            " — leave periodic out, or give Particles a cell"
        )
    vectors = cell.vectors[["xyz".index(axis) for axis in axes]]
    largest = np.abs(vectors).max(axis=1, keepdims=True)  # first, so that squares stay in range
    if (largest == 0).any():
        raise InputError(f"periodic={axes!r}: the cell has no extent along {axes[int(np.argmin(largest))]}")
    rows = vectors / largest
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    if np.sqrt(max(0.0, float(np.linalg.det(rows @ rows.T)))) < _FLAT:
        raise InputError(
            f"periodic={axes!r}: the cell is degenerate, its vectors are almost parallel or in one plane:"
            f" {vectors.tolist()}"
        )
    return cell
