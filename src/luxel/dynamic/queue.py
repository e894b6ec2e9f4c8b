"""RequestQueue: which texture next (paper 4.2)."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["DISTANCE_S", "RequestQueue", "priority"]

Ids = NDArray[np.int32]

# T is in seconds and D in scene diagonals: a particle one diagonal away counts as if it had been seen this much earlier.
DISTANCE_S = 2.0

_NO_IDS: Ids = np.empty(0, dtype=np.int32)


def priority(now_s: float, distance: ArrayLike) -> NDArray[np.float64]:
    """Return P = T - D of paper 4.2 with f the identity.

    Parameters
    ----------
    now_s
        T, the moment of the sighting, in seconds.
    distance
        (K,) distances from the particles to the eye, in diagonals of the scene.
    """
    return now_s - DISTANCE_S * np.asarray(distance, dtype=np.float64)


@dataclass(eq=False)
class _Wants:
    """What one client asked for: ascending particle ids, their priority, and when each was sighted last."""

    ids: Ids = field(default_factory=lambda: _NO_IDS)
    priority: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    seen_s: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))

    def part(self, chosen: NDArray[np.bool_]) -> _Wants:
        return _Wants(self.ids[chosen], self.priority[chosen], self.seen_s[chosen])

    def keep(self, chosen: NDArray[np.bool_]) -> None:
        self.ids, self.priority, self.seen_s = self.ids[chosen], self.priority[chosen], self.seen_s[chosen]

    def merge(self, fresh: _Wants) -> None:
        """Take in what is not there yet; copies."""
        ids = np.concatenate([self.ids, fresh.ids])
        self.priority = np.concatenate([self.priority, fresh.priority])
        self.seen_s = np.concatenate([self.seen_s, fresh.seen_s])
        order = np.argsort(ids)
        self.ids, self.priority, self.seen_s = ids[order], self.priority[order], self.seen_s[order]


@dataclass(eq=False)
class _Lane:
    """Requests of one light key: every client's, and all of them best first. Ids before `head` have been popped."""

    clients: dict[str, _Wants] = field(default_factory=dict)
    ids: Ids = field(default_factory=lambda: _NO_IDS)
    priority: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    head: int = 0

    def __len__(self) -> int:
        return len(self.ids) - self.head

    def waiting(self) -> Ids:
        return self.ids[self.head :]

    def settle(self) -> None:
        """Take what has been popped out of every client's wants."""
        if self.head:
            popped = np.sort(self.ids[: self.head])
            for wants in self.clients.values():
                wants.keep(~_is_in(wants.ids, popped))
            self.ids, self.priority, self.head = self.ids[self.head :], self.priority[self.head :], 0

    def unwanted(self, ids: Ids) -> Ids:
        """Those of `ids` that no client asks for."""
        for wants in self.clients.values():
            ids = ids[~_is_in(ids, wants.ids)]
        return ids

    def sort(self, max_count: int) -> Ids:
        """Order all wants again, each particle at its best priority; return those past `max_count`, given up."""
        wants = list(self.clients.values())
        total = _Wants()
        for want in wants:
            known = _is_in(want.ids, total.ids)
            place = np.searchsorted(total.ids, want.ids[known])
            total.priority[place] = np.maximum(total.priority[place], want.priority[known])
            total.merge(want.part(~known))
        order = np.argsort(-total.priority)
        self.ids, self.priority = total.ids[order], total.priority[order]
        excess = self.ids[max_count:]
        if len(excess):
            for want in wants:
                want.keep(~_is_in(want.ids, np.sort(excess)))
            self.ids, self.priority = self.ids[:max_count], self.priority[:max_count]
        return excess


