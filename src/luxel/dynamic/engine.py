"""Engine: satisfies texture requests, on threads of its own or on the caller's (paper 4.2, figure 7)."""

from __future__ import annotations

import contextlib
import functools
import logging
import math
import os
import queue
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from luxel.dynamic.baking import Baking
from luxel.dynamic.cache import TextureCache
from luxel.dynamic.desk import Desk, Kind
from luxel.dynamic.entries import Entries
from luxel.dynamic.pace import Cost
from luxel.dynamic.preparing import TEXTURES, Preparing, waiting
from luxel.dynamic.queue import Heuristic, RequestQueue, recent_and_near
from luxel.dynamic.rehearsal import rehearse
from luxel.dynamic.shares import Helpers
from luxel.dynamic.sightings import Ids, Measure, Sighting
from luxel.dynamic.threads import end_threads, start_threads
from luxel.dynamic.work import CoarseListener, Listener, MakeBakers
from luxel.dynamic.workshop import Workshop
from luxel.errors import SessionClosedError
from luxel.textures.textures import Encoding

__all__ = ["Engine"]

log = logging.getLogger(__name__)

#: Does a piece of work and returns the seconds that particles took; None for what is no work on particles.
Job = Callable[[], float | None]

# Pieces are short enough to notice a new priority soon, long enough to hide what each costs besides. That is Python, which one thread
# at a time can run: of more threads than a few, each takes longer pieces, and some thread still asks for a new one as often.
_PIECE_S, _FEW_THREADS = 0.03, 4
# The last piece of a budget may be so many times longer, rather than be followed by one that is hardly worth taking.
_LAST_PIECE = 1.5
# Whoever waits so long for something to be prepared is not put off any more for what has come since.
_PATIENCE_S = {Kind.FIRST_TEXTURE: 2.0, Kind.REFINEMENT: 10.0}
_OLDEST_EVERY = 4  # of so many pieces of work, one goes to the requests that have waited longest


@dataclass(frozen=True, eq=False)
class _Lit:
    """The current light; replaced as a whole, so that frames need no lock to read it."""

    light: Entries
    make: MakeBakers


