"""What frames have seen: counted while they draw, and by hand."""

from __future__ import annotations

import numpy as np
import pytest

import luxel
from luxel.dynamic.look import Look
from luxel.errors import InputError
from luxel.kernels import FIRST_LIGHT, STALE
from luxel.kernels.seen import are_rising, count_slots, list_seen
from luxel.light.world import make_world
from luxel.picture.drawing import Crew, bare_table, draw_rays, make_eye, make_skin
from luxel.textures.textures import TextureTable
from luxel.trace.spheres import SphereSet


@pytest.mark.parametrize("threads", [1, 3])
def test_threads_together_count_every_particle_once(threads: int) -> None:
    rng = np.random.default_rng(3)
    particles = luxel.Particles(rng.uniform(-1, 1, (4000, 3)), 0.03)
    world = make_world(luxel.Scene(particles))
    camera = luxel.Camera.framing(particles.bounds, aspect=1.0)
    eye = make_eye(camera, SphereSet.of(particles), 1.0)
    bare = bare_table(4000)
    slot = rng.choice(np.array([-1, FIRST_LIGHT, 0, STALE], np.int32), 4000)
    coarse = np.ones((4000, 4), np.float32)
    table = TextureTable(slot, bare.codes, np.tile(bare.decoding, 2), "latlong", coarse)
    seen, found = np.zeros(4000, np.uint8), np.empty(4000, np.int32)
    total = np.zeros((150, 150, 5), np.float32)
    crew = Crew(threads)
    for _ in range(5):
        seen[:] = 0
        count, *counts = draw_rays(
            world.tree, world.lights, eye, (0.5, 0.5), make_skin(table, np.ones((4000, 3), np.float32)), total, crew, seen=seen
        )  # fmt: skip
        ids = found[: list_seen(seen, found)]
        assert count == len(ids) > 500
        np.testing.assert_array_equal(ids, np.flatnonzero(seen))
        assert tuple(counts) == count_slots(ids, slot)
        there = slot[ids]
        expected = [
            ((there >= 0) & (there < STALE)).sum(),
            (there == FIRST_LIGHT).sum(),
            (there >= STALE).sum(),
        ]
        assert counts[:3] == expected
    # Nothing is new any more.
    assert draw_rays(
        world.tree, world.lights, eye, (0.5, 0.5), make_skin(table, np.ones((4000, 3), np.float32)), total, crew, seen=seen
    ) == [0] * 5  # fmt: skip
    crew.close()


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
