"""SeenMarks: which particles rays have hit since they were cleared."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from luxel.kernels.seen import clear_seen, join_tallies, list_seen, tally_seen

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
        self._tallies: NDArray[np.int64] = np.zeros((threads, 5), np.int64)
        self._tallied = [False] * threads  # since `begin` and the last `tally`
        self._clean = True

    def begin(self) -> None:
        """Take it that no thread has drawn yet, whatever became of what was drawn last."""
        self._tallied = [False] * len(self._tallied)

    def of_thread(self, row: int) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Return marks and tally of one thread, for it to write to."""
        self._clean = False
        self._tallied[row] = True
        return self.marks[row], self.marked[row], self._tallies[row]

    def clear(self) -> None:
        """Unmark all."""
        self.begin()
        if not self._clean:
            clear_seen(self.marks, self.marked)
            self._tallies[...] = 0
            self._clean = True

    def tally(self, slot: NDArray[np.int32]) -> tuple[int, int, int, int, int]:
        """Return how many particles are marked, and what :func:`luxel.kernels.seen.count_slots` finds of them, after all threads have drawn.

        `slot` (count,) is that of the table by which those threads have drawn that did so since the last call.
        """
        for row, done in enumerate(self._tallied):
            if not done:  # but its marks are from before
                tally_seen(self.marks[row], self.marked[row], slot, self._tallies[row])
        self.begin()
        count, textured, dim, stale, digest = join_tallies(self.marks, self.marked, slot, self._tallies)
        return int(count), int(textured), int(dim), int(stale), int(digest)

    def list_into(self, found: NDArray[np.int32]) -> int:
        """Write the marked particles, ascending, to the beginning of `found` (count,); return how many there are."""
        return int(list_seen(self.marks, self.marked, found))
