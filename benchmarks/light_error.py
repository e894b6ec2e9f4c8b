"""Table of errors: texels against means of thousands of samples, and what the same error costs with Embree."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

import luxel
from benchmarks.light_scenes import ISA, DataSet
from benchmarks.light_speed import SAMPLES, Rows, bake_of
from benchmarks.measure import interleaved, ratio
from luxel.kernels.tone import develop
from luxel.light.lights import scene_white
from luxel.scene.colormap import linear_to_srgb
from luxel.textures.bake import Baker, bake_with
from luxel.textures.spec import TextureSpec
from luxel.trace.tree import thread_count
from tests.embree_light import EmbreeBaker
from tests.light.exposure import open_fraction

_TRUTHS = Path(__file__).parents[1] / "out" / "truth"
_TRUTH_SEED = 987_654_321
_LIT = 0.01
# A texel of which less than this lies in the open is left out: its truth rests on few samples.
_OPEN = 0.5


@dataclass(frozen=True)
class Truth:
    """Well-sampled luminance of some particles.

    Parameters
    ----------
    ids
        (K,) int32.
    luminance
        (K, T, T): mean over the part of each texel that no neighbour buries, which is what estimators average.
    weight
        (K, T, T): solid angle of the texels that count (lit, and at least half in the open), 0 elsewhere.
    samples
        In each texel; its own noise is this many times smaller in variance than that of one sample.
    """

    ids: NDArray[np.int32]
    luminance: NDArray[np.float64]
    weight: NDArray[np.float64]
    samples: int


def truth_of(scene: luxel.Scene, ids: NDArray[np.int32], samples: int) -> Truth:
    """Bake `ids` in paper mode with a seed of its own, before rounding to 8 bits; kept on disk under ``out/truth``."""
    spec = TextureSpec(samples=samples, seed=_TRUTH_SEED)
    digest = hashlib.blake2b(f"{scene.key} {spec}".encode() + ids.tobytes(), digest_size=16).hexdigest()
    path = _TRUTHS / f"{digest}.npy"
    if path.exists():
        mean = np.load(path)
    else:
        baker = Baker(scene, spec)
        with ThreadPoolExecutor(thread_count(None)) as pool:
            mean = np.concatenate(
                list(pool.map(lambda k: baker.luminance(ids[k : k + 4])[0], range(0, len(ids), 4)))
            )
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, mean)
    exposed = open_fraction(scene.particles, ids, mean.shape[1])
    luminance = mean.astype(np.float64) / np.maximum(exposed, _OPEN)
    edges = np.cos(np.linspace(0, np.pi, mean.shape[1] + 1))
    weight = (edges[:-1] - edges[1:])[:, None] * ((exposed >= _OPEN) & (luminance > _LIT))
    return Truth(ids, luminance, weight, samples)


def displayed(scene: luxel.Scene, luminance: NDArray[Any]) -> NDArray[np.float64]:
    """Levels of 255 that a white particle shows at these luminances, unrounded; same shape."""
    flat = luminance.reshape(1, -1, 1).astype(np.float32)
    total = np.concatenate([flat, flat, flat, flat, np.ones_like(flat)], axis=2)
    picture = np.empty((1, flat.shape[1], 3), np.float32)
    develop(total, 1, np.float32(1), np.float32(scene_white(scene)), np.zeros(3, np.float32), picture)
    return 255.0 * np.asarray(linear_to_srgb(picture[0, :, 0]), dtype=np.float64).reshape(luminance.shape)


def errors(
    scene: luxel.Scene,
    truth: Truth,
    luminance: NDArray[Any],
    share: float = 0.0,
    raw: dict[str, float] | None = None,
) -> dict[str, float]:
    """Solid-angle weighted errors; the truth's own noise, `share` of the mean squares of `raw`, is subtracted from RMSE."""
    noise = {name: share * raw[name] ** 2 if raw else 0.0 for name in ("RMSE", "RMSE levels")}
    counts = truth.weight > 0
    weight = truth.weight[counts] / truth.weight.sum()
    difference = (luminance - truth.luminance)[counts]
    shown = (displayed(scene, luminance) - displayed(scene, truth.luminance))[counts]
    order = np.argsort(np.abs(difference))
    rank = np.searchsorted(np.cumsum(weight[order]), 0.95)
    return {
        "RMSE": float(np.sqrt(max(0.0, weight @ difference**2 - noise["RMSE"]))),
        "p95": float(np.abs(difference)[order[min(rank, len(order) - 1)]]),
        "max": float(np.abs(difference).max()),
        "bias": float(weight @ difference),
        "RMSE levels": float(np.sqrt(max(0.0, weight @ shown**2 - noise["RMSE levels"]))),
    }


