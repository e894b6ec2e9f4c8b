"""A baker whose texels are a function of key and particle, and a clock that moves when told."""

from __future__ import annotations

import threading
import zlib

import numpy as np

from luxel.dynamic.cache import TextureCache
from luxel.dynamic.engine import Engine
from luxel.dynamic.queue import RequestQueue

TEXELS = 4
GUARD_S = 60.0  # only ever waited for when a test is about to fail


def ids_of(*values: int) -> np.ndarray:
    return np.array(values, dtype=np.int32)


def code_of(key: str, ids: np.ndarray) -> np.ndarray:
    """(K,) uint8: what every texel of these textures is."""
    return ((ids.astype(np.int64) * 7 + zlib.crc32(key.encode())) % 251).astype(np.uint8)


def record_of(key: str, ids: np.ndarray) -> np.ndarray:
    """(K, 4) float32: their first light."""
    return code_of(key, ids)[:, None] + np.arange(4, dtype=np.float32)


class Clock:
    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


class FakeBaker:
    """Bakes `code_of`, takes `texture_s` of fake time a texture, fails for `bad` particles while told to."""

    def __init__(
        self, key: str, clock: Clock | None = None, texture_s: float = 0.0, bad: tuple[int, ...] = ()
    ) -> None:
        self.key, self.clock, self.texture_s = key, clock, texture_s
        self.bad = set(bad)
        self.batches: list[list[int]] = []
        self.work: list[tuple[str, list[int]]] = []  # all that was asked of it, in order
        self.lock = threading.Lock()

    def first_light(self, ids: np.ndarray) -> np.ndarray:
        with self.lock:
            self.work.append(("first light", ids.tolist()))
        return record_of(self.key, ids)

    def prepare(self, threads: int) -> None:
        with self.lock:
            self.work.append(("prepare", []))

    def bake_into(self, ids: np.ndarray, codes: np.ndarray) -> int:
        with self.lock:
            self.batches.append(ids.tolist())
            self.work.append(("bake", ids.tolist()))
        if self.clock is not None:
            self.clock.now_s += self.texture_s * len(ids)
        codes[:] = 99  # a batch that fails must not leave this behind
        if self.bad & set(ids.tolist()):
            raise ArithmeticError("a bad particle")
        codes[:] = code_of(self.key, ids)[:, None, None]
        return int(np.count_nonzero(ids % 10 == 0))


class Stage:
    """An engine over fake bakers, and what its listeners heard."""

    def __init__(
        self,
        threads: int = 0,
        count: int = 1000,
        capacity: int = 100_000,
        clock: Clock | None = None,
        expiry_s: float = 2.0,
        **baker: object,
    ) -> None:
        self.count = count
        self.clock = clock or Clock()
        self.cache = TextureCache(TEXELS, capacity * TEXELS * TEXELS)
        self.engine = Engine(self.cache, RequestQueue(expiry_s), threads=threads, clock=self.clock)
        self.bakers: dict[str, FakeBaker] = {}
        self.made: list[str] = []
        self.baker_options = baker
        self.heard: list[tuple[str, int]] = []
        self.stale: set[str] = set()
        self.wrong: list[str] = []
        self._lock = threading.Lock()
        self.engine.subscribe(self.listen)
        self.dawned: list[tuple[str, int]] = []
        self.engine.subscribe_coarse(self.listen_coarse)

    def listen(self, batch) -> None:
        with self._lock:
            self.heard += [(batch.key, each) for each in batch.ids.tolist()]
            if batch.stale:
                self.stale.add(batch.key)
            if not (batch.codes == code_of(batch.key, batch.ids)[:, None, None]).all():
                self.wrong.append(batch.key)

    def listen_coarse(self, batch) -> None:
        with self._lock:
            self.dawned += [(batch.key, each) for each in batch.ids.tolist()]
            if not (batch.records == record_of(batch.key, batch.ids)).all():
                self.wrong.append(batch.key)

    def make(self, key: str) -> FakeBaker:
        with self._lock:
            self.made.append(key)
            return self.bakers.setdefault(key, FakeBaker(key, **self.baker_options))

    def select(self, key: str) -> None:
        self.engine.select(key, self.count, 1.0, "linear", lambda: self.make(key))

    def request(self, key: str, ids, distance=None, client: str = "") -> int:
        ids = np.asarray(ids, dtype=np.int32)
        return self.engine.request(
            key, ids, np.zeros(len(ids)) if distance is None else np.asarray(distance), client
        )

    def ready(self, key: str) -> set[int]:
        everything = np.arange(self.count, dtype=np.int32)
        mask, codes = self.cache.lookup(key, everything)
        assert (codes == code_of(key, everything[mask])[:, None, None]).all()
        return set(np.flatnonzero(mask).tolist())
