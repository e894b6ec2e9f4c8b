"""Pictures by ray tracing: luminance textures on visible particles, or every pixel path-traced."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from luxel.errors import InputError
from luxel.kernels import frustum, shade, tiles
from luxel.kernels.path import World
from luxel.kernels.tone import Tone, develop_rows
from luxel.light.mapping import Mapping
from luxel.light.world import make_world
from luxel.particles import Particles
from luxel.picture.drawing import (
    NO_NEAREST,
    NONE_BLANK,
    Crew,
    Nearest,
    bare_table,
    blank_tiles,
    checked_size,
    draw_folded,
    draw_rays,
    make_eye,
    make_gaze,
    make_skin,
    make_tone,
    ray_shifts,
    seen_tree,
    trace_primary,
)
from luxel.picture.image import Image
from luxel.scene.camera import Camera
from luxel.scene.from_arrays import looked_at
from luxel.scene.scene import Scene
from luxel.scene.view import View
from luxel.textures.bake import Baker, bake_with
from luxel.textures.spec import Mode, TextureSpec, light_key
from luxel.textures.textures import TextureSource, TextureTable
from luxel.trace.spheres import SphereSet
from luxel.trace.tree import run_parts, thread_count

__all__ = ["render", "shown_ids", "visible_ids"]

Progress = Callable[[int, int], None]
_CENTRE = (0.5, 0.5)
Light = Literal["texture", "pixel"]


def render(
    scene: Scene | Particles | ArrayLike,
    view: View | None = None,
    textures: TextureSource | None = None,
    size: tuple[int, int] = (1280, 720),
    *,
    radii: ArrayLike | None = None,
    colors: ArrayLike | str | None = None,
    color_by: ArrayLike | str | None = None,
    light: Light = "texture",
    samples: int | None = None,
    mode: Mode = "fast",
    mapping: Mapping = "latlong",
    antialias: int = 3,
    threads: int | None = None,
    seed: int = 0,
    colorbar: bool = True,
    key: str | None = None,
    progress: Progress | None = None,
) -> Image:
    """Draw a picture.

    Parameters
    ----------
    scene, view
        What to draw and how; the default view frames the data. What either hides is not drawn. Particles, or a plain
        (N, 3) array of positions, get the default lights.
    textures
        A bake or another source of textures; particles that it has none for show their coarse record, or are
        Lambert. None bakes the textures of the visible particles first.
    size
        Width and height in pixels.
    radii, colors, color_by
        Of an array of positions: radii (N,) or one number; sRGB colours (N, 3), whole numbers 0..255 or others 0..1,
        which light makes brighter or darker without changing their hue; or values (N,) to be shown in the view's
        colour map. With a scene, `color_by` is the name of a scalar.
    light
        ``"texture"``: look luminance textures up. ``"pixel"``: path trace every pixel; the truth to compare with.
    samples
        Of light: a texel (default 6, of what the picture shows; in paper mode a square number, default 49) or a pixel (default 64).
    mode, mapping, seed
        Of the textures that are baked here, see :class:`luxel.TextureSpec`.
    antialias
        Rays along each side of a pixel: 1 for none, 3 for nine rays a pixel.
    threads
        None means all that the process may use; never changes the picture.
    colorbar
        Draw the colour bar, when the view colours by a scalar.
    key
        The light key to ask `textures` for; by default their own.
    progress
        Called as ``progress(done, total)``.

    Returns
    -------
    Image
        With ``ids`` and ``depth`` of the pixel centres.

    Raises
    ------
    InputError
        For a size, light or sample count out of range, and arrays of wrong shape.
    """
    subject, view = looked_at(scene, view, radii=radii, colors=colors, color_by=color_by)
    scene = subject if isinstance(subject, Scene) else Scene(subject)
    view = view or View()
    width, height = checked_size(size)
    if light not in ("texture", "pixel"):
        raise InputError(f"light must be texture or pixel, got {light!r}")
    if not 1 <= antialias <= 16:
        raise InputError(f"antialias must be 1..16 rays along a pixel, got {antialias}")
    workers = thread_count(threads)
    camera = view.camera_for(scene.particles, (width, height))
    world = make_world(scene, seed=seed)
    seen = world._replace(tree=seen_tree(scene, view).arrays)
    eye = make_eye(camera, SphereSet.of(scene.particles), width / height)
    colors = view.colors(scene.particles)
    pixels = np.empty((height, width, 3), np.uint8)
    shifts, tone = ray_shifts(antialias), make_tone(scene, view)
    nearest = None
    if light == "pixel":
        spp = 64 if samples is None else samples
        if spp < 1:
            raise InputError(f"samples must be at least 1, got {samples}")
        total = np.zeros((height, width, 5), np.float32)
        _draw_pixels(world, seen, eye, shifts, -(-spp // len(shifts)), colors, total, workers, progress)
        develop_rows(total, NONE_BLANK, len(shifts), tone, 0, height, pixels)
    else:
        spec = TextureSpec.usual(
            mode,
            samples,
            purpose="picture",
            seed=seed,
            mapping=mapping,
        )
        table = _table(scene, eye, size, shifts, textures, key, spec, workers, progress, seen)
        nearest = draw_textures(seen, eye, antialias, table, colors, workers, tone=tone, picture=pixels)
    distance, ids = nearest or trace_primary(seen, eye, width, height, _CENTRE, workers)
    if colorbar and view.color_by is not None:
        from luxel.picture.colorbar import draw_colorbar

        pixels = draw_colorbar(pixels, view, scene.particles)
    distance *= np.float32(SphereSet.of(scene.particles).unit)
    return Image(pixels, ids, distance)


def visible_ids(
    scene: Scene, camera: Camera, size: tuple[int, int], *, antialias: int = 1, threads: int | None = None
) -> NDArray[np.int32]:
    """Return the sorted ids (M,) int32 of particles that some ray of the picture hits first."""
    width, height = checked_size(size)
    eye = make_eye(camera, SphereSet.of(scene.particles), width / height)
    return _visible(make_world(scene), eye, width, height, ray_shifts(antialias), thread_count(threads))


def shown_ids(
    scene: Scene, view: View, size: tuple[int, int], *, antialias: int = 3, threads: int | None = None
) -> NDArray[np.int32]:
    """Return the sorted ids (M,) int32 of particles that :func:`render` shows: those whose textures a picture needs."""
    width, height = checked_size(size)
    camera = view.camera_for(scene.particles, (width, height))
    eye = make_eye(camera, SphereSet.of(scene.particles), width / height)
    seen = make_world(scene)._replace(tree=seen_tree(scene, view).arrays)
    return _visible(seen, eye, width, height, ray_shifts(antialias), thread_count(threads))


def draw_textures(
    world: World,
    eye: frustum.Eye,
    antialias: int,
    table: TextureTable,
    colors: NDArray[np.float32],
    threads: int,
    *,
    tone: Tone,
    picture: NDArray[np.uint8],
) -> Nearest | None:
    """Send `antialias`² textured rays through every pixel of `picture` (H, W, 3); see ``kernels.frame``.

    With one ray a pixel, textures are filtered over the pixel; several rays filter by themselves. Returns what the pixels' centres show, if a ray goes through them.
    """
    height, width = picture.shape[:2]
    crew, skin = Crew(threads), make_skin(table, colors)
    nearest = NO_NEAREST
    if antialias % 2:
        nearest = np.empty((height, width), np.float32), np.empty((height, width), np.int32)
    to: dict[str, Any] = {"nearest": nearest, "tone": tone, "picture": picture}
    try:
        if antialias > 1:
            draw_folded(world.tree, world.lights, eye, antialias, skin, crew, **to)
        else:
            total, blank = np.zeros((height, width, 5), np.float32), blank_tiles(width, height)
            draw_rays(
                world.tree, world.lights, eye, _CENTRE, skin, total, crew, spacing=1.0, blank=blank, **to
            )
    finally:
        crew.close()
    return nearest if antialias % 2 else None


def _draw_pixels(
    world: World,
    seen: World,
    eye: frustum.Eye,
    shifts: list[tuple[float, float]],
    samples: int,
    colors: NDArray[np.float32],
    total: NDArray[np.float32],
    threads: int,
    progress: Progress | None,
) -> None:
    height, width = total.shape[:2]
    lock = threading.Lock()
    done = 0
    for k, shift in enumerate(shifts):
        distance, ids = trace_primary(seen, eye, width, height, shift, threads)
        x, y = np.float32(shift[0]), np.float32(shift[1])

        def band(
            row: int,
            k: int = k,
            x: np.float32 = x,
            y: np.float32 = y,
            hits: tuple[NDArray[np.float32], NDArray[np.int32]] = (distance, ids),
        ) -> None:
            nonlocal done
            last = min(row + tiles.TILE, height)
            shade.shade_pixels(world, eye, x, y, row, last, *hits, samples, k * samples, colors, total)
            with lock:
                done += last - row
                if progress is not None:
                    progress(done, height * len(shifts))

        run_parts(band, range(0, height, tiles.TILE), threads)


def _table(
    scene: Scene,
    eye: frustum.Eye,
    size: tuple[int, int],
    shifts: list[tuple[float, float]],
    textures: TextureSource | None,
    key: str | None,
    spec: TextureSpec,
    threads: int,
    progress: Progress | None,
    world: World,
) -> TextureTable:
    count = len(scene.particles)
    if textures is not None:
        if key is None:
            key = textures.key
        table = textures.snapshot(key)
        if len(table.slot) != count:
            raise InputError(f"the textures are of {len(table.slot)} particles, the scene has {count}")
        return table
    if scene.model == "lambertian":
        return bare_table(count)
    visible = _visible(world, eye, *size, shifts, threads)
    baked = bake_with(
        Baker(scene, spec), visible, progress=progress, threads=threads, gaze=make_gaze(eye, visible, count)
    )
    return baked.snapshot(light_key(scene, spec))


def _visible(
    world: World, eye: frustum.Eye, width: int, height: int, shifts: list[tuple[float, float]], threads: int
) -> NDArray[np.int32]:
    seen = np.zeros(len(world.radii) + 1, np.bool_)
    for shift in shifts:
        seen[trace_primary(world, eye, width, height, shift, threads)[1]] = (
            True  # -1 marks the spare last entry
        )
    return np.flatnonzero(seen[:-1]).astype(np.int32)
