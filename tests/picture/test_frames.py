"""Frames: the same pictures as `render`, never waiting for light, within their budget."""

from __future__ import annotations

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

import luxel
from luxel.errors import InputError, ScalarError
from luxel.picture.drawing import seen_tree
from luxel.picture.frames import Frames
from luxel.picture.raytrace import visible_ids
from luxel.scene.lights import Sky, Sun
from luxel.session import Session
from luxel.textures.bake import Baker
from luxel.textures.spec import TextureSpec
from luxel.trace.spheres import SphereSet
from tests.dynamic.fakes import TEXELS, Clock, FakeBaker
from tests.scenes import cloud

SIZE = (60, 44)
SPEC = TextureSpec(mode="paper", samples=1, texels=8)
GUARD_S = 60.0


def fake_session(particles=None, clock=None, texture_s=0.0, threads=0, **options):
    particles = cloud(80) if particles is None else particles
    clock = clock or Clock()
    spec = TextureSpec(texels=TEXELS, mode="fast", samples=1)
    return Session(
        particles,
        spec=spec,
        threads=threads,
        clock=clock,
        make_baker=lambda scene, spec: FakeBaker("fake", clock, texture_s),
        **options,
    )


@pytest.mark.parametrize("antialias", [1, 2, 3])
def test_dynamic_precomputed_and_rendered_pictures_are_the_same_bytes(antialias):
    scene = luxel.Scene(cloud(80))
    view = luxel.View(color_by="value", colormap="plasma")
    textures = luxel.bake(scene, samples=1, mode="paper", texels=8)
    expected = luxel.render(scene, view, textures, SIZE, antialias=antialias, colorbar=False)
    with (
        Session(scene, spec=SPEC, threads=0) as session,
        Frames(session, view, SIZE, antialias=antialias, threads=2, bake_budget_s=0.05) as dynamic,
        Frames(scene, view, SIZE, textures=textures, antialias=antialias, threads=1) as still,
    ):
        *_, last = dynamic
        *_, precomputed = still
    assert last.final
    assert last.rays == antialias**2
    assert last.ready == last.visible > 10
    assert np.array_equal(last.pixels, precomputed.pixels)
    assert np.array_equal(last.pixels, expected.pixels)


class BlockedBaker(Baker):
    """Waits for ever, unless it is let go."""

    entered, go = threading.Event(), threading.Event()

    def bake_into(self, ids, codes):
        self.entered.set()
        assert self.go.wait(GUARD_S)
        return super().bake_into(ids, codes)


def test_a_frame_does_not_wait_for_light():
    particles = cloud(80)
    with (
        Session(particles, spec=SPEC, threads=1, make_baker=BlockedBaker) as session,
        Frames(session, size=SIZE, threads=2, antialias=2) as frames,
    ):
        try:
            first = frames.draw()
            # Requests lapse unless somebody keeps looking.
            deadline_s = time.monotonic() + GUARD_S
            while not BlockedBaker.entered.wait(0.01) and time.monotonic() < deadline_s:
                frames.draw()
            assert BlockedBaker.entered.is_set()  # from now on a texture is being baked, and stays so
            still = [frames.draw() for _ in range(10)]
            assert first.visible > 10
            assert still[-1].ready == 0
            assert still[-1].rays == 4  # a whole antialiased picture, meanwhile
            assert not still[-1].final
            camera = luxel.Camera.framing(particles.bounds, azimuth=40, aspect=SIZE[0] / SIZE[1])
            assert frames.draw(luxel.View(camera=camera)).rays == 1
        finally:
            BlockedBaker.go.set()
        *_, last = frames
        assert last.ready == last.visible


