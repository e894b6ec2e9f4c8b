"""Table of one view of the plate: time to see it lit, and how far the picture is from the converged one."""

from __future__ import annotations

from time import perf_counter
from typing import Any

import numpy as np

import luxel
from benchmarks.light_scenes import DataSet
from benchmarks.light_speed import Rows
from benchmarks.scenes import plate_camera
from luxel.picture.raytrace import render, visible_ids
from luxel.textures.bake import Baker, bake_with
from luxel.textures.spec import TextureSpec

_DEFAULT_SAMPLES = 4  # of render
_VIEWS = 5


def one_view(data: DataSet, side: int, truth_samples: int, everything: bool) -> Rows:
    """Primary rays, first estimate, light at default quality, new views, and the picture's error.

    Parameters
    ----------
    truth_samples
        Paths a pixel of each of the two converged pictures.
    everything
        Bake all particles; otherwise a random subset tells what that would take.
    """
    scene = data.scene("sky+sun")
    camera = plate_camera(data.particles)
    size = (side, side)
    rows: Rows = []

    def row(what: str, value: float, unit: str, remark: str = "") -> None:
        rows.append({"what": what, "value": value, "unit": unit, "remark": remark})

    ids = visible_ids(scene, camera, size)
    start = perf_counter()
    ids = visible_ids(scene, camera, size)
    row(
        f"visible particles at {side}², one ray a pixel",
        1e3 * (perf_counter() - start),
        "ms",
        f"{len(ids):,} visible",
    )

    default = TextureSpec(mode="fast", samples=_DEFAULT_SAMPLES)
    start = perf_counter()
    baker = Baker(scene, default)
    first_light = getattr(baker, "first_light", None)
    if first_light is not None:
        baker.prepare()
        first_light(ids)
        remark = "coarse records"
    else:
        bake_with(Baker(scene, TextureSpec(mode="fast", samples=1)), ids)
        remark = "fast, 1 sample a texel, preparation included"
    row("first estimate of all that is visible", perf_counter() - start, "s", remark)

    start = perf_counter()
    baker = Baker(scene, default)
    baker.prepare()
    prepared = perf_counter()
    bake_with(baker, ids)
    done = perf_counter()
    row(
        "visible set lit at default quality",
        done - start,
        "s",
        f"{prepared - start:.2f} s of it preparation; {1e6 * (done - prepared) / len(ids):.0f} us a texture",
    )
    seen = visible_ids(scene, camera, size, antialias=3)
    textures = bake_with(baker, seen)

    chosen = np.arange(len(data.particles), dtype=np.int32) if everything else data.group("all", 4096)
    preparation = prepared - start
    start = perf_counter()
    clipped = bake_with(baker, chosen).clipped_count
    took = preparation + (perf_counter() - start) * len(data.particles) / len(chosen)
    row(
        f"all {len(data.particles):,} lit at default quality",
        took,
        "s",
        ("measured" if everything else f"extrapolated from {len(chosen):,}") + f"; {clipped} texels clipped",
    )

    for antialias, what in ((3, "nine rays a pixel"), (1, "one ray a pixel")):
        times = []
        for k in range(_VIEWS + 1):
            view = luxel.View(camera=_stepped(camera, 0.01 * k))
            start = perf_counter()
            render(scene, view, textures=textures, size=size, antialias=antialias, colorbar=False)
            times.append(1e3 * (perf_counter() - start))
        row(
            f"new view at {side}², {what}",
            float(np.median(times[1:])),
            "ms",
            f"median of {_VIEWS}, whole call",
        )

    view = luxel.View(camera=camera)
    common: dict[str, Any] = {"size": size, "antialias": 3, "colorbar": False}
    start = perf_counter()
    truths = [render(scene, view, light="pixel", samples=truth_samples, seed=s, **common) for s in (1, 2)]
    took = 0.5 * (perf_counter() - start)
    covered = truths[0].ids >= 0
    a, b = (t.array[..., :3].astype(np.float64)[covered] for t in truths)
    truth, noise = 0.5 * (a + b), ((a - b) ** 2).mean() / 4
    picture = render(scene, view, textures=textures, **common).array[..., :3].astype(np.float64)[covered]
    mean_square = ((picture - truth) ** 2).mean()
    row(
        "picture error, RMS over covered pixels",
        float(np.sqrt(max(0.0, mean_square - noise))),
        "levels",
        f"mean {(picture - truth).mean():+.2f}; truth {truth_samples} paths a pixel twice, {took:.0f} s each, "
        f"its noise of {np.sqrt(noise):.2f} subtracted; {covered.mean():.0%} covered",
    )
    return rows


def _stepped(camera: luxel.Camera, turn: float) -> luxel.Camera:
    """The camera, gone a little around its target about the z axis."""
    c, s = np.cos(turn), np.sin(turn)
    offset = np.asarray(camera.eye) - np.asarray(camera.target)
    moved = np.array([c * offset[0] - s * offset[1], s * offset[0] + c * offset[1], offset[2]])
    return luxel.Camera(np.asarray(camera.target) + moved, camera.target, camera.up, camera.fov)
