"""What the machinery of dynamic textures costs by itself, with bakers that take no time: `python -m benchmarks.dynamic`.

Frames: noting what is seen and taking a snapshot, while textures stream in and when all are there. Workers: taking requests in,
handing pieces out, publishing, with one lock and with shards. Memory: a random walk of the camera over many particles, against the budget.
"""

from __future__ import annotations

import argparse
import gc
import resource
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.measure import report
from luxel.dynamic.cache import TextureCache
from luxel.dynamic.engine import Engine
from luxel.dynamic.work import Bakers

TEXELS = 16


class Baker:
    """Textures of one value for each particle, at once."""

    def first_light(self, ids: NDArray[np.int32]) -> NDArray[np.float32]:
        """All black."""
        return np.zeros((len(ids), 4), np.float32)

    def preparation(self, threads: int) -> Iterator[None]:
        """Nothing to learn."""
        return iter(())

    def bake_into(self, ids: NDArray[np.int32], codes: NDArray[np.uint8]) -> int:
        """Write the particle's number."""
        codes[...] = (ids % 251).astype(np.uint8)[:, None, None]
        return 0


def engine_of(count: int, max_bytes: int, threads: int = 0, shards: int | None = None) -> Engine:
    cache = TextureCache(TEXELS, max_bytes, shards=shards)
    engine = Engine(cache, threads=threads)
    engine.select("light", count, 1.0, "linear", lambda: Bakers(Baker()))
    return engine


def views(count: int, visible: int, step: float, seed: int = 0) -> Iterator[NDArray[np.int32]]:
    """What is visible in one frame after the other: a window that moves over a shuffled ring of particles."""
    rng = np.random.default_rng(seed)
    ring = rng.permutation(count).astype(np.int32)
    at = 0.0
    while True:
        at += step * visible * rng.uniform(0.2, 1.8)
        yield np.sort(ring[(int(at) + np.arange(visible)) % count])


def frames(count: int, visible: int, rounds: int) -> list[dict[str, Any]]:
    """Milliseconds a frame spends on textures besides shading them."""
    rows = []
    distance = np.random.default_rng(1).random(count)
    for name, step, bake in (
        ("all is there, camera at rest", 0.0, 10**9),
        ("textures stream in, camera at rest", 0.0, 300),
        ("textures stream in, camera moves", 0.02, 300),
    ):
        engine = engine_of(count, 512 << 20)
        looks = views(count, visible, step)
        see, snap, take = [], [], []
        table = None
        for _ in range(rounds):
            ids = next(looks)
            start = time.perf_counter()
            table = engine.cache.snapshot("light")
            snap.append(time.perf_counter() - start)
            start = time.perf_counter()
            engine.request("light", ids, lambda some: (distance[some], None))
            see.append(time.perf_counter() - start)
            start = time.perf_counter()
            done = 0
            while done < bake and engine.run_once():
                done += 100
            take.append(time.perf_counter() - start)
        assert table is not None
        half = rounds // 2
        rows.append(
            {
                "case": name,
                "particles": count,
                "visible": visible,
                "snapshot ms": 1e3 * float(np.median(snap[half:])),
                "sighting ms": 1e3 * float(np.median(see[half:])),
                "work between, ms": 1e3 * float(np.median(take[half:])),
                "textures": engine.cache.stats().textures,
            }
        )
    return rows


def workers(count: int, seconds: float) -> list[dict[str, Any]]:
    """Textures a second that go through queue and cache, while frames go on."""
    rows = []
    for threads in (1, 2, 4, 8):
        for shards in (1, 8):
            engine = engine_of(count, 512 << 20, threads, shards)
            looks = views(count, 35_000, 0.5)
            waits = []
            end = time.perf_counter() + seconds
            start = time.perf_counter()
            while time.perf_counter() < end:
                before = time.perf_counter()
                table = engine.cache.snapshot("light")
                engine.request("light", next(looks), lambda some: (np.zeros(len(some)), None))
                waits.append(time.perf_counter() - before)
                del table
                time.sleep(1 / 60)
            stats = engine.cache.stats()
            rows.append(
                {
                    "threads": threads,
                    "shards": shards,
                    "textures/s": int((stats.ready + stats.refined) / (time.perf_counter() - start)),
                    "frame's share ms": 1e3 * float(np.median(waits)),
                    "p99 ms": 1e3 * float(np.percentile(waits, 99)),
                }
            )
            engine.close()
    return rows


def memory(count: int, budget_mb: int, frames_: int) -> list[dict[str, Any]]:
    """Bytes under a random walk, as the cache counts them and as the system does."""
    gc.collect()
    looks = views(count, 35_000, 0.3)
    next(looks)
    before = resident()
    engine = engine_of(count, budget_mb << 20)
    most, table = 0, None
    peak = threading.Event()
    for _ in range(frames_):
        engine.request("light", next(looks), lambda some: (np.zeros(len(some)), None))
        engine.run_for(1e9)
        table = engine.cache.snapshot("light")
        nbytes = engine.cache.stats().nbytes
        most = max(most, nbytes)
        if nbytes > engine.cache.max_bytes:
            peak.set()
    del table
    stats = engine.cache.stats()
    return [
        {
            "particles": count,
            "budget MiB": budget_mb,
            "counted, most MiB": most / 2**20,
            "resident, more MiB": (resident() - before) / 2**20,
            "textures made": stats.ready,
            "evicted": stats.evicted,
            "dropped": stats.dropped,
            "above budget": peak.is_set(),
        }
    ]


def resident() -> int:
    """Bytes of memory that this process holds now."""
    status = Path("/proc/self/statm")
    if status.exists():
        return int(status.read_text().split()[1]) * resource.getpagesize()
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    count = 1_000_000
    report("dynamic: a frame's share", frames(count, 35_000, 20 if options.quick else 60), options.json)
    report("dynamic: workers", workers(count, 1.0 if options.quick else 4.0), options.json)
    report("dynamic: memory", memory(count, 64, 40 if options.quick else 300), options.json)


if __name__ == "__main__":
    main()
