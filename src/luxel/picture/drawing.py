"""One ray a pixel at a time, on several threads: what `render` and `Frames` draw with."""

from __future__ import annotations

import contextlib
import math
import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache

import numpy as np
from numpy.typing import NDArray

from luxel.errors import InputError
from luxel.kernels import folded, frame, frustum, tiles
from luxel.kernels.light import Lights
from luxel.kernels.lookup import opened_words
from luxel.kernels.path import World
from luxel.kernels.tone import SRGB_CELLS, Tone
from luxel.kernels.tree import Tree
from luxel.light.in_view import Gaze
from luxel.light.lights import scene_white
from luxel.light.mapping import mapping_code
from luxel.picture.seen import SeenMarks
from luxel.scene.camera import Camera
from luxel.scene.colormap import linear_to_srgb, rgb, srgb_to_linear
from luxel.scene.scene import Scene
from luxel.scene.view import View
from luxel.textures.textures import TextureTable, decoding_table
from luxel.trace.spheres import SphereSet
from luxel.trace.tree import SphereTree, run_parts, thread_count

__all__ = [
    "NONE_BLANK",
    "NO_NEAREST",
    "NO_PICTURE",
    "NO_SUMS",
    "Crew",
    "Nearest",
    "bare_table",
    "blank_tiles",
    "checked_size",
    "draw_folded",
    "draw_rays",
    "id_at",
    "make_eye",
    "make_gaze",
    "make_skin",
    "make_tone",
    "part_of",
    "ray_shifts",
    "seen_tree",
    "trace_primary",
]

NONE_BLANK: NDArray[np.uint8] = np.empty((0, 0), np.uint8)
#: Distance (H, W) float32 and ids (H, W) int32 of what each pixel shows.
Nearest = tuple[NDArray[np.float32], NDArray[np.int32]]
NO_NEAREST: Nearest = np.empty((0, 0), np.float32), np.empty((0, 0), np.int32)
NO_PICTURE: NDArray[np.uint8] = np.empty((0, 0, 3), np.uint8)
NO_SUMS: NDArray[np.float32] = np.empty((0, 0, 5), np.float32)

_FAR_AWAY = 1e4  # in normalised units, of which a scene has about two
_NO_MARKS = (np.empty(0, np.int64),) * 3
_BAND = 4 * tiles.TILE  # rows a task
_MOST_PIXELS = 2**28
_LARGEST_EDGE, _BLOCKS_A_THREAD = frame.BLOCK // tiles.TILE, 16


class Crew:
    """Threads that do one thing together, again and again; the caller is one of them.

    Safe to use from several threads, which then share the helpers.

    Parameters
    ----------
    threads
        The caller's included; None means all that the process may use.
    """

    def __init__(self, threads: int | None = None) -> None:
        self.threads = thread_count(threads)
        self._pool: ThreadPoolExecutor | None = None
        self._lock = threading.Lock()
        self._benches: deque[tuple[tuple[int, int, int], frame.Bench]] = deque(maxlen=self.threads)

    def run(self, work: Callable[[], object], first: Callable[[], object] | None = None) -> None:
        """Call `work` on every thread at once and wait for all; re-raises an error. The caller's begins with `first`."""
        if self.threads == 1:
            if first is not None:
                first()
            work()
            return
        # A helper that has no time before all is done is called off, but stays in the pool's queue for a while. It must not
        # keep what `work` holds: a table of textures that is held is not brought up to date.
        jobs = [work]

        def help_out() -> None:
            for job in jobs:
                job()

        with self._lock:
            if self._pool is None:
                self._pool = ThreadPoolExecutor(self.threads - 1, "luxel-draw")
            others = [self._pool.submit(help_out) for _ in range(self.threads - 1)]
        try:
            if first is not None:
                first()
            work()
        finally:
            begun = [other for other in others if not other.cancel()]
            wait(begun)  # after an error, too: they write what the caller's next work does
            jobs.clear()
        for other in begun:
            other.result()

    @contextlib.contextmanager
    def bench(self, stack_size: int, words: int, rays: int = 0) -> Iterator[frame.Bench]:
        """Lend one of the working memories that are kept, for trees of such a depth, textures of so many words when opened, and so many rays a pixel at once."""
        sizes = stack_size, words, rays
        try:
            found, bench = self._benches.pop()
        except IndexError:
            found = (-1, -1, -1)
        if found != sizes:
            bench = frame.make_bench(*sizes)
        try:
            yield bench
        finally:
            self._benches.append((sizes, bench))

    def close(self) -> None:
        """End the threads; a later :meth:`run` starts new ones."""
        with self._lock:
            pool, self._pool = self._pool, None
        if pool is not None:
            pool.shutdown(wait=True)


