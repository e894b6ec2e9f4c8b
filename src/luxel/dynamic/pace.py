"""Pace: how fast work goes, what each piece costs besides, and so how much of it makes a piece of a given time."""

from __future__ import annotations

from collections import deque

__all__ = ["Cost", "Pace", "Rate"]

_LARGEST_PIECE = 1024
# Before anything is known: tiny pieces would be as many messages to a page, but a frame's budget must not be overrun by much.
_FIRST_PIECE, _FIRST_CAREFUL_PIECE = 16, 1
_WINDOW_S = 3.0
_COST_RISES, _COST_FALLS = 1 / 8, 1 / 2


class Pace:
    """Measures pieces of one kind of work. Holds no lock and no clock: the owner calls it under its own lock and passes times in.

    Attributes
    ----------
    each_s
        Seconds for one particle on one thread, as found lately; 0 before anything is known.
    """

    def __init__(self) -> None:
        self.each_s = 0.0
        self._took_s = self._count = 0.0  # of the last piece, half of the one before, and so on
        self._largest = 0  # pieces at most double

    def record(self, took_s: float, count: int) -> None:
        """Note that `count` particles took so many seconds."""
        now = max(0.0, took_s) / count
        # A single slow piece, such as a first call that compiles, must not make pieces tiny for long, nor a fast one make them huge.
        if self.each_s > 0:
            now = min(max(now, self.each_s / 2), self.each_s * 2)
        # By particles, not by pieces: the few that fill up a budget take longer each.
        self._took_s, self._count = self._took_s / 2 + now * count, self._count / 2 + count
        self.each_s = self._took_s / self._count
        self._largest = min(_LARGEST_PIECE, max(self._largest, 2 * count))

    def count(self, limit_s: float, *, careful: bool = False) -> int:
        """Particles that take about `limit_s` seconds, at least one; few before anything is known, and one if `careful`."""
        largest = self._largest or (_FIRST_CAREFUL_PIECE if careful else _FIRST_PIECE)
        if self.each_s == 0:
            return largest
        return int(max(1, min(limit_s / self.each_s, largest)))


class Cost:
    """What a piece costs, however small: taking it and handing it in. Holds no lock and no clock.

    Attributes
    ----------
    each_s
        Seconds, of the cheaper ones among the last pieces; 0 before anything is known.
    """

    def __init__(self) -> None:
        self.each_s = 0.0

    def record(self, took_s: float) -> None:
        """Note what one piece cost."""
        more_s = max(0.0, took_s) - self.each_s
        # One that compiled something or waited long for others must not pass for the rule for long.
        self.each_s += more_s * (_COST_FALLS if more_s < 0 or self.each_s == 0 else _COST_RISES)


class Rate:
    """How many things a second are finished, over the last few seconds. Holds no lock and no clock."""

    def __init__(self) -> None:
        self._finished: deque[tuple[float, int]] = deque()

    def record(self, now_s: float, count: int) -> None:
        """Note that so many are finished."""
        self._finished.append((now_s, count))

    def per_s(self, now_s: float) -> float:
        """Return the rate."""
        while self._finished and self._finished[0][0] <= now_s - _WINDOW_S:
            self._finished.popleft()
        return sum(count for _, count in self._finished) / _WINDOW_S
