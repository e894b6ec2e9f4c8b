"""Passes: the picture that is shown, and the better one that will replace it, ray by ray."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from luxel.picture.drawing import blank_tiles

__all__ = ["Pass", "Passes", "Sums"]


class Sums(NamedTuple):
    """What rays add up to, see ``kernels.frame``."""

    total: NDArray[np.float32]
    blank: NDArray[np.uint8]

    @classmethod
    def of(cls, width: int, height: int) -> Sums:
        """Make sums of nothing."""
        return cls(np.zeros((height, width, 5), np.float32), blank_tiles(width, height))


@dataclass(eq=False)
class Pass:
    """A picture that grows.

    Parameters
    ----------
    sums
        Of its rays.
    moving
        A single ray through the middle of each pixel.
    want
        Rays a pixel before it replaces what is shown.
    count
        Rays a pixel so far.
    pure
        Whether all of it is under the same light and with the same colours.
    """

    sums: Sums
    moving: bool
    want: int
    count: int = 0
    pure: bool = True


class Passes:
    """Says where the next ray of each pixel goes. Not safe to share.

    Parameters
    ----------
    most
        Rays a pixel of a complete picture.

    Attributes
    ----------
    shown
        What is shown; None before the first picture.
    growing
        What will replace it; None if nothing will.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self.shown: Pass | None = None
        self.growing: Pass | None = None
        self._spare: Sums | None = None

    def next(self, size: tuple[int, int], *, moved: bool, changed: bool) -> Pass | None:
        """Return what gets the next ray; None if the picture is complete.

        Parameters
        ----------
        size
            Width and height.
        moved
            The camera did: all begins anew.
        changed
            The light did, or colours: what is shown is to be replaced.
        """
        most = self._most
        if moved or self.shown is None:
            if self.growing is not None:
                self._spare, self.growing = self.growing.sums, None
            self.shown = _begin(size, None if self.shown is None else self.shown.sums, True, 1)
            return self.shown
        shown = self.shown
        if self.growing is None:
            if changed:
                shown.pure = False
            if not shown.pure or (shown.moving and most > 1):
                sums, self._spare = self._spare, None
                # As good as what it replaces, or half the rays: new light must not wait for all of them.
                want = 1 if most == 1 else (most + 1) // 2
                self.growing = _begin(size, sums, most == 1, want)
            elif shown.count < (1 if shown.moving else most):
                return shown
        elif changed and self.growing.count:
            self.growing.pure = False
        return self.growing

    def drawn(self, current: Pass) -> None:
        """Note that a pass has got its ray: it is shown from now on, if it has enough of them."""
        if current is self.growing and current.count >= current.want:
            assert self.shown is not None
            self._spare, self.shown, self.growing = self.shown.sums, current, None


def _begin(size: tuple[int, int], sums: Sums | None, moving: bool, want: int) -> Pass:
    width, height = size
    if sums is None or sums.total.shape[:2] != (height, width):
        sums = Sums.of(width, height)
    return Pass(sums, moving, want)
