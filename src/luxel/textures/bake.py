"""Baking: luminance textures of chosen particles (paper 3.2)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait

import numpy as np
from numpy.typing import ArrayLike, NDArray

from luxel.arrays import as_ids
from luxel.light.denoise import standard_error
from luxel.light.fast import FastLight
from luxel.light.in_view import Gaze
from luxel.light.lights import luminance_scale
from luxel.light.mapping import Mapping
from luxel.light.sampling import draw_paths
from luxel.light.world import make_world
from luxel.scene.scene import Scene
from luxel.textures.spec import Mode, TextureSpec, light_key
from luxel.textures.textures import LuminanceTextures, encode
from luxel.trace.tree import thread_count

__all__ = ["Baker", "bake", "bake_with"]

Progress = Callable[[int, int], None]

# Particles baked by one call: many, so that interpreter and scheduling cost nothing; but a fair share for every thread.
_BATCH_COUNT, _LEAST_BATCH_COUNT, _BATCHES_A_THREAD = 128, 8, 8


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
    world
        What kernels take.
    """

    def __init__(self, scene: Scene, spec: TextureSpec | None = None) -> None:
        self.scene = scene
        self.spec = spec or TextureSpec()
        self.key = light_key(scene, self.spec)
        self.scale = luminance_scale(scene)
        self.encoding = self.spec.encoding
        self.world = make_world(scene, seed=self.spec.seed, max_bounces=self.spec.max_bounces)
        self._fast = FastLight(
            self.world,
            self.scale,
            self.spec.mapping,
            self.spec.texels,
            self.spec.samples,
            self.spec.seed,
            scene.hidden,
        )

    def luminance(
        self, ids: NDArray[np.int32], gaze: Gaze | None = None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Luminance of particles `ids` (K,), before it is rounded to 8 bits.

        With a `gaze`, ``fast`` mode samples only the texels that are looked at, and its filter tells the rest from them.

        Returns
        -------
        luminance, error
            (K, T, T) float32; (K,) float32, the standard error expected of an exposed texel, root mean square over
            the sphere.
        """
        spec = self.spec
        if spec.mode == "fast":
            return self._fast.luminance(ids, gaze)
        found = draw_paths(self.world, spec.mapping, spec.texels, spec.samples, ids)
        share = found.exposed / np.float32(spec.samples)
        return np.asarray(found.mean * share, np.float32), standard_error(found, spec.mapping)

    def bake_into(
        self,
        ids: NDArray[np.int32],
        codes: NDArray[np.uint8],
        errors: NDArray[np.float32] | None = None,
        gaze: Gaze | None = None,
    ) -> int:
        """Write codes (K, T, T) and expected errors (K,) of particles `ids` (K,); return how many texels clipped. See :meth:`luminance`."""
        luminance, error = self.luminance(ids, gaze)
        codes[...], clipped = encode(luminance, self.scale, self.encoding)
        if errors is not None:
            errors[...] = error
        return clipped

    def first_light(self, ids: NDArray[np.int32]) -> NDArray[np.float32]:
        """Return coarse light of particles `ids` (K,), fast and without preparation.

        (K, 4) float32: luminance towards unit normal n is about max(0, c0 + c1 nx + c2 ny + c3 nz), with c0 >= 0.
        """
        return self._fast.first_light(ids)

    def prepare(self, threads: int | None = None, gaze: Gaze | None = None) -> None:
        """Do now, on several threads, what the first bake of ``fast`` mode would do on one: learn the filter, with a `gaze` that of pictures."""
        if self.spec.mode == "fast":
            self._fast.prepare(thread_count(threads), gaze)

    def preparation(self, threads: int) -> Iterator[None]:
        """As :meth:`prepare`, with one thread in short steps."""
        if self.spec.mode == "fast":
            yield from self._fast.preparation(threads)

    def coarser_light(self, texels: int, samples: int) -> FastLight:
        """Return ``fast`` light of the same scene at another resolution."""
        return self._fast.coarser(texels, samples)


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
        (M,) particles to bake; None means all that the scene does not hide.
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
    if ids is None and scene.hidden is not None:
        ids = np.flatnonzero(~scene.hidden)
    return bake_with(
        Baker(scene, spec), as_ids(ids, len(scene.particles)), progress=progress, threads=threads
    )


def bake_with(
    baker: Baker,
    ids: NDArray[np.int32],
    *,
    progress: Progress | None = None,
    threads: int | None = None,
    gaze: Gaze | None = None,
) -> LuminanceTextures:
    """Bake particles `ids` with a baker that is already there, see :meth:`Baker.luminance`."""
    count, texels = len(ids), baker.spec.texels
    codes = np.zeros((count, texels, texels), np.uint8)
    errors = np.zeros(count, np.float32)
    workers = thread_count(threads)
    baker.prepare(workers, gaze)
    size = min(_BATCH_COUNT, max(_LEAST_BATCH_COUNT, count // (_BATCHES_A_THREAD * workers)))
    parts = [slice(k, min(k + size, count)) for k in range(0, count, size)]
    clipped = 0
    pool = ThreadPoolExecutor(workers)
    try:
        jobs = [pool.submit(baker.bake_into, ids[part], codes[part], errors[part], gaze) for part in parts]
        for part, job in zip(parts, jobs, strict=True):
            clipped += _result(job)
            if progress is not None:
                progress(part.stop, count)
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
        errors,
    )


def _result(job: Future[int]) -> int:
    """Wait for a job. Time-outs keep the main thread responsive to Ctrl-C."""
    while not job.done():
        wait([job], timeout=0.2)
    return job.result()
