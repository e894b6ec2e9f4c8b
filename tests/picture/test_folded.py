"""Several rays a pixel at once against as many pictures with one ray a pixel."""

from __future__ import annotations

import numpy as np
import pytest

import luxel
from luxel.kernels import FIRST_LIGHT
from luxel.kernels.tone import develop_rows
from luxel.light.world import make_world
from luxel.picture.drawing import (
    NO_NEAREST,
    NONE_BLANK,
    Crew,
    bare_table,
    draw_folded,
    draw_rays,
    make_eye,
    make_skin,
    make_tone,
    ray_shifts,
    trace_primary,
)
from luxel.textures.textures import TextureTable
from luxel.trace.spheres import SphereSet

COUNT = 900


def _table(rng: np.random.Generator) -> TextureTable:
    """Textures, first light and neither, mixed."""
    slot = rng.choice(np.array([-1, FIRST_LIGHT, 0, 1, 2], np.int32), COUNT)
    codes = rng.integers(0, 256, (3, 16, 16)).astype(np.uint8)
    return TextureTable(
        slot, codes, bare_table(COUNT).decoding, "latlong", rng.random((COUNT, 4)).astype(np.float32)
    )


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize(("antialias", "size"), [(2, (61, 40)), (3, (64, 48)), (3, (33, 70)), (5, (19, 24))])
def test_sums_are_those_of_single_rays(antialias: int, size: tuple[int, int], orthographic: bool) -> None:
    rng = np.random.default_rng(antialias)
    particles = luxel.Particles(rng.uniform(-1, 1, (COUNT, 3)), rng.uniform(0.02, 0.1, COUNT))
    world = make_world(luxel.Scene(particles))
    width, height = size
    camera = luxel.Camera.framing(particles.bounds, aspect=width / height, orthographic=orthographic)
    eye = make_eye(camera, SphereSet.of(particles), width / height)
    skin = make_skin(_table(rng), rng.random((COUNT, 3)).astype(np.float32))
    expected, found = (np.zeros((height, width, 5), np.float32) for _ in range(2))
    nearest = (np.empty((height, width), np.float32), np.empty((height, width), np.int32))
    crew = Crew(2)
    for shift in ray_shifts(antialias):
        draw_rays(world.tree, world.lights, eye, shift, skin, expected, crew)
    draw_folded(
        world.tree, world.lights, eye, antialias, skin, crew, total=found, nearest=nearest if antialias % 2 else NO_NEAREST
    )  # fmt: skip
    np.testing.assert_array_equal(found, expected)
    # Without sums that outlive a block, the same picture.
    tone = make_tone(luxel.Scene(particles), luxel.View())
    shown, kept = (np.empty((height, width, 3), np.uint8) for _ in range(2))
    draw_folded(world.tree, world.lights, eye, antialias, skin, crew, tone=tone, picture=shown)
    crew.close()
    develop_rows(expected, NONE_BLANK, antialias**2, tone, 0, height, kept)
    np.testing.assert_array_equal(shown, kept)
    covered = (found[:, :, 4] == antialias**2).mean()
    assert 0.05 < covered < 0.95, "nothing to test"
    if antialias % 2:
        distance, ids = trace_primary(world, eye, width, height, (0.5, 0.5), 1)
        np.testing.assert_array_equal(nearest[0], distance)
        np.testing.assert_array_equal(nearest[1], ids)


def test_background_alone_stays_blank() -> None:
    particles = luxel.Particles([[0.0, 0.0, 0.0]], 0.1)
    camera = luxel.Camera((5, 0, 0), (10, 0, 0))  # looks away
    picture = luxel.render(particles, luxel.View(camera=camera), size=(40, 24))
    assert picture.ids is not None
    assert (picture.ids == -1).all()
    assert len(np.unique(picture.array.reshape(-1, 3), axis=0)) == 1


@pytest.mark.parametrize("orthographic", [False, True])
def test_rays_that_enter_the_tree_together_find_what_single_ones_find(orthographic: bool) -> None:
    rng = np.random.default_rng(8)
    count = 60_000  # four levels of tree, of which a close view cuts off three
    particles = luxel.Particles(rng.uniform(-1, 1, (count, 3)), rng.uniform(0.002, 0.02, count))
    world = make_world(luxel.Scene(particles))
    size = 40
    camera = luxel.Camera((1.3, 0.4, 0.5), (0.8, 0.1, 0.1), height=0.3 if orthographic else None)
    eye = make_eye(camera, SphereSet.of(particles), 1.0)
    nearest = (np.empty((size, size), np.float32), np.empty((size, size), np.int32))
    skin = make_skin(bare_table(count), np.ones((count, 3), np.float32))
    crew = Crew(1)
    draw_folded(
        world.tree,
        world.lights,
        eye,
        3,
        skin,
        crew,
        total=np.zeros((size, size, 5), np.float32),
        nearest=nearest,
    )
    crew.close()
    distance, ids = trace_primary(world, eye, size, size, (0.5, 0.5), 1)
    np.testing.assert_array_equal(nearest[0], distance)
    np.testing.assert_array_equal(nearest[1], ids)
    assert len(np.unique(ids)) > 100
