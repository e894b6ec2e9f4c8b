"""What `benchmarks.picture --filter` measures: first light, and textures on particles a few pixels wide."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np

import luxel
from benchmarks.scenes import plate, plate_camera
from luxel.kernels.tone import develop
from luxel.light.lights import scene_white
from luxel.light.world import make_world
from luxel.picture.drawing import Crew, draw_rays, make_eye, make_skin
from luxel.picture.raytrace import render
from luxel.scene.colormap import linear_to_srgb, rgb, srgb_to_linear
from luxel.textures.bake import Baker, bake_with
from luxel.textures.spec import TextureSpec
from luxel.textures.textures import FIRST_LIGHT, TextureTable, decoding_table
from luxel.trace.spheres import SphereSet

_LIGHTS = (luxel.Sky(1.0), luxel.Sun((1, 1, 2), level=2.0, angular_diameter=15))


class _Coarse:
    """A source of coarse records alone."""

    def __init__(self, key: str, records: np.ndarray) -> None:
        self.key = key
        slot = np.where(records[:, 0] >= 0, FIRST_LIGHT, -1).astype(np.int32)
        blank = np.zeros((1, 16, 16), np.uint8)
        self._table = TextureTable(slot, blank, decoding_table(1.0, "sqrt"), coarse=records)

    def snapshot(self, key: str) -> TextureTable:
        return self._table

    def sighted(self, ids: np.ndarray, eye: np.ndarray) -> None:
        """Nothing more comes."""


def first_light_rows() -> list[dict[str, Any]]:
    """Differences of first light and of Lambert from the picture with textures, in levels."""
    particles = plate(8000)
    scene, view = luxel.Scene(particles, lights=_LIGHTS), luxel.View(camera=plate_camera(particles))
    baker = Baker(scene, TextureSpec(samples=4, mode="fast"))
    ids = np.arange(len(particles), dtype=np.int32)
    baker.first_light(ids[:4])  # compiles
    start = time.thread_time()
    records = baker.first_light(ids)
    rate = len(ids) / (time.thread_time() - start)
    common = {"size": (300, 200), "antialias": 3, "colorbar": False}
    textured = render(scene, view, **common)
    seen = textured.ids >= 0
    rows = []
    for name, shown in (("first light", records), ("Lambert", np.full_like(records, -1))):
        image = render(scene, view, _Coarse(baker.key, shown), **common)
        difference = image.array[seen][:, :3].astype(float) - textured.array[seen][:, :3]
        mean = {"mean abs levels": float(np.abs(difference).mean()), "mean levels": float(difference.mean())}
        rows.append({"shown": name, **mean, "particles/s a thread": rate if name == "first light" else ""})
    return rows


def filter_rows(quick: bool) -> list[dict[str, Any]]:
    """RMS levels against the converged path-traced picture, without and with the filter, one ray a pixel."""
    particles = plate(5000)
    camera = plate_camera(particles)
    scene, view = luxel.Scene(particles, lights=_LIGHTS), luxel.View(camera=camera)
    distance = np.linalg.norm(np.subtract(camera.eye, camera.target))
    tall = 2 * distance * math.tan(math.radians(camera.fov) / 2) / (2 * 0.55)  # the view, in particles
    ids = np.arange(len(particles), dtype=np.int32)  # no ray of any picture meets one without a texture
    bakes = {
        (mode, samples): bake_with(Baker(scene, TextureSpec(samples=samples, mode=mode)), ids)
        for mode, samples in (("fast", 4), ("paper", 49))
    }
    rows = []
    for width in (2, 4) if quick else (2, 4, 8):
        height = 2 * round(width * tall / 2)
        size = (height * 4 // 3, height)
        truth = render(scene, view, size=size, light="pixel", samples=192, antialias=8, colorbar=False)
        seen = truth.ids >= 0
        for (mode, samples), bake in bakes.items():
            row: dict[str, Any] = {"width": f"{width} px", "textures": f"{mode}, {samples} samples"}
            for name, filtered in (("without", False), ("with", True)):
                levels = _levels(scene, view, size, bake.snapshot(bake.key), filtered)
                difference = levels[seen] - truth.array[seen][:, :3]
                row[name] = float(np.sqrt((difference**2).mean()))
            rows.append(row)
    return rows


def _levels(
    scene: luxel.Scene,
    view: luxel.View,
    size: tuple[int, int],
    table: TextureTable,
    filtered: bool,
) -> np.ndarray:
    """(H, W, 3) levels as `render` makes them, not rounded; one ray a pixel, with or without the filter."""
    width, height = size
    eye = make_eye(view.camera_for(scene.particles, size), SphereSet.of(scene.particles), width / height)
    total, picture = np.zeros((height, width, 5), np.float32), np.empty((height, width, 3), np.float32)
    colors = view.colors(scene.particles)
    world, crew = make_world(scene), Crew()
    spacing = 1.0 if filtered else 0.0
    draw_rays(
        world.tree, world.lights, eye, (0.5, 0.5), make_skin(table, colors), total, crew, spacing=spacing
    )
    crew.close()
    background = srgb_to_linear(rgb(view.background)).astype(np.float32)
    white = np.float32(scene_white(scene))
    develop(total, 1, np.float32(view.exposure), white, background, picture)
    return linear_to_srgb(picture) * 255
