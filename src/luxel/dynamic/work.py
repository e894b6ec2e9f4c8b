"""What goes in and out of the engine: bakers, finished batches, and who hears of them."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

__all__ = ["CoarseBatch", "CoarseListener", "Listener", "Listeners", "MakeBaker", "TileBaker", "TileBatch"]

log = logging.getLogger(__name__)

Ids = NDArray[np.int32]
Batch = TypeVar("Batch")


class TileBaker(Protocol):
    """What the engine needs of :class:`luxel.textures.bake.Baker`."""

    def first_light(self, ids: Ids) -> NDArray[np.float32]:
        """Return (K, 4) coarse records of (K,) `ids`, cheaply, even before `prepare`. Called from several threads."""
        ...

    def prepare(self, threads: int) -> None:
        """Do, on up to so many threads, what has to be done once before textures; called before the first of them."""
        ...

    def bake_into(self, ids: Ids, codes: NDArray[np.uint8]) -> int:
        """Fill (K, texels, texels) `codes` for (K,) `ids`; return the clipped texels. Called from several threads."""
        ...


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
    stale
        Whether the light had changed when they were finished.
    """

    key: str
    ids: Ids
    codes: NDArray[np.uint8]
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
MakeBaker = Callable[[], TileBaker]


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
