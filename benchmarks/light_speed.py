"""Tables of speed: paper mode against Embree on the same samples, scaling with the number of particles, unequal radii."""

from __future__ import annotations

import gc
import time
import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

import luxel
from benchmarks.light_scenes import ISA, LIGHTS, DataSet, packing, slab
from benchmarks.measure import interleaved, ratio
from luxel.textures.bake import Baker, bake_with
from luxel.textures.spec import TextureSpec
from tests.embree_light import EmbreeBaker

Rows = list[dict[str, Any]]
SAMPLES = 49


def paper_against_embree(sets: list[DataSet], counts: dict[str, int], rounds: int) -> Rows:
    """Ambient occlusion and all bounces under sky and sun, 49 samples; rays are counted on Embree's side for both."""
    rows: Rows = []
    for data in sets:
        for model in ("ao", "interreflection"):
            scene = data.scene("sky+sun", model)
            baker, embree = Baker(scene, TextureSpec(samples=SAMPLES)), EmbreeBaker(scene, isa=ISA)
            baker.prepare()
            for group in ("all", "visible"):
                ids = data.group(group, counts[model])
                rays = 0

                def theirs(ids: NDArray[np.int32] = ids, embree: EmbreeBaker = embree) -> None:
                    nonlocal rays
                    rays = embree.sample(ids, SAMPLES)[2]

                seconds = interleaved({"ours": bake_of(baker, ids), "embree": theirs}, rounds)
                middle, low, high = ratio(seconds["embree"], seconds["ours"])
                own, other = float(np.median(seconds["ours"])), float(np.median(seconds["embree"]))
                rows.append(
                    {
                        "scene": data.name,
                        "light": "unit sky (ao)" if model == "ao" else "sky+sun, all bounces",
                        "particles": f"{len(ids):,} of {group}",
                        "Mray": rays / 1e6,
                        "ours s": own,
                        "embree s": other,
                        "ours Mray/s": rays / own / 1e6,
                        "embree Mray/s": rays / other / 1e6,
                        "embree/ours": middle,
                        "range": f"{low:.2f}-{high:.2f}",
                    }
                )
    return rows


def bake_of(baker: Baker, ids: NDArray[np.int32]) -> Callable[[], Any]:
    """Bake of `ids` as a function of nothing, for timing."""
    return lambda: bake_with(baker, ids)


def scaling(counts: list[int], textures: int) -> Rows:
    """Time a texture, of preparation, and working memory against the number of particles, at fixed density."""
    rows: Rows = []
    for warm in ("paper", "fast"):  # nothing is compiled under the clock
        luxel.bake(luxel.Scene(slab(1000), LIGHTS["sky+sun"]), range(32), samples=4, mode=warm)
    for count in counts:
        particles = slab(count)
        ids = np.random.default_rng(0).choice(len(particles), min(textures, len(particles)), replace=False)
        ids = ids.astype(np.int32)
        row: dict[str, Any] = {"particles": len(particles), "textures": len(ids)}
        for mode, samples in (("paper", 4), ("fast", 2)):
            scene = luxel.Scene(particles, LIGHTS["sky+sun"])
            spec = TextureSpec(mode=mode, samples=samples)
            start = time.perf_counter()
            baker = Baker(scene, spec)
            baker.prepare()
            prepared = time.perf_counter()
            bake_with(baker, ids)
            row[f"{mode} prepare s"] = prepared - start
            row[f"{mode} ms/texture"] = 1e3 * (time.perf_counter() - prepared) / len(ids)
        row["bytes/particle"] = working_bytes(particles, ids) / len(particles)
        rows.append(row)
        gc.collect()
    sizes = np.log([row["particles"] for row in rows])
    slopes: dict[str, Any] = {"particles": "log-log slope", "textures": ""}
    for name in ("paper prepare s", "paper ms/texture", "fast prepare s", "fast ms/texture"):
        slopes[name] = float(np.polyfit(sizes, np.log([row[name] for row in rows]), 1)[0])
    return [*rows, slopes]


def working_bytes(particles: luxel.Particles, ids: NDArray[np.int32]) -> int:
    """Most memory that a fast bake of `ids` held at any time, beyond the particles and the textures it returned."""
    fresh = luxel.Particles(particles.local, particles.radii)  # nothing computed from it yet
    gc.collect()
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        textures = luxel.bake(luxel.Scene(fresh, LIGHTS["sky+sun"]), ids, samples=4, mode="fast")
        return tracemalloc.get_traced_memory()[1] - before - textures.nbytes
    finally:
        tracemalloc.stop()


def unequal_radii(count: int, textures: int, rounds: int) -> Rows:
    """The price of radii over 1 : 1000, for the same number of particles, textures and samples; and a ray."""
    rows: Rows = []
    packings = {"equal": packing(count, 1.0), "1:1000": packing(count, 1000.0)}
    for model, mode in (("ao", "paper"), ("interreflection", "paper"), ("interreflection", "fast")):
        runs: dict[str, Callable[[], Any]] = {}
        rays: dict[str, int] = {}
        for name, particles in packings.items():
            scene = luxel.Scene(particles, LIGHTS["sky+sun"], model=model)
            ids = np.random.default_rng(0).permutation(len(particles))[:textures].astype(np.int32)
            baker = Baker(scene, TextureSpec(mode=mode, samples=16))
            baker.prepare()
            rays[name] = EmbreeBaker(scene, isa=ISA).sample(ids, 16)[2]
            runs[name] = bake_of(baker, ids)
        seconds = interleaved(runs, rounds)
        middle, low, high = ratio(seconds["1:1000"], seconds["equal"])
        rows.append(
            {
                "light": f"{model}, {mode}, 16 samples",
                "textures": textures,
                "equal s": float(np.median(seconds["equal"])),
                "1:1000 s": float(np.median(seconds["1:1000"])),
                "1:1000 / equal": middle,
                "range": f"{low:.2f}-{high:.2f}",
                "same, a ray": middle * rays["equal"] / rays["1:1000"],
            }
        )
    return rows
