"""Pace: how fast textures come, and how many to bake at a time."""

from __future__ import annotations

import math
from collections import deque

__all__ = ["Pace"]

_BATCH_S = 0.03  # short enough to notice a new priority soon, long enough to hide what a batch costs besides
_FIRST_BATCH = 16
_LARGEST_BATCH = 512
_WINDOW_S = 3.0


class Pace:
    """Measures batches. Holds no lock and no clock: the engine calls it under its own lock and passes times in.

    Attributes
    ----------
    batch_count
        Textures that take one thread about 30 ms.
    """

    def __init__(self) -> None:
        self.batch_count = _FIRST_BATCH
        self._finished: deque[tuple[float, int]] = deque()

    def record(self, start_s: float, end_s: float, count: int) -> None:
        """Note that `count` textures took from `start_s` to `end_s`, in seconds."""
        self._finished.append((end_s, count))
        aim = count * _BATCH_S / (end_s - start_s) if end_s > start_s else math.inf
        # By a factor of two at most: a first call may compile.
        self.batch_count = int(min(max(aim, self.batch_count / 2, 1), self.batch_count * 2, _LARGEST_BATCH))

    def textures_per_s(self, now_s: float) -> float:
        """Textures finished a second, over the last few seconds."""
        while self._finished and self._finished[0][0] <= now_s - _WINDOW_S:
            self._finished.popleft()
        return sum(count for _, count in self._finished) / _WINDOW_S
