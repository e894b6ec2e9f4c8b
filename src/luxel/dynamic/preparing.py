"""Making the bakers of light keys, and preparing them for textures: once each, and once more if it fails."""

from __future__ import annotations

import functools
import logging
from collections import Counter
from collections.abc import Callable, Iterable

from luxel.dynamic.baking import Baking
from luxel.dynamic.desk import Desk, Kind
from luxel.dynamic.entries import Entries
from luxel.dynamic.work import MakeBakers
from luxel.dynamic.workshop import Workshop, Workshops

__all__ = ["TEXTURES", "Preparing", "waiting"]

log = logging.getLogger(__name__)

#: Kinds of work for which bakers have to be prepared.
TEXTURES = (Kind.FIRST_TEXTURE, Kind.REFINEMENT)
_MAX_ATTEMPTS = 2  # to make or to prepare a baker


class Preparing:
    """Bakers by light key. Several threads may take what there is to do; the lock of `baking` guards who does.

    Parameters
    ----------
    baking
        What failures are reported to; its light and desks are the current ones.
    clock
        The engine's.
    threads
        That work; 0 if it is the caller's, whose time is short.
    """

    def __init__(self, baking: Baking, clock: Callable[[], float], threads: int) -> None:
        self._baking, self._clock, self._threads = baking, clock, threads
        self._lock = baking.lock
        self._workshops = Workshops()
        self._building: set[str] = set()
        # At a baker under 0, at its preparation under its grade.
        self._attempts: Counter[tuple[str, int]] = Counter()

    def shop(self, key: str) -> Workshop | None:
        """Return the bakers of a light key, if there are some; with the lock held."""
        return self._workshops.get(key)

    def begin_anew(self) -> None:
        """Forget what has failed: the light has changed; with the lock held."""
        self._attempts.clear()

    def take_build(self, light: Entries, make: MakeBakers, now_s: float) -> Callable[[], None] | None:
        """Return what makes the bakers of a light key, if somebody waits for them and nobody is at it."""
        key = light.key
        if not waiting(self._baking.desks, now_s):
            return None
        with self._lock:
            if key in self._building or self._workshops.get(key) is not None:
                return None
            if self._attempts[key, 0] >= _MAX_ATTEMPTS:  # given up since it was looked who waits
                return None
            self._building.add(key)
        return functools.partial(self._build, light, make)

    def take_preparation(
        self, light: Entries, shop: Workshop, now_s: float, limit_s: float
    ) -> Callable[[], None] | None:
        """Return what prepares bakers for textures, for about so many seconds, if somebody waits for these and nobody is at it."""
        if all(shop.is_ready(kind) for kind in TEXTURES):
            return None
        found = waiting(self._baking.desks, now_s)
        with self._lock:
            kind = next((kind for kind in TEXTURES if found[kind] and not shop.is_ready(kind)), None)
            if kind is None or shop.preparing:
                return None
            shop.preparing = True
        return functools.partial(self._prepare, light, shop, kind, limit_s)

    def _build(self, light: Entries, make: MakeBakers) -> None:
        key = light.key
        try:
            bakers = make()
        except Exception as error:
            log.exception("no baker for light key %s", key)
            self._failed(light, 0, tuple(Kind), error)
            with self._lock:  # only now: another thread would try before this failure counts
                self._building.discard(key)
        else:
            with self._lock:
                self._building.discard(key)
                self._workshops.put(key, bakers)

    def _prepare(self, light: Entries, shop: Workshop, kind: Kind, limit_s: float) -> None:
        end_s = None if self._threads else self._clock() + limit_s
        try:
            for _ in shop.preparation(kind, max(1, self._threads), self._baking.gaze(light)):
                if end_s is not None and self._clock() >= end_s:
                    with self._lock:
                        shop.preparing = False
                    return
        except Exception as error:
            log.exception("the baker of light key %s is not ready for textures", light.key)
            with self._lock:
                shop.failed(kind)
                shop.preparing = False
            kinds = tuple(each for each in TEXTURES if shop.grade(each) == shop.grade(kind))
            self._failed(light, shop.grade(kind), kinds, error)
        else:
            with self._lock:
                shop.prepared(kind)
                shop.preparing = False

    def _failed(self, light: Entries, grade: int, kinds: tuple[Kind, ...], error: Exception) -> None:
        with self._lock:
            self._baking.report(light, error)
            self._attempts[light.key, grade] += 1
            hopeless = self._attempts[light.key, grade] >= _MAX_ATTEMPTS
        if hopeless:
            self._baking.give_up(light, kinds)


def waiting(desks: Iterable[Desk], now_s: float) -> Counter[Kind]:
    """Return how many particles wait for each kind of work, over all desks."""
    total: Counter[Kind] = Counter()
    for desk in desks:
        total.update({kind: count for kind, count in desk.waiting(now_s).items() if count})
    return total