@pytest.mark.parametrize("budget_s", [0.01, 0.033, 0.2])
def test_a_frame_takes_its_budget_and_at_most_one_piece_of_work_more(budget_s):
    clock, texture_s = Clock(), 0.002
    with (
        fake_session(clock=clock, texture_s=texture_s) as session,
        Frames(session, size=SIZE, threads=1, bake_budget_s=budget_s, clock=clock) as frames,
    ):
        sizes = []
        for _ in range(200):
            before_s = clock.now_s
            frame = frames.draw()
            took_s = clock.now_s - before_s
            status = session.status()
            if status.queued:  # latency is bounded from below, the frame rate from above (paper 4.2)
                assert took_s > budget_s - 1.01 * texture_s  # no piece is begun that would not fit
            assert took_s <= budget_s + 0.06  # a batch is what takes one thread about 30 ms
            sizes.append(took_s)
            if frame.final:
                break
        assert frame.final
        assert frame.ready == frame.visible
        assert sum(sizes) >= 0.999 * texture_s * frame.visible


def test_a_camera_at_rest_leaves_the_processors_to_light_that_comes():
    tick_s = 1 / 64
    ticks = iter(np.arange(0.0, 1e3, tick_s))
    with (
        fake_session(texture_s=0.01) as session,
        Frames(session, size=SIZE, threads=1, antialias=2, clock=lambda: float(next(ticks))) as frames,
    ):
        dark = [(frames.draw(), frames.pause_s)[1] for _ in range(20)]
        assert dark == [0.0] * 20  # nothing comes: no reason to wait
        pauses = []
        for _ in range(400):
            session.run_for(0.01)
            frame = frames.draw()
            if frame.ready < frame.visible:
                pauses.append(frames.pause_s)
        assert frame.final
        assert frames.pause_s == 0.0
        assert sum(pause >= 6 * tick_s for pause in pauses) > len(pauses) / 2 > 5
        session.relight(albedo=0.3)
        for _ in range(8):
            frames.draw()
            session.run_for(0.01)
        assert frames.pause_s > 0
        camera = luxel.Camera.framing(session.scene.particles.bounds, azimuth=40)
        frames.draw(luxel.View(camera=camera))
        assert frames.pause_s == 0.0  # a flying camera waits for nothing


def test_a_camera_at_rest_leaves_the_processors_to_refinements_too():
    ticks = iter(np.arange(0.0, 1e3, 1 / 64))
    particles = cloud(80)
    spec = TextureSpec(texels=8, samples=4, mode="fast")
    with (
        Session(particles, spec=spec, threads=0) as session,
        Frames(session, size=SIZE, threads=1, antialias=2, clock=lambda: float(next(ticks))) as frames,
    ):
        refining = []
        for _ in range(2000):
            session.run_for(1e-9)
            frame = frames.draw()
            if frame.ready == frame.visible and not frame.final:
                refining.append(frames.pause_s)
            if frame.final:
                break
    assert frame.final
    assert sum(pause > 0 for pause in refining) > 5


def test_rays_add_up_while_the_camera_rests_and_start_anew_when_it_moves():
    scene = luxel.Scene(cloud(80))
    view = luxel.View()
    with Frames(scene, view, SIZE, threads=1, antialias=3) as frames:
        counts = [frames.draw().rays for _ in range(12)]
        assert counts == [1, 1, 1, 1, 1, 5, 6, 7, 8, 9, 9, 9]
        rested = frames.draw()
        assert rested.final
        assert frames.draw() is rested
        moved = frames.draw(luxel.View(camera=luxel.Camera((3, 3, 3), (0.5, 0.5, 0.5))))
        assert moved.rays == 1
        assert not moved.final
        assert not np.array_equal(moved.pixels, rested.pixels)


def test_a_picture_that_somebody_holds_is_not_written_again():
    scene = luxel.Scene(cloud(80))
    with Frames(scene, size=SIZE, threads=1, antialias=1) as frames:
        held = []
        for azimuth in range(0, 80, 10):
            camera = luxel.Camera.framing(scene.particles.bounds, azimuth=azimuth, aspect=1.4)
            pixels = frames.draw(luxel.View(camera=camera)).pixels
            held.append((pixels[4:, ::2], pixels.copy()[4:, ::2]))  # views count too
        for kept, copy in held:
            assert np.array_equal(kept, copy)
        del held, kept, copy, pixels
        for azimuth in range(0, 80, 10):
            camera = luxel.Camera.framing(scene.particles.bounds, azimuth=azimuth, aspect=1.4)
            frames.draw(luxel.View(camera=camera))
        assert len(frames._pictures) <= 9  # and memory that nobody holds is used again