class RequestQueue:
    """Requests for textures, best priority first, every particle at most once.

    A client is whoever looks: each new sighting of it replaces the priority of what it asked for before. What several
    clients ask for has the best of their priorities. A request lapses when its client has not sighted the particle for
    `expiry_s` though it kept sighting others, and no other client still wants it.

    There is no thread, no lock and no clock inside: the owner (:class:`luxel.dynamic.engine.Engine`) calls every
    method under its own lock and passes times in.

    Parameters
    ----------
    expiry_s
        In seconds.
    max_count
        Requests at most for one light key; the worst are given up.
    """

    def __init__(self, expiry_s: float = 2.0, max_count: int = 1 << 20) -> None:
        self.expiry_s = expiry_s
        self.max_count = max_count
        self._lanes: dict[str, _Lane] = {}

    def __len__(self) -> int:
        return sum(len(lane) for lane in self._lanes.values())

    def keys(self) -> list[str]:
        """Light keys with requests."""
        return [key for key, lane in self._lanes.items() if len(lane)]

    def best(self, skip: Collection[str] = ()) -> str | None:
        """Return the light key of the best request, leaving out keys in `skip`; None if there is none."""
        heads = [
            (lane.priority[lane.head], key)
            for key, lane in self._lanes.items()
            if len(lane) and key not in skip
        ]
        return max(heads)[1] if heads else None

    def push(
        self, key: str, ids: Ids, priority: NDArray[np.float64], now_s: float = 0.0, client: str = ""
    ) -> Ids:
        """Note what a client's latest sighting asks for; return the ids that are no longer queued for want of it.

        Parameters
        ----------
        key
            Light key.
        ids
            (K,) int32, each once; empty when all that the client sees is there.
        priority
            (K,) float64, larger is sooner; see :func:`priority`.
        now_s
            When, in seconds.
        client
            Who.

        Returns
        -------
        ids
            int32: requests that lapsed, and those that `max_count` has no room for.
        """
        lane = self._lanes.setdefault(key, _Lane())
        lane.settle()
        order = np.argsort(ids)
        fresh = _Wants(ids[order], np.asarray(priority[order], dtype=np.float64), np.full(len(ids), now_s))
        wants = lane.clients.setdefault(client, _Wants())
        wants.keep(~_is_in(wants.ids, fresh.ids))
        current = now_s - wants.seen_s < self.expiry_s
        lapsed = wants.ids[~current]
        wants.keep(current)
        wants.merge(fresh)
        return np.concatenate([lane.unwanted(lapsed), self._sort(key)])

    def pop(self, count: int, key: str | None = None) -> tuple[str, Ids]:
        """Take up to `count` requests of one light key, best first: of `key`, else of the key with the best request.

        Returns ``("", empty)`` when there is nothing.
        """
        key = self.best() if key is None else key
        lane = self._lanes.get(key) if key is not None else None
        if key is None or lane is None:
            return "", _NO_IDS
        taken = lane.waiting()[:count]
        lane.head += len(taken)
        if not len(lane):
            del self._lanes[key]
        return key, taken

    def cancel(self, key: str) -> Ids:
        """Withdraw every request of a light key; return their ids."""
        lane = self._lanes.pop(key, None)
        return _NO_IDS if lane is None else lane.waiting()

    def forget(self, client: str) -> list[tuple[str, Ids]]:
        """Withdraw what only `client` wants; return it by light key."""
        gone = []
        for key in list(self._lanes):
            lane = self._lanes[key]
            lane.settle()
            wants = lane.clients.pop(client, None)
            if wants is not None:
                gone.append((key, lane.unwanted(wants.ids)))
                self._sort(key)
        return gone

    def _sort(self, key: str) -> Ids:
        lane = self._lanes[key]
        excess = lane.sort(self.max_count)
        if not len(lane):
            del self._lanes[key]
        return excess


def _is_in(ids: Ids, ascending: Ids) -> NDArray[np.bool_]:
    """(K,) bool: which of `ids` occur in `ascending`. Faster than np.isin, which sorts both."""
    if not len(ascending):
        return np.zeros(len(ids), dtype=bool)
    place = np.searchsorted(ascending, ids)
    place[place == len(ascending)] = 0
    found: NDArray[np.bool_] = ascending[place] == ids
    return found
