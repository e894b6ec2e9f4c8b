"""Hidden particles in pictures, under both rules for light."""

import numpy as np
import pytest

import luxel
from luxel import Cut, Particles, Scene, Select, Sky, Sun, View, render
from luxel.picture.raytrace import visible_ids
from luxel.scene.camera import Camera
from luxel.trace.reference import ReferenceTracer
from luxel.trace.spheres import SphereSet
from luxel.trace.tree import SphereTree
from tests.scenes import cloud, random_rays

SIZE = (64, 48)
PIXEL = {"light": "pixel", "samples": 4, "antialias": 1, "colorbar": False}


def block() -> Particles:
    """A cloud whose corners are held by tiny spheres, so that its bounds stay whatever else is left out."""
    inner = cloud(300, radius=0.08)
    corners = np.array([[x, y, z] for x in (-0.2, 1.2) for y in (-0.2, 1.2) for z in (-0.2, 1.2)])
    positions = np.concatenate([corners, inner.positions])
    radii = np.concatenate([np.full(8, 1e-3), inner.radii]).astype(np.float32)
    value = np.concatenate([np.full(8, 0.5), inner.scalars["value"]])
    return Particles(positions, radii, {"value": value})


CONDITIONS = (Select("value", 0.3, 0.9), Cut("x", 1.3))


def subset(particles: Particles, keep: np.ndarray) -> Particles:
    return Particles(
        particles.positions[keep], particles.radii[keep], {"value": particles.scalars["value"][keep]}
    )


@pytest.mark.parametrize("light", ["pixel", "texture"])
@pytest.mark.parametrize("rule", ["keeps", "opens"])
def test_hidden_particles_are_not_drawn_and_all_keep_their_ids(light, rule):
    particles = block()
    gone = View(hide=CONDITIONS).hidden(particles)
    scene, view = Scene(particles, model="shadows"), View()
    if rule == "opens":
        scene = scene.with_changes(hide=CONDITIONS)
    else:
        view = view.with_changes(hide=CONDITIONS)
    found = render(scene, view, size=SIZE, light=light, samples=1, antialias=1)
    seen = np.unique(found.ids[found.ids >= 0])
    assert len(seen) > 50
    assert not gone[seen].any()
    kept = np.flatnonzero(~gone)
    bare = render(Scene(subset(particles, kept), model="lambertian"), View(), size=SIZE, antialias=1)
    expected = np.where(bare.ids >= 0, kept[bare.ids], -1)
    assert np.array_equal(found.ids, expected)


@pytest.mark.parametrize("model", ["shadows", "ao", "interreflection"])
def test_opened_light_is_that_of_a_file_without_the_hidden_particles(model):
    particles = block()
    kept = np.flatnonzero(~View(hide=CONDITIONS).hidden(particles))
    opened = render(Scene(particles, model=model, hide=CONDITIONS), size=SIZE, **PIXEL)
    alone = render(Scene(subset(particles, kept), model=model), size=SIZE, **PIXEL)
    assert np.array_equal(opened.pixels, alone.pixels)


def test_kept_light_is_that_of_the_whole():
    """Whatever is still in sight looks as it did; what the hidden ones covered lies in their shadow."""
    particles = block()
    scene = Scene(particles)
    view = View(hide=Cut("-y", -0.3))  # away with the front
    kept = render(scene, view, size=SIZE, **PIXEL)
    whole = render(scene, View(), size=SIZE, **PIXEL)
    same = (kept.ids == whole.ids) & (kept.ids >= 0)
    assert same.sum() > 50
    assert np.array_equal(kept.pixels[same], whole.pixels[same])
    opened = render(scene.with_changes(hide=Cut("-y", -0.3)), View(), size=SIZE, **PIXEL)
    assert np.array_equal(opened.ids, kept.ids)
    revealed = (kept.ids >= 0) & ~same
    assert revealed.sum() > 50
    assert kept.pixels[revealed].mean() < 0.8 * opened.pixels[revealed].mean()


