"""Engine: satisfies texture requests, on threads of its own or on the caller's (paper 4.2, figure 7)."""

from __future__ import annotations

import atexit
import contextlib
import functools
import logging
import math
import os
import sys
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from luxel.dynamic.cache import TextureCache
from luxel.dynamic.pace import Pace
from luxel.dynamic.queue import RequestQueue, priority
from luxel.dynamic.work import (
    CoarseBatch,
    CoarseListener,
    Listener,
    Listeners,
    MakeBaker,
    TileBaker,
    TileBatch,
)
from luxel.errors import SessionClosedError
from luxel.textures.textures import Encoding

__all__ = ["Engine"]

log = logging.getLogger(__name__)

Ids = NDArray[np.int32]
Job = Callable[[], None]

_MAX_ATTEMPTS = 3
_BAKERS_KEPT = 3  # an undone slider finds its tree and filter again
_CLOSE_TIMEOUT_S = 5.0
_FIRST_LIGHT_COUNT = 1024  # particles in a batch: about a tenth of a second


@dataclass(eq=False)
class _Workshop:
    """The baker of one light key, and whether it is prepared for textures: not yet, just now, or since."""

    baker: TileBaker
    preparing: bool = False
    prepared: bool = False


class Engine:
    """Bakes what is requested, best first, and tells listeners.

    What has neither texture nor coarse record gets its first light, a record that costs a sixteenth of a texture,
    before any texture is baked, and even if the cache has no room for its texture.

    One light key is current (:meth:`select`); requests for another are ignored. Work that waits for an old key is
    cancelled; what is being baked for it is finished and cached under its own key.

    Worker threads start with the first request and sleep on a condition while there is nothing to do. With
    ``threads=0`` nothing happens until somebody calls :meth:`run_once` or :meth:`run_for`: the per-frame callback of
    the paper. Both ways may be used together.

    Safe to use from several threads: the engine owns one lock, which also guards its queues; it calls the cache, but
    neither bakers nor listeners, while it holds it.

    Parameters
    ----------
    cache
        Where tiles are published.
    queue
        Where requests for textures wait; used by this engine alone.
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
        self._dark = RequestQueue(self._queue.expiry_s, self._queue.max_count)  # requests for first light
        self._dawning: list[Ids] = []  # whose first light is being made
        self._clock = clock
        self._lock = threading.Lock()
        self._work = threading.Condition(self._lock)
        self._idle = threading.Condition(self._lock)
        self._threads: list[threading.Thread] = []
        self._tiles_heard: Listeners[TileBatch] = Listeners()
        self._coarse_heard: Listeners[CoarseBatch] = Listeners()
        self._closed = False
        self._key = ""
        self._make: MakeBaker | None = None
        self._workshops: OrderedDict[str, _Workshop] = OrderedDict()
        self._building: set[str] = set()
        self._attempts: dict[
            tuple[str, int], int
        ] = {}  # failures of a particle, of a baker under id -1, of first light under id -2
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
            for other in {*self._queue.keys(), *self._dark.keys()}:
                self._cancel(other)
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
            now_s = self._clock()
            self._request_first_light(key, ids, distance, now_s, client)
            room = self.cache.room()
            self._over_budget[client] = max(0, len(ids) - room)
            if len(ids) > room:  # baking more would only evict what is on the screen
                nearest = np.argsort(distance, kind="stable")[:room]
                ids, distance = ids[nearest], distance[nearest]
            gone = self._queue.push(key, ids, priority(now_s, distance), now_s, client)
            self.cache.mark_queued(key, ids)
            self.cache.release(key, gone)
            if len(self._queue) or len(self._dark):
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
            self._dark.forget(client)
            self.cache.forget(client)
            self._over_budget.pop(client, None)
            self._notify_if_idle()

    def subscribe(self, listener: Listener) -> Callable[[], None]:
        """Call `listener` with every finished batch, on the thread that baked it; return what ends that."""
        with self._lock:
            self._check_open()
            return self._tiles_heard.add(listener)

    def subscribe_coarse(self, listener: CoarseListener) -> Callable[[], None]:
        """Call `listener` with every batch of first light, on the thread that made it; return what ends that."""
        with self._lock:
            self._check_open()
            return self._coarse_heard.add(listener)

    def run_once(self) -> bool:
        """Do one piece of work on the caller's thread, such as to bake a batch. False if there is none."""
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
            self._tiles_heard.clear()
            self._coarse_heard.clear()
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

    def _do(self, job: Job) -> None:
        try:
            job()
        finally:
            with self._lock:
                self._busy -= 1
                self._notify_if_idle()

    def _build(self, key: str, make: MakeBaker) -> None:
        try:
            baker = make()
        except Exception as error:
            log.exception("no baker for light key %s", key)
            with self._lock:
                self._building.discard(key)
                self._record_baker_failure(key, error)
        else:
            with self._lock:
                self._building.discard(key)
                self._workshops[key] = _Workshop(baker)
                while len(self._workshops) > _BAKERS_KEPT:
                    self._workshops.popitem(last=False)
                self._work.notify_all()

    def _prepare(self, key: str, shop: _Workshop) -> None:
        try:
            shop.baker.prepare(max(1, self.thread_count))
        except Exception as error:
            log.exception("the baker of light key %s is not ready for textures", key)
            with self._lock:
                shop.preparing = False
                self._record_baker_failure(key, error)
        else:
            with self._lock:
                shop.preparing, shop.prepared = False, True
                self._work.notify_all()

    def _first_light(self, key: str, baker: TileBaker, ids: Ids) -> None:
        try:
            batch = CoarseBatch(key, ids, baker.first_light(ids))
            kept = self.cache.put_coarse(key, ids, batch.records)
        except Exception as error:
            log.exception("first light of light key %s failed", key)
            kept = False
            with self._lock:
                if self._record_failure(key, -2, error) >= _MAX_ATTEMPTS:
                    self._dark.cancel(key)
        with self._lock:
            self._dawning = [each for each in self._dawning if each is not ids]
        if kept:
            self._coarse_heard.tell(batch)

    def _bake(self, key: str, baker: TileBaker, ids: Ids) -> None:
        start_s = self._clock()
        try:
            codes = np.empty((len(ids), self.cache.texels, self.cache.texels), dtype=np.uint8)
            clipped = baker.bake_into(ids, codes)
            end_s = self._clock()
            self.cache.publish(key, ids, codes)
        except Exception as error:
            log.exception("%d textures of light key %s failed", len(ids), key)
            with self._lock:
                tries = np.array([self._record_failure(key, int(particle), error) for particle in ids])
                self.cache.fail(key, ids[tries >= _MAX_ATTEMPTS])
                self.cache.release(key, ids[tries < _MAX_ATTEMPTS])
            return
        with self._lock:
            self._clipped_count += clipped
            self._pace.record(start_s, end_s, len(ids))
            stale = key != self._key
        self._tiles_heard.tell(TileBatch(key, ids, codes, stale))

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

    def _request_first_light(
        self, key: str, ids: Ids, distance: NDArray[np.floating], now_s: float, client: str
    ) -> None:
        dark = self.cache.lacks_coarse(key, ids)
        if self._attempts.get((key, -2), 0) >= _MAX_ATTEMPTS:
            dark[:] = False
        for dawning in self._dawning:
            dark &= ~np.isin(ids, dawning)
        self._dark.push(key, ids[dark], priority(now_s, distance[dark]), now_s, client)

    def _cancel(self, key: str) -> None:
        """Withdraw every request under a light key."""
        self._dark.cancel(key)
        self.cache.release(key, self._queue.cancel(key))

    def _take(self) -> Job | None:
        """Return the best piece of work: a baker, else first light, else its preparation for textures, else those."""
        key = self._dark.best(skip=self._building) or self._queue.best(skip=self._building)
        if key is None or self._make is None:
            return None
        shop = self._workshops.get(key)
        if shop is None:
            self._building.add(key)
            job = functools.partial(self._build, key, self._make)
        elif len(self._dark):
            _, ids = self._dark.pop(min(_FIRST_LIGHT_COUNT, self._share(self._dark)), key)
            self._dawning.append(ids)
            job = functools.partial(self._first_light, key, shop.baker, ids)
        elif shop.preparing:
            return None
        elif not shop.prepared:
            shop.preparing = True
            job = functools.partial(self._prepare, key, shop)
        else:
            _, ids = self._queue.pop(min(self._pace.batch_count, self._share(self._queue)), key)
            self.cache.mark_baking(key, ids)
            job = functools.partial(self._bake, key, shop.baker, ids)
        if shop is not None:
            self._workshops.move_to_end(key)
        self._busy += 1
        return job

    def _share(self, queue: RequestQueue) -> int:
        """What one thread takes at most, so that the last requests are spread over all of them."""
        return math.ceil(len(queue) / max(1, self.thread_count))

    def _record_baker_failure(self, key: str, error: Exception) -> None:
        if self._record_failure(key, -1, error) >= _MAX_ATTEMPTS:
            self._cancel(key)
        self._work.notify_all()

    def _record_failure(self, key: str, particle: int, error: Exception) -> int:
        if key == self._key:
            self._error = f"{type(error).__name__}: {error}"
        self._attempts[key, particle] = self._attempts.get((key, particle), 0) + 1
        return self._attempts[key, particle]

    def _at_rest(self) -> bool:
        return not self._busy and not len(self._queue) and not len(self._dark)

    def _notify_if_idle(self) -> None:
        if self._at_rest():
            self._idle.notify_all()
