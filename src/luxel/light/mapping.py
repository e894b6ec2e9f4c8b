"""Mappings of luminance textures to the sphere of directions: their names, solid angles and texel centres."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from luxel.errors import InputError

__all__ = [
    "Mapping",
    "mapping_code",
    "square_directions",
    "texel_directions",
    "texel_neighbours",
    "texel_solid_angles",
    "texel_weights",
]

Mapping = Literal["latlong", "octahedral"]

# Kernels are imported where they run: specs, which name a mapping, load without Numba.


def mapping_code(mapping: Mapping) -> int:
    """Return the number by which kernels, shaders and messages know a mapping.

    Raises
    ------
    InputError
        For any other name.
    """
    names = get_args(Mapping)
    if mapping not in names:
        raise InputError(f"mapping must be {' or '.join(names)}, got {mapping!r}")
    return names.index(mapping)


def texel_directions(mapping: Mapping, texels: int) -> NDArray[np.float32]:
    """Return the unit vectors (T, T, 3) of texel centres.

    Parameters
    ----------
    mapping
        ``"latlong"`` or ``"octahedral"``.
    texels
        T, rows and columns.

    Raises
    ------
    InputError
        For an unknown mapping, or texels that are no even number above 0.
    """
    return square_directions(mapping, (np.arange(_checked(texels)) + 0.5) / texels)


def square_directions(mapping: Mapping, at: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return the unit vectors (n, n, 3) of a grid of places in a texture's square: u = at[column], v = at[row]."""
    from luxel.kernels import mapping as kernels

    found = np.empty((len(at), len(at), 3), np.float32)
    kernels.square_directions(mapping_code(mapping), at.astype(np.float32), found)
    return found


def texel_solid_angles(mapping: Mapping, texels: int) -> NDArray[np.float64]:
    """Return the solid angle (T, T) of every texel in steradians: the weights of errors over a sphere; they sum to 4π.

    Parameters and errors are those of :func:`texel_directions`.
    """
    shape = (_checked(texels), texels)
    if mapping_code(mapping) == mapping_code("octahedral"):
        return np.full(shape, 4 * np.pi / texels**2)
    # The cosine's differences over rows, as a product that does not cancel near the poles.
    middle = np.pi * (np.arange(texels) + 0.5) / texels
    rows = 4 * np.pi / texels * np.sin(middle) * np.sin(0.5 * np.pi / texels)
    return np.broadcast_to(rows[:, None], shape).copy()


def texel_neighbours(mapping: Mapping, texels: int) -> NDArray[np.int32]:
    """Return the flat indices (4, T²) of the texels above, below, left and right of each, across edges and poles."""
    from luxel.kernels import mapping as kernels

    found = np.empty((4, _checked(texels) ** 2), np.int32)
    kernels.texel_neighbours(mapping_code(mapping), texels, found)
    return found


def texel_weights(mapping: Mapping, texels: int, finer: int) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Return how to interpolate textures bilinearly at the centres of more texels.

    Parameters
    ----------
    mapping
        ``"latlong"`` or ``"octahedral"``.
    texels, finer
        T and F, rows and columns before and after.

    Returns
    -------
    places, weights
        (4, F²) int32 flat indices of texels; (4, F²) float32, which add up to 1 over the four.
    """
    from luxel.kernels import mapping as kernels

    places = np.empty((4, _checked(finer) ** 2), np.int32)
    weights = np.empty(places.shape, np.float32)
    kernels.texel_weights(mapping_code(mapping), _checked(texels), finer, places, weights)
    return places, weights


def _checked(texels: int) -> int:
    if not isinstance(texels, int | np.integer) or texels < 2 or texels % 2:
        raise InputError(f"texels must be an even number above 0, got {texels!r}")
    return int(texels)
