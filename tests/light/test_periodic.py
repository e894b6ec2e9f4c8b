"""Light in periodic cells, against scenes whose images are there as particles."""

import numpy as np
import pytest

import luxel
from luxel import Cell, Particles, Scene
from luxel.errors import InputError
from luxel.light.fast import FastLight
from luxel.light.sampling import draw_paths
from luxel.light.world import make_world
from luxel.picture.raytrace import visible_ids
from luxel.textures.bake import Baker
from luxel.textures.spec import TextureSpec
from tests.conftest import shared_data

SKY = (luxel.Sky(1.0),)
CUBE = np.eye(3)
TRICLINIC = np.array([[1.0, 0, 0], [0.35, 0.9, 0], [-0.3, 0.25, 1.1]])


def packing(count=40, *, vectors=CUBE, origin=(0, 0, 0), radius=0.09, seed=0):
    """Random overlapping spheres that fill a cell."""
    rng = np.random.default_rng(seed)
    radii = radius * np.exp(rng.uniform(-0.4, 0.4, count))
    return Particles(rng.random((count, 3)) @ vectors + origin, radii, cell=Cell(vectors, np.array(origin)))


def slab(count=40, seed=1):
    """A layer of spheres with gaps, half a cell thick."""
    rng = np.random.default_rng(seed)
    return Particles(rng.random((count, 3)) * [1, 1, 0.4], 0.08, cell=Cell(CUBE, np.zeros(3)))


def replicated(particles, axes, times):
    """The particles and their images out to `times` cells along `axes`; the particles come first."""
    steps = [np.arange(-times, times + 1) if axis in axes else np.zeros(1) for axis in "xyz"]
    shifts = np.stack(np.meshgrid(*steps, indexing="ij"), -1).reshape(-1, 3)
    shifts = shifts[np.argsort(np.abs(shifts).sum(axis=1), kind="stable")]
    positions = (particles.positions + (shifts @ particles.cell.vectors)[:, None]).reshape(-1, 3)
    return Particles(positions, np.tile(particles.radii, len(shifts)))


def luminance(scene, ids, samples=16, seed=0):
    return Baker(scene, TextureSpec(samples=samples, seed=seed)).luminance(np.array(ids, np.int32))[0]


def nearly_all_equal(a, b):
    """The same random numbers lead the same rays; rounding sends a few past another edge."""
    return np.mean(np.abs(a - b) > 1e-3) < 0.002


@pytest.mark.parametrize("axes", ["x", "yz", "xyz"])
@pytest.mark.parametrize("vectors", [CUBE, np.diag([0.8, 1.25, 1.0]), TRICLINIC], ids=["cube", "box", "tilt"])
def test_occlusion_equals_that_of_explicit_images(vectors, axes):
    particles = packing(vectors=vectors, origin=(3.0, -1.0, 0.25))
    scene = Scene(particles, model="ao", ao_distance=0.4)
    expected = luminance(scene.with_changes(particles=replicated(particles, axes, 1)), range(40))
    assert nearly_all_equal(luminance(scene.with_changes(periodic=axes), range(40)), expected)
    assert not nearly_all_equal(luminance(scene, range(40)), expected)


@pytest.mark.parametrize("model", ["shadows", "interreflection"])
def test_light_on_a_layer_equals_that_among_explicit_images(model):
    particles = slab()
    lamp = luxel.SphereLight((0.5, 0.5, 1.5), 0.2, 20.0)  # one, whatever repeats
    inside = luxel.QuadLight((2.2, 0.2, 0.6), (0, 0.5, 0), (0.5, 0, 0), 5.0)
    lights = (luxel.Sky(1.0), luxel.Sun((1, 0.5, 2), 1.0), lamp, inside)
    scene = Scene(particles, lights, model)
    wide = luminance(scene.with_changes(particles=replicated(particles, "xy", 5)), range(40))
    periodic = luminance(scene.with_changes(periodic="xy"), range(40))
    assert abs((periodic - wide).mean()) < 0.003
    assert np.mean(np.abs(periodic - wide) > 1e-3) < (0.01 if model == "shadows" else 0.2)
    assert np.sqrt(((periodic - wide) ** 2).mean()) < 0.1 * wide.std()


