"""What is looked at: texels that an eye sees, found near each particle, against rays from the eye through the whole scene."""

import numpy as np
import pytest

import luxel
from luxel.light.in_view import Gaze, texels_looked_at
from luxel.light.mapping import texel_directions, texel_neighbours
from luxel.light.sampling import RaySets, draw_rays
from luxel.light.world import make_world
from luxel.picture.raytrace import render, visible_ids
from luxel.textures.bake import Baker
from luxel.textures.estimate import EstimateBaker
from luxel.textures.spec import TextureSpec
from luxel.trace.spheres import SphereSet
from luxel.trace.tree import SphereTree
from tests.scenes import cloud, lattice

SCENES = {
    "touching": lattice(6),
    "overlapping": cloud(400, radius=0.06, spread=0.3),
    "unequal": luxel.Particles(
        np.concatenate([cloud(300, radius=0.05, spread=0.3).positions, [[0, 0, -5.2]]]),
        np.append(np.full(300, 0.05), 5.0),
    ),
}
EYE = (1.5, -2.0, 1.8)


def gaze_at(particles, eyes, shown=None):
    spheres = SphereSet.of(particles)
    marks = np.ones(len(particles), np.uint8) if shown is None else shown.astype(np.uint8)
    return Gaze(spheres.to_unit(np.atleast_2d(eyes)).astype(np.float32), marks)


def seen_middles(particles, ids, eye, hidden=None, mapping="latlong"):
    """(K, T²) bool: texels to whose middles nothing stands in the way from the eye."""
    spheres = SphereSet.of(particles)
    tree = SphereTree.of(spheres, hidden)
    normals = texel_directions(mapping, 16).reshape(-1, 3).astype(np.float64)
    at = spheres.to_unit(np.asarray(eye))
    found = np.zeros((len(ids), len(normals)), bool)
    for k, i in enumerate(ids):
        points = spheres.centers[i] + spheres.radii[i] * normals
        towards = at - points
        far = np.linalg.norm(towards, axis=1)
        towards /= far[:, None]
        facing = (towards * normals).sum(axis=1) > 0
        skip = np.full(len(points), i, np.int32)
        blocked = tree.occluded(points, towards, limit=far, skip=skip)
        found[k] = facing & ~blocked
    return found


def widened(marks, mapping="latlong"):
    """Those marked, and all around them."""
    beside = texel_neighbours(mapping, 16)
    wide = marks | marks[:, beside[2]] | marks[:, beside[3]]
    return wide | wide[:, beside[0]] | wide[:, beside[1]]


@pytest.mark.parametrize("mapping", ["latlong", "octahedral"])
@pytest.mark.parametrize("name", SCENES)
def test_all_that_the_eye_sees_is_wanted_and_most_of_the_rest_is_not(name, mapping):
    particles = SCENES[name]
    ids = visible_ids(
        luxel.Scene(particles), luxel.Camera(EYE, (0, 0, 0), (0, 0, 1), 40.0), (96, 96), antialias=3
    )
    wanted = texels_looked_at(make_world(luxel.Scene(particles)), mapping, 16, ids, gaze_at(particles, EYE))
    seen = seen_middles(particles, ids, EYE, mapping=mapping)
    some = seen.any(axis=1)
    lacking = widened(seen[some], mapping) & (wanted[some] == 0)
    # rays that graze, which rounding decides
    assert lacking.mean() < 1e-3
    assert wanted.mean() < 0.55
    # what near particles do not hide, others may
    assert (wanted[some] != 0).mean() < 1.5 * widened(seen[some], mapping).mean()


@pytest.mark.parametrize("eye", [(0.0, -2.0, 0.3), (0.0, -4.0, 0.3), (1.2, 1.2, 2.0)])
def test_what_lies_beyond_the_eye_hides_nothing(eye):
    ground, others = [0, 0, -201.0], [[2.4, 2.4, 2.0], [0, -6.0, 0.5]]
    particles = luxel.Particles([[0, 0, 0], ground, *others], [1.0, 200.0, 1.0, 0.9])
    ids = np.arange(1, dtype=np.int32)
    wanted = texels_looked_at(make_world(luxel.Scene(particles)), "latlong", 16, ids, gaze_at(particles, eye))
    seen = seen_middles(particles, ids, eye)
    assert seen.sum() > 20
    assert not (widened(seen) & (wanted == 0)).any()