def draw_rays(
    tree: Tree,
    lights: Lights,
    eye: frustum.Eye,
    shift: tuple[float, float],
    skin: frame.Skin,
    total: NDArray[np.float32],
    crew: Crew,
    *,
    spacing: float = 0.0,
    textured: bool = True,
    shadows: bool = False,
    first: bool = False,
    blank: NDArray[np.uint8] = NONE_BLANK,
    seen: SeenMarks | None = None,
    nearest: Nearest = NO_NEAREST,
    rays: int = 1,
    tone: Tone | None = None,
    picture: NDArray[np.uint8] = NO_PICTURE,
    meanwhile: Callable[[], object] | None = None,
) -> None:
    """Send one ray through every pixel, see :func:`luxel.kernels.frame.draw_frame`.

    What is hit is marked and tallied in `seen`, which has a row for each thread of the crew. `meanwhile` is called while others draw.
    """
    counter = np.zeros(1, np.int64)
    edge = _block_edge(total.shape[1], total.shape[0], crew.threads)
    if tone is None:
        tone = _untoned()
    x, y = np.float32(shift[0]), np.float32(shift[1])
    rows = iter(range(crew.threads))
    if seen is not None:
        seen.begin()

    def work() -> None:
        marks = _NO_MARKS if seen is None else seen.of_thread(next(rows))
        with crew.bench(tree.stack_size, opened_words(skin.texels)) as bench:
            frame.draw_frame(
                tree, lights, eye, x, y, np.float32(spacing), textured, shadows, first, skin, *marks, total, blank,
                *nearest, rays, tone, picture, bench, counter, edge
            )  # fmt: skip

    crew.run(work, meanwhile)


def draw_folded(
    tree: Tree,
    lights: Lights,
    eye: frustum.Eye,
    antialias: int,
    skin: frame.Skin,
    crew: Crew,
    *,
    total: NDArray[np.float32] = NO_SUMS,
    corner: tuple[float, float] = (0.0, 0.0),
    tone: Tone | None = None,
    picture: NDArray[np.uint8] = NO_PICTURE,
    nearest: Nearest = NO_NEAREST,
) -> None:
    """Send the rays of :func:`ray_shifts` through every pixel at once, see :func:`luxel.kernels.folded.draw_folded`.

    As many calls of :func:`draw_rays` without a filter give the same sums, but where a ray meets two spheres at the very same distance: either may be seen.

    Parameters
    ----------
    total
        (H, W, 5) zeros that become sums; none, for the picture alone.
    corner
        Added to the place of rays in their pixels, see :func:`part_of`.
    tone, picture
        The sums are developed by the one into the other, (H, W, 3), if there is one.
    nearest
        Written, if there is room: what pixels show at their centres; with an odd `antialias` only.
    """
    counter = np.zeros(1, np.int64)
    height, width = (total if len(total) else picture).shape[:2]
    edge, blank = _block_edge(width, height, crew.threads), blank_tiles(width, height)
    places = [(k + 0.5) / antialias for k in range(antialias)]
    x, y = (np.array([first + place for place in places], np.float32) for first in corner)
    order = np.empty(antialias**2, np.int32)
    for k, shift in enumerate(ray_shifts(antialias)):
        order[places.index(shift[1]) * antialias + places.index(shift[0])] = k
    if tone is None:
        tone = _untoned()

    def work() -> None:
        with crew.bench(tree.stack_size, opened_words(skin.texels), antialias**2) as bench:
            folded.draw_folded(
                tree, lights, eye, x, y, order, skin, total, blank, *nearest, tone, picture, bench, counter, edge
            )  # fmt: skip

    crew.run(work)