def fast_and_paths(scene, samples):
    """Means (K,) over the exposed texels of every particle: fast mode before its filter, and paths."""
    ids = np.arange(len(scene.particles), dtype=np.int32)
    world = make_world(scene)
    paths = draw_paths(world, "latlong", 16, samples, ids)
    rest, sun = FastLight(world, 3.0, "latlong", 16, 16, 0)._draw(ids, 16, 0)
    mean = rest.mean if sun is None else rest.mean + sun.mean
    clear = (paths.exposed == samples) & (rest.exposed == 16)
    if sun is not None:
        clear &= sun.exposed == sun.exposed.max()
    seen = np.flatnonzero(clear.sum(axis=(1, 2)) > 60)
    assert len(seen) > 25
    return np.array([(mean[k][clear[k]].mean(), paths.mean[k][clear[k]].mean()) for k in seen]).T


@pytest.mark.parametrize("model", ["ao", "shadows", "interreflection"])
def test_fast_light_is_that_of_the_paths(model):
    # Gathers end on images too, and the record of a particle serves all of them.
    scene = Scene(slab(), (luxel.Sky(1.0), luxel.Sun((1, 0.5, 2), 1.0)), model, periodic="xy")
    fast, paths = fast_and_paths(scene, 64)
    assert abs((fast - paths).mean()) < 0.015  # as among explicit images: what nine numbers leave out
    assert np.sqrt(((fast - paths) ** 2).mean()) < 0.03


def test_fast_light_of_a_lamp_among_the_images():
    # It lights particles beside it that are dark where the file has them: no record tells.
    lamp = luxel.SphereLight((1.5, 0.5, 0.25), 0.1, 100.0)
    fast, paths = fast_and_paths(Scene(slab(), (lamp,), albedo=0.9, periodic="xy"), 256)
    assert abs((fast - paths).mean()) < 0.08 * paths.mean()
    assert np.sqrt(((fast - paths) ** 2).mean()) < 0.3 * paths.mean()


@pytest.mark.parametrize("model", ["lambertian", "interreflection"])
def test_images_bury_points_as_particles_do(model):
    ids = np.arange(40, dtype=np.int32)
    scene = Scene(packing(), SKY, model, albedo=0.0)
    explicit = scene.with_changes(particles=replicated(scene.particles, "xyz", 1))
    there, here, alone = (
        draw_paths(make_world(s), "latlong", 16, 4, ids).exposed
        for s in (explicit, scene.with_changes(periodic="xyz"), scene)
    )
    assert np.mean(here != there) < 0.002
    assert np.mean(alone != there) > 0.02


@pytest.mark.parametrize("axes", ["z", "xy", "xyz"])
def test_one_particle_sees_its_own_images(axes):
    particles = Particles([[0.2, 0.9, 0.4]], 0.45, cell=Cell(CUBE, np.zeros(3)))
    scene = Scene(particles, SKY, "ao", ao_distance=1.4)
    expected = luminance(scene.with_changes(particles=replicated(particles, axes, 2)), [0], 100)
    got = luminance(scene.with_changes(periodic=axes), [0], 100)
    assert np.abs(got - expected).max() < 0.02
    assert expected.mean() < 0.95


def test_radii_may_exceed_the_cell():
    rng = np.random.default_rng(4)
    floor = [[0.3, 0.8, -2.2]]
    positions = np.concatenate([floor, rng.random((20, 3)) * [1, 1, 0.3] + [0, 0, 0.3]])
    particles = Particles(positions, [2.4] + [0.05] * 20, cell=Cell(CUBE, np.zeros(3)))
    scene = Scene(particles, SKY, "ao", ao_distance=0.4)
    expected = luminance(scene.with_changes(particles=replicated(particles, "xy", 6)), range(21))
    got = luminance(scene.with_changes(periodic="xy"), range(21))
    assert nearly_all_equal(got, expected)
    # The exposed tip of the huge sphere lies in its own cell, its flanks cells away inside its images.
    assert 0 < got[0].mean() < 0.5


