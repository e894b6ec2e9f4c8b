"""A baker whose texels are a function of key, particle and grade, and a clock that moves when told."""

from __future__ import annotations

import threading
import zlib
from collections.abc import Iterator

import numpy as np

from luxel.dynamic.allotment import bytes_for
from luxel.dynamic.cache import TextureCache
from luxel.dynamic.engine import Engine
from luxel.dynamic.entries import ESTIMATE, FULL
from luxel.dynamic.work import Bakers
from luxel.light.in_view import Gaze

TEXELS = 4
GUARD_S = 60.0  # only ever waited for when a test is about to fail


def ids_of(*values: int) -> np.ndarray:
    return np.array(values, dtype=np.int32)


def code_of(key: str, ids: np.ndarray, grade: int = FULL) -> np.ndarray:
    """(K,) uint8: what every texel of these textures is."""
    return ((ids.astype(np.int64) * 7 + zlib.crc32(key.encode()) + 100 * (grade != FULL)) % 251).astype(
        np.uint8
    )


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
        self,
        key: str,
        clock: Clock | None = None,
        texture_s: float = 0.0,
        bad: tuple[int, ...] = (),
        grade: int = FULL,
        steps: int = 0,
        step_s: float = 0.0,
    ) -> None:
        self.key, self.clock, self.texture_s, self.grade = key, clock, texture_s, grade
        self.steps, self.step_s = steps, step_s
        self.bad = set(bad)
        self.batches: list[list[int]] = []
        self.gazes: list[Gaze | None] = []  # of each batch
        self.prepared_for: Gaze | None = None
        self.unsuitable: set[int] = set()  # gazes that show one of these need another preparation
        self.work: list[tuple[str, list[int]]] = []  # all that was asked of it, in order
        self.lock = threading.Lock()

    def first_light(self, ids: np.ndarray) -> np.ndarray:
        with self.lock:
            self.work.append(("first light", ids.tolist()))
        return record_of(self.key, ids)

    def preparation(self, threads: int, gaze: Gaze | None = None) -> Iterator[None]:
        with self.lock:
            self.prepared_for = None if gaze is None else Gaze(gaze.eyes.copy(), gaze.shown.copy())
            self.work.append(("prepare", []))
        for _ in range(self.steps):
            if self.clock is not None:
                self.clock.now_s += self.step_s
            yield

    def suits(self, gaze: Gaze | None) -> bool:
        def strange(one: Gaze | None) -> bool:
            return one is not None and bool(self.unsuitable & set(np.flatnonzero(one.shown).tolist()))

        return strange(gaze) == strange(self.prepared_for)

    def bake_into(self, ids: np.ndarray, codes: np.ndarray, gaze: Gaze | None = None) -> int:
        with self.lock:
            self.batches.append(ids.tolist())
            self.gazes.append(None if gaze is None else Gaze(gaze.eyes.copy(), gaze.shown.copy()))
            self.work.append(("bake", ids.tolist()))
        if self.clock is not None:
            self.clock.now_s += self.texture_s * len(ids)
        codes[:] = 99  # a batch that fails must not leave this behind
        if self.bad & set(ids.tolist()):
            raise ArithmeticError("a bad particle")
        codes[:] = code_of(self.key, ids, self.grade)[:, None, None]
        return int(np.count_nonzero(ids % 10 == 0))


class Stage:
    """An engine over fake bakers, and what its listeners heard."""

    def __init__(
        self,
        threads: int = 0,
        count: int = 1000,
        capacity: int = 100_000,
        clock: Clock | None = None,
        shards: int | None = 1,
        estimates: bool = False,
        texels: int = TEXELS,
        engine: dict[str, object] | None = None,
        components: int = 0,
        **baker: object,
    ) -> None:
        self.count = count
        self.clock = clock or Clock()
        self.cache = TextureCache(
            texels, bytes_for(capacity, texels, count), shards=shards, components=components
        )
        self.engine = Engine(self.cache, threads=threads, clock=self.clock, **(engine or {}))
        self.bakers: dict[str, FakeBaker] = {}
        self.estimators: dict[str, FakeBaker] = {}
        self.estimates = estimates
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
            for grade, chosen in ((FULL, ~batch.estimate), (ESTIMATE, batch.estimate)):
                expected = code_of(batch.key, batch.ids[chosen], grade)[:, None, None]
                if not (batch.codes[chosen] == expected).all():
                    self.wrong.append(batch.key)

    def listen_coarse(self, batch) -> None:
        with self._lock:
            self.dawned += [(batch.key, each) for each in batch.ids.tolist()]
            if not (batch.records == record_of(batch.key, batch.ids)).all():
                self.wrong.append(batch.key)

    def make(self, key: str) -> Bakers:
        with self._lock:
            self.made.append(key)
            full = self.bakers.setdefault(key, FakeBaker(key, **self.baker_options))
            if not self.estimates:
                return Bakers(full)
            return Bakers(
                full, self.estimators.setdefault(key, FakeBaker(key, grade=ESTIMATE, **self.baker_options))
            )

    def select(self, key: str) -> None:
        self.engine.select(key, self.count, 1.0, "linear", lambda: self.make(key))

    def request(self, key: str, ids, distance=None, client: str = "", pixels=None, eye=None) -> int:
        """Sight `ids`; distance and pixels are arrays beside them."""
        ids = np.asarray(ids, dtype=np.int32)
        far, wide = np.zeros(self.count), np.zeros(self.count)
        far[ids] = 0 if distance is None else distance
        wide[ids] = 0 if pixels is None else pixels

        def measure(some):
            return far[some], None if pixels is None else wide[some]

        return self.engine.request(key, np.sort(ids), measure, client, eye)

    def queued(self, key: str) -> int:
        self.engine.settle()
        return self.cache.counts(key).queued

    def ready(self, key: str) -> set[int]:
        everything = np.arange(self.count, dtype=np.int32)
        mask, codes, grades = self.cache.lookup(key, everything)
        ids = everything[mask]
        expected = np.where(grades == FULL, code_of(key, ids), code_of(key, ids, ESTIMATE))
        assert (codes == expected[:, None, None]).all()
        return set(np.flatnonzero(mask).tolist())