def blank_tiles(width: int, height: int) -> NDArray[np.uint8]:
    """Return what :func:`draw_rays` takes as ``blank`` with sums of zeros."""
    return np.ones((-(-height // tiles.TILE), -(-width // tiles.TILE)), np.uint8)


def _block_edge(width: int, height: int, threads: int) -> int:
    """Tiles along the side of a block: many are traced faster together, but all threads should be done at the same time."""
    tiles_each = width * height / (tiles.TILE**2 * threads)
    return min(_LARGEST_EDGE, max(1, math.isqrt(int(tiles_each / _BLOCKS_A_THREAD))))


def make_eye(camera: Camera, spheres: SphereSet, aspect: float) -> frustum.Eye:
    """Return the camera as kernels take it; `aspect` is width over height."""
    right, up, forward = camera.basis()
    half = math.tan(math.radians(camera.fov) / 2)
    if camera.height is not None:
        half = 0.5 * spheres.length_to_unit(camera.height)
    return frustum.Eye(
        spheres.to_unit(camera.eye).astype(np.float32),
        (right * half * aspect).astype(np.float32),
        (up * half).astype(np.float32),
        forward.astype(np.float32),
        camera.orthographic,
    )


def make_gaze(eye: frustum.Eye, visible: NDArray[np.int32], count: int) -> Gaze:
    """Return who looks at a picture in which those `visible` of `count` particles are."""
    at = eye.origin.astype(np.float64)
    if eye.orthographic:
        at = at - _FAR_AWAY * eye.forward
    shown = np.zeros(count, np.uint8)
    shown[visible] = 1
    return Gaze(at.astype(np.float32).reshape(1, 3), shown)


def part_of(
    eye: frustum.Eye, size: tuple[int, int], corner: tuple[int, int], part: tuple[int, int]
) -> tuple[frustum.Eye, tuple[float, float]]:
    """Return an eye that sees a part of a picture as a picture of its own, and what is added to the place of its rays in their pixels.

    Parameters
    ----------
    size
        Width and height of the whole picture that `eye` sees.
    corner, part
        Column and row of the part's upper left pixel, and its width and height.
    """
    shares = [np.float32(some / whole) for some, whole in zip(part, size, strict=True)]
    shift = tuple(first - (whole - some) / 2 for first, whole, some in zip(corner, size, part, strict=True))
    return eye._replace(right=eye.right * shares[0], up=eye.up * shares[1]), (shift[0], shift[1])


def id_at(tree: Tree, eye: frustum.Eye, size: tuple[int, int], place: tuple[float, float]) -> int:
    """Return the particle that the middle of a pixel shows, -1 for none; `place` is from the left and from the top, in [0, 1]."""
    column, row = (min(int(at * extent), extent - 1) for at, extent in zip(place, size, strict=True))
    part, (x, y) = part_of(eye, size, (column, row), (1, 1))
    distance, ids = np.empty((1, 1), np.float32), np.empty((1, 1), np.int32)
    tiles.primary_tiles(tree, part, 1, 1, np.float32(x + 0.5), np.float32(y + 0.5), 0, 1, distance, ids)
    return int(ids[0, 0])


def make_skin(table: TextureTable, colors: NDArray[np.float32]) -> frame.Skin:
    """Return what kernels need to know of the particles' looks; `colors` is (N, 3) float32 linear."""
    return frame.Skin(
        table.slot,
        table.codes,
        _decoding_law(table.decoding),
        table.coarse,
        colors,
        mapping_code(table.mapping),
    )


def _decoding_law(decoding: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return (2, 2) factors of code and code squared in the luminance of codes, for each half of a decoding table."""
    halves = []
    for start in (0, len(decoding) - 256):
        first, last = float(decoding[start + 1]), float(decoding[start + 255])
        square = (last / 255 - first) / 254
        halves.append((first - square, square))
    return np.array(halves, np.float32)


def make_tone(scene: Scene, view: View, grading: tuple[float, float] | None = None) -> Tone:
    """Return how sums become pixels.

    Parameters
    ----------
    grading
        Factors on the background's linear colour at the top and at the bottom of the picture; None means the same everywhere.
    """
    cells, steps = _srgb_tables()
    background = srgb_to_linear(rgb(view.background))
    top, bottom = (
        np.minimum(factor * background, 1.0).astype(np.float32) for factor in grading or (1.0, 1.0)
    )
    return Tone(np.float32(view.exposure), np.float32(scene_white(scene)), top, bottom, cells, steps)


def bare_table(count: int) -> TextureTable:
    """Return a table without any texture: all of `count` particles are Lambert."""
    none = np.full(count, -1, np.int32)
    return TextureTable(none, np.zeros((1, 16, 16), np.uint8), decoding_table(1.0, "linear"))


def seen_tree(scene: Scene, view: View) -> SphereTree:
    """Return the tree that a picture's own rays meet: what scene or view hide is not there."""
    hidden = view.hidden(scene.particles)
    if hidden is None:
        hidden = scene.hidden
    elif scene.hidden is not None:
        hidden = hidden | scene.hidden
    return SphereTree.of(SphereSet.of(scene.particles), hidden)


def ray_shifts(antialias: int) -> list[tuple[float, float]]:
    """Where in its pixel each of antialias² rays goes through.

    The first half, rounded up, is every other place of the grid, as on a chessboard: balanced about the pixel's centre, and a
    good picture by itself.
    """
    places = [(k % antialias, k // antialias) for k in range(antialias * antialias)]
    places.sort(key=lambda place: (place[0] + place[1]) % 2)  # stable
    return [((x + 0.5) / antialias, (y + 0.5) / antialias) for x, y in places]


def trace_primary(
    world: World, eye: frustum.Eye, width: int, height: int, shift: tuple[float, float], threads: int
) -> Nearest:
    """Return distance (H, W) float32 in normalised units and ids (H, W) int32; infinite and -1 on the background."""
    distance, ids = np.empty((height, width), np.float32), np.empty((height, width), np.int32)

    def band(row: int) -> None:
        tiles.primary_tiles(
            world.tree,
            eye,
            width,
            height,
            np.float32(shift[0]),
            np.float32(shift[1]),
            row,
            min(row + _BAND, height),
            distance,
            ids,
        )

    run_parts(band, range(0, height, _BAND), threads)
    return distance, ids


@cache
def _untoned() -> Tone:
    """Return a tone for frames that are not developed."""
    black = np.zeros(3, np.float32)
    return Tone(np.float32(1), np.float32(1), black, black, *_srgb_tables())


@cache
def _srgb_tables() -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Return, for ``kernels.tone``, the sRGB level at the start of each cell and the least linear value of each level."""
    levels = np.arange(1, 256)
    low, high = np.zeros(255, np.int32), np.full(255, np.float32(1).view(np.int32))
    while (low < high).any():  # by halves, over the bit patterns of floats, which are ordered as they are
        middle = low + (high - low) // 2
        reached = srgb_levels(middle.view(np.float32)) >= levels
        low, high = np.where(reached, low, middle + 1), np.where(reached, middle, high)
    steps = np.concatenate([[0.0], high.astype(np.int32).view(np.float32), [np.inf]]).astype(np.float32)
    return srgb_levels(np.arange(SRGB_CELLS + 1, dtype=np.float32) / np.float32(SRGB_CELLS)), steps


def srgb_levels(linear: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Nearest of 256 sRGB levels of linear light in [0, 1], float32."""
    return np.asarray(linear_to_srgb(linear) * 255 + 0.5).astype(np.uint8)


def checked_size(size: tuple[int, int]) -> tuple[int, int]:
    """Return width and height as whole numbers.

    Raises
    ------
    InputError
        If they are none, or out of range.
    """
    try:
        width, height = (int(v) for v in size)
    except (TypeError, ValueError):
        raise InputError(f"size must be (width, height), got {size!r}") from None
    if width < 1 or height < 1 or width * height > _MOST_PIXELS:
        raise InputError(
            f"size must be at least 1x1 and at most {_MOST_PIXELS} pixels in all, got {width}x{height}"
        )
    return width, height