@pytest.mark.parametrize("reach", [0.001, 0.1, 0.8])
@pytest.mark.parametrize("model", ["ao", "interreflection"])
def test_the_reach_of_ghosts_does_not_change_light(reach, model):
    # With the least, most surfaces near a face leave the domain, and no near field is complete.
    rng = np.random.default_rng(6)
    radii = np.concatenate([np.full(4, 0.3), np.full(30, 0.04)])
    particles = Particles(rng.random((34, 3)), radii, cell=Cell(TRICLINIC, np.zeros(3)))
    lamp = luxel.SphereLight((0.5, 0.5, 2.0), 0.3, 10.0)
    scene = Scene(particles, (luxel.Sky(1.0), lamp), model, ao_distance=0.4, periodic="xy")
    baker = Baker(scene, TextureSpec(samples=16))
    expected = baker.luminance(np.arange(34, dtype=np.int32))[0]
    baker.world = make_world(scene, ghost_reach=reach)
    got = baker.luminance(np.arange(34, dtype=np.int32))[0]
    # Paths of many bounces amplify rounding, which differs here, so that a few end elsewhere.
    assert np.mean(np.abs(got - expected) > 1e-3) < (0.002 if model == "ao" else 0.01)
    assert abs((got - expected).mean()) < 1e-3


@pytest.mark.parametrize("model", ["ao", "shadows", "interreflection"])
def test_pixels_are_lit_as_textures_are(model):
    rng = np.random.default_rng(8)
    grid = np.stack(np.meshgrid(*[range(3)] * 3, indexing="ij"), -1).reshape(-1, 3)
    particles = Particles((grid + 0.3 * rng.random((27, 3))) / 3, 0.11, cell=Cell(CUBE, np.zeros(3)))
    scene = Scene(particles, (luxel.Sky(1.0), luxel.Sun((1, -1, 2), 1.0)), model, periodic="xy")
    view = luxel.View()
    textures = luxel.bake(scene, samples=64, texels=32)
    flat, pixel = (
        luxel.render(scene, view, textures, size=(48, 36)),
        luxel.render(scene, view, size=(48, 36), light="pixel", samples=64),
    )
    shown = flat.ids >= 0
    difference = pixel.pixels[shown].astype(float) - flat.pixels[shown]
    assert abs(difference.mean()) < 2.5
    alone = luxel.render(scene.with_changes(periodic=""), view, size=(48, 36), light="pixel", samples=64)
    assert alone.pixels[shown].mean() > pixel.pixels[shown].mean() + 8


@pytest.mark.parametrize("shift", [(0.5, 0, 0), (0.31, -0.77, 5.0), (-40.2, 3.3, 0.1)])
def test_moving_all_particles_through_the_faces_changes_nothing(shift):
    particles = packing(vectors=TRICLINIC)
    inverse = np.linalg.inv(TRICLINIC)
    moved = particles.positions + shift
    wrapped = (moved @ inverse - np.floor(moved @ inverse)) @ TRICLINIC
    scene = Scene(particles, SKY, "ao", ao_distance=0.7, periodic="xyz")
    expected = luminance(scene, range(40))
    for positions in (moved, wrapped):  # as trajectories hold them, unwrapped or wrapped
        other = Particles(positions, particles.radii, cell=particles.cell)
        assert nearly_all_equal(luminance(scene.with_changes(particles=other), range(40)), expected)


def test_moving_a_layer_leaves_all_its_bounces():
    particles = slab()
    scene = Scene(particles, (luxel.Sky(1.0), luxel.Sun((1, 0.5, 2), 1.0)), periodic="xy")
    moved = (particles.positions + np.array([0.37, 0.81, 0])) % [1, 1, 9]
    other = scene.with_changes(particles=Particles(moved, 0.08, cell=particles.cell))
    a, b = luminance(scene, range(40), 64), luminance(other, range(40), 64)
    assert abs((a - b).mean()) < 0.003
    assert np.sqrt(((a - b) ** 2).mean()) < 0.15 * a.std()


def test_furnace():
    # Albedo 1 under a unit sky: a layer that leaves no gap below it, and one with gaps, reflect all they get.
    grid = np.stack(np.meshgrid(range(3), range(3), indexing="ij"), -1).reshape(-1, 2)
    layer = np.concatenate([grid, np.zeros((9, 1))], axis=1).astype(float)
    pits = np.concatenate([layer, layer[::2] + np.array([0, 0, 1.0])])
    particles = Particles(pits, 0.499, cell=Cell(np.diag([3.0, 3, 0]), np.zeros(3)))  # flat: no third vector
    scene = Scene(particles, SKY, albedo=1.0, periodic="xy", periodic_images=200)
    got = luminance(scene, range(len(pits)), 49)
    assert abs(got.mean() - 1) < 3e-3
    assert np.abs(got.mean(axis=(1, 2)) - 1).max() < 0.03
    # The default bound loses only what grazes.
    assert 0.98 < luminance(scene.with_changes(periodic_images=8), range(len(pits)), 49).mean() <= got.mean()


