"""Rays: our sphere tree against Embree on the same rays; construction, memory, gather rays, primary rays.

    python -m benchmarks.rays [--quick] [--json]

Embree is called from Numba with one ray at a time for gather rays and with 4 x 4 packets for primary ones, the way
each is fastest. With NUMBA_CPU_NAME=haswell both sides run AVX2 code.
"""

from __future__ import annotations

import argparse
import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np

import luxel
from benchmarks.measure import interleaved, ratio, report
from benchmarks.scenes import plate, plate_camera
from luxel.light.world import make_world
from luxel.picture.raytrace import make_eye, trace_primary, visible_ids
from luxel.trace.spheres import SphereSet
from luxel.trace.tree import SphereTree, thread_count
from tests import embree_twin
from tests.scenes import random_rays


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--quick", action="store_true", help="a tenth of the particles and rays")
    options.add_argument("--json", action="store_true")
    chosen = options.parse_args()
    count, ray_count, rounds = (55_000, 100_000, 3) if chosen.quick else (550_000, 1_000_000, 7)
    particles = plate(count)
    spheres = SphereSet.of(particles)
    threads = thread_count(None)
    isa = "avx2" if os.environ.get("NUMBA_CPU_NAME") == "haswell" else ""
    embree = embree_twin.EmbreeScene(spheres.centers, spheres.radii, threads=threads, isa=isa)
    tree = SphereTree(spheres)
    rows = []

    def row(what: str, ours, theirs, work: float = 0.0, **more) -> None:
        seconds = interleaved({"ours": ours, "embree": theirs}, rounds)
        middle, low, high = ratio(seconds["embree"], seconds["ours"])
        own, other = np.median(seconds["ours"]), np.median(seconds["embree"])
        speed = {"ours Mray/s": work / own / 1e6, "embree Mray/s": work / other / 1e6} if work else {}
        rows.append(
            {
                "what": what,
                "ours s": own,
                "embree s": other,
                **speed,
                "embree/ours": middle,
                "range": f"{low:.2f}-{high:.2f}",
                **more,
            }
        )

    row(
        f"build {len(spheres):,} spheres",
        lambda: SphereTree(spheres),
        lambda: embree_twin.EmbreeScene(spheres.centers, spheres.radii, threads=threads, isa=isa),
        remark=f"{tree.nbytes / len(spheres):.1f} bytes a particle",
    )

    camera = plate_camera(particles)
    scene = luxel.Scene(particles)
    seen = visible_ids(scene, camera, (512, 512))
    rng = np.random.default_rng(0)
    for group, pool in (("all", None), ("visible", seen)):
        origins, directions, ids = random_rays(particles, ray_count)
        if pool is not None:
            shift = ids.copy()
            ids = pool[rng.integers(0, len(pool), ray_count)]
            origins = origins - spheres.centers[shift] + spheres.centers[ids]
        # Embree cannot leave a sphere out, so both start a hair above the surface.
        origins = origins + (origins - spheres.centers[ids]) * np.float32(1e-4)
        skip = np.full(ray_count, -1, np.int32)
        for what, any_hit in (("closest hit", False), ("occlusion", True)):
            found = np.empty(ray_count, np.int32)
            distance = np.empty(ray_count, np.float32)
            parts = [slice(k, k + 16_384) for k in range(0, ray_count, 16_384)]

            def theirs(
                origins=origins,
                directions=directions,
                any_hit=any_hit,
                distance=distance,
                found=found,
                parts=parts,
            ) -> None:
                with ThreadPoolExecutor(threads) as workers:
                    list(
                        workers.map(
                            lambda p: embree_twin.trace_rays(
                                embree.handle, origins[p], directions[p], any_hit, distance[p], found[p]
                            ),
                            parts,
                        )
                    )

            method = tree.occluded if any_hit else tree.closest
            ours = method(origins, directions, skip=skip)
            theirs()
            agree = np.mean(ours == (found >= 0)) if any_hit else np.mean((ours[1] >= 0) == (found >= 0))
            row(
                f"{what}, {group} particles",
                lambda m=method, o=origins, d=directions, s=skip: m(o, d, skip=s),
                theirs,
                ray_count,
                remark=f"agree {agree:.4%}",
            )

    side = 512 if chosen.quick else 1024
    world = make_world(scene)
    eye = make_eye(camera, spheres, 1.0)
    picture = np.empty((side, side), np.int32)

    def embree_picture() -> None:
        with ThreadPoolExecutor(threads) as workers:
            list(
                workers.map(
                    lambda y: embree_twin.primary_rays(
                        embree.handle,
                        eye.origin,
                        eye.right,
                        eye.up,
                        eye.forward,
                        side,
                        side,
                        y,
                        min(y + 32, side),
                        picture,
                    ),
                    range(0, side, 32),
                )
            )

    embree_picture()
    ids = trace_primary(world, eye, side, side, (0.5, 0.5), threads)[1]
    row(
        f"primary rays {side} x {side}",
        lambda: trace_primary(world, eye, side, side, (0.5, 0.5), threads),
        embree_picture,
        side * side,
        remark=f"agree {np.mean(ids == picture):.4%}, covered {np.mean(ids >= 0):.0%}, visible {len(seen):,}",
    )
    report("rays", rows, chosen.json)


if __name__ == "__main__":
    main()
