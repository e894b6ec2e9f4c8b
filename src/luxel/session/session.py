"""Session: the one place that wires particle data, scene, textures and engine; what the front ends share."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import EllipsisType, TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from luxel.arrays import as_ids, as_vector
from luxel.dynamic.budget import BudgetDriver
from luxel.dynamic.cache import TextureCache
from luxel.dynamic.engine import Engine
from luxel.dynamic.entries import ESTIMATE
from luxel.dynamic.look import Look
from luxel.dynamic.shares import Helpers
from luxel.dynamic.work import Bakers, CoarseBatch, CoarseListener, Listener, TileBaker, TileBatch
from luxel.errors import FormatError, FrameError, InputError, SessionClosedError
from luxel.light.lights import luminance_scale
from luxel.particles import Particles
from luxel.scene.hiding import Condition
from luxel.scene.lights import Light
from luxel.scene.periodic import parse_axes
from luxel.scene.saved import Lighting
from luxel.scene.scene import Model, Scene
from luxel.session.status import Status
from luxel.session.textures import SessionTextures
from luxel.textures.bake import Baker
from luxel.textures.estimate import EstimateBaker, takes_long
from luxel.textures.spec import TextureSpec, light_key
from luxel.textures.store.reader import Baked, BakedFrame
from luxel.textures.store.source import StoredBaker
from luxel.textures.textures import Encoding, TextureTable, decoding_table
from luxel.trace.spheres import SphereSet
from luxel.trace.tree import thread_count

if TYPE_CHECKING:
    from luxel.io import Series
    from luxel.scene.view import View

__all__ = ["MakeBaker", "Session"]

MakeBaker = Callable[[Scene, TextureSpec], TileBaker]


@dataclass(frozen=True, eq=False)
class _Lit:
    """What is shown at one moment; replaced as a whole, so that readers need no lock."""

    frame: int
    scene: Scene
    key: str
    scale: float
    diagonal: float  # of the scene, in normalised units


class Session:
    """One data set under changing light, shared by any number of clients.

    Parameters
    ----------
    series
        A :class:`luxel.Series`, some `Particles`, or a `Scene`, which brings its own lights, model and albedo. Or what
        :func:`luxel.open_baked` opened: then the light is fixed, textures are read and not computed, and the
        lights, model, albedo, ao_distance, periodic and spec are the store's.
    frame
        Which time step; None means the first with particles.
    lights, model, albedo, ao_distance, periodic, hide
        See :class:`luxel.Scene`.
    radius_scale
        Factor on all radii.
    lighting
        All of the above in one, instead.
    spec
        How textures are made in the end; None means nine ``fast`` samples a texel, see `estimates`. ``TextureSpec.usual()`` has one, as bakes do.
    view
        How clients should look at it at first; the session only keeps it.
    threads
        Baking threads; None means one a core, 0 none: :meth:`run_for` does the work.
    bake_budget_s
        Seconds of a frame, at most 1, for which these threads work on light at a time, instead of all the time; they leave the rest of it to those who draw. A
        frame is a thirtieth of a second, or the budget if that is longer. 0 for no such limit.
    max_bytes
        Budget of the texture cache.
    components
        Keep textures compressed, as so many principal components of a byte each, learnt from those that come, so that many more find room; 8 is a good number. 0
        keeps them as they are made.
    estimates
        Whether cheap textures (:class:`luxel.textures.estimate.EstimateBaker`) of a quarter of the texels come before those of `spec`. None: where those take
        long, such as four samples or the 49 of ``paper`` mode, textures of one ``fast`` sample do, of which only what somebody looks at has been sampled.
        Those that are visible are replaced as long as some client keeps sighting them.
    small_pixels
        With estimates: a particle narrower than this on every screen, as far as clients tell, gets nothing better. 0 for none.
    clock
        Seconds, never going backwards.
    make_baker
        Makes the baker of a scene; None means :class:`luxel.textures.bake.Baker`. Called on the engine's threads.

    Raises
    ------
    InputError
        For anything that a scene does not take.
    FrameError
        For a frame outside the series.

    Notes
    -----
    Safe to use from several threads. The session owns a lock that puts changes of light and frame in a row; what is
    current is one immutable value, read without it. Cache and engine own their locks; none is held while listeners run.
    """

    def __init__(
        self,
        series: Series | Particles | Scene | Baked,
        *,
        frame: int | None = None,
        lights: Sequence[Light] | None = None,
        model: Model = "interreflection",
        albedo: float = 0.7,
        ao_distance: float | None = None,
        periodic: str | Sequence[bool] = "",
        hide: Condition | Sequence[Condition] = (),
        radius_scale: float = 1.0,
        lighting: Lighting | None = None,
        spec: TextureSpec | None = None,
        view: View | None = None,
        threads: int | None = None,
        bake_budget_s: float = 0.0,
        max_bytes: int = 256 << 20,
        components: int = 0,
        estimates: bool | None = None,
        small_pixels: float = 0.0,
        clock: Callable[[], float] = time.monotonic,
        make_baker: MakeBaker | None = None,
    ) -> None:
        self._baked = series if isinstance(series, Baked) else None
        if self._baked is not None:
            spec = self._baked.spec
        self.spec = TextureSpec.usual(purpose="view") if spec is None else spec
        self.view = view
        count = 0 if threads == 0 else thread_count(threads)
        if not 0 <= bake_budget_s <= 1:
            raise InputError(f"bake_budget_s must be seconds in [0, 1], got {bake_budget_s!r}")
        if bake_budget_s > 0 and not count:
            raise InputError("a budget for baking is for threads, and threads is 0 — call run_for() with it")
        self._make_baker = Baker if make_baker is None else make_baker
        self._lock = threading.RLock()
        self._cache = TextureCache(self.spec.texels, max_bytes, self.spec.mapping, components=components)
        self._estimates = estimates
        self._clock = clock
        self._engine, self._engine_beside = (
            Engine(self._cache, threads=0 if bake_budget_s else count, clock=clock, small_pixels=small_pixels)
            for _ in range(2)
        )
        self._driver = BudgetDriver(self.run_for, bake_budget_s, count) if bake_budget_s else None
        self._beside: _Lit | None = None  # what is compared with
        self._closed = False
        self.series: Sequence[Particles]
        if isinstance(series, Scene):
            self.series, scene = (series.particles.unscaled,), series
            frame = self._check_frame(frame or 0)
        elif isinstance(series, Baked):
            self.series = series.series
            frame = self._check_frame(frame or 0)
            scene = series[frame].scene
        else:
            self.series = (series,) if isinstance(series, Particles) else series
            frame = self._check_frame(_first_frame(self.series) if frame is None else frame)
            if lighting is None:
                axes = parse_axes(periodic)
                lighting = Lighting(model, lights, albedo, ao_distance, axes, 8, hide, radius_scale)
            scene = lighting.scene(self.series[frame])
        self._lit = self._light(frame, scene)

    @property
    def frame(self) -> int:
        """Index of the current time step."""
        return self._lit.frame

    @property
    def particles(self) -> Particles:
        """The current time step."""
        return self._lit.scene.particles

    @property
    def scene(self) -> Scene:
        """The current scene."""
        return self._lit.scene

    @property
    def key(self) -> str:
        """The current light key."""
        return self._lit.key

    @property
    def scale(self) -> float:
        """Luminance of code 255 under the current light."""
        return self._lit.scale

    @property
    def stored(self) -> BakedFrame | None:
        """The stored frame whose textures are shown; None where light is computed."""
        return None if self._baked is None else self._baked[self._lit.frame]

    @property
    def encoding(self) -> Encoding:
        """How codes become luminance."""
        return self.spec.encoding

    @property
    def source(self) -> SessionTextures:
        """The session's textures for renderers: a :class:`luxel.textures.textures.TextureSource`."""
        return SessionTextures(self)

    def sighted(
        self,
        ids: ArrayLike,
        eye: ArrayLike,
        client: str = "",
        key: str | None = None,
        pixels: ArrayLike | None = None,
    ) -> None:
        """Note which particles a client sees now, and queue those without a texture. Cheap; call it once a frame.

        Parameters
        ----------
        ids
            (K,) ids of all visible particles.
        eye
            (3,) where they are seen from, in file units.
        client
            Any name; see :meth:`forget`.
        key
            The light key that the client shows, if it may be behind; then nothing happens.
        pixels
            (K,) how wide they are on the screen, in pixels, beside `ids`; None if nobody knows.

        Raises
        ------
        InputError
            For ids outside the frame, an eye that is not three finite numbers, or another number of widths.
        """
        self._check_open()
        lit, engine, beside = self._lit, self._engine, self._beside
        if beside is not None and key == beside.key != lit.key:
            lit, engine = beside, self._engine_beside
        if (key is not None and key != lit.key) or lit.scene.model == "lambertian":
            return
        visible = np.asarray(ids)
        width = None if pixels is None else np.array(pixels, dtype=np.float32)
        if width is not None and width.shape != visible.shape:
            raise InputError(f"pixels must have shape {visible.shape} as ids have, got {width.shape}")
        spheres = SphereSet.of(lit.scene.particles)
        look = Look.at(spheres, as_vector(eye, "eye"), lit.diagonal, visible, width)
        if engine.request(lit.key, look.visible, look, client, look.unit_eye) and self._driver is not None:
            self._driver.wake()

    def snapshot(self, key: str) -> TextureTable:
        """Return a consistent table for one frame; empty where the session knows nothing of `key`."""
        table = self._cache.snapshot(key)
        if table is not None:
            return table
        nothing = np.empty((0, self.spec.texels, self.spec.texels), dtype=np.uint8)
        slot = np.full(len(self.particles), -1, dtype=np.int32)
        return TextureTable(slot, nothing, decoding_table(self.scale, self.encoding), self.spec.mapping)

    def tiles(self, ids: ArrayLike, key: str | None = None) -> TileBatch:
        """Return the finished textures among `ids`, under the current light key or another that is still cached."""
        self._check_open()
        lit = self._lit
        key = lit.key if key is None else key
        count = self._cache.particle_count(key)
        wanted = as_ids(np.asarray(ids) if count else [], count)
        ready, codes, grades = self._cache.lookup(key, wanted)
        return TileBatch(
            key, wanted[ready], codes, grades == ESTIMATE, stale=key not in (lit.key, self.key_beside)
        )

    def first_light(self, ids: ArrayLike, key: str | None = None) -> CoarseBatch:
        """Return the coarse records that there are among `ids`, under the current light key; none for another."""
        self._check_open()
        key = self._lit.key if key is None else key
        count = self._cache.particle_count(key)
        wanted = as_ids(np.asarray(ids) if count else [], count)
        there, records = self._cache.lookup_coarse(key, wanted)
        return CoarseBatch(key, wanted[there], records)

    def subscribe(self, listener: Listener) -> Callable[[], None]:
        """Call `listener` with each finished :class:`TileBatch`, from baking threads; return what ends that."""
        ends = [engine.subscribe(listener) for engine in (self._engine, self._engine_beside)]

        def end_all() -> None:
            for end in ends:
                end()

        return end_all

    def subscribe_coarse(self, listener: CoarseListener) -> Callable[[], None]:
        """Call `listener` with each :class:`CoarseBatch` of first light, from baking threads; return what ends that."""
        return self._engine.subscribe_coarse(listener)

    def relight(
        self,
        *,
        model: Model | None = None,
        lights: Sequence[Light] | None = None,
        albedo: float | None = None,
        ao_distance: float | EllipsisType | None = ...,
        hide: Condition | Sequence[Condition] | None = None,
        radius_scale: float | None = None,
    ) -> str:
        """Change the light; return the new light key. What is not given stays.

        Work queued under the old key is cancelled; its textures stay cached for when the change is undone.

        Raises
        ------
        InputError
            For anything that a scene does not take, and where the light is baked in.
        """
        if self._baked is not None:
            raise InputError(
                f"the light of {self._baked.path} is baked in — bake again with another, or open the particle file"
            )
        changes: dict[str, Any] = {"model": model, "lights": lights, "albedo": albedo, "hide": hide}
        changes = {name: value for name, value in changes.items() if value is not None}
        if ao_distance is not ...:
            changes["ao_distance"] = ao_distance
        with self._lock:
            self._check_open()
            if radius_scale is not None:
                changes["particles"] = self.particles.scaled(radius_scale)
            return self._show(self._lit.frame, self._lit.scene.with_changes(**changes))

    def compare(self, model: Model | None) -> str | None:
        """Light the same scene under another shading model as well, for a second picture beside the first.

        That light has a key of its own, by which :meth:`sighted` and :meth:`tiles` know it. It follows all changes of light and
        frame, and has no first light.

        Parameters
        ----------
        model
            None ends it.

        Returns
        -------
        str or None
            Its light key.

        Raises
        ------
        InputError
            For an unknown model, where the light is baked in, and if the cache has no room for two light keys.
        """
        with self._lock:
            if model is None:
                self._beside = None
                return None
            self._check_open()
            if self._baked is not None:
                raise InputError(
                    f"the light of {self._baked.path} is baked in: there is no other to compare with"
                )
            self._beside = self._light_beside(model)
            return self._beside.key

    @property
    def scene_beside(self) -> Scene | None:
        """The scene under the model that is compared with, see :meth:`compare`; None while there is none."""
        beside = self._beside
        return None if beside is None else beside.scene

    @property
    def key_beside(self) -> str | None:
        """Light key of :attr:`scene_beside`."""
        beside = self._beside
        return None if beside is None else beside.key

    @property
    def light_fixed(self) -> bool:
        """Whether the light is baked in, so that :meth:`relight` refuses to change it."""
        return self._baked is not None

    def restore(self, light: Lighting | None, frame: int | None = None) -> str:
        """Show what a saved view says: both at once, or nothing if one of them cannot be; return the light key.

        Parameters
        ----------
        light
            None keeps the current one, as does a baked light.
        frame
            None keeps the current one.

        Raises
        ------
        FrameError
            If there is no such frame.
        InputError
            For a light that a scene does not take.
        """
        with self._lock:
            self._check_open()
            k = self._lit.frame if frame is None else self._check_frame(frame)
            now = self._lit.scene
            particles = now.particles.unscaled if k == self._lit.frame else self.series[k]
            if self._baked is not None:
                scene = now.with_changes(particles=particles)
            else:
                scene = (Lighting.of(now) if light is None else light).scene(particles)
            return self._show(k, scene)

    def set_frame(self, k: int) -> str:
        """Show another time step under the same light; return the new light key.

        Raises
        ------
        FrameError
            If there is no such frame.
        InputError
            If it holds no particles, or no cell for light that repeats; the session stays where it was.
        """
        with self._lock:
            self._check_open()
            k = self._check_frame(k)
            if k != self._lit.frame:
                particles = self.series[k].scaled(self.particles.radius_scale)
                self._show(k, self._lit.scene.with_changes(particles=particles))
            return self._lit.key

    def status(self, *, beside: bool = False) -> Status:
        """Return what the session is doing: for its light, or for that which is compared with, if there is any."""
        lit = (self._beside if beside else None) or self._lit
        (self._engine_beside if beside else self._engine).settle()
        counts = self._cache.counts(lit.key)
        return Status(
            key=lit.key,
            particles=len(lit.scene.particles),
            ready=counts.ready + counts.refining,
            refining=counts.refining,
            queued=counts.queued,
            baking=counts.baking,
            failed=counts.failed,
            evicted=self._cache.stats().evicted,
            textures_per_s=self._engine.textures_per_s + self._engine_beside.textures_per_s,
            over_budget=self._engine.over_budget,
            clipped=self._engine.clipped_count,
            error=self._engine.error or self._engine_beside.error,
        )

    def forget(self, client: str) -> None:
        """Withdraw what only this client wanted; call it when the client is gone."""
        self._engine.forget(client)
        self._engine_beside.forget(client)

    def wait(self, timeout_s: float | None = None) -> bool:
        """Block until everything requested is ready, and as good as `spec` asks for; False if that takes longer than `timeout_s`."""
        return self._engine.wait(timeout_s) and self._engine_beside.wait(timeout_s)

    def run_for(self, budget_s: float, helpers: Helpers | None = None) -> int:
        """Bake on the caller's thread for about `budget_s` seconds: the per-frame callback of paper 4.2; return pieces of work done.

        `helpers` are threads that share each piece with the caller's, such as those that draw.
        """
        end_s = self._clock() + budget_s
        done = self._engine.run_for(budget_s, helpers)
        if self._beside is not None and (left_s := end_s - self._clock()) > 0:
            done += self._engine_beside.run_for(left_s, helpers)
        return done

    def take_in(self) -> None:
        """Take in what was sighted, which :meth:`run_for` would begin with; frames do so while other threads draw."""
        self._engine.take_in()
        if self._beside is not None:
            self._engine_beside.take_in()

    def close(self) -> None:
        """Stop baking and join the threads; closing twice does no harm."""
        with self._lock:
            self._closed = True
        if self._driver is not None:
            self._driver.close()
        self._engine.close()
        self._engine_beside.close()

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _check_open(self) -> None:
        if self._closed:
            raise SessionClosedError("this session is closed — open a new one")

    def _check_frame(self, frame: int) -> int:
        if not isinstance(frame, int | np.integer) or not 0 <= frame < len(self.series):
            raise FrameError(f"no frame {frame!r} — there are {len(self.series)}, counted from 0")
        return int(frame)

    def _show(self, frame: int, scene: Scene) -> str:
        self._lit = self._light(frame, scene)
        if self._beside is not None:
            try:
                self._beside = self._light_beside(self._beside.scene.model)
            except InputError:  # no room for two any more
                self._beside = None
                raise
        return self._lit.key

    def _light_beside(self, model: Model) -> _Lit:
        lit = self._lit
        scene = lit.scene.with_changes(model=model)
        key, scale = light_key(scene, self.spec), luminance_scale(scene)
        if key != lit.key and model != "lambertian":
            self._engine_beside.select(
                key,
                len(scene.particles),
                scale,
                self.spec.encoding,
                lambda: self._bakers(lit.frame, scene),
                beside=True,
            )
        return replace(lit, scene=scene, key=key, scale=scale)

    def _light(self, frame: int, scene: Scene) -> _Lit:
        key = light_key(scene, self.spec)
        scale = luminance_scale(scene)
        if self._baked is not None and self._baked[frame].scale != scale:
            raise FormatError(
                self._baked.path,
                "was baked by a luxel that scales luminance otherwise",
                remedy="bake it again",
            )
        self._engine.select(
            key, len(scene.particles), scale, self.spec.encoding, lambda: self._bakers(frame, scene)
        )
        low, high = SphereSet.of(scene.particles).bounds()
        return _Lit(frame, scene, key, scale, float(np.linalg.norm(high - low)))

    def _bakers(self, frame: int, scene: Scene) -> Bakers:
        if self._baked is not None:
            return Bakers(StoredBaker(self._baked[frame]))
        baker = self._make_baker(scene, self.spec)
        wanted = takes_long(self.spec) if self._estimates is None else self._estimates
        if not wanted or not isinstance(baker, Baker):
            return Bakers(baker)
        return Bakers(baker, EstimateBaker(baker, whole=self._estimates is None))


def _first_frame(series: Sequence[Particles]) -> int:
    finder = getattr(series, "first_frame", None)
    return 0 if finder is None else int(finder())