@pytest.mark.parametrize("model", ["shadows", "interreflection", "ao"])
def test_closed_pockets_are_black(model):
    # Spheres this large close the windows between them; around the cell's corners pockets stay open inside.
    particles = Particles([[0.5, 0.5, 0.5]], 0.75, cell=Cell(CUBE, np.zeros(3)))
    scene = Scene(particles, (luxel.Sky(1.0), luxel.Sun((1, 1, 1), 5.0)), model, periodic="xyz")
    found = draw_paths(make_world(scene), "latlong", 16, 49, np.zeros(1, np.int32))
    assert found.exposed.sum() > 100
    assert not found.mean.any()


def test_a_lamp_in_a_closed_crystal_still_shines():
    particles = Particles([[0.5, 0.5, 0.5]], 0.3, cell=Cell(CUBE, np.zeros(3)))
    scene = Scene(particles, (luxel.SphereLight((0, 0, 0), 0.1, 50.0),), "shadows", periodic="xyz")
    rows = luminance(scene, [0], 100)[0].mean(axis=1)
    assert rows[-4:].min() > 0.1  # the lamp stands below, at one corner alone
    assert rows[:4].max() == 0


def test_sky_light_ends_after_the_last_image():
    # Sparse: rays fly on until the bound, and the more of them are lost the lower it is.
    particles = Particles([[0.5, 0.5, 0.5]], 0.05, cell=Cell(CUBE, np.zeros(3)))
    scene = Scene(particles, SKY, "ao", periodic="xy")
    mean = [luminance(scene.with_changes(periodic_images=n), [0], 49).mean() for n in (0, 1, 8, 64)]
    assert mean == sorted(mean)
    # The particle's own height is the layer's: all light leaves it but what is nearly level.
    assert mean[0] < mean[-1]
    assert mean[-1] > 0.95
    assert not luminance(scene.with_changes(periodic="xyz"), [0]).any()


def test_a_cell_much_larger_than_the_data_is_as_none():
    base = packing()
    far = Particles(base.positions, base.radii, cell=Cell(CUBE * 1000, np.full(3, -500.0)))
    lights = (luxel.Sky(1.0), luxel.Sun((1, 1, 1), 1.0))
    scene = Scene(far, lights, "shadows")
    periodic = luminance(scene.with_changes(periodic="xy"), range(40))
    assert nearly_all_equal(periodic, luminance(scene, range(40)))


def test_ghosts_are_complete_within_their_reach_and_no_farther():
    particles = packing(vectors=TRICLINIC, origin=(1.0, 2.0, 3.0))
    scene = Scene(particles, periodic="xz")
    cell = make_world(scene, ghost_reach=0.3).cell
    unit = 0.3 / cell.reach
    count = len(particles)
    assert np.array_equal(cell.original[:count], np.arange(count))
    for i in range(count):
        ghosts = range(cell.first[i], cell.first[i + 1])
        assert (cell.original[ghosts] == i).all()
        shift = cell.image[np.array(ghosts, int) - count] @ cell.vectors
        np.testing.assert_allclose(cell.centers[ghosts], cell.centers[i] + shift, atol=1e-6)
    # Every image near some particle, found one by one.
    own = cell.centers[:count].astype(float) * unit
    shifts = np.stack(np.meshgrid(range(-2, 3), range(1), range(-2, 3), indexing="ij"), -1).reshape(-1, 3)
    for shift in shifts[shifts.any(axis=1)]:
        images = own + shift @ TRICLINIC
        gap = np.linalg.norm(images[:, None] - own, axis=2).min(axis=1) - particles.radii
        for i in np.flatnonzero(gap < 0.3):
            assert (cell.image[cell.first[i] - count : cell.first[i + 1] - count] == shift).all(axis=1).any()
    assert (make_world(scene, ghost_reach=0.05).cell.image.shape[0]) < cell.image.shape[0]


