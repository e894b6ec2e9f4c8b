"""Mappings: latitude-longitude against equal-area octahedral textures of equal bytes, where surfaces show them.

    python -m benchmarks.mapping [--quick] [--json] [--lying]

Surface error: bilinear lookup against the light at random points of visible particles, uniformly distributed over
their spheres and not buried in neighbours; linear luminance. ``limit`` is a texture of so many samples that only its
resolution errs (exposed samples alone, buried texels filled in); ``fast`` and ``paper`` are bakes as users make them.
Mean square errors are products of two independent estimates of the same difference, so noise of the truth and of
limit textures does not count; 95th percentiles and maxima are of the differences to the mean of both truths. The range
of a ratio holds 95 % of resamplings of the particles.
"""

from __future__ import annotations

import argparse
import math
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

import luxel
from benchmarks.measure import report
from benchmarks.scenes import plate, plate_camera
from luxel.data import demo_particles, demo_view
from luxel.kernels.jit import kernel
from luxel.kernels.path import luminance_at
from luxel.kernels.rng import PURPOSE_PIXEL, path_key
from luxel.kernels.shade import bilinear
from luxel.kernels.tree_trace import scratch
from luxel.light.denoise import dilate
from luxel.light.mapping import Mapping, mapping_code, texel_solid_angles
from luxel.light.sampling import draw_paths
from luxel.light.world import make_world
from luxel.picture.raytrace import visible_ids
from luxel.textures.bake import Baker
from luxel.textures.spec import Mode, TextureSpec
from luxel.trace.tree import thread_count

Floats = NDArray[np.float32]
MAPPINGS: tuple[Mapping, ...] = ("latlong", "octahedral")
BATCH = 16


@kernel
def points_light(world, spheres, normals, samples, out):
    """Mean light (P,) of `samples` paths at points of `spheres` (P,) with unit normals (P, 3); NaN where buried."""
    work = scratch(world.tree.stack_size)
    for k in range(spheres.shape[0]):
        i = spheres[k]
        nx, ny, nz = normals[k, 0], normals[k, 1], normals[k, 2]
        r = world.radii[i]
        px, py, pz = world.centers[i, 0] + r * nx, world.centers[i, 1] + r * ny, world.centers[i, 2] + r * nz
        total, count = 0.0, 0
        for s in range(samples):
            state = path_key(world.seed, i, k, s, PURPOSE_PIXEL)
            value = luminance_at(world, work, i, px, py, pz, nx, ny, nz, state)
            if value >= 0:
                total += value
                count += 1
        out[k] = total / count if 2 * count > samples else np.nan


@kernel
def look_up(mapping, codes, decoding, slots, normals, out):
    """Bilinear lookups (P,) in textures `slots` (P,)."""
    for k in range(slots.shape[0]):
        out[k] = bilinear(mapping, codes, decoding, slots[k], normals[k, 0], normals[k, 1], normals[k, 2])


def looked_up(mapping: Mapping, textures: Floats, slots: NDArray[np.int32], normals: Floats) -> Floats:
    """Look (K, T, T) textures of floats up, not rounded to 8 bits: every texel is its own code."""
    out = np.empty(len(slots), np.float32)
    codes = np.arange(textures.size, dtype=np.int32).reshape(textures.shape)
    look_up(mapping_code(mapping), codes, textures.ravel(), slots, normals, out)
    return out


def in_parts(pool: ThreadPoolExecutor, work: Any, count: int) -> list[Any]:
    """Results of `work` for consecutive slices."""
    return list(pool.map(lambda k: work(slice(k, min(k + BATCH, count))), range(0, count, BATCH)))


def truth(
    pool: ThreadPoolExecutor,
    scene: luxel.Scene,
    seed: int,
    ids: NDArray[np.int32],
    normals: Floats,
    samples: int,
) -> Floats:
    """Light at points, see `points_light`."""
    world = make_world(scene, seed=seed)
    out = np.empty(len(ids), np.float32)
    in_parts(pool, lambda p: points_light(world, ids[p], normals[p], samples, out[p]), len(ids))
    return out


def baked(pool: ThreadPoolExecutor, scene: luxel.Scene, spec: TextureSpec, ids: NDArray[np.int32]) -> Floats:
    """(K, T, T) luminance as a bake of this spec has it before it is rounded to 8 bits."""
    baker = Baker(scene, spec)
    baker.prepare()
    return np.concatenate(in_parts(pool, lambda p: baker.luminance(ids[p])[0], len(ids)))


def limit(pool: ThreadPoolExecutor, scene: luxel.Scene, spec: TextureSpec, ids: NDArray[np.int32]) -> Floats:
    """(K, T, T) mean luminance of exposed samples, unfiltered, buried texels filled in."""
    baker = Baker(scene, spec)
    parts = in_parts(
        pool, lambda p: draw_paths(baker.world, spec.mapping, spec.texels, spec.samples, ids[p]), len(ids)
    )
    mean, _, exposed = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return dilate(mean, exposed > 0, spec.mapping)


class Errors:
    """Errors of lookups; `first` and `second` estimate the same ones, at points of the particles in `slots`."""

    def __init__(
        self, first: Floats, second: Floats, truths: tuple[Floats, Floats], slots: NDArray[np.int32]
    ) -> None:
        squares = (first - truths[0]).astype(np.float64) * (second - truths[1])
        away = np.abs(0.5 * (first + second) - 0.5 * (truths[0] + truths[1]))
        self.sums = np.bincount(slots, squares)
        self.rmse = math.sqrt(max(0.0, squares.mean()))
        self.p95 = float(np.quantile(away, 0.95))
        self.max = float(away.max())


