"""Compile what the engine's bookkeeping needs before anything else is compiled.

Numba compiles one function at a time in a process. Who asks for a small kernel while a thread of the engine compiles one of light waits until that is
done, which takes half a minute on a slow machine; and it may be the event loop of a viewer's server, or somebody who draws frames, that asks.
"""

from __future__ import annotations

import functools

import numpy as np

from luxel.dynamic.entries import STORED, WANTING
from luxel.dynamic.queue import RequestQueue
from luxel.dynamic.sightings import by_shard
from luxel.kernels.requests import list_lacking
from luxel.kernels.seen import are_rising, distances, note_sighting

__all__ = ["rehearse"]


@functools.cache
def rehearse() -> None:
    """Go through what takes no time once, with a few particles; only the first call of a process does anything."""
    ids = np.arange(4, dtype=np.int32)
    state = np.zeros(len(ids), np.uint8)
    are_rising(ids, len(ids))
    note_sighting(ids, ids, state, STORED, WANTING, np.zeros(len(ids), np.int64), 0)
    by_shard(ids, 2)
    list_lacking(ids, state, WANTING, np.empty_like(ids), np.empty_like(state))
    apart = np.zeros(len(ids))
    distances(np.zeros((len(ids), 3), np.float32), ids, np.zeros(3), 1.0, apart)
    queue = RequestQueue()
    queue.push(ids, apart)
    queue.push(ids[2:], apart[2:])  # some are carried over, and some are picked
    queue.refresh(0.0)
    queue.pop(1)
    queue.refresh(queue.expiry_s)
