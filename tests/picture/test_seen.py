"""What frames have seen: counted while they draw, and by hand."""

from __future__ import annotations

import numpy as np
import pytest

import luxel
from luxel.dynamic.look import Look
from luxel.errors import InputError
from luxel.kernels import FIRST_LIGHT, STALE
from luxel.kernels.seen import are_rising, count_slots
from luxel.light.world import make_world
from luxel.picture.drawing import Crew, bare_table, draw_rays, make_eye, make_skin, trace_primary
from luxel.picture.seen import SeenMarks
from luxel.trace.spheres import SphereSet


@pytest.mark.parametrize("threads", [1, 3])
def test_threads_together_list_every_particle_that_is_hit_once(threads: int) -> None:
    count = 10_000  # three blocks of marks, and a part of one
    particles = luxel.Particles(np.random.default_rng(3).uniform(-1, 1, (count, 3)), 0.02)
    world = make_world(luxel.Scene(particles))
    camera = luxel.Camera.framing(particles.bounds, aspect=1.0)
    eye = make_eye(camera, SphereSet.of(particles), 1.0)
    seen, found, slot = SeenMarks(count, threads), np.empty(count, np.int32), np.zeros(count, np.int32)
    total, skin = (
        np.zeros((150, 150, 5), np.float32),
        make_skin(bare_table(count), np.ones((count, 3), np.float32)),
    )
    crew = Crew(threads)

    def draw(shift: float) -> list[int]:
        draw_rays(world.tree, world.lights, eye, (shift, shift), skin, total, crew, seen=seen)
        ids: list[int] = found[: seen.list_into(found, slot)].tolist()
        return ids

    def hit(shift: float) -> set[int]:
        return set(trace_primary(world, eye, 150, 150, (shift, shift), 1)[1].ravel().tolist()) - {-1}

    for _ in range(5):
        seen.clear()
        assert seen.list_into(found, slot) == 0
        assert draw(0.5) == sorted(hit(0.5))
    # Until they are cleared, marks stay.
    assert draw(0.1) == sorted(hit(0.5) | hit(0.1))
    assert len(hit(0.5) | hit(0.1)) > len(hit(0.5)) > 500
    crew.close()


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
