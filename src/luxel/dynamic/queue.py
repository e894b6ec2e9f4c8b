"""RequestQueue: which texture next (paper 4.2)."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from luxel.dynamic.sightings import Ids
from luxel.kernels.requests import carry_over, mark_common, pick

__all__ = [
    "DISTANCE_S",
    "Heuristic",
    "RequestQueue",
    "Requests",
    "largest_first",
    "longest_visible_first",
    "recent_and_near",
]

# T is in seconds and D in scene diagonals: a particle one diagonal away counts as if it had been seen this much earlier.
DISTANCE_S = 2.0
# Of a particle as wide as this many pixels, one of twice the width counts as if it had been seen a second later.
_PIXELS = 8.0
# Requests that are put in order at a time: few, since after the next sighting it is another order; then more and more.
_RUN_COUNT, _LONGEST_RUN = 256, 4096
# A list so many times longer than another is looked up in it by halves.
_MUCH_LONGER = 16

_NO_IDS: Ids = np.empty(0, dtype=np.int32)

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Requests:
    """Requests, one a particle.

    Parameters
    ----------
    ids
        (K,) int32, ascending.
    seen_s
        (K,) when some client sighted each last, in seconds: T of the paper.
    since_s
        (K,) when the sightings began that led to the request: some client has sighted it ever since without a gap as long
        as requests live.
    distance
        (K,) from the nearest client's eye, in diagonals of the scene: D of the paper.
    pixels
        (K,) width on the screen of the client that sees it largest; 0 where no client tells.
    """

    ids: Ids
    seen_s: Floats
    since_s: Floats
    distance: Floats
    pixels: Floats

    def __len__(self) -> int:
        return len(self.ids)

    def part(self, chosen: NDArray[np.bool_]) -> Requests:
        """Return some of them."""
        count = np.count_nonzero(chosen)
        some = Requests(np.empty(count, np.int32), *(np.empty(count) for _ in range(4)))
        pick(chosen, *self._columns, *some._columns)
        return some

    def at(self, places: NDArray[np.intp]) -> Requests:
        """Return those at some places."""
        ids, *rest = self._columns
        return Requests(ids[places], *(column[places] for column in rest))

    @property
    def _columns(self) -> tuple[Ids, Floats, Floats, Floats, Floats]:
        return self.ids, self.seen_s, self.since_s, self.distance, self.pixels


_NOTHING = Requests(_NO_IDS, *(np.empty(0) for _ in range(4)))


class Heuristic(Protocol):
    """What makes a request urgent; looked up again after every sighting."""

    def __call__(self, requests: Requests) -> Floats:
        """Return (K,) priorities: larger is sooner."""
        ...


def recent_and_near(requests: Requests) -> Floats:
    """P = f(T − D) of paper 4.2, f the identity."""
    return requests.seen_s - DISTANCE_S * requests.distance


def largest_first(requests: Requests) -> Floats:
    """What is large on the screen first: T plus a second for every doubling of the width."""
    return np.asarray(requests.seen_s + np.log2(1 + requests.pixels / _PIXELS))


def longest_visible_first(requests: Requests) -> Floats:
    """What has been in sight longest first; of these, the near."""
    return -requests.since_s - 1e-3 * DISTANCE_S * requests.distance


@dataclass(eq=False)
class _Client:
    """What one client asks for: what its latest sighting shows, and what earlier ones did."""

    latest: Requests = _NOTHING
    earlier: Requests = _NOTHING
    oldest_s: float = math.inf  # no earlier request was seen before

    def remove(self, ids: Ids) -> None:
        """Take out some requests, ascending ids."""
        self.latest = _without(self.latest, ids)
        self.earlier = _without(self.earlier, ids)

    def keep_earlier(self, requests: Requests) -> None:
        """Replace the earlier requests."""
        self.earlier = requests
        self.oldest_s = float(requests.seen_s.min()) if len(requests) else math.inf

    def expire(self, before_s: float) -> None:
        if self.oldest_s <= before_s:
            self.keep_earlier(self.earlier.part(self.earlier.seen_s > before_s))


class RequestQueue:
    """Requests for textures under one light, each particle at most once.

    A client is whoever looks. Each sighting of it replaces what it told before about the same particles: T is the latest
    sighting by any client, D the least of the clients' distances. A request stands as long as the latest sighting of some client
    shows its particle, however long ago that was: a client that rests still shows it. It lapses `expiry_s` after the last sighting that did,
    and at once when the only clients that asked for it are forgotten.

    :meth:`pop` serves the best first, :meth:`pop_oldest` those that have waited longest, whatever their priority. Who calls the latter for every
    n-th batch serves a request that stands, at the latest, with batch n (w + 1) from now, w being the requests that have waited as long or longer.

    There is no thread, no lock and no clock inside: the owner (:class:`luxel.dynamic.desk.Desk`) calls every method under its own lock and passes
    times in, which never fall.

    Parameters
    ----------
    heuristic
        Priorities.
    expiry_s
        In seconds.
    max_count
        Requests at most; the worst are given up.
    """

    def __init__(
        self, heuristic: Heuristic = recent_and_near, expiry_s: float = 2.0, max_count: int = 1 << 20
    ) -> None:
        self.heuristic = heuristic
        self.expiry_s = expiry_s
        self.max_count = max_count
        self._clients: dict[str, _Client] = {}
        self._all = _NOTHING  # of all clients; those popped since are still among them
        self._priority: Floats = np.empty(0)
        self._taken: NDArray[np.bool_] = np.empty(0, np.bool_)
        self._left = 0  # one number, so that whoever asks without a lock is not told nonsense
        self._run: NDArray[np.intp] = np.empty(0, np.intp)  # the best of `_all`, best first …
        self._head = 0  # … those before have been looked at
        self._run_count = _RUN_COUNT  # how many to put in order next
        self._waited: NDArray[np.intp] = np.empty(0, np.intp)  # who have waited longest, best first …
        self._more_waited = False  # … and more have waited as long
        self._stale = False  # clients changed since `_all` was made

    def __len__(self) -> int:
        return self._left

    @property
    def clients(self) -> list[str]:
        """Those who asked for something and have not been forgotten."""
        return list(self._clients)

    @property
    def ids(self) -> Ids:
        """(len,) int32, what waits, ascending, as of the last :meth:`refresh`."""
        return self._all.ids[~self._taken]

    @property
    def oldest_s(self) -> float:
        """The least `since_s` of all that waits; infinite if nothing does."""
        return float(self._all.since_s[self._longest_waiting(1)[0]]) if len(self) else math.inf

    def push(
        self, ids: Ids, distance: Floats, pixels: Floats | None = None, now_s: float = 0.0, client: str = ""
    ) -> None:
        """Note what a client's latest sighting asks for; :meth:`refresh` takes it in.

        Parameters
        ----------
        ids
            (K,) int32, ascending, each once; empty when all that the client sees is there.
        distance, pixels
            (K,), see :class:`Requests`.
        now_s
            When, in seconds.
        client
            Who.
        """
        self._settle_taken()
        known = self._clients.setdefault(client, _Client())
        if not len(ids) and not len(known.latest):
            return
        self._stale = True
        since = np.full(len(ids), now_s)
        old = known.latest
        if np.array_equal(ids, old.ids):
            since = old.since_s
            rest = _NOTHING
        else:
            rest = _carry_over(old, ids, since)
        earlier = _carry_over(known.earlier, ids, since)
        known.latest = Requests(
            ids,
            np.full(len(ids), now_s),
            since,
            np.asarray(distance, np.float64),
            np.zeros(len(ids)) if pixels is None else np.asarray(pixels, np.float64),
        )
        if earlier is not known.earlier or len(rest):
            known.keep_earlier(_joined([earlier, rest]))

    def forget(self, client: str) -> None:
        """Withdraw what only this client asked for; :meth:`refresh` does it."""
        self._settle_taken()
        if self._clients.pop(client, None) is not None:
            self._stale = True

    def refresh(self, now_s: float) -> Ids:
        """Bring the queue up to date; return the ids, ascending, of requests that it has given up since the last time.

        They lapsed or were withdrawn, or `max_count` had no room for them.
        """
        before_s = now_s - self.expiry_s
        if not self._stale and all(each.oldest_s > before_s for each in self._clients.values()):
            return _NO_IDS
        self._settle_taken()
        for each in self._clients.values():
            each.expire(before_s)
        before = self._all.ids
        self._set(_merged([part for each in self._clients.values() for part in (each.latest, each.earlier)]))
        self._stale = False
        asked = self._all.ids
        excess = self.limit(self.max_count)
        gone = before[~_is_in(before, asked)]
        return np.union1d(gone, excess) if len(excess) else gone

    def drop_unseen(self) -> None:
        """Give up, before they lapse, requests that no client's latest sighting shows; :meth:`refresh` does it."""
        self._settle_taken()
        for each in self._clients.values():
            each.keep_earlier(_NOTHING)
        self._stale = True

    def limit(self, count: int) -> Ids:
        """Give up the worst requests until at most `count` are left; return their ids, ascending."""
        if len(self) <= count:
            return _NO_IDS
        self._settle_taken()
        order = np.argpartition(-self._priority, count) if count else np.arange(len(self._all))
        excess = np.sort(self._all.ids[order[count:]])
        self._remove(excess)
        return excess

    def pop(self, count: int) -> Ids:
        """Take up to `count` requests, best first."""
        found: list[NDArray[np.intp]] = []
        while count > 0 and len(self):
            if self._head >= len(self._run):
                self._sort_run()
            place = self._run[self._head : self._head + count]
            self._head += len(place)
            place = place[~self._taken[place]]  # pop_oldest may have been here
            self._take(place)
            found.append(place)
            count -= len(place)
        return self._all.ids[np.concatenate(found)] if found else _NO_IDS

    def pop_oldest(self, count: int) -> Ids:
        """Take up to `count` of the requests that have waited longest; of those that have waited as long, the best."""
        if not len(self):
            return _NO_IDS
        place = self._longest_waiting(count)[:count]
        self._take(place)
        return self._all.ids[place]

    def arrange(self) -> None:
        """Do now what the next :meth:`pop` and :meth:`pop_oldest` would have to do first."""
        if len(self):
            if self._head >= len(self._run):
                self._sort_run()
            self._longest_waiting(1)

    def clear(self) -> Ids:
        """Withdraw everything and forget all clients; return the ids of what waited."""
        ids = self.ids
        self._clients.clear()
        self._set(_NOTHING)
        self._stale = False
        return ids

    def _set(self, requests: Requests) -> None:
        self._all = requests
        self._priority = self.heuristic(requests)
        self._taken = np.zeros(len(requests), np.bool_)
        self._left = len(requests)
        self._run, self._head, self._run_count = self._run[:0], 0, _RUN_COUNT
        self._waited = self._waited[:0]

    def _take(self, place: NDArray[np.intp]) -> None:
        self._taken[place] = True
        self._left -= len(place)

    def _sort_run(self) -> None:
        """Put the best of what waits in order; the whole would cost more than most of it is worth before it changes."""
        waiting = np.flatnonzero(~self._taken)
        self._run = waiting[_least(-self._priority[waiting], self._run_count)]
        self._run_count = min(2 * self._run_count, _LONGEST_RUN)
        self._head = 0

    def _longest_waiting(self, count: int) -> NDArray[np.intp]:
        """Return where those are that have waited longest, the best of them first: at least `count`, if so many have waited as long. Something must wait."""
        self._waited = self._waited[~self._taken[self._waited]]
        if not len(self._waited) or (self._more_waited and len(self._waited) < count):
            waiting = np.flatnonzero(~self._taken)
            since = self._all.since_s[waiting]
            place = waiting[since == since.min()]
            self._waited = place[_least(-self._priority[place], max(count, _RUN_COUNT))]
            self._more_waited = len(self._waited) < len(place)
        return self._waited

    def _settle_taken(self) -> None:
        """Take what has been popped out of all clients' requests."""
        if self._left < len(self._all):
            self._remove(self._all.ids[self._taken])

    def _remove(self, ids: Ids) -> None:
        before, left = self._all, _without(self._all, ids)
        for each in self._clients.values():
            if each.latest is before:  # it alone asks for anything
                each.latest = left
            else:
                each.remove(ids)
        self._set(left)