def test_particles_that_are_not_shown_hide_nothing():
    particles = lattice(5)
    ids = np.arange(len(particles), dtype=np.int32)
    world = make_world(luxel.Scene(particles))
    shown = np.zeros(len(particles), bool)
    shown[::2] = True
    wanted = texels_looked_at(world, "latlong", 16, ids[shown], gaze_at(particles, EYE, shown))
    seen = widened(seen_middles(particles, ids[shown], EYE, hidden=~shown))
    assert (seen & (wanted == 0)).mean() < 1e-3
    among_all = texels_looked_at(world, "latlong", 16, ids[shown], gaze_at(particles, EYE))
    assert among_all.sum() < wanted.sum()


def test_several_eyes_want_what_each_of_them_wants():
    particles = lattice(4)
    ids = np.arange(len(particles), dtype=np.int32)
    world = make_world(luxel.Scene(particles))
    one, other = (
        texels_looked_at(world, "latlong", 16, ids, gaze_at(particles, eye)) for eye in (EYE, (-2, 0, 0))
    )
    both = texels_looked_at(world, "latlong", 16, ids, gaze_at(particles, [EYE, (-2, 0, 0)]))
    np.testing.assert_array_equal(both, one | other)


def test_from_inside_a_sphere_all_of_it_is_wanted():
    particles = luxel.Particles([[0, 0, 0], [3.0, 0, 0]], 1.0)
    ids = np.arange(2, dtype=np.int32)
    wanted = texels_looked_at(
        make_world(luxel.Scene(particles)), "octahedral", 6, ids, gaze_at(particles, (0.1, 0, 0))
    )
    assert wanted.shape == (2, 36)
    assert wanted[0].all()
    assert 0 < wanted[1].sum() < 36


def test_where_images_may_hide_things_all_that_faces_the_eye_is_wanted():
    rng = np.random.default_rng(5)
    particles = luxel.Particles(rng.random((60, 3)), 0.1, cell=luxel.Cell(np.eye(3), np.zeros(3)))
    world = make_world(luxel.Scene(particles, periodic="xyz", model="ao", ao_distance=0.5))
    ids = np.arange(60, dtype=np.int32)
    wanted = texels_looked_at(world, "latlong", 16, ids, gaze_at(particles, (3, 3, 3)))
    assert (wanted.mean(axis=1) > 0.5).all()


@pytest.mark.parametrize("samples", [1, 4])
def test_texels_that_are_wanted_are_sampled_as_ever_and_no_others(samples):
    particles = SCENES["overlapping"]
    scene = luxel.Scene(particles, (luxel.Sky(1.0), luxel.Sun((1, 1, 2), 2.0, 15.0)))
    world = make_world(scene)
    sets = RaySets.make("latlong", (16, 16), samples, world.lights.suns, sun_samples=16)
    ids = np.arange(0, 400, 9, dtype=np.int32)
    wanted = texels_looked_at(world, "latlong", 16, ids, gaze_at(particles, EYE))
    every, some = draw_rays(world, sets, ids), draw_rays(world, sets, ids, wanted)
    mask = wanted.reshape(-1, 16, 16) != 0
    for whole, part in zip(every, some, strict=True):
        for expected, found in zip(whole, part, strict=True):
            assert (found[~mask] == 0).all()
            # What blocked other rays is looked at first: a ray that grazes a sphere and its box within rounding may fall either way.
            assert (found != expected)[mask].mean() <= 1e-3


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("name", SCENES)
def test_a_picture_of_what_is_in_view_is_as_good_as_one_of_whole_textures(name, orthographic):
    scene = luxel.Scene(SCENES[name], (luxel.Sky(1.0), luxel.Sun((1, 1, 2), 2.0, 15.0)))
    camera = luxel.Camera.framing(scene.particles.bounds, aspect=1.0, orthographic=orthographic)
    view, size = luxel.View(camera=camera), (80, 80)
    how = {"size": size, "antialias": 2, "colorbar": False}
    truth = render(scene, view, light="pixel", samples=256, **how).array.astype(float)
    whole = luxel.bake(scene, samples=4, mode="fast")
    errors = []
    for textures in (None, whole):
        picture = render(scene, view, textures, samples=4, **how)
        errors.append(np.sqrt(((picture.array - truth) ** 2).mean()))
    assert errors[0] < 1.1 * errors[1]


def looks(particles, *eye):
    """What is visible from an eye towards the middle of the particles, and its gaze."""
    camera = luxel.Camera(eye, particles.bounds.mean(axis=0))
    ids = visible_ids(luxel.Scene(particles), camera, (300, 300))
    return ids, gaze_at(particles, eye, np.isin(np.arange(len(particles)), ids))


