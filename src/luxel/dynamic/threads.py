"""Threads that end before the interpreter does: daemons that compile or bake while it goes away would crash it."""

from __future__ import annotations

import atexit
import logging
import threading
from collections.abc import Callable, Iterable

__all__ = ["end_threads", "start_threads"]

log = logging.getLogger(__name__)

_CLOSE_TIMEOUT_S = 5.0


def start_threads(threads: Iterable[threading.Thread], close: Callable[[], object]) -> None:
    """Start daemons; `close`, which must tell them to end and call :func:`end_threads`, is called at the interpreter's end."""
    atexit.register(close)
    for thread in threads:
        thread.start()


def end_threads(threads: Iterable[threading.Thread], close: Callable[[], object]) -> None:
    """Wait for threads that have been told to end, but for the caller's own; one that takes too long is named in the log."""
    atexit.unregister(close)
    for thread in threads:
        if thread is not threading.current_thread():
            thread.join(_CLOSE_TIMEOUT_S)
            if thread.is_alive():
                log.warning("%s is still busy and ends on its own", thread.name)
