"""SeenMarks: which particles rays have hit since they were cleared."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from luxel.kernels.seen import clear_seen, list_seen

__all__ = ["SeenMarks"]

_BLOCK = 64 * 64  # particles that a word of `marked` stands for


class SeenMarks:
    """Marks of particles, a bit each for each thread, so that none waits for another's memory.

    What is not touched takes neither memory nor time. Each row belongs to one thread at a time; the rest is not safe to share.

    Parameters
    ----------
    count
        Particles.
    threads
        That mark at the same time.

    Attributes
    ----------
    marks, marked
        (threads, W) and (threads, W / 64) int64, see :func:`luxel.kernels.seen.mark_seen`.
    """

    def __init__(self, count: int, threads: int) -> None:
        blocks = -(-count // _BLOCK)
        self.marks: NDArray[np.int64] = np.zeros((threads, 64 * blocks), np.int64)
        self.marked: NDArray[np.int64] = np.zeros((threads, blocks), np.int64)

    def clear(self) -> None:
        """Unmark all."""
        clear_seen(self.marks, self.marked)

    def list_into(self, found: NDArray[np.int32], slot: NDArray[np.int32]) -> int:
        """Write the marked particles, ascending, to the beginning of `found` (count,); return how many there are.

        Their places in `slot` (count,), which are looked at next, are fetched meanwhile.
        """
        return int(list_seen(self.marks, self.marked, found, slot))
