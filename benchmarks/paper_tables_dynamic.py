"""The paper's tables 5 and 6: dynamic textures. Run through ``benchmarks.paper_tables``.

The camera path "arc": 100 views, a quarter turn from azimuth -60° on, from 35° above the horizon, 512², at half the distance at which
everything is in view, so that the data fills the picture. "arc, far" is as far away as that, where most particles are smaller than a pixel.

table5: memory. "one view" and "arc" are the particles that one ray a pixel meets, of the first view and of all of them. The last columns are about a
cache that keeps eight principal components a texture, learnt as textures come: particles a MB, with all that a slot costs, and the RMS error in
codes, beside that of a basis learnt from all of them.
table6: frames a second along the arc, one ray a pixel. "query only": the same Lambert and the same shadow rays, every
pixel looked up, every visible particle requested, generation off. "outstanding": from an empty cache, while requests
wait. "completed": all textures there, one bilinear lookup a pixel as in the paper; "filtered" is what the viewer
shows of small particles. Targets are for views that the data fills, as the paper's; from twice as far is for comparison. Pairs of frames in turn; their median ratio with quartiles. "lookup" and "noting" are thread time over plain Lambert: a bilinear
lookup, and marking particles as seen; what else asking takes is in "query only".
"""

from __future__ import annotations

import statistics
from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter, thread_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

import luxel
from benchmarks.dynamic import engine_of
from benchmarks.light_scenes import DataSet
from luxel.dynamic.cache import TextureCache
from luxel.light.world import make_world
from luxel.picture.drawing import Crew, bare_table, draw_rays, make_eye, make_skin
from luxel.picture.frames import Frame, Frames
from luxel.picture.raytrace import visible_ids
from luxel.picture.seen import SeenMarks
from luxel.session import Session
from luxel.textures.bake import Baker, bake_with
from luxel.textures.codecs import Distortion, IncrementalPCA
from luxel.textures.spec import TextureSpec, light_key
from luxel.trace.spheres import SphereSet
from luxel.trace.tree import thread_count

__all__ = ["arc", "table5", "table6"]

Rows = list[dict[str, Any]]
_SIDE = 512
_SIZE = (_SIDE, _SIDE)
_SPEC = TextureSpec(mode="fast", samples=1)
_BYTES = 512 << 20
_TEXTURE = 256  # bytes
_PCA_SHARED = 9 * 256 * 4  # mean and eight basis textures

_LEAST = {"query only": 0.95, "outstanding": 0.5, "completed": 1.9}  # targets, over Lambert with shadows
_MOST_LOOKUP_NS = 15

_PAPER_TABLE5 = (
    ("Bullet-2", 569_523, 4.53, 6.31, 139.04, 4.35),
    ("Cylinder-6", 214_036, 11.64, 6.34, 52.26, 1.64),
    ("Fireball-10", 954_903, 8.07, 18.84, 233.13, 7.29),
    ("JP8-173", 809_533, 8.91, 17.62, 197.64, 6.18),
)
_PAPER_TABLE6 = (
    ("Bullet-2", 46.13, 17.44, 5.20, 72.95),
    ("Cylinder-6", 29.84, 9.23, 2.74, 39.59),
    ("Fireball-10", 59.17, 21.44, 3.54, 65.37),
    ("JP8-173", 24.78, 8.85, 2.85, 35.81),
)


def arc(particles: luxel.Particles, count: int = 100, distance: float = 0.5) -> list[luxel.Camera]:
    """The named camera path, thinned out to `count` views; `distance` over that at which everything is in view."""
    path = []
    for azimuth in np.linspace(-60.0, 30.0, count):
        whole = luxel.Camera.framing(particles.bounds, azimuth=azimuth, elevation=35.0, aspect=1.0)
        target = np.asarray(whole.target)
        eye = target + distance * (np.asarray(whole.eye) - target)
        path.append(luxel.Camera(eye, target, up=whole.up, fov=whole.fov))
    return path


