"""What each client sees, and how particle ids are spread over shards."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from luxel.kernels.requests import sort_by_shard

__all__ = ["Ids", "Measure", "Sighting", "by_shard", "shard_of"]

Ids = NDArray[np.int32]

#: Distances (K,) of particles from the eye in diagonals of the scene, and their widths (K,) in pixels or None if unknown.
Measure = Callable[[Ids], tuple[NDArray[np.floating], NDArray[np.floating] | None]]


@dataclass(frozen=True, eq=False)
class Sighting:
    """What one client sees at one moment.

    Parameters
    ----------
    client
        Who.
    number
        Counts the sightings of all clients.
    key
        The light key that it shows.
    ids
        (K,) int32, every visible particle, ascending, each once.
    measure
        How far and how large they are; called later, on a thread of the engine, for what needs a texture.
    seen_s
        When, in seconds.
    eye
        (3,) from where, in normalised units; None if nobody says.
    """

    client: str
    number: int
    key: str
    ids: Ids
    measure: Measure
    seen_s: float
    eye: NDArray[np.float32] | None = None
    _parts: dict[int, list[Ids]] = field(default_factory=dict, repr=False)

    def part(self, shard: int, shards: int) -> Ids:
        """Return those of `ids` that belong to a shard, ascending."""
        if shards == 1:
            return self.ids
        if shards not in self._parts:  # two threads that do this at once do the same
            places = by_shard(self.ids, shards)
            self._parts[shards] = [self.ids[place] for place in places]
        return self._parts[shards][shard]


def shard_of(ids: Ids, shards: int) -> NDArray[np.uint8]:
    """(K,) the shard of each particle, 0 <= shard < `shards`, a power of two up to 256.

    Hashed, since what is visible often has ids of one residue or one range: files list lattices layer by layer.
    """
    if shards == 1:
        return np.zeros(len(ids), np.uint8)
    mixed = ids.astype(np.uint32) * np.uint32(2_654_435_769)  # Knuth's multiplicative hash
    return (mixed >> np.uint32(_shift(shards))).astype(np.uint8)


def by_shard(ids: Ids, shards: int) -> list[NDArray[np.intp]]:
    """Where in `ids` each shard's particles are, ascending."""
    order, ends = np.empty(len(ids), np.intp), np.empty(shards, np.intp)
    sort_by_shard(np.ascontiguousarray(ids), _shift(shards), ends, order)
    edges = [0, *ends.tolist()]
    return [order[edges[k] : edges[k + 1]] for k in range(shards)]


def _shift(shards: int) -> int:
    """Of a hash of 32 bits, how many do not tell the shard."""
    return 33 - shards.bit_length()
