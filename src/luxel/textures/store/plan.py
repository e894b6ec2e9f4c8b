"""What a bake will cost, from a short measured sample."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxel.light.fast import in_batches
from luxel.particles import Particles
from luxel.scene.lights import Light
from luxel.scene.scene import Model, Scene
from luxel.textures.bake import Baker, bake_with
from luxel.textures.spec import TextureSpec
from luxel.textures.store.bake import chosen_frames
from luxel.trace.tree import thread_count

__all__ = ["Plan", "plan_bake", "seconds_of_many"]

_FIRST_SAMPLE = 64
_RATIO = 4  # of the codecs in the table: the paper's


@dataclass(frozen=True)
class Plan:
    """What a bake will cost.

    Parameters
    ----------
    particles
        In all frames.
    frames
        How many.
    exact
        Whether `particles` was counted; else all frames are taken to be as large as the first.
    texels, samples, mode
        Of the textures.
    sizes
        Codec to what a texture takes, as a formula, and bytes of all textures.
    sampled
        Particles that were baked to measure.
    prepare_s, rate
        Seconds of preparation a frame, and textures a second after that.
    seconds
        Of the whole bake, before compression.
    """

    particles: int
    frames: int
    exact: bool
    texels: int
    samples: int
    mode: str
    sizes: dict[str, tuple[str, int]]
    sampled: int
    prepare_s: float
    rate: float
    seconds: float

    def to_json(self) -> dict[str, Any]:
        """Return plain values."""
        return {**vars(self), "sizes": {name: list(size) for name, size in self.sizes.items()}}


def plan_bake(
    target: Sequence[Particles] | Particles | Scene,
    *,
    frames: Sequence[int] | None = None,
    lights: Sequence[Light] | None = None,
    model: Model = "interreflection",
    albedo: float = 0.7,
    ao_distance: float | None = None,
    periodic: str | Sequence[bool] = "",
    spec: TextureSpec | None = None,
    threads: int | None = None,
    budget_s: float = 3.0,
    clock: Callable[[], float] = time.perf_counter,
) -> Plan:
    """Say what :func:`luxel.bake_to` with the same arguments will cost, by baking a few particles.

    Parameters
    ----------
    budget_s
        Measure for about so long, after the preparation that a bake begins with.
    clock
        Seconds, never going backwards.

    Returns
    -------
    Plan
        Particles are sampled evenly over the whole frame, always the same ones.
    """
    spec = TextureSpec.usual() if spec is None else spec
    counts: list[int | None]
    if isinstance(target, Scene):
        scene, counts = target, [len(target.particles)]
    else:
        series = [target] if isinstance(target, Particles) else target
        chosen = chosen_frames(series, frames)
        scene = Scene(series[chosen[0]], lights, model, albedo, ao_distance, periodic)
        known = getattr(series, "particle_count", lambda _: None)
        counts = [len(scene.particles), *(known(frame) for frame in chosen[1:])]
    first = len(scene.particles)
    total = sum(first if count is None else count for count in counts)
    warm = Baker(scene, spec)
    bake_with(
        warm, np.arange(min(first, 1), dtype=np.int32), threads=threads
    )  # whatever is compiled or read once
    started = clock()
    baker = Baker(scene, spec)
    baker.prepare(threads)
    prepared = clock()
    order = np.random.default_rng(0).permutation(first).astype(np.int32)
    count, sampled = min(_FIRST_SAMPLE, first), 0
    while True:
        part = order[sampled : sampled + count]
        took = seconds_of_many(baker, part, threads=threads, clock=clock)
        sampled += len(part)
        rate = len(part) / max(took, 1e-9)
        if sampled == first or clock() - prepared > budget_s / 2:
            break
        count = 2 * count  # the last batch, half of them all, gives the rate
    prepare_s = prepared - started
    return Plan(
        total,
        len(counts),
        None not in counts,
        spec.texels,
        spec.samples,
        spec.mode,
        _sizes(total, len(counts), spec.texels),
        sampled,
        prepare_s,
        rate,
        prepare_s * len(counts) + total / rate,
    )


def seconds_of_many(
    baker: Baker,
    ids: NDArray[np.int32],
    *,
    threads: int | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> float:
    """Bake particles `ids`, drawn from all over; return the seconds that they take as a part of a bake of all.

    A bake makes the coarse record of every particle once, whoever asks for it first. A few particles alone have to make those of
    all their neighbours; so theirs are timed apart, and the textures when all records are there.
    """
    records_s = 0.0
    if baker.spec.mode == "fast":
        begun = clock()
        in_batches(baker.first_light, ids, thread_count(threads))
        records_s = clock() - begun
        bake_with(baker, ids, threads=threads)
    begun = clock()
    bake_with(baker, ids, threads=threads)
    return records_s + clock() - begun


def _sizes(particles: int, frames: int, texels: int) -> dict[str, tuple[str, int]]:
    raw = texels * texels
    return {
        "raw": (f"{texels}² bytes a texture", particles * raw),
        f"any, --ratio {_RATIO}": (
            f"{texels}² / {_RATIO} bytes a texture, shared arrays included",
            particles * raw // _RATIO,
        ),
    }