def test_pictures_show_the_particles_as_they_are():
    particles = Particles(packing().positions + np.array([2.3, 0, 0]), 0.1, cell=Cell(CUBE, np.zeros(3)))
    scene = Scene(particles)
    periodic = scene.with_changes(periodic="xy")
    view = luxel.View()
    pictures = [luxel.render(s, view, size=(48, 36), light="pixel", samples=9) for s in (scene, periodic)]
    assert np.array_equal(pictures[0].ids, pictures[1].ids)
    assert np.array_equal(pictures[0].depth, pictures[1].depth)
    lit = pictures[0].ids >= 0
    assert pictures[1].pixels[lit].mean() < pictures[0].pixels[lit].mean() - 10  # images stand in the light
    camera = view.camera_for(particles, (48, 36))
    assert np.array_equal(visible_ids(scene, camera, (48, 36)), visible_ids(periodic, camera, (48, 36)))


def test_the_key_knows_the_cell_only_where_it_repeats():
    particles = packing()
    other = Particles(particles.local, particles.radii, cell=Cell(CUBE * 1.01, np.zeros(3)))
    assert Scene(other).key == Scene(particles).key == Scene(particles, periodic_images=3).key
    scenes = [
        Scene(particles),
        Scene(particles, periodic="x"),
        Scene(particles, periodic="xy"),
        Scene(particles, periodic="xy", periodic_images=9),
        Scene(other, periodic="xy"),
    ]
    assert len({scene.key for scene in scenes}) == len(scenes)
    assert Scene(particles, periodic=(True, True, False)).key == Scene(particles, periodic="YX").key


FLAT = Cell(np.array([[1.0, 0, 0], [2, 0, 0], [0, 0, 1]]), np.zeros(3))


@pytest.mark.parametrize(
    "cell, fields, message",
    [
        (None, {"periodic": "xy"}, "needs a simulation cell"),
        (FLAT, {"periodic": "xy"}, "degenerate"),
        (Cell(np.diag([1.0, 1, 0]), np.zeros(3)), {"periodic": "yz"}, "no extent along z"),
        (Cell(CUBE, np.zeros(3)), {"periodic": "xw"}, "must name axes"),
        (Cell(CUBE, np.zeros(3)), {"periodic": "xx"}, "must name axes"),
        (Cell(CUBE, np.zeros(3)), {"periodic": (True, False)}, "three flags"),
        (Cell(CUBE, np.zeros(3)), {"periodic": "x", "periodic_images": -1}, "periodic_images"),
    ],
)
def test_scenes_that_cannot_repeat_are_refused(cell, fields, message):
    with pytest.raises(InputError, match=message):
        Scene(Particles([[0, 0, 0]], 0.1, cell=cell), **fields)


def test_degenerate_vectors_that_do_not_repeat_are_no_matter():
    particles = Particles([[0, 0, 0.0]], 0.1, cell=FLAT)
    assert luminance(Scene(particles, SKY, "ao", periodic="yz"), [0]).mean() > 0.5


def test_radii_far_beyond_the_cell_are_refused():
    scene = Scene(Particles([[0, 0, 0]], 1000.0, cell=Cell(CUBE, np.zeros(3))), periodic="xyz")
    with pytest.raises(InputError, match="too large"):
        make_world(scene)
    with pytest.raises(InputError, match="ghost_reach"):
        make_world(scene, ghost_reach=0.0)


def test_a_session_repeats_and_stays_at_a_frame_with_a_cell():
    frames = (packing(), Particles([[0, 0, 0]], 0.1))
    with luxel.Session(frames, periodic="xy", threads=0) as session:
        assert session.scene.axes == "xy"
        assert session.scene.key == Scene(frames[0], periodic="xy").key
        with pytest.raises(InputError, match="cell"):
            session.set_frame(1)
        assert session.frame == 0


@pytest.mark.shared_data
@pytest.mark.parametrize("name", ["md/albite_triclinic.dump", "md/molecules.gsd", "dem/pour.lammpstrj.gz"])
def test_simulation_files_render(name):
    series = luxel.open(str(shared_data(name)))
    scene = Scene(series[series.first_frame()], periodic="xy")
    picture = luxel.render(scene, size=(48, 36), samples=1, antialias=1)
    shown = picture.ids >= 0
    assert 20 < picture.pixels[shown].mean() < 230