def test_exposure_and_background_cost_no_ray():
    scene = luxel.Scene(cloud(80), model="lambertian")
    with Frames(scene, size=SIZE, threads=1, antialias=2) as frames:
        *_, last = frames
        rays = last.rays
        changed = frames.draw(luxel.View(exposure=0.4, background="#804020"))
        assert changed.rays == rays
        expected = luxel.render(scene, luxel.View(exposure=0.4, background="#804020"), size=SIZE, antialias=2)
        assert np.array_equal(changed.pixels, expected.pixels)


def test_colours_and_size_change_at_once():
    scene = luxel.Scene(cloud(80), model="lambertian")
    look = luxel.View(color_by="value", colormap="magma")
    with Frames(scene, size=SIZE, threads=1, antialias=2) as frames:
        list(frames)
        frames.view = look
        *_, last = frames
        assert np.array_equal(
            last.pixels, luxel.render(scene, look, size=SIZE, antialias=2, colorbar=False).pixels
        )
        frames.size = (30, 50)
        assert frames.draw().pixels.shape == (50, 30, 3)


def test_new_light_is_drawn_and_old_light_never_shown_as_new():
    with (
        fake_session(lights=(Sky(1.0), Sun((1, 1, 1), 2.0))) as session,
        Frames(session, size=SIZE, threads=1, antialias=2, bake_budget_s=1.0) as frames,
    ):
        *_, lit = frames
        assert lit.ready == lit.visible
        session.relight(albedo=0.2)
        unlit = frames.draw()
        assert unlit.ready == 0
        *_, again = frames
        assert again.final
        assert again.ready == again.visible


def test_old_light_is_shown_and_told_until_there_is_new():
    with (
        fake_session(lights=(Sky(1.0), Sun((1, 1, 1), 2.0))) as session,
        Frames(session, size=SIZE, threads=1, antialias=1) as frames,
    ):
        while not frames.draw().final:
            session.run_for(1.0)
        lit = frames.draw()
        session.relight(albedo=0.2)
        frames.draw()
        old = frames.draw()
        assert (old.ready, old.dim, old.stale) == (0, 0, old.visible)
        assert not old.final
        assert np.array_equal(old.pixels, lit.pixels)  # the tone is the same: it depends on no albedo
        session.relight(lights=(Sky(1.0),))  # and again, before anything of it has come
        other = frames.draw()
        assert (other.ready, other.stale) == (0, lit.visible)
        session.relight(
            lights=(Sky(1.0), Sun((1, 1, 1), 2.0)), albedo=0.7
        )  # undone: what was stale is current
        again = frames.draw()
        assert (again.ready, again.stale) == (again.visible, 0)
        session.relight(albedo=0.2)
        counts = []
        while not (frame := frames.draw()).final:
            session.run_for(1e-9)
            counts.append(frame.stale)
            assert frame.ready + frame.dim + frame.stale <= frame.visible
        assert counts[0] == lit.visible
        assert counts == sorted(counts, reverse=True)
        assert counts[-1] == 0
        assert (frame.ready, frame.stale) == (frame.visible, 0)


def test_old_light_goes_when_no_new_one_comes(caplog):
    with (
        fake_session() as session,
        Frames(session, size=SIZE, threads=1, antialias=1, bake_budget_s=1.0) as frames,
    ):
        list(frames)

        def broken(scene, spec):
            raise MemoryError("no room for a tree")

        session._make_baker = broken
        session.relight(albedo=0.2)
        assert frames.draw().stale > 0
        *_, last = frames
        assert (last.ready, last.stale) == (0, 0)


