"""Sessions with a baker that costs nothing, and one with the real one."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
import pytest

import luxel
from luxel.dynamic.allotment import bytes_for
from luxel.dynamic.work import TileBatch
from luxel.errors import FrameError, InputError, SessionClosedError
from luxel.particles import Particles
from luxel.scene.lights import Sky
from luxel.scene.scene import Scene
from luxel.session import Session, Status
from luxel.textures.spec import DEFAULT_SAMPLES, TextureSpec, light_key

GUARD_S = 120.0  # only ever waited for when a test is about to fail
EYE = (10.0, 0.0, 0.0)
SPEC = TextureSpec(texels=4, mode="fast", samples=1)


class FakeBaker:
    def __init__(self, scene: Scene, spec: TextureSpec) -> None:
        self.value = len(scene.particles) + round(100 * scene.albedo)

    def first_light(self, ids: np.ndarray) -> np.ndarray:
        return np.repeat(ids[:, None] % 251, 4, axis=1).astype(np.float32)

    def preparation(self, threads: int) -> Iterator[None]:
        return iter(())  # nothing to learn

    def bake_into(self, ids: np.ndarray, codes: np.ndarray) -> int:
        codes[:] = ((ids + self.value) % 256).astype(np.uint8)[:, None, None]
        return 0


class Clock:
    now_s = 50.0

    def __call__(self) -> float:
        return self.now_s


def cloud(count: int = 100, seed: int = 0) -> Particles:
    return Particles(np.random.default_rng(seed).random((count, 3)), 0.02)


def open_session(series=None, **options) -> Session:
    options = {"spec": SPEC, "threads": 0, "make_baker": FakeBaker, **options}
    return Session(cloud() if series is None else series, **options)


class Frames(list):
    """A series: frame 0 is empty."""

    def first_frame(self) -> int:
        return 1


def frames() -> Frames:
    return Frames([Particles(np.empty((0, 3)), 1.0), cloud(100), cloud(40, seed=1)])


def test_a_session_starts_with_the_first_frame_that_has_particles():
    series = frames()
    with open_session(series) as session:
        assert session.series is series
        assert session.frame == 1
        assert session.particles is series[1]
        assert session.key == light_key(session.scene, SPEC)
        assert session.status() == Status(session.key, 100)


def test_particles_make_a_series_of_one():
    particles = cloud()
    with open_session(particles) as session:
        assert len(session.series) == 1
        assert session.series[0] is particles


def test_a_scene_brings_its_light():
    scene = Scene(cloud(), [Sky(0.5)], "ao", 0.25)
    with open_session(scene) as session:
        assert session.scene is scene
        assert session.key == light_key(scene, SPEC)


def test_the_default_spec_is_fast():
    with Session(cloud(), threads=0) as session:
        assert session.spec == TextureSpec(mode="fast", samples=DEFAULT_SAMPLES["fast"]["view"])
        assert session.encoding == "sqrt"


def test_sighted_particles_become_ready_and_nobody_else():
    with open_session() as session:
        heard: list[TileBatch] = []
        session.subscribe(heard.append)
        session.sighted([5, 3, 3, 8], EYE)
        status = session.status()
        assert (status.queued, status.ready) == (3, 0)
        assert session.wait()
        status = session.status()
        assert (status.queued, status.baking, status.ready) == (0, 0, 3)
        assert status.textures_per_s > 0
        assert sorted(np.concatenate([batch.ids for batch in heard]).tolist()) == [3, 5, 8]
        batch = session.tiles([8, 9, 3])
        assert batch.key == session.key
        assert batch.ids.tolist() == [8, 3]
        assert batch.codes.shape == (2, 4, 4)
        assert batch.codes[:, 0, 0].tolist() == [8 + 170, 3 + 170]


def test_a_renderer_may_fill_its_list_of_ids_anew():
    with open_session() as session:
        found = np.arange(100, dtype=np.int32)
        session.sighted(found[:5], EYE)
        found[:] = 99
        session.wait()
        assert session.tiles(range(100)).ids.tolist() == [0, 1, 2, 3, 4]


def test_widths_go_with_their_ids():
    with open_session() as session:
        with pytest.raises(InputError, match="pixels"):
            session.sighted([1, 2], EYE, pixels=[3.0])
        session.sighted([7, 3, 7, 5], EYE, pixels=[70.0, 30.0, 70.0, 50.0])
        (sighting,) = session._cache.sightings.values()
        assert sighting.ids.tolist() == [3, 5, 7]
        assert sighting.measure(np.array([3, 7], np.int32))[1].tolist() == [30.0, 70.0]


def test_the_nearest_to_the_eye_come_first():
    particles = Particles(np.array([[0.0, 0, 0], [5.0, 0, 0], [9.0, 0, 0]]) + 1e6, 0.1)
    with open_session(particles) as session:
        order: list[int] = []
        session.subscribe(lambda batch: order.extend(batch.ids.tolist()))
        session.sighted([0, 1, 2], np.array(EYE) + 1e6)
        session.wait()
        assert order == [2, 1, 0]


def test_lambertian_needs_no_textures():
    with open_session(model="lambertian") as session:
        session.sighted([1, 2], EYE)
        assert session.status().queued == 0
        assert len(session.tiles([1, 2])) == 0
        session.relight(model="shadows")
        session.sighted([1, 2], EYE)
        assert session.status().queued == 2


def test_undoing_a_change_of_light_finds_the_textures_again():
    with open_session() as session:
        first = session.key
        session.sighted([1, 2], EYE)
        session.wait()
        second = session.relight(albedo=0.3)
        assert second != first
        assert session.scene.albedo == 0.3
        assert session.status().ready == 0
        assert len(session.tiles([1, 2])) == 0
        stale = session.tiles([1, 2], first)
        assert stale.stale
        assert stale.ids.tolist() == [1, 2]
        assert session.relight(albedo=0.7) == first
        assert session.status().ready == 2


def test_a_change_of_light_cancels_what_waits():
    with open_session() as session:
        first = session.key
        session.sighted(range(50), EYE)
        session.relight(lights=[Sky(2.0)])
        session.wait()
        assert len(session.tiles(range(50), first)) == 0
        assert session.status().ready == 0


def test_a_sighting_under_an_old_key_is_ignored():
    with open_session() as session:
        first = session.key
        session.relight(albedo=0.1)
        session.sighted([1], EYE, key=first)
        assert session.status().queued == 0
        session.sighted([1], EYE, key=session.key)
        assert session.status().queued == 1


def test_a_second_model_is_lit_beside_the_first_and_follows_it():
    heard: list[TileBatch] = []
    with open_session(frames(), model="ao") as session:
        session.subscribe(heard.append)
        assert session.key_beside is None
        beside = session.compare("shadows")
        assert session.scene_beside.model == "shadows"
        assert beside == light_key(session.scene_beside, SPEC) != session.key
        session.sighted([1, 2, 3], EYE, "page", session.key)
        session.sighted([3, 4], EYE, "page, beside", beside)
        session.sighted([5], EYE, "page, beside", "no such key")
        assert session.wait(GUARD_S)
        assert sorted(session.tiles(range(100)).ids.tolist()) == [1, 2, 3]
        there = session.tiles(range(100), beside)
        assert sorted(there.ids.tolist()) == [3, 4]
        assert not there.stale
        assert {(batch.key, batch.stale) for batch in heard} == {(session.key, False), (beside, False)}
        assert sorted(session.first_light(range(100)).ids.tolist()) == [
            1,
            2,
            3,
        ]  # not lost to the second light
        assert not len(session.first_light(range(100), beside).ids)
        session.relight(albedo=0.5)
        assert session.key_beside == light_key(session.scene.with_changes(model="shadows"), SPEC)
        session.set_frame(2)
        assert len(session.scene_beside.particles) == 40
        assert session.compare(None) is None
        assert session.scene_beside is None


def test_comparing_a_model_with_itself_bakes_once():
    with open_session() as session:
        assert session.compare(session.scene.model) == session.key
        session.sighted([1, 2], EYE, "a", session.key)
        session.sighted([2, 3], EYE, "b", session.key)
        assert session.wait(GUARD_S)
        assert sorted(session.tiles(range(100)).ids.tolist()) == [1, 2, 3]
        assert session.status().ready == 3


def test_a_second_model_that_cannot_be_is_refused():
    with open_session() as session:
        with pytest.raises(InputError, match="model"):
            session.compare("flat")
        assert session.key_beside is None


def test_relight_changes_only_what_is_given():
    with open_session(lights=[Sky(0.5)], model="ao", albedo=0.4, ao_distance=2.0) as session:
        session.relight(albedo=0.6)
        scene = session.scene
        assert (scene.model, scene.albedo, scene.ao_distance, scene.sources[0].level) == ("ao", 0.6, 2.0, 0.5)
        session.relight(ao_distance=None)
        assert session.scene.ao_distance is None


def test_a_bad_change_leaves_the_session_as_it_was():
    with open_session() as session:
        key = session.key
        with pytest.raises(InputError, match="albedo"):
            session.relight(albedo=2.0)
        assert session.key == key
        session.sighted([1], EYE)
        assert session.wait()


def test_frames_change_under_the_same_light():
    with open_session(frames(), albedo=0.2) as session:
        first = session.key
        session.sighted(range(100), EYE)
        session.wait()
        session.set_frame(2)
        assert (session.frame, len(session.particles), session.scene.albedo) == (2, 40, 0.2)
        assert session.status().particles == 40
        assert session.source.snapshot(session.key).slot.shape == (40,)
        assert session.source.snapshot(first).slot.shape == (100,)
        assert len(session.tiles([99], first)) == 1
        assert session.set_frame(1) == first
        assert session.status().ready == 100


@pytest.mark.parametrize("frame", [-1, 3, 1.5])
def test_frames_outside_the_series_are_refused(frame):
    with open_session(frames()) as session:
        with pytest.raises(FrameError, match=r"no frame .* there are 3"):
            session.set_frame(frame)
        assert session.frame == 1
    with pytest.raises(FrameError):
        open_session(frames(), frame=frame)


def test_an_empty_frame_is_refused_and_the_session_stays():
    with open_session(frames()) as session:
        with pytest.raises(InputError, match="no particles"):
            session.set_frame(0)
        assert session.frame == 1


@pytest.mark.parametrize(
    "ids, eye", [([100], EYE), ([-1], EYE), ([0.5], EYE), ([1], (0, 0)), ([1], (0, 0, np.nan))]
)
def test_bad_sightings_are_refused(ids, eye):
    with open_session() as session, pytest.raises(InputError):
        session.sighted(ids, eye)


def test_requests_of_a_client_that_leaves_are_withdrawn():
    with open_session() as session:
        session.sighted([1, 2], EYE, "ann")
        session.sighted([2, 3], EYE, "bob")
        session.forget("ann")
        session.wait()
        assert session.tiles([1, 2, 3]).ids.tolist() == [2, 3]


def test_the_rate_is_over_the_last_seconds():
    clock = Clock()
    with open_session(clock=clock) as session:
        session.sighted(range(30), EYE)
        session.wait()
        assert session.status().textures_per_s == pytest.approx(10)
        clock.now_s += 10
        assert session.status().textures_per_s == 0


def test_a_view_larger_than_the_budget_is_reported():
    with open_session(max_bytes=bytes_for(40, SPEC.texels, 100)) as session:
        session.sighted(range(100), EYE)
        session.wait()
        status = session.status()
        assert (status.ready, status.over_budget) == (40, 60)
        session.sighted(range(50, 60), EYE)
        session.wait()
        assert session.status().over_budget == 0
        assert session.status().evicted >= 1


def test_a_baker_that_fails_shows_in_the_status():
    def broken(scene, spec):
        raise MemoryError("no room")

    with open_session(make_baker=broken) as session:
        session.sighted([1], EYE)
        session.wait()
        assert session.status().error == "MemoryError: no room"
        assert session.status().queued == 0


def test_bakers_are_made_on_the_engine_not_in_sighted():
    made = []

    def maker(scene, spec):
        made.append((scene, spec))
        return FakeBaker(scene, spec)

    with open_session(make_baker=maker) as session:
        session.sighted([1], EYE)
        assert not made
        session.run_for(1.0)
        assert made == [(session.scene, SPEC)]
        assert session.status().ready == 1


def test_a_closed_session_says_so():
    session = open_session(threads=2)
    session.sighted(range(50), EYE)
    session.close()
    session.close()
    for use in (
        lambda: session.sighted([1], EYE),
        lambda: session.tiles([1]),
        lambda: session.relight(albedo=0.1),
        lambda: session.set_frame(0),
        lambda: session.subscribe(print),
        lambda: session.wait(),
    ):
        with pytest.raises(SessionClosedError, match="closed"):
            use()


def test_status_is_a_value():
    with open_session() as session, pytest.raises(dataclasses.FrozenInstanceError):
        session.status().ready = 3


@pytest.mark.parametrize("mode", ["paper", "fast"])
def test_a_session_gives_the_bytes_of_a_bake(mode):
    particles = cloud(60)
    spec = TextureSpec(texels=8, samples=4, mode=mode)
    expected = luxel.bake(Scene(particles), texels=8, samples=4, mode=mode, threads=1)
    with Session(particles, spec=spec, threads=3) as session:
        assert session.key == expected.key
        assert (session.scale, session.encoding) == (expected.scale, expected.encoding)
        for start in (0, 7, 30):
            session.sighted(range(start, 60, 2), EYE)
            assert session.wait(GUARD_S)
        assert session.status().error is None
        batch = session.tiles(range(60))
        assert len(batch) >= 50
        assert (batch.codes == expected.codes[batch.ids]).all()
