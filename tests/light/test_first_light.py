"""Coarse records: exact where light is linear in the normal, the same in any batch, close to the textures they stand in for."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np

import luxel
from luxel.light.records import RecordBook
from luxel.light.world import make_world
from luxel.picture.raytrace import render
from luxel.textures.bake import Baker
from luxel.textures.spec import TextureSpec
from luxel.textures.textures import FIRST_LIGHT, TextureTable, decoding_table
from tests.scenes import cloud


def ids_of(*values: int) -> np.ndarray:
    return np.array(values, np.int32)


def test_a_lone_particle_under_a_gradient_sky_has_its_closed_form():
    # Sky of level (1 + z) / 2 from pole to pole: irradiance / π is 1/2 + z/3.
    scene = luxel.Scene(
        luxel.Particles([[0, 0, 0]], 1.0), lights=[luxel.Sky(1.0, ground=0.0)], model="shadows"
    )
    records = np.mean(
        [RecordBook(make_world(scene, seed=s)).first_light(ids_of(0))[0] for s in range(60)], axis=0
    )
    np.testing.assert_allclose(records, [0.5, 0, 0, 1 / 3], atol=0.03)


def test_half_buried_particles_are_fitted_to_what_is_exposed():
    # The lower half of particle 0 lies inside a huge black sphere: (1 + nz) / 2 of the sky is left to the upper half.
    particles = luxel.Particles([[0, 0, 0], [0, 0, -500]], [1.0, 500.0])
    scene = luxel.Scene(particles, lights=[luxel.Sky(1.0)], model="shadows")
    records = np.mean(
        [RecordBook(make_world(scene, seed=s)).first_light(ids_of(0))[0] for s in range(60)], axis=0
    )
    np.testing.assert_allclose(records, [0.5, 0, 0, 0.5], atol=0.12)


def test_entirely_buried_particles_are_black():
    scene = luxel.Scene(luxel.Particles([[0, 0, 0], [0, 0, 0.2]], [0.1, 1.0]))
    assert RecordBook(make_world(scene)).first_light(ids_of(0)).tolist() == [[0, 0, 0, 0]]


def test_records_are_the_same_in_any_batch_and_thread():
    particles = cloud(150, radius=0.1)
    world = make_world(luxel.Scene(particles))
    ids = np.arange(150, dtype=np.int32)
    whole = RecordBook(world).first_light(ids)
    book = RecordBook(world)
    assert whole.shape == (150, 4)
    assert whole.dtype == np.float32
    assert (whole[:, 0] >= 0).all()
    order = np.random.default_rng(0).permutation(ids).astype(np.int32)
    with ThreadPoolExecutor(4) as pool:
        parts = list(pool.map(lambda k: book.first_light(order[k : k + 7]), range(0, 150, 7)))
    assert np.array_equal(np.concatenate(parts), whole[order])


def crack() -> luxel.Particles:
    """A slab of touching spheres with a deep crack across it."""
    grid = np.stack(np.meshgrid(*[np.arange(n) for n in (14, 14, 6)], indexing="ij"), -1).reshape(-1, 3)
    return luxel.Particles(grid[(abs(grid[:, 0] - 6.5) > 1) | (grid[:, 2] < 1)].astype(float), 0.52)


def test_a_picture_of_coarse_records_is_close_to_one_of_textures():
    particles = crack()
    scene = luxel.Scene(
        particles, lights=[luxel.Sky(1.0), luxel.Sun((1, 1, 2), level=2.0, angular_diameter=15)]
    )
    baker = Baker(scene, TextureSpec(samples=4, mode="fast"))
    records = baker.first_light(np.arange(len(particles), dtype=np.int32))

    class Coarse:
        key = baker.key

        def __init__(self, slot: int) -> None:
            self.slot = np.full(len(particles), slot, np.int32)

        def snapshot(self, key: str) -> TextureTable:
            codes = np.zeros((1, 16, 16), np.uint8)
            return TextureTable(self.slot, codes, decoding_table(baker.scale, "sqrt"), coarse=records)

        def sighted(self, ids: np.ndarray, eye: np.ndarray) -> None:
            """Nothing more comes."""

    view = luxel.View(camera=luxel.Camera((6.5, -16, 18), (6.5, 6.5, 4), fov=40))
    pictures = [
        render(scene, view, textures=source, size=(150, 110), antialias=2, samples=4)
        for source in (None, Coarse(FIRST_LIGHT), Coarse(-1))
    ]
    seen = pictures[0].ids >= 0
    textured, coarse, lambert = (each.array[seen][:, :3].astype(float) for each in pictures)
    flat = render(scene.with_changes(model="lambertian"), view, size=(150, 110), antialias=2)
    assert np.array_equal(pictures[2].array, flat.array)
    assert np.abs(coarse - textured).mean() < 0.6 * np.abs(lambert - textured).mean()
    assert abs((coarse - textured).mean()) < 0.25 * abs((lambert - textured).mean())
    assert abs((coarse - textured).mean()) < 2.0
