"""Pictures: colours stay true, textures approach path-traced pixels, options are checked."""

import numpy as np
import pytest

import luxel
from luxel.errors import InputError
from luxel.picture.raytrace import render
from luxel.scene.colormap import srgb_to_linear
from tests.scenes import cloud

SIZE = (120, 90)


@pytest.mark.parametrize("light", ["texture", "pixel"])
def test_every_pixel_has_the_chromaticity_of_the_colour_map(light):
    # Over-lit pixels included: exposure 30 drives most of the picture to the top of the tone curve.
    particles = cloud(80)
    scene = luxel.Scene(particles)
    for exposure in (0.3, 1.0, 30.0):
        view = luxel.View(color_by="value", colormap="plasma", exposure=exposure, background="black")
        image = render(scene, view, size=SIZE, light=light, samples=4, antialias=1, colorbar=False)
        seen = image.ids >= 0
        pixel = srgb_to_linear(image.array[seen][:, :3] / 255.0)
        expected = view.colors(particles)[image.ids[seen]]
        brightness = pixel.sum(axis=1)
        bright = brightness > 0.15
        assert bright.sum() > 300
        got = pixel[bright] / brightness[bright, None]
        want = expected[bright] / expected[bright].sum(axis=1, keepdims=True)
        assert np.abs(got - want).max() < 0.02


def test_a_white_particle_beside_a_red_one_stays_white():
    particles = luxel.Particles([[0, 0, 0], [0.9, 0, 0]], 0.5, {"kind": [0, 1]})
    view = luxel.View(color_by="kind", colormap="Reds", range=(0, 1), background="black")
    image = render(luxel.Scene(particles), view, size=SIZE, samples=16, antialias=1, colorbar=False)
    white = image.array[image.ids == 0].astype(int)
    reference = view.lut()[0].astype(int)
    shift = (white[:, 0] - white[:, 2]) - (reference[0] - reference[2]) * white.max(axis=1) / reference.max()
    assert np.abs(shift).max() <= 2


def test_textures_approach_path_traced_pixels():
    # 22.5 degree texels and 8 bits are bias; docs/light.md states its size on a real data set.
    particles = cloud(200, radius=0.07, seed=5)
    scene = luxel.Scene(particles)
    view = luxel.View()
    truth = render(scene, view, size=SIZE, light="pixel", samples=256, antialias=2, seed=1).array.astype(
        float
    )
    picture = render(scene, view, size=SIZE, samples=64, antialias=2)
    seen = picture.ids >= 0
    difference = (picture.array.astype(float) - truth)[seen]
    lambert = render(scene.with_changes(model="lambertian"), view, size=SIZE, antialias=2).array.astype(float)
    assert np.sqrt((difference**2).mean()) < 12
    assert np.sqrt((difference**2).mean()) < 0.35 * np.sqrt(((lambert - truth)[seen] ** 2).mean())
    assert abs(difference.mean()) < 5


def test_a_bake_of_the_scene_draws_the_same_picture_as_baking_on_demand():
    particles = cloud(60)
    scene = luxel.Scene(particles)
    textures = luxel.bake(scene, samples=4, mode="fast")
    view = luxel.View(color_by="value")
    a = render(scene, view, textures=textures, size=SIZE).array
    assert np.array_equal(a, render(scene, view, size=SIZE, samples=4, mode="fast").array)
    assert np.array_equal(a, render(scene, view, textures=textures, size=SIZE, threads=7).array)


def test_particles_without_textures_are_lambert():
    particles = cloud(60)
    scene = luxel.Scene(particles)
    none = luxel.bake(scene, [], samples=1)
    flat = render(scene.with_changes(model="lambertian"), size=SIZE)
    assert np.array_equal(render(scene, textures=none, size=SIZE).array, flat.array)


def test_textures_of_other_particles_are_refused():
    textures = luxel.bake(luxel.Scene(cloud(5)), samples=1)
    with pytest.raises(InputError, match="5 particles"):
        render(luxel.Scene(cloud(6)), textures=textures, size=SIZE)


@pytest.mark.parametrize(
    "bad", [{"size": (0, 5)}, {"size": "x"}, {"size": (10**6, 10**6)}, {"light": "sun"}, {"samples": 0}, {"samples": 5, "mode": "paper"}, {"antialias": 0},
            {"seed": -1}, {"light": "pixel", "seed": -1}, {"light": "pixel", "seed": 2**64}, {"light": "pixel", "samples": 0}, {"mode": "quick"}],
)  # fmt: skip
def test_bad_options(bad):
    with pytest.raises(InputError):
        render(luxel.Scene(cloud(5)), **{"size": SIZE, **bad})


def test_depth_is_in_file_units():
    image = render(
        luxel.Scene(luxel.Particles([[0, 0, 0]], 100.0)),
        luxel.View(camera=luxel.Camera([500, 0, 0], [0, 0, 0])),
        size=(65, 65),
        samples=1,
    )
    assert image.depth[32, 32] == pytest.approx(400, rel=1e-5)
    assert np.isinf(image.depth[0, 0])
