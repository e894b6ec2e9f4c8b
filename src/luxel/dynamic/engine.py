"""Engine: satisfies texture requests, on threads of its own or on the caller's (paper 4.2, figure 7)."""

from __future__ import annotations

import atexit
import contextlib
import logging
import math
import os
import sys
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from luxel.dynamic.cache import TextureCache
from luxel.dynamic.pace import Pace
from luxel.dynamic.queue import RequestQueue, priority
from luxel.errors import SessionClosedError
from luxel.textures.textures import Encoding

__all__ = ["Engine", "Listener", "TileBaker", "TileBatch"]

log = logging.getLogger(__name__)

Ids = NDArray[np.int32]

_MAX_ATTEMPTS = 3
_BAKERS_KEPT = 3  # an undone slider finds its tree and filter again
_CLOSE_TIMEOUT_S = 5.0


class TileBaker(Protocol):
    """What the engine needs of :class:`luxel.textures.bake.Baker`."""

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


Listener = Callable[[TileBatch], None]
MakeBaker = Callable[[], TileBaker]


@dataclass(frozen=True, eq=False)
class _Job:
    """One piece of work: bake `ids`, or, without a baker, make one."""

    key: str
    baker: TileBaker | None
    make: MakeBaker
    ids: Ids


class Engine:
    """Bakes what is requested, best first, and tells listeners.

    One light key is current (:meth:`select`); requests for another are ignored. Work that waits for an old key is
    cancelled; what is being baked for it is finished and cached under its own key.

    Worker threads start with the first request and sleep on a condition while there is nothing to do. With
    ``threads=0`` nothing happens until somebody calls :meth:`run_once` or :meth:`run_for`: the per-frame callback of
    the paper. Both ways may be used together.

    Safe to use from several threads: the engine owns one lock, which also guards `queue`; it calls the cache, but
    neither bakers nor listeners, while it holds it.

    Parameters
    ----------
    cache
        Where tiles are published.
    queue
        Where requests wait; used by this engine alone.
    threads
        Worker threads; 0 for none.
    clock
        Seconds, never going backwards.
    """

    def __init__(
        self,
        cache: TextureCache,
        queue: RequestQueue | None = None,
        *,
        threads: int,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.cache = cache
        self.thread_count = threads
        self._queue = RequestQueue() if queue is None else queue
        self._clock = clock
        self._lock = threading.Lock()
        self._work = threading.Condition(self._lock)
        self._idle = threading.Condition(self._lock)
        self._threads: list[threading.Thread] = []
        self._listeners: tuple[Listener, ...] = ()
        self._closed = False
        self._key = ""
        self._make: MakeBaker | None = None
        self._bakers: OrderedDict[str, TileBaker] = OrderedDict()
        self._building: set[str] = set()
        self._attempts: dict[tuple[str, int], int] = {}  # failures of a particle, or of a baker under id -1
        self._busy = 0
        self._pace = Pace()
        self._error: str | None = None
        self._clipped_count = 0
        self._over_budget: dict[str, int] = {}

    def select(self, key: str, count: int, scale: float, encoding: Encoding, make_baker: MakeBaker) -> None:
        """Make `key` the current light key and cancel what is queued for any other.

        Parameters
        ----------
        key
            Light key.
        count
            Particles in its scene.
        scale, encoding
            How its codes become luminance.
        make_baker
            Makes its baker; called on the thread that first has something to bake, so it may take its time.
        """
        with self._lock:
            self._check_open()
            if key == self._key:
                return
            for other in self._queue.keys():  # noqa: SIM118  it is no mapping
                self.cache.release(other, self._queue.cancel(other))
            self.cache.begin(key, count, scale, encoding)
            self._key, self._make, self._error = key, make_baker, None
            self._attempts = {}
            self._over_budget = {}
            self._notify_if_idle()

    def request(self, key: str, ids: Ids, distance: NDArray[np.floating], client: str = "") -> int:
        """Note what a client sees now, and queue what has no texture yet; return how many of them are queued.

        Parameters
        ----------
        key
            The light key that the client shows; ignored unless current.
        ids
            (K,) int32, every visible particle, each once.
        distance
            (K,) their distance from the eye, in diagonals of the scene.
        client
            Who looks.
        """
        with self._lock:
            self._check_open()
            if key != self._key:
                return 0
            wanted = self.cache.see(key, ids, client)
            if (key, -1) in self._attempts and self._attempts[key, -1] >= _MAX_ATTEMPTS:
                return 0
            ids, distance = ids[wanted], distance[wanted]
            room = self.cache.room()
            self._over_budget[client] = max(0, len(ids) - room)
            if len(ids) > room:  # baking more would only evict what is on the screen
                nearest = np.argsort(distance, kind="stable")[:room]
                ids, distance = ids[nearest], distance[nearest]
            now_s = self._clock()
            gone = self._queue.push(key, ids, priority(now_s, distance), now_s, client)
            self.cache.mark_queued(key, ids)
            self.cache.release(key, gone)
            if len(self._queue):
                self._start_threads()
                self._work.notify_all()
            else:
                self._notify_if_idle()
            return len(ids)

    def forget(self, client: str) -> None:
        """Withdraw what only this client wanted."""
        with self._lock:
            for key, ids in self._queue.forget(client):
                self.cache.release(key, ids)
            self.cache.forget(client)
            self._over_budget.pop(client, None)
            self._notify_if_idle()

    def subscribe(self, listener: Listener) -> Callable[[], None]:
        """Call `listener` with every finished batch, on the thread that baked it; return what ends that."""
        with self._lock:
            self._check_open()
            self._listeners = (*self._listeners, listener)

        def unsubscribe() -> None:
            with self._lock:
                self._listeners = tuple(each for each in self._listeners if each is not listener)

        return unsubscribe

    def run_once(self) -> bool:
        """Do one piece of work on the caller's thread: make a baker or bake a batch. False if there is none."""
        with self._lock:
            self._check_open()
            job = self._take()
        if job is None:
            return False
        self._do(job)
        return True

    def run_for(self, budget_s: float) -> int:
        """Work on the caller's thread until `budget_s` seconds have passed or nothing is left; return pieces done."""
        end_s = self._clock() + budget_s
        count = 0
        while self._clock() < end_s and self.run_once():
            count += 1
        return count

    def wait(self, timeout_s: float | None = None) -> bool:
        """Block until every request is satisfied and every listener has been told; False after `timeout_s`.

        Without threads the work is done here.
        """
        if self.thread_count == 0:
            self.run_for(math.inf if timeout_s is None else timeout_s)
        with self._lock:
            self._check_open()
            rested = self._idle.wait_for(lambda: self._closed or self._at_rest(), timeout_s)
            self._check_open()
            return rested

    @property
    def error(self) -> str | None:
        """What went wrong last under the current light key, in words; None if nothing did."""
        with self._lock:
            return self._error

    @property
    def clipped_count(self) -> int:
        """Texels brighter than their scale, of all tiles baked so far."""
        with self._lock:
            return self._clipped_count

    @property
    def over_budget(self) -> int:
        """Visible particles that stay without texture because the cache is full of visible ones."""
        with self._lock:
            return max(self._over_budget.values(), default=0)

    @property
    def textures_per_s(self) -> float:
        """Textures finished a second, over the last few seconds."""
        with self._lock:
            return self._pace.textures_per_s(self._clock())

    def close(self) -> None:
        """Stop after the batches in progress and join the threads. Later use raises; closing twice does not."""
        with self._lock:
            self._closed = True
            self._listeners = ()
            self._work.notify_all()
            self._idle.notify_all()
            threads, self._threads = self._threads, []
        atexit.unregister(self.close)
        for thread in threads:
            if thread is not threading.current_thread():
                thread.join(_CLOSE_TIMEOUT_S)
                if thread.is_alive():
                    log.warning("%s is still busy and ends on its own", thread.name)

    def _worker(self) -> None:
        if sys.platform == "linux":
            # A thread's own there: what draws and answers on this machine comes before what bakes.
            with contextlib.suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), 5)
        while True:
            with self._lock:
                job = None
                while not self._closed and (job := self._take()) is None:
                    self._work.wait()
            if job is None:
                return
            self._do(job)

    def _do(self, job: _Job) -> None:
        try:
            if job.baker is None:
                self._build(job)
            else:
                self._bake(job, job.baker)
        finally:
            with self._lock:
                self._busy -= 1
                self._notify_if_idle()

    def _build(self, job: _Job) -> None:
        try:
            baker = job.make()
        except Exception as error:
            log.exception("no baker for light key %s", job.key)
            with self._lock:
                self._building.discard(job.key)
                if self._record_failure(job.key, -1, error) >= _MAX_ATTEMPTS:
                    self.cache.release(job.key, self._queue.cancel(job.key))
                self._work.notify_all()
        else:
            with self._lock:
                self._building.discard(job.key)
                self._bakers[job.key] = baker
                while len(self._bakers) > _BAKERS_KEPT:
                    self._bakers.popitem(last=False)
                self._work.notify_all()

    def _bake(self, job: _Job, baker: TileBaker) -> None:
        start_s = self._clock()
        try:
            codes = np.empty((len(job.ids), self.cache.texels, self.cache.texels), dtype=np.uint8)
            clipped = baker.bake_into(job.ids, codes)
            end_s = self._clock()
            self.cache.publish(job.key, job.ids, codes)
        except Exception as error:
            log.exception("%d textures of light key %s failed", len(job.ids), job.key)
            with self._lock:
                tries = np.array(
                    [self._record_failure(job.key, int(particle), error) for particle in job.ids]
                )
                self.cache.fail(job.key, job.ids[tries >= _MAX_ATTEMPTS])
                self.cache.release(job.key, job.ids[tries < _MAX_ATTEMPTS])
            return
        with self._lock:
            self._clipped_count += clipped
            self._pace.record(start_s, end_s, len(job.ids))
            stale, listeners = job.key != self._key, self._listeners
        batch = TileBatch(job.key, job.ids, codes, stale)
        for listener in listeners:
            try:
                listener(batch)
            except Exception:
                log.exception("a listener to finished textures failed")

    # What follows runs under the lock.

    def _check_open(self) -> None:
        if self._closed:
            raise SessionClosedError("the texture engine is closed — open a new session")

    def _start_threads(self) -> None:
        if self._threads or not self.thread_count:
            return
        self._threads = [
            threading.Thread(target=self._worker, name=f"luxel-bake-{number}", daemon=True)
            for number in range(self.thread_count)
        ]
        # Daemons that compile or bake while the interpreter goes away would crash it.
        atexit.register(self.close)
        for thread in self._threads:
            thread.start()

    def _take(self) -> _Job | None:
        key = self._queue.best(skip=self._building)
        if key is None or self._make is None:
            return None
        self._busy += 1
        baker = self._bakers.get(key)
        if baker is None:
            self._building.add(key)
            return _Job(key, None, self._make, np.empty(0, dtype=np.int32))
        self._bakers.move_to_end(key)
        share = math.ceil(
            len(self._queue) / max(1, self.thread_count)
        )  # the last requests are spread over all threads
        _, ids = self._queue.pop(min(self._pace.batch_count, share), key)
        self.cache.mark_baking(key, ids)
        return _Job(key, baker, self._make, ids)

    def _record_failure(self, key: str, particle: int, error: Exception) -> int:
        if key == self._key:
            self._error = f"{type(error).__name__}: {error}"
        self._attempts[key, particle] = self._attempts.get((key, particle), 0) + 1
        return self._attempts[key, particle]

    def _at_rest(self) -> bool:
        return not self._busy and not len(self._queue)

    def _notify_if_idle(self) -> None:
        if self._at_rest():
            self._idle.notify_all()
