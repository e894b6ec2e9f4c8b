"""Doing pieces of work: first light and textures, how fast they come, and what becomes of those that fail."""

from __future__ import annotations

import functools
import logging
import math
import threading
from collections import Counter
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from luxel.dynamic.cache import TextureCache
from luxel.dynamic.desk import Desk, Kind, Piece
from luxel.dynamic.entries import ESTIMATE, NONE, Entries
from luxel.dynamic.onlookers import Onlookers
from luxel.dynamic.pace import Pace, Rate
from luxel.dynamic.shares import Helpers, in_shares
from luxel.dynamic.sightings import Ids
from luxel.dynamic.work import CoarseBatch, Listeners, TileBatch
from luxel.dynamic.workshop import Workshop
from luxel.light.in_view import Gaze

__all__ = ["Baking"]

log = logging.getLogger(__name__)

#: Seconds that particles took, how many were done, and what tells listeners.
_Done = tuple[float, int, Callable[[], None]]

_MAX_FAILURES = 16  # single particles in a row; then a kind of work is given up
# Of a piece with a deadline, so much is baked before it is seen how much of the rest there is time for.
_FIRST_PART, _LEAST_PARTED, _PLENTY = 2 / 3, 24, 2.0


class Baking:
    """Does pieces and tells listeners. Several threads may, with pieces of their own; `lock` guards what it counts.

    Parameters
    ----------
    cache, clock, lock
        The engine's.

    Attributes
    ----------
    light, desks
        The current light, None before there is one, and who hands out work on it; set by the engine.
    error
        What went wrong last under the current light, in words; None if nothing did.
    tiles_heard, coarse_heard
        Who is told.
    paces, rate
        How fast each kind of work goes, and how many textures come a second.
    failures
        Single particles in a row that failed.
    clipped_count
        Texels brighter than their scale, of all textures so far.
    """

    def __init__(self, cache: TextureCache, clock: Callable[[], float], lock: threading.Lock) -> None:
        self._cache, self._clock, self.lock = cache, clock, lock
        self._onlookers = Onlookers(cache)
        self.light: Entries | None = None
        self.desks: tuple[Desk, ...] = ()
        self.error: str | None = None
        self.tiles_heard: Listeners[TileBatch] = Listeners()
        self.coarse_heard: Listeners[CoarseBatch] = Listeners()
        self.paces = {kind: Pace() for kind in Kind}
        self.rate = Rate()
        self.failures: Counter[Kind] = Counter()
        self.clipped_count = 0

    def do(
        self, desk: Desk, shop: Workshop, piece: Piece, helpers: Helpers | None, end_s: float = math.inf
    ) -> float | None:
        """Do one piece, with `helpers`; return the seconds that its particles took, None if it failed.

        Textures that would not be done by `end_s` are left to the next piece.
        """
        try:
            if piece.kind is Kind.FIRST_LIGHT:
                took_s, count, tell = self._first_light(shop, piece, helpers)
            else:
                took_s, count, tell = self._bake(desk, shop, piece, helpers, end_s)
        except BaseException as error:
            self._failed(desk, piece, error)
            if not isinstance(error, Exception):
                raise
            return None
        with self.lock:
            self.failures[piece.kind] = 0
            self.paces[piece.kind].record(took_s, count)
        tell()
        return took_s

    def gaze(self, light: Entries) -> Gaze | None:
        """Return who looks, where estimates may go by that: not where they are all that small particles get, or what a basis is learnt from."""
        stay = self._cache.components > 0 or any(desk.small_pixels > 0 for desk in self.desks)
        return None if stay else self._onlookers.gaze(light)

    def report(self, light: Entries, error: BaseException) -> None:
        """Note what went wrong under a light; with the lock held."""
        if light is self.light:
            self.error = f"{type(error).__name__}: {error}"

    def give_up(self, light: Entries, kinds: tuple[Kind, ...]) -> None:
        """Do no more work of some kinds under a light."""
        for desk in self.desks:
            desk.give_up(light, kinds)

    def _first_light(self, shop: Workshop, piece: Piece, helpers: Helpers | None) -> _Done:
        light, ids = piece.light, piece.ids
        start_s = self._clock()
        baker = shop.bakers.textures
        records = np.concatenate(in_shares(lambda share: baker.first_light(ids[share]), len(ids), helpers))
        took_s = self._clock() - start_s
        kept = self._cache.put_coarse(light, ids, records)

        def tell() -> None:
            if kept:
                self.coarse_heard.tell(CoarseBatch(light.key, ids, records))

        return took_s, len(ids), tell

    def _bake(self, desk: Desk, shop: Workshop, piece: Piece, helpers: Helpers | None, end_s: float) -> _Done:
        light, ids = piece.light, piece.ids
        grade = shop.grade(piece.kind)
        start_s = self._clock()
        codes = np.empty((len(ids), self._cache.texels, self._cache.texels), dtype=np.uint8)
        make: Callable[[Ids, NDArray[np.uint8]], int] = shop.bakers.textures.bake_into
        if grade == ESTIMATE and shop.bakers.estimates is not None:
            gaze = self.gaze(light)
            if not shop.bakers.estimates.suits(gaze):  # good enough for this piece
                with self.lock:
                    shop.outgrown(piece.kind)
            make = functools.partial(shop.bakers.estimates.bake_into, gaze=gaze)

        def bake(first: int, last: int) -> int:
            some, room = ids[first:last], codes[first:last]
            return sum(in_shares(lambda share: make(some[share], room[share]), len(some), helpers))

        count = len(ids) if helpers is not None else self._first_part(piece, end_s - start_s)
        clipped = bake(0, count)
        now_s = self._clock()
        if count < len(ids):
            more = (end_s - now_s) * count / max(now_s - start_s, 1e-9)
            if more >= 1:
                last = min(len(ids), count + int(more))
                clipped += bake(count, last)
                count, now_s = last, self._clock()
        made, codes = ids[:count], codes[:count]
        stored = self._cache.publish(light, made, codes, grade)
        if stored.any():
            desk.done(piece, grade)
        if not stored.all():
            desk.lost(piece)
        if count < len(ids):
            desk.leave(piece, ids[count:])

        def tell() -> None:
            with self.lock:
                self.clipped_count += clipped
                self.rate.record(now_s, count)
                stale = self.light is None or light.key != self.light.key
            self.tiles_heard.tell(TileBatch(light.key, made, codes, np.full(count, grade == ESTIMATE), stale))

        return now_s - start_s, count, tell

    def _first_part(self, piece: Piece, left_s: float) -> int:
        """How many of a piece to bake before the clock is read: all where time is plenty, or a part would hardly be worth a call."""
        count, each_s = len(piece.ids), self.paces[piece.kind].each_s
        if count < _LEAST_PARTED or each_s == 0 or left_s > _PLENTY * each_s * count:
            return count
        return max(1, min(math.ceil(_FIRST_PART * count), int(left_s / each_s)))

    def _failed(self, desk: Desk, piece: Piece, error: BaseException) -> None:
        """Report a failure, and do the piece once more, or give it up."""
        light, ids, kind = piece.light, piece.ids, piece.kind
        hopeless = False
        with self.lock:
            self.report(light, error)
            if piece.alone:
                self.failures[kind] += 1
                hopeless = self.failures[kind] >= _MAX_FAILURES
            first = self.failures[kind] <= 1
        log.log(
            logging.ERROR if first else logging.DEBUG,
            "%s of %d particles under light key %s failed",
            kind.value,
            len(ids),
            light.key,
            exc_info=error if first else None,
        )
        again = not piece.alone and isinstance(error, Exception) and desk.retry(piece)
        if not again:
            if kind is Kind.FIRST_LIGHT:
                self._cache.release_dawning(light, ids)
            elif piece.alone:
                self._cache.fail(light, ids)
            else:
                self._cache.release(light, ids)
            desk.done(piece, NONE)
        if hopeless:
            self.give_up(light, (kind,))
