import numpy as np
import pytest

from luxel import Particles, QuadLight, Scene, Sky, SphereLight, Sun, TextureSpec, View
from luxel.errors import InputError
from luxel.scene.lights import default_lights, sun_direction, up_frame
from luxel.textures.spec import light_key

POINTS = np.random.default_rng(0).random((5, 3))


def particles(**changes):
    return Particles(**{"positions": POINTS, "radii": 0.1, **changes})


@pytest.mark.parametrize("up, axis", [("x", [1, 0, 0]), ("y", [0, 1, 0]), ("z", [0, 0, 1])])
def test_up_frame_is_a_rotation_that_lifts_z(up, axis):
    frame = up_frame(up)
    assert np.linalg.det(frame) == pytest.approx(1)
    np.testing.assert_allclose(np.array([0, 0, 1]) @ frame, axis)


def test_sun_direction():
    np.testing.assert_allclose(sun_direction(0, 0), [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(sun_direction(90, 0), [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(sun_direction(0, 90, "y"), [0, 1, 0], atol=1e-12)


def test_default_lights_follow_up():
    _, sun = default_lights("y")
    assert np.argmax(np.abs(sun.direction)) == 1 or sun.direction[1] == pytest.approx(np.sin(np.radians(50)))


@pytest.mark.parametrize(
    "make",
    [
        lambda: Sky(-1),
        lambda: Sky(np.inf),
        lambda: Sky(1, ground=-1),
        lambda: Sun((0, 0, 0)),
        lambda: Sun((0, 0, 1), angular_diameter=0),
        lambda: Sun((0, 0, 1), angular_diameter=121),
        lambda: Sun((0, 0, 1), level=np.nan),
        lambda: SphereLight((0, 0, 0), 0),
        lambda: QuadLight((0, 0, 0), (1, 0, 0), (2, 0, 0)),
    ],
)
def test_bad_lights_are_refused(make):
    with pytest.raises(InputError):
        make()


@pytest.mark.parametrize(
    "fields",
    [
        {"model": "phong"},
        {"albedo": 1.1},
        {"albedo": -0.1},
        {"ao_distance": 0},
        {"lights": [Sky(), Sky()]},
        {"lights": ["sun"]},
        {"particles": Particles(np.empty((0, 3)), 1.0)},
        {"particles": POINTS},
    ],
)
def test_bad_scenes_are_refused(fields):
    with pytest.raises(InputError):
        Scene(**{"particles": particles(), **fields})


CHANGES = [
    {"model": "ao"},
    {"albedo": 0.5},
    {"ao_distance": 1.0},
    {"lights": [Sky(2)]},
    {"lights": [Sky(1, ground=0.5)]},
    {"lights": [*default_lights()[:1], Sun((0, 0, 1))]},
    {"particles": particles(radii=0.2)},
    {"particles": particles(positions=POINTS + 1e-3)},
    {"particles": particles(positions=POINTS[::-1])},
]


@pytest.mark.parametrize("change", CHANGES)
def test_what_light_depends_on_changes_the_key(change):
    scene = Scene(particles())
    assert scene.with_changes(**change).key != scene.key


def test_all_keys_differ():
    scene = Scene(particles())
    keys = [scene.key, *(scene.with_changes(**change).key for change in CHANGES)]
    assert len(set(keys)) == len(keys)


def test_scalars_do_not_change_the_key():
    assert Scene(particles(scalars={"t": np.arange(5)})).key == Scene(particles()).key


def test_key_is_reproducible_and_view_has_no_part_in_it():
    assert Scene(particles()).key == Scene(particles()).key
    assert not set(View().to_json()) & {"lights", "model", "albedo", "particles"}


def test_light_key_knows_the_spec():
    scene = Scene(particles())
    keys = {
        light_key(scene, spec)
        for spec in (
            TextureSpec(),
            TextureSpec(samples=25),
            TextureSpec(seed=1),
            TextureSpec(mode="fast"),
            TextureSpec(texels=8),
            TextureSpec(max_bounces=2),
        )
    }
    assert len(keys) == 6
