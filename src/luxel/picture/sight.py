"""Sight: what a camera has seen since it moved last, how it is lit, and what of it has been told."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from luxel.kernels.seen import count_slots
from luxel.picture.seen import SeenMarks
from luxel.textures.textures import TextureSource, TextureTable

__all__ = ["Sight"]

# Requests of a client that keeps looking elsewhere lapse after two seconds; one that rests repeats itself sooner.
_TELL_AGAIN_S = 0.5


class Sight:
    """Particles that rays have met. Not safe to share; `marks` has a row for each thread that draws.

    Attributes
    ----------
    marks
        Where rays mark what they meet.
    count
        Particles seen since the camera moved, as of the last :meth:`gather`.
    lit
        How many of them showed a texture, first light, and a texture of the light before.
    """

    def __init__(self, threads: int) -> None:
        self._threads = threads
        self.marks = SeenMarks(0, threads)
        self._others = SeenMarks(0, threads)  # hold what the frame before saw until that is told
        self.count = 0
        self.lit: tuple[int, int, int] = (0, 0, 0)
        self._found: NDArray[np.int32] = np.empty(0, np.int32)  # the first `_listed` have been seen
        self._listed = 0
        self._digest = 0  # of their slots
        self._told = ("", 0)  # light key, and how many of them the source was told
        self._told_s = -np.inf

    def forget(self, count: int) -> None:
        """Begin anew, with so many particles in all."""
        if len(self._found) != count:
            self.marks, self._others = SeenMarks(count, self._threads), SeenMarks(count, self._threads)
            self._found = np.empty(count, np.int32)
        else:
            self.marks, self._others = self._others, self.marks
            self.marks.clear()
        self.count, self._listed, self._told = 0, 0, ("", 0)
        self._digest, self.lit = 0, (0, 0, 0)

    def changes(self, table: TextureTable) -> bool:
        """Whether what has been seen looks otherwise by this table than by that of the last :meth:`gather`."""
        return bool(count_slots(self._list(), table.slot)[-1] != self._digest)

    def gather(self, table: TextureTable) -> None:
        """Count what has been seen, and what of it has light; `table` is what was drawn by, or, if nothing was drawn, another one."""
        self.count, *lit, self._digest = self.marks.tally(table.slot)
        self.lit = lit[0], lit[1], lit[2]

    def _list(self) -> NDArray[np.int32]:
        """Return what had been seen at the last :meth:`gather`."""
        if self._listed != self.count:  # what is marked grows
            self._listed = self.marks.list_into(self._found)
        return self._found[: self.count]

    def is_told(self, source: TextureSource) -> bool:
        """Whether the source knows of all that has been gathered."""
        return self._told == (source.key, self.count)

    def tell(self, source: TextureSource, eye: NDArray[np.float64], now_s: float) -> None:
        """Tell the source what is seen: when there is more of it, and now and then, so that requests do not lapse."""
        now = source.key, self.count
        if self._told == now and now_s - self._told_s < _TELL_AGAIN_S:
            return
        self.telling(source, eye)()
        self._told, self._told_s = now, now_s

    def telling(
        self, source: TextureSource, eye: NDArray[np.float64], then: Callable[[], object] | None = None
    ) -> Callable[[], None]:
        """Return what tells the source, and does something then, if it is called once, at the latest while the next frame is drawn."""
        marks, found = self.marks, self._found

        def tell() -> None:
            if marks is self.marks:  # the camera rests: the next frame marks what it sees there as well
                ids = self._list()
            else:
                ids = found[: marks.list_into(found)]
                marks.clear()
            if len(ids):
                source.sighted(ids, eye)
                if then is not None:
                    then()

        return tell
