"""What frames have seen: counted while they draw, and by hand."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import luxel
from luxel.dynamic.look import Look
from luxel.errors import InputError
from luxel.kernels import FIRST_LIGHT, STALE
from luxel.kernels.jit import kernel
from luxel.kernels.seen import are_rising, count_slots
from luxel.kernels.simd import LANES
from luxel.kernels.tiles import RAYS, leaders
from luxel.light.world import make_world
from luxel.picture.drawing import Crew, bare_table, draw_rays, make_eye, make_skin, trace_primary
from luxel.picture.seen import SeenMarks
from luxel.trace.spheres import SphereSet


@kernel
def all_leaders(who):
    return leaders(who)


@pytest.mark.parametrize("threads", [1, 3])
def test_threads_together_list_every_particle_that_is_hit_once(threads: int) -> None:
    count = 10_000  # three blocks of marks, and a part of one
    particles = luxel.Particles(np.random.default_rng(3).uniform(-1, 1, (count, 3)), 0.02)
    world = make_world(luxel.Scene(particles))
    camera = luxel.Camera.framing(particles.bounds, aspect=1.0)
    eye = make_eye(camera, SphereSet.of(particles), 1.0)
    seen, found = SeenMarks(count, threads), np.empty(count, np.int32)
    total, skin = (
        np.zeros((150, 150, 5), np.float32),
        make_skin(bare_table(count), np.ones((count, 3), np.float32)),
    )
    crew = Crew(threads)

    def draw(shift: float) -> list[int]:
        draw_rays(world.tree, world.lights, eye, (shift, shift), skin, total, crew, seen=seen)
        ids: list[int] = found[: seen.list_into(found)].tolist()
        return ids

    def hit(shift: float) -> set[int]:
        return set(trace_primary(world, eye, 150, 150, (shift, shift), 1)[1].ravel().tolist()) - {-1}

    for _ in range(5):
        seen.clear()
        assert seen.list_into(found) == 0
        assert draw(0.5) == sorted(hit(0.5))
    # Until they are cleared, marks stay.
    assert draw(0.1) == sorted(hit(0.5) | hit(0.1))
    assert len(hit(0.5) | hit(0.1)) > len(hit(0.5)) > 500
    crew.close()


@pytest.mark.parametrize("threads", [1, 3])
def test_tallies_of_threads_together_are_those_of_what_they_list(threads: int) -> None:
    rng = np.random.default_rng(6)
    count = 9000
    particles = luxel.Particles(rng.uniform(-1, 1, (count, 3)), 0.03)
    world = make_world(luxel.Scene(particles))
    eye = make_eye(luxel.Camera.framing(particles.bounds, aspect=1.0), SphereSet.of(particles), 1.0)
    table = bare_table(count)
    skin = make_skin(table, np.ones((count, 3), np.float32))
    total, seen, found = (
        np.zeros((120, 120, 5), np.float32),
        SeenMarks(count, threads),
        np.empty(count, np.int32),
    )
    kinds = np.array([-1, FIRST_LIGHT, STALE + 3], np.int32)
    crew = Crew(1)

    def is_right() -> bool:
        there, *counts = seen.tally(table.slot)
        ids = found[: seen.list_into(found)]
        return there == len(ids) and tuple(counts) == count_slots(ids, table.slot)

    for round_ in range(6):
        table.slot[:] = rng.choice(kinds, count)
        if round_ == 3:
            seen.clear()
            assert is_right()
            assert seen.tally(table.slot)[0] == 0
        # Each thread draws all there is in its turn, so that all mark the same; in some rounds, not every thread draws.
        for row in range(threads if round_ % 2 else 1):
            one = SimpleNamespace(begin=lambda: None, of_thread=lambda _, row=row: seen.of_thread(row))
            draw_rays(world.tree, world.lights, eye, (0.5, 0.1 * round_), skin, total, crew, seen=one)
        assert is_right()
        assert seen.tally(table.slot)[0] > 500
        table.slot[:] = rng.choice(kinds, count)  # nothing drawn since
        assert is_right()
    crew.close()


def test_leaders_are_new_to_the_left_and_above() -> None:
    rng = np.random.default_rng(7)
    for kinds in (1, 2, 5, 100):
        room = rng.integers(-1, kinds, RAYS + LANES).astype(np.int32)
        who = room[LANES:]
        expected = 0
        for j, i in enumerate(who):
            left = who[j - 1] if j % 4 else -1
            above = who[j - 4] if j % 16 >= 4 else -1
            expected |= int(i not in (-1, left, above)) << j
        assert int(all_leaders(who)) % 2**64 == expected


def test_counts_of_slots() -> None:
    rng = np.random.default_rng(4)
    slot = rng.choice(np.array([-1, FIRST_LIGHT, 0, 5, STALE, STALE + 7], np.int32), 1000)
    ids = np.flatnonzero(rng.random(1000) < 0.3).astype(np.int32)
    there = slot[ids]
    *counts, digest = count_slots(ids, slot)
    assert counts == [
        ((there >= 0) & (there < STALE)).sum(),
        (there == FIRST_LIGHT).sum(),
        (there >= STALE).sum(),
    ]
    other = slot.copy()
    other[ids[7]] += 1
    assert count_slots(ids, other)[-1] != digest == count_slots(ids, slot)[-1]


@pytest.mark.parametrize(
    ("ids", "rising"),
    [([], True), ([0, 1, 9], True), ([0, 0, 1], False), ([3, 2], False), ([-1, 2], False), ([3, 10], False)],
)
def test_rising(ids: list[int], rising: bool) -> None:
    assert are_rising(np.array(ids, np.int32), 10) == rising


def test_a_look_takes_ids_in_any_order_and_refuses_others() -> None:
    spheres = SphereSet.of(luxel.Particles(np.arange(30.0).reshape(10, 3), 0.1))
    eye = np.array([4.0, 5.0, 6.0])
    look = Look.at(spheres, eye, 1.0, np.array([5, 2, 5, 1]), np.array([50, 20, 50, 10], np.float32))
    np.testing.assert_array_equal(look.visible, [1, 2, 5])
    distance, pixels = look(np.array([1, 5], np.int32))
    np.testing.assert_array_equal(pixels, [10, 50])
    centers = spheres.to_unit(np.arange(30.0).reshape(10, 3)[[1, 5]])
    np.testing.assert_allclose(
        distance, np.linalg.norm(centers - spheres.to_unit(eye), axis=1), rtol=1e-6, atol=1e-6
    )
    for bad in ([10], [-1]):
        with pytest.raises(InputError, match="ids must lie in 0"):
            Look.at(spheres, eye, 1.0, np.array(bad, np.int32), None)