def test_old_light_is_not_shown_under_a_model_without_textures():
    with (
        fake_session() as session,
        Frames(session, size=SIZE, threads=1, antialias=1, bake_budget_s=1.0) as frames,
    ):
        list(frames)
        session.relight(model="lambertian")
        assert frames.draw().stale == 0
        *_, last = frames
        assert (last.ready, last.stale) == (0, 0)


def test_old_light_of_other_particles_is_not_shown():
    with (
        fake_session([cloud(80), cloud(80, seed=2)]) as session,
        Frames(session, size=SIZE, threads=1, antialias=1, bake_budget_s=1.0) as frames,
    ):
        list(frames)
        session.set_frame(1)
        assert frames.draw().stale == 0


def test_stale_textures_are_decoded_by_their_own_scale():
    from luxel.picture.drawing import bare_table

    scene = luxel.Scene(cloud(80))
    codes = np.random.default_rng(0).integers(0, 256, (80, 8, 8)).astype(np.uint8)
    ids = np.arange(80, dtype=np.int32)
    before = luxel.LuminanceTextures(ids, codes, 2.0, "sqrt", 80, "k").snapshot("k")
    now = replace(before, slot=bare_table(80).slot, decoding=before.decoding * np.float32(9))

    class Table:
        key = "k"

        def __init__(self, table):
            self.table = table

        def snapshot(self, key):
            return self.table

        def sighted(self, ids, eye):
            pass

    pictures = []
    for table in (before, now.with_stale(before)):
        with Frames(scene, size=SIZE, textures=Table(table), antialias=1, threads=1) as frames:
            pictures.append(frames.draw().pixels)
    assert np.array_equal(*pictures)
    assert now.with_stale(replace(before, codes=codes.copy())) is now  # of other memory


def test_frames_follow_the_session_to_other_particles():
    with (
        fake_session([cloud(80), cloud(30, seed=2)]) as session,
        Frames(session, size=SIZE, threads=1, antialias=1, bake_budget_s=1.0) as frames,
    ):
        list(frames)
        session.set_frame(1)
        *_, last = frames
        assert last.ready == last.visible <= 30


class Witness:
    """A source that only notes what it is told."""

    key = "witness"

    def __init__(self, count):
        self.count, self.told = count, []

    def snapshot(self, key):
        from luxel.picture.drawing import bare_table

        return bare_table(self.count)

    def sighted(self, ids, eye):
        self.told.append((ids.copy(), eye))


def test_what_is_sighted_is_what_the_picture_shows():
    particles = cloud(300)
    scene = luxel.Scene(particles, model="lambertian")
    camera = luxel.Camera.framing(particles.bounds, aspect=SIZE[0] / SIZE[1])
    source = Witness(len(particles))
    with Frames(scene, luxel.View(camera=camera), SIZE, textures=source, threads=2, antialias=2) as frames:
        frames.draw()
        ids, eye = source.told[0]
        assert ids.dtype == np.int32
        assert ids.tolist() == visible_ids(scene, camera, SIZE).tolist()
        assert np.array_equal(eye, camera.eye)
        list(frames)
        between = visible_ids(scene, camera, SIZE, antialias=2)
        assert source.told[-1][0].tolist() == np.union1d(ids, between).tolist()
        cut = luxel.Cut("x", 0.5)
        frames.draw(luxel.View(camera=camera, hide=cut))
        assert not cut.hides(particles)[source.told[-1][0]].any()


def test_a_view_that_fails_is_not_taken_for_drawn():
    particles = cloud(60)
    camera = luxel.Camera.framing(particles.bounds, aspect=1.0)
    source = Witness(len(particles))
    with Frames(luxel.Scene(particles), size=(48, 48), textures=source, threads=2) as frames:
        with pytest.raises(ScalarError):
            frames.draw(luxel.View(camera=camera, color_by="nothing"))
        frame = frames.draw(luxel.View(camera=camera))
        assert frame.visible == len(source.told[0][0]) > 0