class Engine:
    """Bakes what is requested, best first, and tells listeners.

    What has neither texture nor coarse record, whatever its shard, gets its first light, a record that costs a fraction of a texture, before any texture is
    baked, and even if the cache has no room for its texture; then an estimate, where there is somebody who makes those; then its texture,
    unless it is small on the screen. Of every four pieces of work, one goes to those requests that have waited longest.

    One light key is current (:meth:`select`); requests for another are ignored. Work that waits for an old key is
    cancelled; what is being baked for it is finished and cached under its own key.

    Worker threads start with the first request and sleep while there is nothing to do. With ``threads=0`` nothing happens until
    somebody calls :meth:`run_once` or :meth:`run_for`: the per-frame callback of the paper. Both ways may be used together, and
    the callback by several threads at once.

    What fails is reported (:attr:`error`) and done once more, one particle at a time; what fails again is given up. A kind of work
    that fails for many particles in a row is given up as a whole until the light changes.

    Safe to use from several threads. :meth:`request`, which frames call, takes no lock that a worker holds while it works; the engine's
    own is for who does what, and neither bakers nor listeners are called while it is held.

    Parameters
    ----------
    cache
        Where textures are published.
    threads
        Worker threads; 0 for none.
    clock
        Seconds, never going backwards.
    heuristic
        Which request comes first.
    expiry_s
        Requests lapse when nobody has sighted them for so many seconds.
    small_pixels
        A particle narrower than this on every screen is content with an estimate.
    """

    def __init__(
        self,
        cache: TextureCache,
        *,
        threads: int,
        clock: Callable[[], float] = time.monotonic,
        heuristic: Heuristic = recent_and_near,
        expiry_s: float = 2.0,
        small_pixels: float = 0.0,
    ) -> None:
        rehearse()
        self.cache = cache
        self.thread_count = threads
        self.small_pixels = small_pixels
        self._make_queue = functools.partial(RequestQueue, heuristic, expiry_s)
        self._clock = clock
        self._lit: _Lit | None = None
        self._closed = False
        self._bell: queue.SimpleQueue[None] = queue.SimpleQueue()
        self._sleepers = 0
        self._lock = threading.Lock()  # what follows is for those who work
        self._idle = threading.Condition(self._lock)
        self._baking = Baking(cache, clock, self._lock)
        self._preparing = Preparing(self._baking, clock, threads)
        self._threads: list[threading.Thread] = []
        self._busy = 0
        self._turn = 0
        self._since_oldest = 0  # pieces since one went to those that have waited longest
        self._events = 0  # counts what may give a sleeping worker something to do, besides sightings
        self._looking = threading.Lock()  # who takes sightings in at the start of a budget
        self._handling = Cost()  # of pieces that are done within a budget

    def select(
        self,
        key: str,
        count: int,
        scale: float,
        encoding: Encoding,
        make_bakers: MakeBakers,
        *,
        beside: bool = False,
    ) -> None:
        """Make `key` the current light key and cancel what is queued for any other.

        Parameters
        ----------
        key
            Light key.
        count
            Particles in its scene.
        scale, encoding
            How its codes become luminance.
        make_bakers
            Makes its bakers; called on the thread that first has something to bake, so it may take its time.
        beside
            Whether another engine over the same cache works at the light that is current there, see `TextureCache.begin`.

        Raises
        ------
        InputError
            If the cache's budget is too small for so many particles.
        """
        with self._lock:
            self._check_open()
            lit = self._lit
            if lit is not None and key == lit.light.key and not beside:
                return
            light = self.cache.begin(key, count, scale, encoding, beside=beside)
            if lit is not None and light is lit.light:
                return
            for desk in self._baking.desks:
                desk.select(None)
            if not self._baking.desks:
                self._baking.desks = tuple(
                    Desk(k, self.cache, self._make_queue, self.small_pixels)
                    for k in range(len(self.cache.shards))
                )
            self._lit = _Lit(light, make_bakers)
            self._baking.light = light
            self._baking.error = None
            self._preparing.begin_anew()
            self._baking.failures.clear()
            for desk in self._baking.desks:
                desk.select(light)
            self._notify_if_idle()

    def request(
        self,
        key: str,
        ids: Ids,
        measure: Measure,
        client: str = "",
        eye: NDArray[np.float32] | None = None,
    ) -> int:
        """Note what a client sees now, so that what is lacking gets done; return for how many particles that may be.

        Parameters
        ----------
        key
            The light key that the client shows; ignored unless current.
        ids
            (K,) int32, every visible particle, ascending, each once. Not copied.
        measure
            How far and large they are; called later, on threads that work.
        client
            Who looks.
        eye
            (3,) from where, in normalised units; estimates are of what is looked at from there. None if nobody says.
        """
        self._check_open()
        lit = self._lit
        if lit is None or key != lit.light.key:
            return 0
        sighting = Sighting(client, self.cache.next_number(), key, ids, measure, self._clock(), eye)
        lacking = self.cache.see(sighting)
        if lacking:
            if self.thread_count and not self._threads:
                self._start_threads()
            self._ring()
        return lacking

    def forget(self, client: str) -> None:
        """Withdraw what only this client wanted."""
        self.cache.forget(client)
        with self._lock:
            self._notify_if_idle()

    def subscribe(self, listener: Listener) -> Callable[[], None]:
        """Call `listener` with every finished batch, on the thread that baked it; return what ends that."""
        self._check_open()
        return self._baking.tiles_heard.add(listener)

    def subscribe_coarse(self, listener: CoarseListener) -> Callable[[], None]:
        """Call `listener` with every batch of first light, on the thread that made it; return what ends that."""
        self._check_open()
        return self._baking.coarse_heard.add(listener)

    def run_once(self, limit_s: float = math.inf) -> bool:
        """Do one piece of work on the caller's thread, such as to bake a batch, of about `limit_s` seconds. False if there is none."""
        self._check_open()
        job = self._take(limit_s)
        if job is None:
            return False
        self._do(job)
        return True

    def run_for(self, budget_s: float, helpers: Helpers | None = None) -> int:
        """Work on the caller's thread, and with its `helpers`, until `budget_s` seconds have passed or nothing is left; return pieces done.

        Sightings are taken in first. Pieces are made to fit into what is left of the budget then, as far as their pace is known and what handling them costs, and
        none is begun that is known not to fit, or to be more handling than work, but for the first. Textures for which the time turns out too short are left to
        the next piece. So the budget is overrun by what the last third of a piece takes longer than the rest of it, or by the one piece that is done.
        """
        self._check_open()
        if budget_s <= 0:
            return 0
        begun_s = self._clock()
        end_s = begun_s + budget_s
        known = not self._look(begun_s)
        count = 0
        while (left_s := end_s - (begun_s := self._clock())) > 0 or not count:
            job = None
            if known:  # another thread has not come to the end of what is new: meanwhile, what waits since earlier frames
                known = False
                job = self._take(max(0.0, left_s), known=True, helpers=helpers)
            if job is None:
                job = self._take(max(0.0, left_s), must_fit=count > 0, helpers=helpers)
            if job is None:
                break
            work_s = self._do(job)
            if work_s is not None:
                with self._lock:
                    self._handling.record(self._clock() - begun_s - work_s)
            count += 1
            if self._closed:
                break
        return count

    def take_in(self) -> None:
        """Take in what frames have sighted, so that the next budget need not begin with it."""
        self._check_open()
        self._look(self._clock())

    def _look(self, now_s: float) -> bool:
        """Take in what frames have sighted; False if another thread is doing so: two would only wait for each other's Python."""
        if not self._looking.acquire(blocking=False):
            return False
        try:
            for desk in self._baking.desks:
                desk.look(now_s)
        finally:
            self._looking.release()
        return True

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

    def settle(self) -> None:
        """Take in all sightings, so that the counts of the cache are up to date."""
        now_s = self._clock()
        for desk in self._baking.desks:
            desk.waiting(now_s)

    @property
    def error(self) -> str | None:
        """What went wrong last under the current light key, in words; None if nothing did."""
        return self._baking.error

    @property
    def clipped_count(self) -> int:
        """Texels brighter than their scale, of all textures baked so far."""
        return self._baking.clipped_count

    @property
    def over_budget(self) -> int:
        """Visible particles that stay without texture because the cache is full of visible ones."""
        return sum(desk.over_budget for desk in self._baking.desks)

    @property
    def textures_per_s(self) -> float:
        """Textures finished a second, estimates included, over the last few seconds."""
        with self._lock:
            return self._baking.rate.per_s(self._clock())

    def close(self) -> None:
        """Stop after the pieces in progress and join the threads. Later use raises; closing twice does not."""
        with self._lock:
            self._closed = True
            self._baking.tiles_heard.clear()
            self._baking.coarse_heard.clear()
            self._idle.notify_all()
            threads, self._threads = self._threads, []
        for _ in threads:
            self._bell.put(None)
        end_threads(threads, self.close)

    def _check_open(self) -> None:
        if self._closed:
            raise SessionClosedError("the texture engine is closed — open a new session")

    def _ring(self) -> None:
        """Wake a sleeping worker; it wakes the next if it finds something to do."""
        if self._sleepers and self._bell.empty():
            self._bell.put(None)

    def _start_threads(self) -> None:
        with self._lock:
            if self._threads or self._closed:
                return
            self._threads = [
                threading.Thread(target=self._worker, name=f"luxel-bake-{number}", daemon=True)
                for number in range(self.thread_count)
            ]
            start_threads(self._threads, self.close)

    def _worker(self) -> None:
        if sys.platform == "linux":
            # A thread's own there: what draws and answers on this machine comes before what bakes.
            with contextlib.suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), 5)
        while not self._closed:
            known = self.cache.version, self._events
            job = self._take()
            if job is None:
                self._sleep(known)
                continue
            self._ring()
            try:
                self._do(job)
            except BaseException as error:
                log.exception("a baking thread goes on after an error")
                self._baking.error = f"{type(error).__name__}: {error}"

    def _sleep(self, known: tuple[int, int]) -> None:
        with self._lock:
            self._sleepers += 1
        # Whoever comes with something new from here on sees a sleeper; who came before has changed one of these.
        if known == (self.cache.version, self._events) and not self._closed:
            self._bell.get()
        with self._lock:
            self._sleepers -= 1

    def _do(self, job: Job) -> float | None:
        try:
            return job()
        finally:
            with self._lock:
                self._busy -= 1
                self._events += 1
                self._notify_if_idle()
            self._ring()

    def _take(
        self,
        limit_s: float = math.inf,
        *,
        must_fit: bool = False,
        known: bool = False,
        helpers: Helpers | None = None,
    ) -> Job | None:
        """Return the next piece of work: a baker, else work on particles, else what must be prepared for that.

        If `known`, work on particles that needs no look at what frames have sighted, and no waiting for threads that take some.
        """
        now_s = self._clock()
        left_s, piece_s = limit_s, _PIECE_S * max(1.0, self.thread_count / _FEW_THREADS)
        with self._lock:
            lit = self._lit
            if lit is None:
                return None
            shop = self._preparing.shop(lit.light.key)
            careful = not math.isinf(left_s)
            handling_s = self._handling.each_s if careful else 0.0
            left_s -= handling_s
            end_s = now_s + left_s
            limit_s = left_s if left_s <= _LAST_PIECE * piece_s else piece_s
            paces = {
                kind: pace
                for kind, pace in self._baking.paces.items()
                if not must_fit or max(handling_s, pace.each_s) <= left_s
            }
            most = {kind: pace.count(limit_s, careful=careful) for kind, pace in paces.items()}
            self._turn += 1
            turn = self._turn
            self._since_oldest += 1
            oldest = self._since_oldest >= _OLDEST_EVERY and not known
            if oldest and len(paces) == len(
                self._baking.paces
            ):  # else what has waited longest may not be among what fits
                self._since_oldest = 0
            self._busy += 1
        job = None
        try:
            if known:
                if shop is not None:
                    most = {kind: count for kind, count in most.items() if shop.is_ready(kind)}
                    job = self._take_known(lit, shop, most, turn, helpers, end_s)
            elif shop is None:
                job = self._preparing.take_build(lit.light, lit.make, now_s)
            else:
                most = {kind: count for kind, count in most.items() if shop.is_ready(kind)}
                if oldest and self._is_overdue(shop, now_s):
                    job = self._preparing.take_preparation(lit.light, shop, now_s, limit_s)
                if job is None:
                    job = self._take_piece(lit, shop, now_s, most, turn, oldest, helpers, end_s)
                if job is None:
                    job = self._preparing.take_preparation(lit.light, shop, now_s, limit_s)
        finally:
            if job is None:
                with self._lock:
                    # It was nobody's turn: whoever has waited longest is not passed over for it.
                    self._since_oldest = _OLDEST_EVERY if oldest else max(0, self._since_oldest - 1)
                    self._busy -= 1
                    self._notify_if_idle()
        return job

    def _take_piece(
        self,
        lit: _Lit,
        shop: Workshop,
        now_s: float,
        most: Mapping[Kind, int],
        turn: int,
        oldest: bool,
        helpers: Helpers | None,
        end_s: float,
    ) -> Job | None:
        """Return work on particles: a kind at a time over all desks, the first of them in turn; or what has waited longest of all."""
        desks = self._desks_from(turn)
        threads = max(1, self.thread_count)
        offers = [(desk, kind) for kind in Kind if kind in most for desk in desks]
        if oldest:
            waits = {desk: desk.oldest_s(most, now_s) for desk in desks}
            # Stable: of what has waited as long, first light comes first.
            offers.sort(key=lambda offer: waits[offer[0]].get(offer[1], math.inf))
        for desk, kind in offers:
            if not desk.may_have(kind):
                continue
            piece = desk.take(lit.light, kind, most[kind], now_s, threads, oldest=oldest)
            if piece is not None:
                return functools.partial(self._baking.do, desk, shop, piece, helpers, end_s)
        return None

    def _take_known(
        self,
        lit: _Lit,
        shop: Workshop,
        most: Mapping[Kind, int],
        turn: int,
        helpers: Helpers | None,
        end_s: float,
    ) -> Job | None:
        """Return work on particles that desks know of, a kind at a time over all desks that no other thread is at."""
        threads = max(1, self.thread_count)
        for kind in most:
            for desk in self._desks_from(turn):
                piece = desk.take_known(lit.light, kind, most[kind], threads)
                if piece is not None:
                    return functools.partial(self._baking.do, desk, shop, piece, helpers, end_s)
        return None

    def _desks_from(self, turn: int) -> tuple[Desk, ...]:
        """Return all desks, each of them first in its turn."""
        first = turn % len(self._baking.desks)
        return (*self._baking.desks[first:], *self._baking.desks[:first])

    def _is_overdue(self, shop: Workshop, now_s: float) -> bool:
        """Whether some request has waited long for preparation, since ever new particles want first light, or estimates."""
        kinds = [kind for kind in TEXTURES if not shop.is_ready(kind)]
        return bool(kinds) and any(
            since_s < now_s - _PATIENCE_S[kind]
            for desk in self._baking.desks
            for kind, since_s in desk.oldest_s(kinds, now_s).items()
        )

    # What follows runs under the lock.

    def _at_rest(self) -> bool:
        return not self._busy and not waiting(self._baking.desks, self._clock())

    def _notify_if_idle(self) -> None:
        if not self._busy:
            self._idle.notify_all()
