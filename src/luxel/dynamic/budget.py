"""BudgetDriver: gives an engine without threads a share of every frame, where those who draw do not call it themselves."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from luxel.dynamic.threads import end_threads, start_threads

__all__ = ["BudgetDriver", "pause_after"]

log = logging.getLogger(__name__)

_FRAME_S = 1 / 30
_LEAST_PAUSE_S = 0.002  # so that whoever draws gets its turn, however long the budget


def pause_after(took_s: float) -> float:
    """Seconds to leave to others after work of `took_s`: what is left of a thirtieth of a second, but at least two milliseconds."""
    return max(_LEAST_PAUSE_S, _FRAME_S - took_s)


class BudgetDriver:
    """Threads that work for a budget, give way for the rest of a frame, and sleep while there is nothing to do.

    A frame is a thirtieth of a second here, or the budget and a short pause if that is longer. Threads start with the first :meth:`wake`.

    Safe to use from several threads; owns a lock for its list of threads.

    Parameters
    ----------
    run_for
        Works for about so many seconds and returns how much it has done; called on several threads at once.
    budget_s
        Seconds a frame.
    threads
        How many.
    """

    def __init__(self, run_for: Callable[[float], int], budget_s: float, threads: int) -> None:
        self.budget_s = budget_s
        self._run_for = run_for
        self._count = threads
        self._lock = threading.Lock()
        self._threads: list[threading.Thread] = []
        self._work = [threading.Event() for _ in range(threads)]
        self._closed = threading.Event()

    def wake(self) -> None:
        """Say that there is something to do."""
        if not self._threads:
            self._start()
        for event in self._work:
            event.set()

    def close(self) -> None:
        """Stop after the pieces in progress and join the threads; closing twice does no harm."""
        self._closed.set()
        with self._lock:
            threads, self._threads = self._threads, []
        for event in self._work:
            event.set()
        end_threads(threads, self.close)

    def _start(self) -> None:
        with self._lock:
            if self._threads or self._closed.is_set():
                return
            self._threads = [
                threading.Thread(target=self._work_on, args=(event,), name=f"luxel-frame-{k}", daemon=True)
                for k, event in enumerate(self._work)
            ]
            start_threads(self._threads, self.close)

    def _work_on(self, work: threading.Event) -> None:
        while True:
            work.wait()
            work.clear()
            if self._closed.is_set():
                return
            start_s = time.monotonic()
            try:
                if self._run_for(self.budget_s):
                    self.wake()  # there may be more, for all: what has been prepared here, for one
            except BaseException as error:
                if not self._closed.is_set():  # else it is what closed
                    log.exception("a frame's share of light failed: %s", error)
            self._closed.wait(pause_after(time.monotonic() - start_s))
