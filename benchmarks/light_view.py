"""Table of one view of the plate: time to see it lit, and how far the picture is from the converged one."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

import luxel
from benchmarks.light_scenes import DataSet
from benchmarks.light_speed import Rows
from benchmarks.scenes import plate_camera
from luxel.light.fast import in_batches
from luxel.light.in_view import Gaze
from luxel.picture.drawing import make_eye, make_gaze
from luxel.picture.raytrace import render, visible_ids
from luxel.textures.bake import Baker, bake_with
from luxel.textures.estimate import EstimateBaker
from luxel.textures.spec import TextureSpec
from luxel.trace.spheres import SphereSet
from luxel.trace.tree import thread_count

_VIEWS = 9
_NEW_VIEW_SIDE = 1024
_PART = 128


def one_view(data: DataSet, side: int, picture_side: int, truth_samples: int, patience_s: float) -> Rows:
    """Primary rays, first estimate, light at default quality, new views, and the picture's error.

    Parameters
    ----------
    side, picture_side
        Pixels along a side: what defines the visible set, and the pictures that are compared with converged ones.
    truth_samples
        Paths a pixel of each of the two converged pictures.
    patience_s
        A bake that takes longer is broken off and extrapolated, and the remark says so.
    """
    scene = data.scene("sky+sun")
    camera, size = plate_camera(data.particles), (side, side)
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
    gaze = _gaze(data, camera, ids)
    _first_textures(scene, ids[:32], gaze)  # nothing is compiled under the clock

    start = perf_counter()
    in_batches(Baker(scene, TextureSpec(mode="fast")).first_light, ids, thread_count(None))
    row(
        "first estimate of all that is visible",
        perf_counter() - start,
        "s",
        "coarse records, nothing prepared",
    )

    _, prepare_s, took = _first_textures(scene, ids, gaze)
    row(
        "visible set lit, as views do first",
        prepare_s + took,
        "s",
        f"a sample of each texel in view; {prepare_s:.2f} s preparation; {1e6 * took / len(ids):.0f} us a texture",
    )

    start = perf_counter()
    baker = Baker(scene, TextureSpec.usual())
    baker.prepare()
    prepare_s = perf_counter() - start
    everyone = np.arange(len(data.particles), dtype=np.int32)
    for what, chosen in (("visible set", ids), (f"all {len(everyone):,}", everyone)):
        took, how = _bake_s(baker, chosen, patience_s)
        remark = f"{prepare_s:.2f} s preparation; {1e6 * took / len(chosen):.0f} us a texture, {how}"
        row(f"{what} lit, whole textures of one sample", prepare_s + took, "s", remark)

    size = (_NEW_VIEW_SIDE, _NEW_VIEW_SIDE)
    textures = bake_with(baker, visible_ids(scene, camera, size, antialias=3))
    for antialias, what in ((3, "nine rays a pixel"), (2, "four rays a pixel"), (1, "one ray a pixel")):
        times = []
        for k in range(_VIEWS + 1):
            view = luxel.View(camera=_stepped(camera, 0.01 * k))
            start = perf_counter()
            render(scene, view, textures=textures, size=size, antialias=antialias, colorbar=False)
            times.append(1e3 * (perf_counter() - start))
        row(
            f"new view at {_NEW_VIEW_SIDE}², {what}",
            float(np.median(times[1:])),
            "ms",
            f"median of {_VIEWS}, whole call",
        )

    size = (picture_side, picture_side)
    visible = visible_ids(scene, camera, size, antialias=3)
    view = luxel.View(camera=camera)
    common: dict[str, Any] = {"size": size, "antialias": 3, "colorbar": False}
    start = perf_counter()
    truths = [render(scene, view, light="pixel", samples=truth_samples, seed=s, **common) for s in (1, 2)]
    took = 0.5 * (perf_counter() - start)
    covered = truths[0].ids >= 0
    a, b = (t.array[..., :3].astype(np.float64)[covered] for t in truths)
    truth, noise = 0.5 * (a + b), ((a - b) ** 2).mean() / 4
    said = (
        f"truth {truth_samples} paths a pixel twice, {took:.0f} s each, its noise of {np.sqrt(noise):.2f} subtracted; "
        f"{covered.mean():.0%} covered"
    )
    gaze = _gaze(data, camera, visible)
    textures, _, took = _first_textures(scene, visible, gaze)
    ways = [("what views show first", 1, textures, took)]
    for what, spec, looked_at in (
        ("whole textures of one sample", TextureSpec.usual(), None),
        ("a single picture's default", TextureSpec.usual(purpose="picture"), gaze),
        ("a view's default, refined", TextureSpec.usual(purpose="view"), None),
    ):
        baker = Baker(scene, spec)
        baker.prepare()
        start = perf_counter()
        textures = bake_with(baker, visible, gaze=looked_at)
        ways.append((what, spec.samples, textures, perf_counter() - start))
    for what, samples, textures, took in ways:
        picture = render(scene, view, textures=textures, **common).array[..., :3].astype(np.float64)[covered]
        row(
            f"picture error at {picture_side}², {what}",
            float(np.sqrt(max(0.0, ((picture - truth) ** 2).mean() - noise))),
            "levels",
            f"{samples} a texel, {took:.1f} s for {len(visible):,}; mean {(picture - truth).mean():+.2f}; {said}",
        )
        said = "as above"
    return rows


def _gaze(data: DataSet, camera: luxel.Camera, visible: NDArray[np.int32]) -> Gaze:
    """Who looks at a square picture."""
    return make_gaze(make_eye(camera, SphereSet.of(data.particles), 1.0), visible, len(data.particles))


def _first_textures(
    scene: luxel.Scene, ids: NDArray[np.int32], gaze: Gaze
) -> tuple[luxel.LuminanceTextures, float, float]:
    """Textures that views show first, and seconds for preparation and for them."""
    start = perf_counter()
    baker = Baker(scene, TextureSpec.usual(purpose="view"))
    first = EstimateBaker(baker, whole=True)
    threads = thread_count(None)
    for _ in first.preparation(threads, gaze):
        pass
    prepared = perf_counter()
    codes = np.empty((len(ids), baker.spec.texels, baker.spec.texels), np.uint8)
    parts = [slice(k, k + _PART) for k in range(0, len(ids), _PART)]
    with ThreadPoolExecutor(threads) as pool:
        for done in [pool.submit(first.bake_into, ids[part], codes[part], gaze) for part in parts]:
            done.result()
    took = perf_counter() - prepared
    count = len(scene.particles)
    textures = luxel.LuminanceTextures(ids, codes, baker.scale, baker.encoding, count, baker.key)
    return textures, prepared - start, took


def _bake_s(baker: Baker, ids: NDArray[np.int32], patience_s: float) -> tuple[float, str]:
    """Seconds to bake `ids` in their order, as bakes do, extrapolated when they are more than `patience_s`; and which it is."""
    done, took = 0, 0.0
    while done < len(ids):
        # Large parts: whatever a bake costs by itself must not be paid often.
        part = ids[done : done + max(4096, len(ids) // 16)]
        start = perf_counter()
        bake_with(baker, part)
        last = (perf_counter() - start) / len(part)
        took += last * len(part)
        done += len(part)
        if took > patience_s:
            break
    # A baker that keeps what it computes gets faster as it goes, so the last part is nearest to the rest.
    rest = len(ids) - done
    return took + last * rest, f"extrapolated from {done:,}" if rest else "measured"


def _stepped(camera: luxel.Camera, turn: float) -> luxel.Camera:
    """The camera, gone a little around its target about the z axis."""
    c, s = np.cos(turn), np.sin(turn)
    offset = np.asarray(camera.eye) - np.asarray(camera.target)
    moved = np.array([c * offset[0] - s * offset[1], s * offset[0] + c * offset[1], offset[2]])
    return luxel.Camera(np.asarray(camera.target) + moved, camera.target, camera.up, camera.fov)
