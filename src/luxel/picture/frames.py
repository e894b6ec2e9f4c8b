"""Frames: pictures one after another that never wait for light (paper 4.2, figure 6)."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from types import TracebackType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from luxel.errors import InputError
from luxel.kernels.tone import develop_rows
from luxel.light.lights import pack_lights
from luxel.particles import Particles
from luxel.picture.drawing import (
    NO_PICTURE,
    Crew,
    bare_table,
    checked_size,
    draw_rays,
    id_at,
    make_eye,
    make_skin,
    make_tone,
    ray_shifts,
    seen_tree,
)
from luxel.picture.image import Image
from luxel.picture.lit import Bare, Lit, Still, lit_now
from luxel.picture.passes import Pass, Passes
from luxel.picture.sight import Sight
from luxel.scene.camera import Camera
from luxel.scene.scene import Scene
from luxel.scene.view import View
from luxel.textures.textures import TextureSource, TextureTable
from luxel.trace.spheres import SphereSet

__all__ = ["Frame", "Frames"]

Shading = Literal["textures", "lambertian", "shadows"]

_SHADINGS = ("textures", "lambertian", "shadows")
_PAUSE_S = 0.1  # between looks for new light, where nobody tells of it
# At rest, what computes light gets so many times what drawing takes, up to a second, as long as light has come within so many seconds.
_LIGHT_SHARE, _LONGEST_PAUSE_S, _LIGHT_COMES_S = 6.0, 1.0, 0.5
_FEW_THREADS = 4  # with so many, each takes pieces of work of its own
_OWN_REFERENCES = 3  # the list's, the loop's, the call's
_NOT_COLORS = frozenset({"camera", "hide", "exposure", "background", "up"})

# What tells what the last frame saw, and of which particles.
_Owed = tuple[Particles | None, Callable[[], None] | None]
_NOTHING_OWED: _Owed = (None, None)


@dataclass(frozen=True, eq=False)
class Frame:
    """One picture of a :class:`Frames`.

    Parameters
    ----------
    pixels
        (H, W, 3) uint8 sRGB. Never written again while anybody holds it.
    rays
        Rays a pixel.
    visible, ready, dim, stale
        Particles seen since the camera moved last, and how many of them showed a texture, first light, and a texture of the light before,
        when it was drawn.
    final
        The camera rests, the picture is antialiased, and no better light will come: the next frame would be the same.
    """

    pixels: NDArray[np.uint8]
    rays: int
    visible: int
    ready: int
    dim: int
    stale: int
    final: bool

    def image(self) -> Image:
        """Return it as an image that can be saved."""
        return Image(self.pixels)


class Frames:
    """Pictures of a session, one after another.

    Each :meth:`draw` sends one ray through every pixel, shades what it hits with the textures that are ready now, else
    with first light, else as Lambert, and tells the source what was seen. While the camera moves, that is the
    picture; what it shows is told while the next frame is drawn. Once it rests, rays add up to an antialiased picture that is, when all light is there, the one that
    :func:`luxel.render` makes of the same textures, byte for byte.

    Iterating draws until the picture is final::

        for frame in luxel.Frames(session, view, (640, 480)):
            show(frame.pixels)

    Light is computed by threads of the session's own, or on the drawing threads after each frame, for `bake_budget_s`
    seconds (paper figure 7), or by both.

    Parameters
    ----------
    target
        A :class:`luxel.Session`, a :class:`luxel.Scene`, or any :class:`Lit`.
    view, size
        Camera, colours and tone; width and height in pixels. Both may be set between frames. None frames the data.
    textures
        With a scene: a bake of it.
    shading
        ``"textures"``; or a baseline that looks nothing up and asks for nothing: ``"lambertian"``, or ``"shadows"``,
        Lambert with a shadow ray from each pixel to the middle of each light.
    shadows
        Whether what has neither texture nor first light yet gets such shadow rays too.
    antialias
        Rays along each side of a pixel once the camera rests.
    filtered
        Filter textures over the pixel where there is one ray a pixel.
    threads
        Drawing threads; None means all that the process may use.
    bake_budget_s
        Seconds that each drawing thread bakes for after each frame; 0 leaves all to the session's threads.
    crew
        Drawing threads to share with others, instead of `threads`.
    grading
        See :func:`luxel.picture.drawing.make_tone`.
    clock
        Seconds, never going backwards.

    Raises
    ------
    InputError
        For values out of range.

    Notes
    -----
    Not safe to use from several threads at once.
    """

    def __init__(
        self,
        target: Lit | Scene,
        view: View | None = None,
        size: tuple[int, int] = (1280, 720),
        *,
        textures: TextureSource | None = None,
        shading: Shading = "textures",
        shadows: bool = False,
        antialias: int = 3,
        filtered: bool = True,
        threads: int | None = None,
        bake_budget_s: float = 0.0,
        crew: Crew | None = None,
        grading: tuple[float, float] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        if isinstance(target, Scene):
            target = Still(target, Bare(len(target.particles)) if textures is None else textures)
        elif textures is not None:
            raise InputError("textures were given with a session, which has its own — give its scene instead")
        if shading not in _SHADINGS:
            raise InputError(f"shading must be one of {', '.join(_SHADINGS)}, got {shading!r}")
        if not 1 <= antialias <= 16:
            raise InputError(f"antialias must be 1..16 rays along a pixel, got {antialias}")
        if not 0 <= bake_budget_s < 60:
            raise InputError(f"bake_budget_s must be seconds in [0, 60), got {bake_budget_s!r}")
        self.target = target
        self.view = view or View()
        self.size = size
        self.shading: Shading = shading
        self.shadows = shadows
        self.filtered = filtered
        self.bake_budget_s = bake_budget_s
        self.grading = grading
        self._crew, self._owns_crew = (Crew(threads), True) if crew is None else (crew, False)
        self._clock = clock
        self._shifts = ray_shifts(antialias)
        self._news = threading.Event()
        self._made_of: dict[str, Any] = {}  # what each of the following parts was made of
        self._lights: Any = None
        self._tree: Any = None
        self._eye: Any = None
        self._place: NDArray[np.float64] = np.zeros(3)  # where the eye is, in file units
        self._tone: Any = None
        self._colors: NDArray[np.float32] = np.empty((0, 3), np.float32)
        self._bare: TextureTable | None = None
        self._sight = Sight(self._crew.threads)
        self._passes = Passes(antialias**2)
        self._before = ""  # key of the light that is shown where there is none yet
        self._lit_by: tuple[str, Particles | None] = ("", None)
        self._owed: _Owed = _NOTHING_OWED
        self._flies = False  # the camera moved before the last frame
        self._light_came_s = -np.inf
        self._pause_s = 0.0
        self._pictures: list[NDArray[np.uint8]] = []
        self._frame: Frame | None = None
        self._drew = False
        self._rested = False  # the last time there was nothing to draw

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self._size

    @size.setter
    def size(self, size: tuple[int, int]) -> None:
        self._size = checked_size(size)

    @property
    def camera(self) -> Camera:
        """The view's camera, or the one that frames the data."""
        return self.view.camera_for(self.target.scene.particles, self.size)

    @property
    def threads(self) -> int:
        """Drawing threads."""
        return self._crew.threads

    def draw(self, view: View | None = None) -> Frame:
        """Draw the next frame, of another `view` if one is given; then bake for `bake_budget_s`.

        Where nothing has changed and nothing can get better, the last frame is returned again.

        Raises
        ------
        ScalarError
            If the particles lack the scalar that the view colours by.
        InputError
            If the textures are of other particles.
        """
        if view is not None:
            self.view = view
        begun_s = self._clock()
        # Before the light is looked at. It is asked only when nothing else is left to do: counting is work, and frames leave that to others.
        waiting = not self._rested or self._waiting()
        scene, source, now = self._look()
        before = self._light_before(scene, source)
        table = now if before is None else now.with_stale(before)
        try:
            moved, changed, toned = self._prepare(scene, source.key)
        except BaseException:
            self._made_of.clear()  # what has moved has not been drawn
            raise
        sight, looks = self._sight, self.shading == "textures"
        light_came = looks and not moved and sight.changes(table)
        if moved or (sight.count and not looks):
            sight.forget(len(scene.particles))
        elif light_came:
            changed = True
        (seen_of, owed), self._owed = self._owed, _NOTHING_OWED
        if seen_of is not scene.particles:
            owed = None  # they have other numbers now
        told = sight.is_told(source)
        drawn = self._passes.next(self.size, moved=moved, changed=changed)
        self._rested = drawn is None
        picture = None
        if drawn is not None:
            try:
                picture = self._add_ray(drawn, table, owed)
            except BaseException:
                self._made_of.clear()  # whatever is there is no whole picture
                raise
        elif owed is not None:
            owed()
        if looks and (drawn is not None or changed):
            sight.gather(table)
        if moved and self._flies:
            # There is a next frame, and it will not see the same: others can draw it while this is told and taken in.
            then = self.target.take_in if self.bake_budget_s > 0 else None
            self._owed = scene.particles, sight.telling(source, self._place, then)
        elif self.target.scene.particles is scene.particles:  # no other thread has brought others
            sight.tell(source, self._place, self._clock())
        self._flies = moved
        if picture is None and (toned or self._frame is None):
            picture = self._developed()
        rests = told and drawn is None and not waiting
        if rests:
            self._before = ""  # nothing better comes: what is still shown under another light goes without
        self._keep(picture, final=rests and not sight.lit[2])
        self._pause_s = self._pause_after(begun_s, light_came=light_came)
        if self.bake_budget_s > 0:
            self._bake_for_a_while()
        assert self._frame is not None
        return self._frame

    def _pause_after(self, begun_s: float, *, light_came: bool) -> float:
        """Return how long to leave the processors to those who compute light, after a frame that was begun then."""
        now_s = self._clock()
        if light_came:
            self._light_came_s = now_s
        grows = self._passes.shown is not None and not self._passes.shown.moving
        if not (grows and self._drew and now_s - self._light_came_s < _LIGHT_COMES_S):
            return 0.0
        return min(_LONGEST_PAUSE_S, _LIGHT_SHARE * (now_s - begun_s))

    def _bake_for_a_while(self) -> None:
        """Spend the budget. A few threads each take pieces of their own, which hides what taking costs; many would queue for it."""
        if self._crew.threads <= _FEW_THREADS:
            end_s = self._clock() + self.bake_budget_s
            self._crew.run(lambda: self.target.run_for(end_s - self._clock()))  # until all are to be done
        else:
            self.target.run_for(self.bake_budget_s, self._crew)

    def __iter__(self) -> Iterator[Frame]:
        """Yield a frame each time that the picture or the light changes, up to the final one.

        With a session that nobody bakes for there is no final one.
        """
        leave = self._listen()
        try:
            last: Frame | None = None
            while True:
                self._news.clear()
                frame = self.draw()
                view = self.view
                if frame is not last:
                    yield frame
                elif not self._drew and not self.bake_budget_s:
                    self._news.wait(_PAUSE_S)
                if frame.final:
                    return
                last = frame
                if view is self.view and not self.bake_budget_s:
                    time.sleep(self._pause_s)
        finally:
            leave()

    @property
    def drawing(self) -> bool:
        """Whether the last :meth:`draw` sent rays, so that the next may show more without any news."""
        return self._drew

    @property
    def pause_s(self) -> float:
        """Seconds by which to put off the next :meth:`draw` of a camera at rest, so that light that is under way comes soon; 0 if none is."""
        return self._pause_s

    def id_at(self, x: float, y: float) -> int:
        """Return the particle at a point of the picture that was drawn last, -1 for none.

        `x` and `y` run over [0, 1] from the left and from the top.

        Raises
        ------
        InputError
            Before the first picture.
        """
        if self._tree is None or self._eye is None:
            raise InputError("nothing has been drawn yet, so nothing is at any point")
        return id_at(self._tree, self._eye, self.size, (x, y))

    def restart(self) -> None:
        """Have the next frame drawn as if the camera had just moved."""
        self._made_of.pop("eye", None)

    def close(self) -> None:
        """End the drawing threads."""
        if self._owns_crew:
            self._crew.close()

    def __enter__(self) -> Frames:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _look(self) -> tuple[Scene, TextureSource, TextureTable]:
        """Return scene and textures that belong together."""
        if self.shading == "textures":
            return lit_now(self.target)
        source, scene = self.target.source, self.target.scene
        if self._bare is None or len(self._bare.slot) != len(scene.particles):
            self._bare = bare_table(len(scene.particles))
        return scene, source, self._bare

    def _light_before(self, scene: Scene, source: TextureSource) -> TextureTable | None:
        """Return the textures of the light before the last change, while some may be shown; not those of other particles."""
        key, particles = self._lit_by
        if key != source.key:
            ready, _, stale = self._sight.lit
            textured = self.shading == "textures" and scene.model != "lambertian"
            if scene.particles is not particles or not textured:
                self._before = ""
            elif ready >= stale:  # else the light before that still shows more
                self._before = key
            self._lit_by = source.key, scene.particles
        elif self._sight.count and self._sight.lit == (self._sight.count, 0, 0):
            self._before = ""  # all that is in sight has been replaced
        return source.snapshot(self._before) if self._before else None

    def _waiting(self) -> bool:
        """Whether better light is on its way."""
        status = getattr(self.target, "status", None)
        if status is None or self.shading != "textures":
            return False
        now = status()
        return bool(now.queued or now.baking or now.refining)

    def _listen(self) -> Callable[[], None]:
        """Have `_news` set when light has come; return what ends that."""
        leave = [
            getattr(self.target, name)(lambda batch: self._news.set())
            for name in ("subscribe", "subscribe_coarse")
            if hasattr(self.target, name)
        ]

        def end() -> None:
            for each in leave:
                each()

        return end

    def _prepare(self, scene: Scene, key: str) -> tuple[bool, bool, bool]:
        """Make what kernels need; return whether the camera moved, light or colours changed, and the tone did."""
        view, particles = self.view, scene.particles
        width, height = self.size

        def differs(part: str, *now: object) -> bool:
            before = self._made_of.get(part)
            self._made_of[part] = now
            return before is None or any(a is not b and a != b for a, b in zip(before, now, strict=True))

        moved = False
        if differs("tree", particles, scene.conditions, view.conditions):
            self._tree, moved = seen_tree(scene, view).arrays, True
        camera = view.camera_for(particles, self.size)
        self._place = np.asarray(camera.eye, np.float64)
        if differs("eye", particles, self.size, *_numbers_of(camera)):
            self._eye, moved = make_eye(camera, SphereSet.of(particles), width / height), True
        changed = differs("light", scene, key, self.shading, self.shadows, self.filtered)
        if changed:
            self._lights = pack_lights(scene, SphereSet.of(particles))
        looks = [getattr(view, each.name) for each in fields(view) if each.name not in _NOT_COLORS]
        if differs("colors", particles, *looks):
            self._colors, changed = view.colors(particles), True
        toned = differs("tone", scene, view.exposure, view.background, self.grading)
        if toned:
            self._tone = make_tone(scene, view, self.grading)
        return moved, changed, toned

    def _add_ray(
        self, current: Pass, table: TextureTable, meanwhile: Callable[[], None] | None
    ) -> NDArray[np.uint8] | None:
        """Send one ray through every pixel; return the picture, if this changes what is shown."""
        shift = (0.5, 0.5) if current.moving else self._shifts[current.count]
        current.count += 1
        picture = self._canvas() if current.count >= current.want else None
        textured = self.shading == "textures"
        draw_rays(
            self._tree,
            self._lights,
            self._eye,
            shift,
            make_skin(table, self._colors),
            current.sums.total,
            self._crew,
            spacing=1.0 if current.moving and self.filtered else 0.0,
            textured=textured,
            shadows=self.shadows if textured else self.shading == "shadows",
            first=current.count == 1,
            blank=current.sums.blank,
            seen=self._sight.marks if textured else None,
            rays=current.count,
            tone=self._tone,
            picture=NO_PICTURE if picture is None else picture,
            meanwhile=meanwhile,
        )
        self._passes.drawn(current)
        return picture

    def _developed(self) -> NDArray[np.uint8]:
        """Return the picture of what is shown under the present tone."""
        assert self._passes.shown is not None
        picture = self._canvas()
        develop_rows(*self._passes.shown.sums, self._passes.shown.count, self._tone, 0, len(picture), picture)
        return picture

    def _canvas(self) -> NDArray[np.uint8]:
        """Return memory for a picture that nobody holds any more."""
        width, height = self.size
        self._pictures = [each for each in self._pictures if each.shape[:2] == (height, width)]
        for each in self._pictures:
            if sys.getrefcount(each) <= _OWN_REFERENCES:
                return each
        self._pictures.append(np.empty((height, width, 3), np.uint8))
        return self._pictures[-1]

    def _keep(self, picture: NDArray[np.uint8] | None, *, final: bool) -> None:
        """Make the frame, unless it would be the last one again."""
        assert self._passes.shown is not None
        last = self._frame
        self._drew = picture is not None or self._passes.growing is not None
        if picture is None:
            assert last is not None
            if (last.visible, last.ready, last.dim, last.stale, last.final) == (
                self._sight.count,
                *self._sight.lit,
                final,
            ):
                return
            picture = last.pixels
        self._frame = Frame(picture, self._passes.shown.count, self._sight.count, *self._sight.lit, final)


def _numbers_of(camera: Camera) -> tuple[object, ...]:
    """Return what tells cameras apart."""
    places = (np.asarray(each).tobytes() for each in (camera.eye, camera.target, camera.up))
    return (*places, camera.fov, camera.height)