def at_equal_error(
    sets: list[DataSet], lights: list[str], count: int, samples: int, timed: int, fast: list[int], rounds: int
) -> tuple[Rows, Rows]:
    """Errors of every setting, and the price of the cheapest fast one that is as good as 49 raw samples.

    Parameters
    ----------
    count, samples
        Particles and samples a texel of the truth.
    timed
        Particles that the rivals are timed on.
    """
    table: Rows = []
    prices: Rows = []
    for data in sets:
        for light in lights:
            scene = data.scene(light)
            embree = EmbreeBaker(scene, isa=ISA)
            prepared: dict[int, tuple[Baker, float]] = {}
            for n in fast:
                start = perf_counter()
                baker = Baker(scene, TextureSpec(mode="fast", samples=n))
                baker.prepare()
                prepared[n] = baker, perf_counter() - start
            for group in ("all", "visible"):
                truth = truth_of(scene, data.group(group, count, seed=1), samples)
                where = {"scene": data.name, "light": light, "particles": f"{len(truth.ids)} of {group}"}
                if not truth.weight.any():
                    table.append({**where, "mode": "nothing is lit"})
                    continue
                total, seen, _ = embree.sample(truth.ids, SAMPLES)
                raw_luminance = total / np.maximum(seen, 1)
                # Raw mean squares fall as one over the samples, so the truth's own share of them is known.
                noise = SAMPLES / (SAMPLES + samples), errors(scene, truth, raw_luminance)
                raw = errors(scene, truth, raw_luminance, *noise)
                table.append({**where, "mode": "Embree paths, raw", "samples": SAMPLES, **raw})
                paper = luxel.bake(scene, truth.ids, mode="paper", samples=SAMPLES).luminance
                share = np.maximum(open_fraction(scene.particles, truth.ids, 16), _OPEN)
                table.append(
                    {
                        **where,
                        "mode": "paper",
                        "samples": SAMPLES,
                        **errors(scene, truth, paper / share, *noise),
                    }
                )
                good = None
                for n, (baker, _) in prepared.items():
                    found = errors(scene, truth, bake_with(baker, truth.ids).luminance, *noise)
                    table.append({**where, "mode": "fast", "samples": n, **found})
                    if good is None and found["RMSE"] <= raw["RMSE"]:
                        good = n
                prices.append(
                    _price(
                        where, embree, good, prepared, data.group(group, timed, seed=2), data, group, rounds
                    )
                )
    return table, prices


def _price(
    where: dict[str, Any],
    embree: EmbreeBaker,
    samples: int | None,
    prepared: dict[int, tuple[Baker, float]],
    ids: NDArray[np.int32],
    data: DataSet,
    group: str,
    rounds: int,
) -> dict[str, Any]:
    """Time a particle of the cheapest fast setting that is good enough against 49 raw samples with Embree."""
    if samples is None:
        return {**where, "fast samples": f"none of {list(prepared)} is as good"}
    baker, preparation = prepared[samples]
    # Fast bakes are too short to time on as few particles as Embree needs.
    many = data.group(group, 8 * len(ids), seed=2)
    # A baker may keep what it computes on the way (records of the particles that rays meet): the first bake pays for it,
    # the rest of a full bake ever less. Both ends are told.
    fresh = Baker(baker.scene, baker.spec)
    fresh.prepare()
    start = perf_counter()
    bake_with(fresh, many)
    cold = (perf_counter() - start) / len(many)
    rivals: dict[str, Callable[[], Any]] = {
        "ours": bake_of(baker, many),
        "embree": lambda: embree.sample(ids, SAMPLES),
    }
    seconds = interleaved(rivals, rounds)
    own = [s / len(many) for s in seconds["ours"]]
    other = [s / len(ids) for s in seconds["embree"]]
    middle, low, high = ratio(other, own)
    everyone = len(data.visible) if group == "visible" else len(data.particles)
    # What preparation adds to a particle when the whole group is baked.
    spread = float(np.median(own)) / (float(np.median(own)) + preparation / everyone)
    return {
        **{k: v for k, v in where.items() if k != "particles"},
        "particles": f"{len(ids):,} of {group}",
        "fast samples": samples,
        "ours warm ms/particle": 1e3 * float(np.median(own)),
        "ours cold ms/particle": 1e3 * cold,
        "embree ms/particle": 1e3 * float(np.median(other)),
        "embree/ours warm": middle,
        "range": f"{low:.1f}-{high:.1f}",
        "cold": float(np.median(other)) / cold,
        "prepare s": preparation,
        "warm, with prepare spread over the group": middle * spread,
    }