@pytest.mark.parametrize("threads", [1, 2])
def test_what_a_flying_camera_sees_is_told_with_the_next_frame(threads):
    particles = cloud(60, radius=0.05)
    scene = luxel.Scene(particles)
    path = [luxel.Camera.framing(particles.bounds, azimuth=40.0 * k, aspect=1.0) for k in range(4)]
    expected = [visible_ids(scene, camera, (48, 48)).tolist() for camera in path]
    source = Witness(len(particles))

    def told():
        return [ids.tolist() for ids, _ in source.told]

    with Frames(scene, size=(48, 48), textures=source, threads=threads) as frames:
        for k, camera in enumerate(path):
            frames.draw(luxel.View(camera=camera))
            assert told() == expected[: max(1, k)]  # nobody knows yet that the camera flies
        assert frames.drawing
        frames.draw()
        assert told()[:4] == expected
        for (_, eye), camera in zip(source.told, path, strict=False):
            assert np.array_equal(eye, camera.eye)
        assert set(told()[-1]) >= set(expected[-1])


def test_shadows_are_those_of_single_rays():
    particles = cloud(60, radius=0.1)
    scene = luxel.Scene(particles, lights=(Sky(0.5), Sun((0.3, -0.5, 1.0), 2.0, 0.1)))
    view = luxel.View(camera=luxel.Camera.framing(particles.bounds, aspect=SIZE[0] / SIZE[1]), color="white")
    pictures = {}
    for shading in ("lambertian", "shadows"):
        with Frames(scene, view, SIZE, shading=shading, threads=1, antialias=1) as frames:
            pictures[shading] = frames.draw().pixels.astype(int).sum(axis=2)
    plain = luxel.render(scene.with_changes(model="lambertian"), view, size=SIZE, antialias=1)
    spheres = SphereSet.of(particles)
    hit = plain.ids >= 0
    eye = spheres.to_unit(view.camera.eye)
    right, up, forward = view.camera.basis()
    x, y = np.meshgrid(
        (np.arange(SIZE[0]) + 0.5) / SIZE[0] * 2 - 1, 1 - (np.arange(SIZE[1]) + 0.5) / SIZE[1] * 2
    )
    half = np.tan(np.radians(view.camera.fov) / 2)
    ray = forward + (x * half * SIZE[0] / SIZE[1])[..., None] * right + (y * half)[..., None] * up
    ray /= np.linalg.norm(ray, axis=2, keepdims=True)
    points = (eye + ray * (plain.depth / spheres.unit)[..., None])[hit].astype(np.float32)
    sun = np.asarray(scene.sources[1].direction, np.float32)
    normal = points - spheres.centers[plain.ids[hit]]
    facing = normal @ sun > 0
    towards = np.broadcast_to(sun, points.shape)
    blocked = seen_tree(scene, view).occluded(points, towards, skip=plain.ids[hit]) & facing
    darker = (pictures["shadows"] < pictures["lambertian"])[hit]
    assert blocked.sum() > 50
    grazing = np.abs(normal @ sun) < 0.02 * np.linalg.norm(normal, axis=1)
    assert (darker == blocked)[~grazing].mean() > 0.995
    assert np.array_equal(pictures["lambertian"], plain.pixels.astype(int).sum(axis=2))


@pytest.mark.parametrize(
    "bad",
    [{"size": (0, 3)}, {"antialias": 0}, {"shading": "phong"}, {"bake_budget_s": -1.0}, {"bake_budget_s": float("nan")}],
)  # fmt: skip
def test_bad_options(bad):
    with pytest.raises(InputError):
        Frames(luxel.Scene(cloud(5)), **{"size": SIZE, **bad})


def test_textures_of_other_particles_are_refused():
    textures = luxel.bake(luxel.Scene(cloud(5)), samples=1)
    with (
        pytest.raises(InputError, match="5 particles"),
        Frames(luxel.Scene(cloud(6)), textures=textures) as frames,
    ):
        frames.draw()
    with fake_session() as session, pytest.raises(InputError, match="its own"):
        Frames(session, textures=textures)


