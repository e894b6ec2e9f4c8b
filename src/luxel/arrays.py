"""The one place that checks the dtype, shape and contiguity of arrays that users hand in."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from luxel.errors import InputError

__all__ = ["as_colors", "as_ids", "as_points", "as_radii", "as_vector", "first_bad"]


def first_bad(mask: NDArray[np.bool_]) -> str:
    """Describe the true entries of `mask` for a message: how many, and which comes first."""
    index = int(np.argmax(mask))
    return f"{int(np.count_nonzero(mask))} of {mask.size}, the first at particle {index}"


def as_points(positions: ArrayLike, what: str = "positions") -> NDArray[Any]:
    """Return `positions` as a finite (N, 3) float32 or float64 array.

    Raises
    ------
    InputError
        For another shape, a dtype that is not real, or NaN or infinite coordinates.
    """
    points = _as_real(positions, what)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"{what} must have shape (N, 3), got {points.shape}")
    if points.dtype != np.float32:
        points = points.astype(np.float64, copy=False)
    bad = ~np.isfinite(points).all(axis=1)
    if bad.any():
        raise InputError(
            f"{what} must be finite; NaN or infinite in {first_bad(bad)} — remove these particles or repair the file"
        )
    return np.ascontiguousarray(points)


def as_radii(radii: ArrayLike, count: int, what: str = "radii") -> NDArray[np.float32]:
    """Return `radii` (a number or (N,)) as positive finite float32 of shape (count,)."""
    values = _as_real(radii, what)
    if values.shape not in {(), (1,), (count,)}:
        raise InputError(f"{what} must be one number or have shape ({count},), got {values.shape}")
    if values.size:
        with np.errstate(over="ignore"):
            single = values.astype(np.float32)
        bad = ~(np.isfinite(single) & (single > 0)).reshape(-1)
        if bad.any():
            raise InputError(
                f"{what} must be positive and finite; they are not in {first_bad(bad)} "
                "— give --radius R, or --radius auto to estimate them from the spacing"
            )
        values = single
    return np.ascontiguousarray(np.broadcast_to(values.reshape(-1), (count,)), dtype=np.float32)


def as_colors(colors: ArrayLike, count: int, what: str = "colors") -> NDArray[Any]:
    """Return sRGB `colors` as (count, 3): uint8, or float32 in [0, 1].

    Raises
    ------
    InputError
        For another shape, whole numbers outside 0..255, other numbers outside 0..1, or NaN.
    """
    values = _as_real(colors, what)
    if values.shape != (count, 3):
        hint = ""
        if values.shape == (count, 4):
            hint = " — leave the alpha channel out: particles are opaque"
        elif values.shape == (count,):
            hint = " — one number a particle is a scalar: pass it as color_by, with a colour map"
        raise InputError(f"{what} must have shape ({count}, 3), got {values.shape}{hint}")
    whole = values.dtype.kind in "iu"
    most = 255 if whole else 1
    with np.errstate(invalid="ignore"):
        bad = ~np.all((values >= 0) & (values <= most), axis=1)
    if bad.any():
        raise InputError(
            f"{what} must lie in 0..{most}, as {'whole' if whole else 'floating point'} numbers do; they do not in {first_bad(bad)}"
        )
    return np.ascontiguousarray(values, dtype=np.uint8 if whole else np.float32)


def as_vector(value: ArrayLike, what: str, *, unit: bool = False) -> NDArray[np.float64]:
    """Return three finite numbers as float64 (3,), normalised when `unit`."""
    vector = _as_real(value, what).astype(np.float64).reshape(-1)
    if vector.shape != (3,) or not all(map(math.isfinite, vector.tolist())):
        raise InputError(f"{what} must be three finite numbers, got {value!r}")
    if unit:
        largest = float(np.abs(vector).max())
        if largest > 1e150:  # its square would overflow
            vector = vector / largest
        length = float(np.linalg.norm(vector))
        if length == 0.0:
            raise InputError(f"{what} must not be the zero vector")
        # What is unit already stays bit for bit, so that a scene read back from a store keeps its key.
        if abs(length - 1.0) > 4 * np.finfo(np.float64).eps:
            vector = vector / length
    return vector


def as_ids(ids: ArrayLike | None, count: int, what: str = "ids") -> NDArray[np.int32]:
    """Return particle ids as int32 (M,), every id in [0, count); None means all particles."""
    if ids is None:
        return np.arange(count, dtype=np.int32)
    values = np.asarray(ids)
    if values.ndim != 1 or (values.size and values.dtype.kind not in "iu"):
        raise InputError(
            f"{what} must be a list of whole numbers, got shape {values.shape} and dtype {values.dtype}"
        )
    if values.dtype == np.int32:  # one look at each: as unsigned numbers, negative ones are the largest
        outside = values.size and values.view(np.uint32).max() >= count
    else:
        outside = values.size and (values.min() < 0 or values.max() >= count)
    if outside:
        raise InputError(f"{what} must lie in 0..{count - 1}, got {values.min()}..{values.max()}")
    return np.ascontiguousarray(values, dtype=np.int32)


def _as_real(value: ArrayLike, what: str) -> NDArray[Any]:
    try:
        array = np.asarray(value)
    except ValueError as error:  # ragged lists
        raise InputError(f"{what} must be a regular array of numbers: {error}") from None
    if array.dtype.kind not in "fiub":
        raise InputError(f"{what} must be real numbers, got dtype {array.dtype}")
    return array
