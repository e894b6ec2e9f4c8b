"""Baking: luminance textures of chosen particles (paper 3.2)."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait

import numpy as np
from numpy.typing import ArrayLike, NDArray

from luxel.arrays import as_ids
from luxel.kernels.texels import sample_texels
from luxel.light.denoise import TextureFilter
from luxel.light.first_light import first_light
from luxel.light.lights import luminance_scale
from luxel.light.mapping import Mapping, mapping_code
from luxel.light.ray_sets import texel_frames
from luxel.light.world import make_world
from luxel.scene.scene import Scene
from luxel.textures.spec import Mode, TextureSpec, light_key
from luxel.textures.textures import LuminanceTextures, encode
from luxel.trace.tree import thread_count

__all__ = ["Baker", "bake", "bake_with"]

Progress = Callable[[int, int], None]

_BATCH_COUNT = 32
# The filter learns from this many lit textures, sampled this much better than the request.
_TRAINING_COUNT = 512
_TRAINING_SAMPLES = 4
_TRAINING_CANDIDATES = 16_384
_TRAINING_ROUND = 1024  # candidates looked at before asking whether enough of them are lit
_LIT = 0.02


class Baker:
    """Makes textures of one scene to one spec. Safe to share between threads; kernels release the GIL.

    Parameters
    ----------
    scene, spec
        What to light and how.

    Attributes
    ----------
    key
        The light key.
    scale, encoding
        How codes become luminance, see :func:`luxel.textures.textures.decode`.
    """

    def __init__(self, scene: Scene, spec: TextureSpec | None = None) -> None:
        self.scene = scene
        self.spec = spec or TextureSpec()
        self.key = light_key(scene, self.spec)
        self.scale = luminance_scale(scene)
        self.encoding = self.spec.encoding
        self._world = make_world(scene, seed=self.spec.seed, max_bounces=self.spec.max_bounces)
        self._filter: TextureFilter | None = None
        self._filter_lock = threading.Lock()

    def luminance(self, ids: NDArray[np.int32]) -> NDArray[np.float32]:
        """(K, T, T) float32 luminance of particles `ids`, before it is rounded to 8 bits."""
        if self.spec.mode == "paper":
            mean, _, exposed = self._sample(ids, self.spec.samples)
            return np.asarray(mean * (exposed / np.float32(self.spec.samples)), dtype=np.float32)
        learned = self._learned()
        return learned.apply(*self._sample(ids, self.spec.samples))

    def bake_into(self, ids: NDArray[np.int32], codes: NDArray[np.uint8]) -> int:
        """Write the codes of particles `ids` (K,) to `codes` (K, T, T); return how many texels clipped."""
        luminance = self.luminance(ids)
        codes[...] = encode(luminance, self.scale, self.encoding)
        return int(np.count_nonzero(luminance > self.scale))

    def first_light(self, ids: NDArray[np.int32]) -> NDArray[np.float32]:
        """(K, 4) float32 coarse records of particles `ids` (K,), see :mod:`luxel.light.first_light`; needs no filter."""
        return first_light(self._world, ids)

    def prepare(self, threads: int | None = None) -> None:
        """Learn the filter of ``fast`` mode now, on several threads; otherwise the first bake does it on one."""
        if self.spec.mode == "fast":
            self._learned(thread_count(threads))

    def _sample(
        self, ids: NDArray[np.int32], samples: int
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint32]]:
        shape = (len(ids), self.spec.texels, self.spec.texels)
        mean, variance = np.empty(shape, np.float32), np.empty(shape, np.float32)
        exposed = np.empty(shape, np.uint32)
        mapping, frames = self.spec.mapping, texel_frames(self.spec.mapping, self.spec.texels)
        sample_texels(
            self._world, mapping_code(mapping), ids, round(samples**0.5), frames, mean, variance, exposed
        )
        return mean, variance, exposed

    def _learned(self, threads: int = 1) -> TextureFilter:
        with self._filter_lock:
            if self._filter is None:
                self._filter = self._learn(threads)
            return self._filter

    def _learn(self, threads: int) -> TextureFilter:
        """Train on lit particles drawn by the seed from the whole scene, so that every bake of a key filters alike."""
        count = len(self.scene.particles)
        order = (
            np.random.default_rng(self.spec.seed).permutation(count)[:_TRAINING_CANDIDATES].astype(np.int32)
        )
        lit: list[NDArray[np.int32]] = []
        found = 0
        for start in range(0, len(order), _TRAINING_ROUND):
            part = order[start : start + _TRAINING_ROUND]
            mean = np.concatenate([m for m, _, _ in self._sample_all(part, 1, threads)])
            lit.append(part[mean.mean(axis=(1, 2)) > _LIT * self.scale])
            found += len(lit[-1])
            if found >= _TRAINING_COUNT:
                break
        chosen = np.concatenate(lit)[:_TRAINING_COUNT] if found >= 16 else order[:_TRAINING_COUNT]
        parts = self._sample_all(chosen, max(_TRAINING_SAMPLES, self.spec.samples), threads)
        mean, variance, exposed = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
        return TextureFilter.learn(mean, variance, exposed, self.spec.mapping)

    def _sample_all(
        self, ids: NDArray[np.int32], samples: int, threads: int
    ) -> list[tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint32]]]:
        parts = [ids[k : k + _BATCH_COUNT] for k in range(0, len(ids), _BATCH_COUNT)]
        with ThreadPoolExecutor(threads) as pool:
            return list(pool.map(lambda part: self._sample(part, samples), parts))


def bake(
    scene: Scene,
    ids: ArrayLike | None = None,
    texels: int = 16,
    samples: int = 49,
    mode: Mode = "paper",
    seed: int = 0,
    progress: Progress | None = None,
    *,
    threads: int | None = None,
    max_bounces: int | None = None,
    mapping: Mapping = "latlong",
) -> LuminanceTextures:
    """Bake luminance textures.

    Parameters
    ----------
    scene
        What to light.
    ids
        (M,) particles to bake; None means all.
    texels, samples, mode, seed, max_bounces, mapping
        See :class:`luxel.TextureSpec`.
    progress
        Called as ``progress(done, total)`` in particles, from this thread.
    threads
        None means all that the process may use; never changes a texture.

    Returns
    -------
    LuminanceTextures
        With ``ids`` (M,) and ``luminance`` (M, texels, texels).

    Raises
    ------
    InputError
        For options out of range or ids that the scene does not have.
    """
    spec = TextureSpec(texels, samples, mode, seed, max_bounces, mapping)
    return bake_with(
        Baker(scene, spec), as_ids(ids, len(scene.particles)), progress=progress, threads=threads
    )


def bake_with(
    baker: Baker, ids: NDArray[np.int32], *, progress: Progress | None = None, threads: int | None = None
) -> LuminanceTextures:
    """Bake particles `ids` with a baker that is already there."""
    count, texels = len(ids), baker.spec.texels
    codes = np.zeros((count, texels, texels), np.uint8)
    workers = thread_count(threads)
    baker.prepare(workers)
    parts = [slice(k, min(k + _BATCH_COUNT, count)) for k in range(0, count, _BATCH_COUNT)]
    done = clipped = 0
    pool = ThreadPoolExecutor(workers)
    try:
        pending = {pool.submit(baker.bake_into, ids[part], codes[part]): part for part in parts}
        while pending:
            # A time-out keeps the main thread responsive to Ctrl-C.
            finished, _ = wait(
                pending, timeout=0.2, return_when=FIRST_EXCEPTION if progress is None else "FIRST_COMPLETED"
            )
            for job in finished:
                part = pending.pop(job)
                clipped += job.result()
                done += part.stop - part.start
            if progress is not None and finished:
                progress(done, count)
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    return LuminanceTextures(
        ids,
        codes,
        baker.scale,
        baker.encoding,
        len(baker.scene.particles),
        baker.key,
        clipped,
        baker.spec.mapping,
    )
