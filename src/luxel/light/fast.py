"""``fast`` mode: few samples, well spread; a filter in texture space; and how large the error is that is left."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from luxel.kernels.path import LAMBERTIAN, World
from luxel.light.denoise import TextureFilter
from luxel.light.in_view import Gaze, texels_looked_at
from luxel.light.mapping import Mapping
from luxel.light.records import RecordBook
from luxel.light.sampling import Drawn, RaySets, Samples, draw_paths, draw_rays

__all__ = ["FastLight", "in_batches"]

Result = TypeVar("Result")

_BATCH_COUNT = 32
_STEP_COUNT = 8  # a few milliseconds
# The filter learns from this many lit textures, sampled at least so well; where all of a large scene may be baked, from one in so many particles:
# it takes a twentieth of the time of that bake, and errors are 2 to 5 % smaller.
_TRAINING_COUNT, _MOST_TRAINING_COUNT = 512, 1024
_PARTICLES_A_TRAINING_TEXTURE = 256
# Filters of pictures serve others seen from within 60 degrees; where the data is, of what is seen, is judged by so many particles, if so many of them are.
_NEAR_BY, _PROBES, _FEWEST_PROBES = 0.5, 4096, 16
_NOWHERE = np.zeros(3, np.float32)
_TRAINING_SAMPLES, _FEW_TRAINING_SAMPLES = 9, 4
# Samples of sunlight a texel, from so many samples of other light on: they are cheap, and shadows have edges. Multiples of 16 are cheapest.
_SUN_SAMPLES = ((6, 64), (4, 32), (1, 16))
_TRAINING_SETS = 16
# Roulette spares paths that weigh so much: half as many paths that all bring their share home are less noisy than twice
# as many of which three in ten bring nothing.
_KEEP = np.float32(0.45)
_TRAINING_CANDIDATES = 16_384
_TRAINING_ROUND = 1024  # candidates looked at before asking whether enough of them are lit
_LIT = 0.02  # of the luminance scale
# Particles that no light reaches but by several bounces, and that are dimmer than this by the records around them, are not
# sampled: their mean errs less than a few samples a texel would. Of the luminance scale: two codes of 255.
_DIM = 2 / 255
# Errors told of those, of the luminance scale and of their level, as found on plates and foam.
_DIM_ERROR, _DIM_SHARE = 0.002, 1.5
# Independent drawings of one texture.
_DRAWN, _FIRST, _SECOND = 0, 1, 2


class FastLight:
    """Fast textures of one world. Safe to share between threads; what a texture becomes depends on its particle alone.

    In pictures it depends on who looks, and on the picture that their filter has learnt from, too.

    Parameters
    ----------
    world, scale
        What to light, and the luminance of code 255.
    mapping, texels, samples, seed
        See :class:`luxel.TextureSpec`.
    hidden
        (N,) bool: particles that do not exist in this world, from which the filter does not learn.
    book
        Coarse records of the world, if there are some already.
    hasty
        Learn the filter in half the time, from fewer samples: it errs a hundredth more.
    """

    def __init__(
        self,
        world: World,
        scale: float,
        mapping: Mapping,
        texels: int,
        samples: int,
        seed: int,
        hidden: NDArray[np.bool_] | None = None,
        *,
        book: RecordBook | None = None,
        hasty: bool = False,
    ) -> None:
        self._hidden, self._hasty = hidden, hasty
        self._world, self._scale, self._seed = world, scale, seed
        self._mapping, self._texels, self._samples = mapping, texels, samples
        self._lock = threading.Lock()
        self._making = threading.Lock()
        self._sets: dict[tuple[int, int, int, bool], RaySets] = {}
        self._book = RecordBook(world) if book is None else book
        self._filters: dict[bool, TextureFilter] = {}  # of pictures, and of bakes that are kept
        # Unit vector to who looked at what the filter of pictures has learnt from, see `_directions`; eyes that it suits.
        self._towards: NDArray[np.float32] | None = None
        self._suited: NDArray[np.float32] | None = None

    def coarser(self, texels: int, samples: int) -> FastLight:
        """Return light of the same world and seed at another resolution, for textures that will not stay; coarse records are shared."""
        return FastLight(
            self._world,
            self._scale,
            self._mapping,
            texels,
            samples,
            self._seed,
            self._hidden,
            book=self._book,
            hasty=True,
        )

    def prepare(self, threads: int, gaze: Gaze | None = None) -> None:
        """Learn the filter, once; with a `gaze`, that of pictures, from what is in this one."""
        self._learned(threads, gaze)

    def preparation(self, threads: int, gaze: Gaze | None = None) -> Iterator[None]:
        """As :meth:`prepare`, with one thread in short steps; and again for a picture that the last one taught too little of, see :meth:`suits`."""
        if self._known(gaze) is None or not self.suits(gaze):
            learned = yield from self._learn(threads, gaze)
            with self._lock:
                self._filters[gaze is not None] = learned

    def suits(self, gaze: Gaze | None) -> bool:
        """Whether the filter of pictures has learnt from one that was seen from about the same side."""
        towards = self._towards
        if gaze is None or towards is None or gaze.eyes is self._suited:
            return True
        found = self._directions(gaze)
        if found is not None and (found @ towards).max() <= _NEAR_BY:
            return False
        self._suited = gaze.eyes  # asked for every few textures
        return True

    def _directions(self, gaze: Gaze) -> NDArray[np.float32] | None:
        """Return unit vectors (E, 3) from the middle of what is shown to the eyes; None where too little of it is known."""
        count = len(self._world.radii)
        probes = np.arange(0, count, max(1, count // _PROBES))
        probes = probes[gaze.shown[probes] != 0]
        if len(probes) < _FEWEST_PROBES:
            return None
        found = gaze.eyes - self._world.centers[probes].mean(axis=0)
        return np.asarray(found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-9), np.float32)

    def luminance(
        self, ids: NDArray[np.int32], gaze: Gaze | None = None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return (K, T, T) luminance and (K,) the standard error expected of a texel that was sampled.

        With a `gaze`, only what is looked at is sampled; the filter tells the rest. It has learned from a picture, see :meth:`prepare`: what
        is in sight is more alike than all particles are.
        """
        learned = self._learned(1, gaze)
        levels = self._book.dim_levels(ids, self._ray_sets(1, _DRAWN, sun_samples=1, every_cell=True))
        dim = (levels >= 0) & (levels < _DIM * self._scale)
        if not dim.any():
            return learned.apply(self._draw(ids, self._samples, _DRAWN, gaze=gaze), gaze is not None)
        luminance = np.empty((len(ids), self._texels, self._texels), np.float32)
        luminance[dim] = levels[dim, None, None]
        error = (_DIM_ERROR * self._scale + _DIM_SHARE * levels).astype(np.float32)
        if not dim.all():
            luminance[~dim], error[~dim] = learned.apply(
                self._draw(ids[~dim], self._samples, _DRAWN, gaze=gaze), gaze is not None
            )
        return luminance, error

    def first_light(self, ids: NDArray[np.int32]) -> NDArray[np.float32]:
        """Return coarse records, see :meth:`luxel.light.records.RecordBook.first_light`."""
        return self._book.first_light(ids)

    def _drawn(self, drawing: int, keep: np.float32) -> World:
        """Return the world of an independent drawing."""
        seed = (int(self._world.seed) + drawing * 0x9E3779B97F4A7C15) % 2**64
        return self._world._replace(seed=np.uint64(seed), keep=keep)

    def _draw(
        self,
        ids: NDArray[np.int32],
        samples: int,
        drawing: int,
        keep: np.float32 = _KEEP,
        gaze: Gaze | None = None,
    ) -> Drawn:
        world = self._drawn(drawing, keep)
        if self._by_paths:
            # unshadowed: next to no noise, so any square number will do
            return Drawn(draw_paths(world, self._mapping, self._texels, math.isqrt(samples) ** 2, ids), None)
        sets = self._ray_sets(samples, drawing, every_cell=drawing != _DRAWN)
        if gaze is None:
            return draw_rays(world, sets, ids)
        drawn = draw_rays(world, sets, ids, texels_looked_at(world, self._mapping, self._texels, ids, gaze))
        missed: NDArray[np.bool_] = ~np.asarray(drawn.rest.exposed.any(axis=(1, 2)))
        # All samples lie inside of neighbours, or none fell there: some light beside them is better than none.
        if missed.any():
            _replace(drawn, missed, draw_rays(world, sets, ids[missed]))
        return drawn

    @property
    def _by_paths(self) -> bool:
        """Whether samples are drawn as in ``paper`` mode: unshadowed light knows no rays to share."""
        return self._world.model == LAMBERTIAN

    def _ray_sets(
        self, samples: int, drawing: int, *, sun_samples: int | None = None, every_cell: bool = False
    ) -> RaySets:
        if sun_samples is None:
            known = 1 if drawing else samples  # training has textures enough to average over
            sun_samples = next(many for least, many in _SUN_SAMPLES if known >= least)
        key = (samples, drawing, sun_samples, every_cell)
        with self._making:  # all threads ask for the same sets at once, and making them is slow
            if key not in self._sets:
                self._sets[key] = RaySets.make(
                    self._mapping,
                    (self._texels, self._texels),
                    samples,
                    self._world.lights.suns,
                    sun_samples=sun_samples,
                    seed=self._seed + drawing,
                    sets=_TRAINING_SETS if drawing else None,
                    every_cell=every_cell,
                )
            return self._sets[key]

    def _known(self, gaze: Gaze | None) -> TextureFilter | None:
        """Return the filter to use, if it is there already; for textures that will not stay, any will do."""
        found = self._filters.get(gaze is not None)
        return self._filters.get(gaze is None) if found is None and self._hasty else found

    def _learned(self, threads: int, gaze: Gaze | None) -> TextureFilter:
        with self._lock:
            found = self._known(gaze)
            if found is None:
                found = self._filters[gaze is not None] = _at_once(self._learn(threads, gaze))
            return found

    def _learn(self, threads: int, gaze: Gaze | None) -> Generator[None, None, TextureFilter]:
        """Train on lit particles drawn by the seed from the whole scene, so that every bake of a key filters alike; or from a picture."""
        if gaze is not None:
            found = self._directions(gaze)
            self._towards, self._suited = _NOWHERE if found is None else found[0], None
        chosen = yield from self._choose(threads, gaze)
        least = _FEW_TRAINING_SAMPLES if self._hasty else _TRAINING_SAMPLES
        well = max(least, min(self._samples, 4 * _TRAINING_SAMPLES))
        first = yield from self._draw_in_steps(chosen, well, _FIRST, threads)
        second = yield from self._draw_in_steps(chosen, well, _SECOND, threads)
        drawn = yield from self._draw_in_steps(chosen, self._samples, _DRAWN, threads)
        return TextureFilter.learn(first, second, drawn, self._mapping)

    def _choose(self, threads: int, gaze: Gaze | None) -> Generator[None, None, NDArray[np.int32]]:
        """Return lit particles (K,) to learn from, or any if too few are lit; first such as are in the picture, if there is one."""
        shuffled = np.random.default_rng(self._seed).permutation(len(self._world.radii)).astype(np.int32)
        if self._hidden is not None and not self._hidden.all():
            shuffled = shuffled[~self._hidden[shuffled]]
        enough, groups = _TRAINING_COUNT, [shuffled]
        if gaze is not None:
            shown = gaze.shown[shuffled] != 0
            groups = [shuffled[shown], shuffled[~shown]]
        elif not self._hasty:
            enough = min(max(enough, len(shuffled) // _PARTICLES_A_TRAINING_TEXTURE), _MOST_TRAINING_COUNT)
        chosen = shuffled[:0]
        for group in groups:
            lit = yield from self._lit(group[:_TRAINING_CANDIDATES], enough - len(chosen), threads)
            chosen = np.concatenate([chosen, lit])
        return chosen if len(chosen) >= 16 else np.concatenate(groups)[:enough]

    def _lit(
        self, order: NDArray[np.int32], enough: int, threads: int
    ) -> Generator[None, None, NDArray[np.int32]]:
        """Return the first `enough` particles of some that are lit."""
        lit = [order[:0]]
        found = 0
        for start in range(0, len(order), _TRAINING_ROUND):
            if found >= enough:
                break
            part = order[start : start + _TRAINING_ROUND]
            level = yield from _in_steps(self._level, part, threads)
            lit.append(part[np.concatenate(level) > _LIT * self._scale])
            found += len(lit[-1])
        return np.concatenate(lit)[:enough]

    def _draw_in_steps(
        self, ids: NDArray[np.int32], samples: int, drawing: int, threads: int
    ) -> Generator[None, None, Drawn]:
        draw = partial(self._draw, samples=samples, drawing=drawing)
        rest, sun = zip(*(yield from _in_steps(draw, ids, threads)), strict=True)
        return Drawn(_joined(rest), None if sun[0] is None else _joined(sun))

    def _level(self, ids: NDArray[np.int32]) -> NDArray[np.float32]:
        """Mean luminance by the records alone."""
        return self._book.first_light(ids)[:, 0]


def in_batches(work: Callable[[NDArray[np.int32]], Any], ids: NDArray[np.int32], threads: int) -> list[Any]:
    """Return the results of `work` for consecutive batches of ids."""
    parts = [ids[k : k + _BATCH_COUNT] for k in range(0, len(ids), _BATCH_COUNT)]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, parts))


def _in_steps(
    work: Callable[[NDArray[np.int32]], Any], ids: NDArray[np.int32], threads: int
) -> Generator[None, None, list[Any]]:
    """As `in_batches`; with one thread, a batch with every step."""
    if threads > 1:
        yield
        return in_batches(work, ids, threads)
    found = []
    for k in range(0, len(ids), _STEP_COUNT):
        yield
        found.append(work(ids[k : k + _STEP_COUNT]))
    return found


def _at_once(steps: Generator[None, None, Result]) -> Result:
    """Run all steps; return their result."""
    while True:
        try:
            next(steps)
        except StopIteration as done:
            result: Result = done.value
            return result


def _replace(drawn: Drawn, chosen: NDArray[np.bool_], others: Drawn) -> None:
    """Put other samples in place of some."""
    for mine, other in zip(drawn, others, strict=True):
        if mine is not None and other is not None:
            for array, values in zip(mine, other, strict=True):
                array[chosen] = values


def _joined(parts: Sequence[Samples]) -> Samples:
    return Samples(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
