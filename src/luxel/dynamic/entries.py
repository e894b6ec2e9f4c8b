"""Entries of the cache: the state of every particle's texture under one light key, a byte each."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from luxel.dynamic.sightings import Ids
from luxel.dynamic.slot_table import SlotTable
from luxel.textures.textures import NO_COARSE

__all__ = [
    "BAKING",
    "DAWNING",
    "ENTRY_BYTES",
    "ESTIMATE",
    "FAILED",
    "FULL",
    "GRADE_SHIFT",
    "IDLE",
    "LIT",
    "NONE",
    "QUEUED",
    "STORED",
    "WANTING",
    "Counts",
    "Entries",
    "grade_of",
    "work_of",
]

# Bits 0-1: what is being done for the texture.
IDLE, QUEUED, BAKING, FAILED = range(4)
# Bits 2-3: what there is. An estimate has fewer samples and texels than were asked for.
NONE, ESTIMATE, FULL = range(3)
# First light is there; first light is being made.
LIT, DAWNING = 16, 32

_WORK, GRADE_SHIFT, _GRADE = 3, 2, 12

#: Bytes of a particle's entry: its state, and its slot.
ENTRY_BYTES = 5


def work_of(state: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Part of states that says what is being done: `IDLE`, `QUEUED`, `BAKING` or `FAILED`."""
    return state & np.uint8(_WORK)


def grade_of(state: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Part of states that says which texture there is: `NONE`, `ESTIMATE` or `FULL`."""
    return (state & np.uint8(_GRADE)) >> np.uint8(GRADE_SHIFT)


_STATES = np.arange(256, dtype=np.uint8)
#: (256,) bool: states in which there is a texture.
STORED: NDArray[np.bool_] = grade_of(_STATES) > NONE
#: (256,) bool: states in which something is left to do that nobody does yet.
WANTING: NDArray[np.bool_] = (grade_of(_STATES) < FULL) & (work_of(_STATES) <= QUEUED)


@dataclass(frozen=True)
class Counts:
    """How many particles of one light key are in each state.

    Parameters
    ----------
    missing, queued, baking, failed
        Without a texture: nothing is done about it, one is requested, is being made, has been given up.
    ready
        With a texture that is as good as it gets, or as was asked for.
    refining
        With an estimate, while a better one is requested or being made.
    """

    missing: int = 0
    queued: int = 0
    baking: int = 0
    ready: int = 0
    refining: int = 0
    failed: int = 0

    @classmethod
    def of(cls, by_state: NDArray[np.int64]) -> Counts:
        """Add up (16,) counts by the lower four bits of states."""
        none, *there = by_state.reshape(4, 4)[: FULL + 1].tolist()
        ready = sum(row[IDLE] + row[FAILED] for row in there)
        refining = sum(row[QUEUED] + row[BAKING] for row in there)
        return cls(none[IDLE], none[QUEUED], none[BAKING], ready, refining, none[FAILED])


@dataclass(eq=False)
class Entries:
    """Everything about one light key. Each shard writes the entries of its own particles, under its lock.

    Parameters
    ----------
    key
        Light key.
    number
        Names it in the arena; never used again.
    decoding
        (256,) float32: luminance of each code.
    state
        (N,) uint8: the bits above.
    table
        Slots of the particles.
    counts
        (shards, 16) int64: how many of a shard's particles have each value of the lower four bits.
    coarse
        (N, 4) float32 coarse records, true where state says `LIT`; (0, 4) if they are not kept.
    dropped
        Whether the key has been given up.
    """

    key: str
    number: int
    decoding: NDArray[np.float32]
    state: NDArray[np.uint8]
    table: SlotTable
    counts: NDArray[np.int64]
    coarse: NDArray[np.float32] = field(default_factory=lambda: NO_COARSE)
    dropped: bool = False

    def move(self, shard: int, ids: Ids, work: int, grade: int | None = None) -> None:
        """Change what is being done for some particles of one shard, and which texture there is; under the shard's lock."""
        if not len(ids):
            return
        old = self.state[ids]
        kept = old & np.uint8(~_WORK & 0xFF)
        if grade is not None:
            kept = (kept & np.uint8(~_GRADE & 0xFF)) | np.uint8(grade << GRADE_SHIFT)
        new = kept | np.uint8(work)
        self.counts[shard] += np.bincount(new & 15, minlength=16) - np.bincount(old & 15, minlength=16)
        self.state[ids] = new