def rmse_ratio(other: Errors, base: Errors) -> tuple[float, str]:
    """Ratio of two RMSEs at the same points, and its 95 % range over resampled particles."""
    chosen = np.random.default_rng(0).integers(0, len(base.sums), (2000, len(base.sums)))
    # A product of estimates can be negative where there is hardly any error.
    squares = [np.maximum(each.sums[chosen].sum(axis=1), 1e-12) for each in (other, base)]
    low, high = np.quantile(np.sqrt(squares[0] / squares[1]), (0.025, 0.975))
    return other.rmse / base.rmse, f"{low:.2f}-{high:.2f}"


def scenes(quick: bool) -> dict[str, tuple[luxel.Particles, luxel.Camera]]:
    """Particles and cameras by name."""
    particles = plate(55_000 if quick else 550_000)
    foam = demo_particles()
    return {
        "plate": (particles, plate_camera(particles)),
        "foam": (foam, demo_view().camera_for(foam, (512, 512))),
    }


def density_rows() -> list[dict[str, Any]]:
    """How many more samples latitude-longitude takes for the sampling density of the equal-area map in every texel."""
    rows = []
    for texels in (8, 16, 32):
        widest = texel_solid_angles("latlong", texels).max()
        factor = float(widest / texel_solid_angles("octahedral", texels)[0, 0])
        row: dict[str, Any] = {"texels": texels, "more samples": f"{factor - 1:.1%}"}
        for samples in (25, 36, 49):
            square = math.ceil(math.sqrt(samples * factor)) ** 2
            row[f"{samples} become"] = f"{square} (+{square / samples - 1:.0%})"
        rows.append(row)
    return rows


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--quick", action="store_true", help="fewer particles, points and samples; 8 texels")
    options.add_argument("--json", action="store_true")
    options.add_argument(
        "--lying",
        action="store_true",
        help="turn the scenes by their diagonal: up becomes +X, the poles lie sideways",
    )
    chosen = options.parse_args()
    particle_count, point_count, point_samples, texel_samples = (
        (60, 8, 256, 36) if chosen.quick else (240, 24, 1024, 64)
    )
    turn = 1 if chosen.lying else 0
    lights = {
        "sky": (luxel.Sky(1.0),),
        "sky + sun": (luxel.Sky(1.0), luxel.Sun(np.roll((1.0, 1.0, 2.0), turn), 2.0, 15.0)),
    }
    bakes: tuple[tuple[Mode, int], ...] = (("fast", 4), ("paper", 25))
    rows: list[dict[str, Any]] = []
    with ThreadPoolExecutor(thread_count(None)) as pool:
        for name, (particles, camera) in scenes(chosen.quick).items():
            rng = np.random.default_rng(0)
            lit = luxel.Particles(np.roll(particles.local, turn, axis=1), particles.radii)
            seen = visible_ids(luxel.Scene(particles), camera, (512, 512))
            ids = np.sort(rng.choice(seen, particle_count, replace=False)).astype(np.int32)
            slots = np.repeat(np.arange(particle_count, dtype=np.int32), point_count)
            normals = rng.normal(size=(len(slots), 3))
            normals = (normals / np.linalg.norm(normals, axis=1)[:, None]).astype(np.float32)
            for light, sources in lights.items():
                scene = luxel.Scene(lit, sources)
                both = [truth(pool, scene, seed, ids[slots], normals, point_samples) for seed in (1, 2)]
                open_points = np.isfinite(both[0]) & np.isfinite(both[1])
                truths = both[0][open_points], both[1][open_points]
                place = slots[open_points], normals[open_points]
                for texels in (8,) if chosen.quick else (8, 16):
                    found: dict[str, dict[Mapping, Errors]] = {}
                    for mapping in MAPPINGS:
                        pair = [
                            limit(
                                pool, scene, TextureSpec(texels, texel_samples, seed=s, mapping=mapping), ids
                            )
                            for s in (3, 4)
                        ]
                        looked = [looked_up(mapping, each, *place) for each in pair]
                        found.setdefault("limit", {})[mapping] = Errors(
                            looked[0], looked[1], truths, place[0]
                        )
                        for mode, samples in bakes:
                            spec = TextureSpec(texels, samples, mode, seed=5, mapping=mapping)
                            once = looked_up(mapping, baked(pool, scene, spec, ids), *place)
                            found.setdefault(f"{mode}, {samples}", {})[mapping] = Errors(
                                once, once, truths, place[0]
                            )
                    for kind, by_mapping in found.items():
                        row: dict[str, Any] = {
                            "scene": name, "light": light, "bytes": texels**2, "texture": kind
                        }  # fmt: skip
                        for measure in ("rmse", "p95", "max"):
                            for mapping in MAPPINGS:
                                row[f"{measure} {mapping}"] = getattr(by_mapping[mapping], measure)
                        row["rmse ratio"], row["range"] = rmse_ratio(*(by_mapping[m] for m in MAPPINGS[::-1]))
                        row["points"] = len(truths[0])
                        rows.append(row)
    report(f"mapping: surface errors{', lying' if chosen.lying else ''}", rows, chosen.json)
    report("mapping: samples a texel for equal density, paper 3.2", density_rows(), chosen.json)


if __name__ == "__main__":
    main()
