"""Arena: memory for textures in slots, reserved once, taken from the system only as slots are first written."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from luxel.dynamic.sightings import Ids
from luxel.errors import InputError

__all__ = ["NOBODY", "SLOT_BYTES", "Arena"]

NOBODY = -1
#: What a slot costs besides its texture: `light`, `owner`, `seen`, and its place in a list of free ones.
SLOT_BYTES = 20


class Arena:
    """Slots for textures. Holds no lock: every slot belongs to one shard, which alone touches it.

    Parameters
    ----------
    count
        Slots.
    shape
        Of a texture's codes, or of its record.

    Attributes
    ----------
    codes
        (count, *shape) uint8.
    light, owner
        (count,) int32: light number, `NOBODY` for a slot not in use, and particle id.
    seen
        (count,) int64: number of the sighting that showed it last.

    Raises
    ------
    InputError
        If the system refuses so much memory.
    """

    def __init__(self, count: int, shape: tuple[int, ...]) -> None:
        try:
            self.codes: NDArray[np.uint8] = np.empty((count, *shape), np.uint8)
            self.light: Ids = np.empty(count, np.int32)
            self.owner: Ids = np.empty(count, np.int32)
            self.seen: NDArray[np.int64] = np.empty(count, np.int64)
        except MemoryError:
            size = count * (int(np.prod(shape)) + SLOT_BYTES)
            raise InputError(
                f"the system does not give {size >> 20} MiB for textures — set a smaller budget (max_bytes)"
            ) from None
