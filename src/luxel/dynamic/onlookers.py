"""Onlookers: from where the clients look, so that what they look at is sampled first."""

from __future__ import annotations

import threading

import numpy as np
from numpy.typing import NDArray

from luxel.dynamic.cache import TextureCache
from luxel.dynamic.entries import Entries
from luxel.dynamic.sightings import Ids
from luxel.light.in_view import Gaze

__all__ = ["Onlookers"]

# With more of them, next to all of a particle is looked at by somebody.
_MOST_EYES = 4


class Onlookers:
    """Keeps a :class:`luxel.light.in_view.Gaze` up to date with the latest sightings. Owns a lock.

    Particles of the current sightings are marked in place: who reads while others change the marks takes some neighbour to hide nothing, or to hide still,
    and only samples a few texels more or fewer.

    Parameters
    ----------
    cache
        Knows the latest sighting of every client.
    """

    def __init__(self, cache: TextureCache) -> None:
        self._cache = cache
        self._lock = threading.Lock()
        self._light: Entries | None = None
        self._version = -1
        self._shown: NDArray[np.uint8] = np.empty(0, np.uint8)
        self._marked: list[Ids] = []
        self._gaze: Gaze | None = None

    def gaze(self, light: Entries) -> Gaze | None:
        """Return who looks at a light from where; None where somebody does not say from where, or too many look, or nobody."""
        with self._lock:
            version = self._cache.version
            if light is not self._light or version != self._version:
                self._look(light)
                self._light, self._version = light, version
            return self._gaze

    def _look(self, light: Entries) -> None:
        seen = [each for each in self._cache.sightings.copy().values() if each.key == light.key]
        eyes = [each.eye for each in seen if each.eye is not None]
        self._gaze = None
        if not eyes or len(eyes) < len(seen) or len(eyes) > _MOST_EYES:
            return
        if len(self._shown) != len(light.state):
            self._shown, self._marked = np.zeros(len(light.state), np.uint8), []
        for ids in self._marked:
            self._shown[ids] = 0
        self._marked = [each.ids for each in seen]
        for ids in self._marked:
            self._shown[ids] = 1
        self._gaze = Gaze(np.array(eyes, np.float32), self._shown)