def _least(values: Floats, count: int) -> NDArray[np.intp]:
    """Where the least `count` of some values are, the least first; of equal ones the first."""
    if len(values) <= 2 * count:
        return np.argsort(values, kind="stable")[:count]
    places = np.flatnonzero(~(values > np.partition(values, count - 1)[count - 1]))
    return places[np.argsort(values[places], kind="stable")[:count]]


def _without(requests: Requests, ids: Ids) -> Requests:
    """Return requests but those for some particles, ascending ids."""
    gone = _is_in(requests.ids, ids)
    return requests.part(~gone) if gone.any() else requests


def _carry_over(old: Requests, ids: Ids, since: Floats) -> Requests:
    """Keep since when particles have been asked for that are sighted again; return the requests for others."""
    if not len(old):
        return old
    gone = np.empty(len(old), np.bool_)
    count = carry_over(old.ids, old.since_s, ids, since, gone)
    return old if count == len(old) else old.part(gone) if count else _NOTHING


def _joined(parts: Iterable[Requests]) -> Requests:
    """Sort requests for different particles into one list."""
    parts = [part for part in parts if len(part)]
    if not parts:
        return _NOTHING
    if len(parts) == 1:
        return parts[0]
    arrays = [
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("ids", "seen_s", "since_s", "distance", "pixels")
    ]
    return Requests(*arrays).at(np.argsort(arrays[0], kind="stable"))


def _merged(parts: Iterable[Requests]) -> Requests:
    """One request a particle: the latest sighting, the longest wait, the least distance, the largest width."""
    every = _joined(parts)
    if not len(every):
        return every
    first = np.flatnonzero(np.concatenate([[True], every.ids[1:] != every.ids[:-1]]))
    if len(first) == len(every):
        return every
    return Requests(
        every.ids[first],
        np.maximum.reduceat(every.seen_s, first),
        np.minimum.reduceat(every.since_s, first),
        np.minimum.reduceat(every.distance, first),
        np.maximum.reduceat(every.pixels, first),
    )


def _is_in(ids: Ids, ascending: Ids) -> NDArray[np.bool_]:
    """(K,) bool: which of `ids` occur in `ascending`; both ascend."""
    if not len(ascending) or not len(ids):
        return np.zeros(len(ids), dtype=bool)
    found: NDArray[np.bool_]
    if _MUCH_LONGER * len(ids) < len(ascending):
        place = np.searchsorted(ascending, ids)
        place[place == len(ascending)] = 0
        found = ascending[place] == ids
    else:
        found = np.empty(len(ids), np.bool_)
        mark_common(ids, ascending, found)
    return found
