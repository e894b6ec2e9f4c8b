"""What the two VTK formats share: types of numbers, and arrays to particles."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxel.io.columns import find_radii, group_columns
from luxel.io.frame import Frame

__all__ = ["to_frame", "words_to_numbers"]

_TIMES = ("TIME", "TimeValue", "Time", "time")


def words_to_numbers(words: list[bytes] | list[str], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Convert words to numbers of `dtype`; raises ValueError for a word that is none."""
    if dtype.kind == "f":
        return np.array(words, dtype=np.float64).astype(dtype)
    try:
        return np.array(words, dtype=np.int64).astype(dtype)
    except ValueError:  # some writers put decimal points into integers
        return np.array(words, dtype=np.float64).astype(np.int64).astype(dtype)


def to_frame(
    positions: NDArray[Any], arrays: Mapping[str, NDArray[Any]], fields: Mapping[str, NDArray[Any]]
) -> Frame:
    """Build a frame from points, point arrays and the fields of the whole data set."""
    radii, source = find_radii(arrays) or (None, None)
    time = next(
        (float(fields[name].reshape(())) for name in _TIMES if name in fields and fields[name].size == 1),
        None,
    )
    return Frame(positions, group_columns(arrays), radii, source, {}, None, time)