def test_textures_of_both_rules_are_those_that_a_source_holds():
    """A cut that keeps light is drawn from textures that know nothing of it."""
    particles = block()
    camera = Camera.framing(particles.bounds)
    scene = Scene(particles, model="ao")
    view = View(camera=camera, hide=Cut("-y", -0.3))
    textures = luxel.bake(scene, samples=1)
    straight = render(scene, view, size=SIZE, samples=1, mode="paper", antialias=1)
    assert np.array_equal(render(scene, view, textures, SIZE, antialias=1).pixels, straight.pixels)
    opened = scene.with_changes(hide=view.hide)
    baked = luxel.bake(opened, samples=1)
    assert np.array_equal(baked.ids, np.flatnonzero(~opened.hidden))
    assert set(visible_ids(opened, camera, SIZE)) <= set(baked.ids)


@pytest.mark.parametrize("rule", ["keeps", "opens"])
def test_everything_hidden_leaves_the_background(rule):
    scene, view = Scene(cloud()), View(background="#336699", color_by="value")
    if rule == "opens":
        scene = scene.with_changes(hide=Cut("x", -9))
        assert len(luxel.bake(scene, samples=1).ids) == 0
    else:
        view = view.with_changes(hide=Cut("x", -9))
    found = render(scene, view, size=SIZE, colorbar=False)
    assert (found.ids == -1).all()
    assert (found.pixels == np.array([0x33, 0x66, 0x99])).all()


def test_a_hidden_sphere_lets_light_through_a_periodic_cell():
    cell = luxel.Cell(np.eye(3) * 2, np.zeros(3))
    positions = [[1.0, 1.0, 0.5], [1.0, 1.0, 1.5]]
    particles = Particles(positions, [0.3, 0.8], {"kind": [0, 1]}, cell=cell)
    scene = Scene(particles, [Sun((0, 0, 1), angular_diameter=5), Sky(0.0)], "shadows", periodic="xy")
    lit = [
        luxel.bake(each, [0], samples=9, threads=1).luminance.max()
        for each in (scene, scene.with_changes(hide=Select("kind", 0, 0)))
    ]
    assert lit[0] == 0
    assert lit[1] > 0.9


def test_the_tree_of_some_is_the_reference_without_the_others():
    particles = cloud(400, spread=1.0)
    hidden = np.random.default_rng(3).random(400) < 0.6
    spheres = SphereSet.of(particles)
    origins, directions, skip = random_rays(particles, 2000)
    kept = np.flatnonzero(~hidden)
    place = np.full(401, -1, np.int32)
    place[kept] = np.arange(len(kept))
    reference = ReferenceTracer(
        SphereSet(spheres.centers[kept], spheres.radii[kept], spheres.center, spheres.unit)
    )
    tree = SphereTree.of(spheres, hidden)
    distance, ids = tree.closest(origins, directions, skip=skip)
    expected, local = reference.closest(origins, directions, skip=place[skip])
    free = distance > 0  # a ray that starts in several spheres hits any of them
    assert free.sum() > 1000
    assert (ids == np.where(local >= 0, kept[local], -1))[free].mean() > 0.999
    np.testing.assert_allclose(distance, expected, rtol=1e-4, atol=1e-5)
    assert SphereTree.of(spheres, hidden.copy()) is tree
    assert SphereTree.of(spheres) is SphereTree.of(spheres)


def test_scaled_radii_draw_and_light_as_if_they_were_the_files():
    """The same normalised units, so that a page only has to scale what it has."""
    particles = block()
    double = particles.scaled(1.5)
    spheres, scaled = SphereSet.of(particles), SphereSet.of(double)
    assert scaled.centers is spheres.centers
    assert scaled.unit == spheres.unit
    camera = Camera.framing(particles.bounds)
    alone = Particles(particles.positions, double.radii)
    one, other = (render(Scene(each), View(camera=camera), size=SIZE, **PIXEL) for each in (double, alone))
    assert (one.ids == other.ids).mean() > 0.999
    assert np.abs(one.pixels.astype(int) - other.pixels).mean() < 1