def errors_in_view(scene, ids, gaze, lessons):
    """RMS error of what is looked at, by filters that have learnt from each of some gazes."""
    baker = Baker(scene, TextureSpec(mode="fast", samples=1))
    seen = texels_looked_at(baker.world, "latlong", 16, ids, gaze).reshape(-1, 16, 16) != 0
    truth = Baker(scene, TextureSpec(mode="fast", samples=25)).luminance(ids)[0]
    errors = []
    for lesson in lessons:
        light = baker.coarser_light(16, 1)
        light.prepare(2, lesson)
        errors.append(np.sqrt(((light.luminance(ids, gaze)[0] - truth)[seen] ** 2).mean()))
    return errors


def test_the_filter_of_a_picture_learns_from_what_is_in_it():
    scene = luxel.Scene(lattice(16), (luxel.Sky(1.0), luxel.Sun((1, 1, 2), 2.0, 15.0)))
    visible, gaze = looks(scene.particles, 30.0, -27.0, 33.0)
    general, own = errors_in_view(scene, visible[::12], gaze, (None, gaze))
    assert own < 0.97 * general


def test_a_picture_of_the_dark_side_teaches_enough_for_the_lit_one():
    scene = luxel.Scene(lattice(16), (luxel.Sun((1, 0, 0), 3.0, 5.0),))
    dark = looks(scene.particles, -60.0, 9.0, 12.0)[1]
    visible, gaze = looks(scene.particles, 70.0, 9.0, 12.0)
    general, other = errors_in_view(scene, visible[::12], gaze, (None, dark))
    assert other < 1.1 * general


def test_views_from_another_side_have_the_filter_learn_again():
    particles = lattice(12)
    scene = luxel.Scene(particles, (luxel.Sky(1.0), luxel.Sun((1, 1, 2), 2.0, 15.0)))
    baker = Baker(scene, TextureSpec(mode="fast", samples=9))

    ids, above = looks(particles, 9.0, 4.0, 40.0)
    beside, below = looks(particles, 22.0, 9.0, 40.0)[1], looks(particles, 9.0, 4.0, -30.0)[1]
    light, other = (EstimateBaker(baker, whole=True) for _ in range(2))
    assert light.suits(above)  # nothing is known yet: it learns in any case

    def prepared(estimates, gaze):
        for _ in estimates.preparation(2, gaze):
            pass
        return estimates.luminance(ids[:40], above)[0]

    first = prepared(light, above)
    assert light.suits(above)
    assert light.suits(beside)
    assert light.suits(None)
    assert not light.suits(below)
    np.testing.assert_array_equal(prepared(light, beside), first)
    second = prepared(light, below)
    assert (second != first).any()
    assert light.suits(below)
    assert not light.suits(above)
    np.testing.assert_array_equal(second, prepared(other, below))


def test_a_picture_of_a_few_particles_is_followed_by_a_better_lesson():
    particles = lattice(12)
    estimates = EstimateBaker(Baker(luxel.Scene(particles), TextureSpec(mode="fast", samples=9)), whole=True)
    few = gaze_at(particles, (9.0, 4.0, 40.0), np.arange(len(particles)) < 10)
    for gaze in (few, looks(particles, 9.0, 4.0, 40.0)[1]):
        for _ in estimates.preparation(2, gaze):
            pass
        assert estimates.suits(gaze)
        assert estimates.suits(few)
        assert estimates.suits(looks(particles, 9.0, 4.0, 40.0)[1]) == (gaze is not few)


def test_textures_that_are_kept_do_not_depend_on_pictures_before():
    scene = luxel.Scene(lattice(9), (luxel.Sky(1.0), luxel.Sun((1, 1, 2), 2.0, 15.0)))
    spec, ids = TextureSpec(mode="fast", samples=1), np.arange(0, 729, 40, dtype=np.int32)
    expected = Baker(scene, spec).luminance(ids)[0]
    baker = Baker(scene, spec)
    # Enough to learn from, and others than would be taken without a picture.
    gaze = gaze_at(scene.particles, (30.0, 4.0, 4.0), scene.particles.positions[:, 0] > 1)
    in_view = baker.luminance(ids, gaze)[0]
    np.testing.assert_array_equal(baker.luminance(ids)[0], expected)
    np.testing.assert_array_equal(baker.luminance(ids, gaze)[0], in_view)
    assert (in_view != expected).any()
