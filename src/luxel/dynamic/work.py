"""What goes in and out of the engine: bakers, finished batches, and who hears of them."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from luxel.dynamic.sightings import Ids
from luxel.light.in_view import Gaze

__all__ = [
    "Bakers",
    "CoarseBatch",
    "CoarseListener",
    "Estimator",
    "Listener",
    "Listeners",
    "MakeBakers",
    "TileBaker",
    "TileBatch",
]

log = logging.getLogger(__name__)

Batch = TypeVar("Batch")


class TileBaker(Protocol):
    """What the engine needs of :class:`luxel.textures.bake.Baker`."""

    def first_light(self, ids: Ids) -> NDArray[np.float32]:
        """Return (K, 4) coarse records of (K,) `ids`, cheaply, even before `prepare`. Called from several threads."""
        ...

    def preparation(self, threads: int) -> Iterator[None]:
        """Do, on up to so many threads, what has to be done once before textures, a little with every step.

        With one thread, steps are short. Run to its end before the first texture, by one thread at a time; it may be left off and begun again.
        """
        ...

    def bake_into(self, ids: Ids, codes: NDArray[np.uint8]) -> int:
        """Fill (K, texels, texels) `codes` for (K,) `ids`; return the clipped texels. Called from several threads."""
        ...


class Estimator(Protocol):
    """What the engine needs of :class:`luxel.textures.estimate.EstimateBaker`."""

    def preparation(self, threads: int, gaze: Gaze | None) -> Iterator[None]:
        """As `TileBaker.preparation`; with a `gaze`, for the picture that is looked at."""
        ...

    def suits(self, gaze: Gaze | None) -> bool:
        """Whether what was prepared serves this picture as well; else it is prepared again. Called with every piece of work."""
        ...

    def bake_into(self, ids: Ids, codes: NDArray[np.uint8], gaze: Gaze | None) -> int:
        """As `TileBaker.bake_into`; what nobody looks at, with a `gaze`, may be guessed."""
        ...


@dataclass(frozen=True)
class Bakers:
    """Who makes textures under one light.

    Parameters
    ----------
    textures
        As good as was asked for; also asked for first light.
    estimates
        Cheaper ones of the same shape and scale, shown until the former are there; None for none.
    """

    textures: TileBaker
    estimates: Estimator | None = None


@dataclass(frozen=True, eq=False)
class TileBatch:
    """Finished textures of one light key.

    Parameters
    ----------
    key
        Their light key.
    ids
        (K,) int32 particle ids.
    codes
        (K, texels, texels) uint8.
    estimate
        (K,) bool: which of them are estimates; better ones may follow.
    stale
        Whether the light had changed when they were finished.
    """

    key: str
    ids: Ids
    codes: NDArray[np.uint8]
    estimate: NDArray[np.bool_]
    stale: bool = False

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True, eq=False)
class CoarseBatch:
    """First light of some particles under one light key.

    Parameters
    ----------
    key
        Their light key.
    ids
        (K,) int32 particle ids.
    records
        (K, 4) float32, see :class:`luxel.textures.textures.TextureTable`.
    """

    key: str
    ids: Ids
    records: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.ids)


Listener = Callable[[TileBatch], None]
CoarseListener = Callable[[CoarseBatch], None]
MakeBakers = Callable[[], Bakers]


class Listeners(Generic[Batch]):
    """Who wants to hear of batches. Owns a lock, not held while they are told."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._all: tuple[Callable[[Batch], None], ...] = ()

    def add(self, listener: Callable[[Batch], None]) -> Callable[[], None]:
        """Add one; return what removes it."""
        with self._lock:
            self._all = (*self._all, listener)

        def remove() -> None:
            with self._lock:
                self._all = tuple(each for each in self._all if each is not listener)

        return remove

    def clear(self) -> None:
        """Remove all."""
        with self._lock:
            self._all = ()

    def tell(self, batch: Batch) -> None:
        """Call every one; what one raises is logged and does not keep it from the others."""
        for listener in self._all:
            try:
                listener(batch)
            except Exception:
                log.exception("a listener to finished work failed")