def _seen(data: DataSet, path: list[luxel.Camera]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Ids of the first view, and of all views of the path."""
    scene = luxel.Scene(data.particles)
    looks = [visible_ids(scene, camera, _SIZE) for camera in path]
    return looks[0], np.unique(np.concatenate(looks))


def table5(sets: list[DataSet], quick: bool) -> Rows:
    """Memory of dynamic, precomputed and compressed textures, MB of 2^20 bytes as in the paper."""
    rows: Rows = []
    for data in sets:
        count = len(data.particles)
        one, union = _seen(data, arc(data.particles))
        engine = engine_of(count, _BYTES)
        engine.request("light", union, lambda ids: (np.zeros(len(ids)), None))
        engine.wait()
        found = engine.cache.stats()
        assert found.textures == len(union)
        engine.close()
        rows.append(
            {
                "scene": data.name,
                "particles": count,
                "one view, %": 100 * len(one) / count,
                "arc, %": 100 * len(union) / count,
                "DLT, MB": len(union) * _TEXTURE / 2**20,
                "with all bookkeeping": found.nbytes / 2**20,
                "PLT, MB": count * _TEXTURE / 2**20,
                "PCA-8, MB": (8 * count + _PCA_SHARED) / 2**20,
                **_compressed(data, union, quick),
            }
        )
    for name, count, percent, dlt, plt, pca in _PAPER_TABLE5:
        rows.append(
            {
                "scene": f"paper, {name}",
                "particles": count,
                "arc, %": percent,
                "DLT, MB": dlt,
                "PLT, MB": plt,
                "PCA-8, MB": pca,
            }
        )
    return rows


def _compressed(data: DataSet, seen: NDArray[np.int32], quick: bool) -> dict[str, Any]:
    """What a cache gains by compression, on textures of what is seen."""
    ids = np.sort(np.random.default_rng(0).permutation(seen)[: 4096 if quick else 32_768])
    baker = Baker(data.scene("sky+sun"), _SPEC)
    baker.prepare(thread_count(None))
    codes = bake_with(baker, ids).codes
    caches = [TextureCache(16, _BYTES, components=components) for components in (0, 8)]
    for cache in caches:
        light = cache.begin("light", len(data.particles), 1.0, "linear")
        start, size = 0, 16
        while start < len(ids):  # as an engine makes them
            cache.publish(light, ids[start : start + size], codes[start : start + size])
            start, size = start + size, min(256, 2 * size)
    raw, packed = (cache.capacity * 2**20 / cache.max_bytes for cache in caches)
    whole = IncrementalPCA().partial_fit(codes).codec(8)
    return {
        "raw, particles a MB": raw,
        "DLT-8, particles a MB": packed,
        "DLT-8, RMSE": caches[1].stats().error,
        "basis from all, RMSE": Distortion.of(whole, codes, whole.encode(codes)).rmse,
    }


def table6(sets: list[DataSet], quick: bool) -> Rows:
    """Frame rates of Lambert with shadows, query only, outstanding, completed."""
    rows: Rows = []
    for distance in (0.5, 1.0):
        for data in sets:
            path = arc(data.particles, (48 if distance < 1 else 24) if quick else 100, distance)
            row = {"scene": data.name, **_frame_rates(data, path)}
            if (
                distance == 1
            ):  # half of the picture and more is background, which neither shadows nor textures cost
                row |= {"scene": f"{data.name}, far", "targets": "none"}
            rows.append(row)
    for name, lambert, query, waiting, completed in _PAPER_TABLE6:
        rows.append(
            {
                "scene": f"paper, {name}",
                "Lambert + shadow, frames/s": lambert,
                "query only": f"{query} ({query / lambert:.2f}x)",
                "outstanding": f"{waiting} ({waiting / lambert:.2f}x)",
                "completed": f"{completed} ({completed / lambert:.2f}x)",
            }
        )
    rows.append(
        {
            "scene": "target",
            **{name: f">= {least}x" for name, least in _LEAST.items()},
            "lookup, ns a pixel": f"<= {_MOST_LOOKUP_NS}",
        }
    )
    return rows


def _frame_rates(data: DataSet, path: list[luxel.Camera]) -> dict[str, Any]:
    """One row of table 6."""
    scene = data.scene("sky+sun")
    with Session(scene, spec=_SPEC, threads=0) as idle, _filled(data, path) as full:
        rivals = {
            "Lambert": Frames(scene, size=_SIZE, shading="shadows", antialias=1),
            "query only": Frames(idle, size=_SIZE, shadows=True, antialias=1),
            "completed": Frames(full, size=_SIZE, antialias=1, filtered=False),
            "filtered": Frames(full, size=_SIZE, antialias=1),
        }
        seconds: dict[str, list[float]] = {name: [] for name in rivals}
        for turn, camera in enumerate([*path[:2], *path]):  # two to warm up
            for name, frames in rivals.items():
                took, frame = _timed(frames, camera)
                if turn >= 2:
                    seconds[name].append(took)
                if name in ("completed", "filtered"):
                    assert frame.ready == frame.visible, "a texture is missing"
        for frames in rivals.values():
            frames.close()
    outstanding = _outstanding(scene, path)
    row: dict[str, Any] = {"Lambert + shadow, frames/s": 1 / statistics.median(seconds["Lambert"])}
    ratios = {"outstanding": statistics.median(seconds["Lambert"]) / outstanding}
    for name in ("query only", "outstanding", "completed", "filtered"):
        if name == "outstanding":
            row[name] = f"{1 / outstanding:.1f} ({ratios[name]:.2f}x)"
            continue
        pairs = [a / b for a, b in zip(seconds["Lambert"], seconds[name], strict=True)]
        low, middle, high = statistics.quantiles(pairs, n=4)
        ratios[name] = middle
        row[name] = f"{1 / statistics.median(seconds[name]):.1f} ({middle:.2f}x, {low:.2f}-{high:.2f})"
    row["lookup, ns a pixel"], row["noting, ns a pixel"] = _pixel_costs_ns(data, path[0])
    missed = [name for name, least in _LEAST.items() if ratios[name] < least]
    missed += ["lookup"] if row["lookup, ns a pixel"] > _MOST_LOOKUP_NS else []
    row["targets"] = "met" if not missed else "missed: " + ", ".join(missed)
    return row


@contextmanager
def _filled(data: DataSet, path: list[luxel.Camera]) -> Iterator[Session]:
    """A session that has every texture that the path shows."""
    union = _seen(data, path)[1]
    with Session(data.scene("sky+sun"), spec=_SPEC, max_bytes=_BYTES) as session:
        eye = path[0].eye
        session.sighted(union, eye)
        while not session.wait(0.5):
            session.sighted(union, eye)  # requests lapse unless somebody keeps looking
        yield session


def _timed(frames: Frames, camera: luxel.Camera) -> tuple[float, Frame]:
    start = perf_counter()
    frame = frames.draw(luxel.View(camera=camera))
    return perf_counter() - start, frame


def _outstanding(scene: luxel.Scene, path: list[luxel.Camera]) -> float:
    """Mean seconds a frame, from an empty cache on, as long as requests wait."""
    took: list[float] = []
    with (
        Session(scene, spec=_SPEC, max_bytes=_BYTES) as session,
        Frames(session, size=_SIZE, antialias=1) as frames,
    ):
        frames.draw(luxel.View(camera=path[0]))  # makes the baker, learns the filter
        session.wait(60.0)
        for camera in path[1:]:
            second, frame = _timed(frames, camera)
            status = session.status()
            if frame.ready < frame.visible and status.queued + status.baking:
                took.append(second)
    return statistics.mean(took) if took else float("nan")


def _pixel_costs_ns(data: DataSet, camera: luxel.Camera) -> tuple[float, float]:
    """What a covered pixel costs in thread time over one of plain Lambert: looking its light up, and noting what it shows so that it is asked for."""
    scene = data.scene("sky+sun")
    world = make_world(scene)
    eye = make_eye(camera, SphereSet.of(data.particles), 1.0)
    seen = visible_ids(scene, camera, _SIZE)
    codes = np.random.default_rng(0).integers(0, 256, (len(seen), 16, 16)).astype(np.uint8)
    count = len(data.particles)
    textures = luxel.LuminanceTextures(seen, codes, 3.0, "sqrt", count, light_key(scene, _SPEC))
    colors, marks = np.ones((count, 3), np.float32), SeenMarks(count, 1)
    total, crew = np.zeros((_SIDE, _SIDE, 5), np.float32), Crew(1)
    plain, lit = make_skin(bare_table(count), colors), make_skin(textures.snapshot(textures.key), colors)
    rivals: tuple[dict[str, Any], ...] = (
        {"skin": plain, "textured": False},
        {"skin": lit},
        {"skin": lit, "seen": marks},
    )
    best = [float("inf")] * 3
    for _ in range(15):
        for k, how in enumerate(rivals):
            marks.clear()
            start = thread_time()
            draw_rays(world.tree, world.lights, eye, (0.5, 0.5), total=total, crew=crew, first=True, **how)
            best[k] = min(best[k], thread_time() - start)
    crew.close()
    covered = int(total[:, :, 4].sum())
    return 1e9 * (best[1] - best[0]) / covered, 1e9 * (best[2] - best[1]) / covered