def test_fewer_particles_come_while_the_camera_flies():
    series = [cloud(3000), cloud(50)]
    with luxel.Session(series, threads=0) as session, Frames(session, size=SIZE, threads=2) as frames:
        for k in range(3):
            frames.draw(luxel.View(camera=luxel.Camera.framing(series[0].bounds, azimuth=30.0 * k)))
        session.set_frame(1)
        frame = frames.draw()
        assert 0 < frame.visible <= 50
        frames.draw()
        assert session.status().queued >= frame.visible


def test_what_fails_while_it_is_drawn_is_drawn_anew():
    particles = cloud(300)
    source, path = (
        Witness(len(particles)),
        [luxel.Camera.framing(particles.bounds, azimuth=30.0 * k) for k in range(3)],
    )
    with Frames(luxel.Scene(particles), size=SIZE, textures=source, threads=1) as frames:
        for camera in path:
            frames.draw(luxel.View(camera=camera))
        told, source.told = source.told, None  # the next telling, while the next frame is drawn, fails
        with pytest.raises(AttributeError):
            frames.draw()
        source.told = told
        *_, last = frames
        with Frames(luxel.Scene(particles), luxel.View(camera=path[-1]), SIZE, textures=source) as others:
            *_, expected = others
        assert np.array_equal(last.pixels, expected.pixels)
        assert last.visible == expected.visible


def test_a_baseline_after_textures_comes_to_rest():
    particles = cloud(300)
    scene = luxel.Scene(particles)
    textures = luxel.bake(scene, texels=8, samples=1)
    with Frames(scene, size=(48, 48), textures=textures, threads=1) as frames:
        *_, lit = frames
        frames.shading = "lambertian"
        for _ in range(20):
            plain = frames.draw()
        assert plain.final
        assert plain.visible == 0
        frames.shading = "textures"
        *_, again = frames
        assert np.array_equal(again.pixels, lit.pixels)
        assert again.visible == lit.visible > 0


@pytest.mark.parametrize("filtered", [False, True])
def test_rays_that_hit_nothing_read_nothing_that_is_not_there(filtered):
    """One of them has its end in the very middle of the units, where a texture's coordinates are not defined."""
    d = np.array([0.3227247553767158, -0.590735983304777, -0.7395131711443529])
    side = np.cross(d, [0, 0, 1.0])
    side /= np.linalg.norm(side)
    up = np.cross(side, d)
    positions = np.stack([0.9 * side, -0.9 * side, 0.06 * side, -0.06 * side, 0.06 * up, -0.06 * up])
    particles = luxel.Particles(positions, np.array([0.001] * 2 + [0.05] * 4))
    spheres = SphereSet.of(particles)
    camera = luxel.Camera(eye=spheres.center + spheres.unit * d, target=spheres.center, fov=60.0)
    codes = np.full((6, 16, 16), 99, np.uint8)
    textures = luxel.LuminanceTextures(np.arange(6, dtype=np.int32), codes, 1.0, "linear", 6, "key")
    with Frames(
        luxel.Scene(particles), luxel.View(camera=camera), (31, 31), textures=textures, filtered=filtered
    ) as frames:
        assert frames.draw().visible >= 4


def test_a_sphere_beyond_the_precision_of_rays_is_drawn():
    particles = luxel.Particles(np.array([[-1, -0.3, 0], [1, 0.3, 0], [0, 0, 0]]), np.array([0.2, 0.2, 1e-9]))
    camera = luxel.Camera(eye=(0, 0, 5), target=(0, 0, 0), up=(0, 1, 0), height=1.0)
    codes = np.full((3, 16, 16), 99, np.uint8)
    textures = luxel.LuminanceTextures(np.arange(3, dtype=np.int32), codes, 1.0, "linear", 3, "key")
    with Frames(luxel.Scene(particles), luxel.View(camera=camera), (1, 1), textures=textures) as frames:
        assert frames.draw().ready == 1
