import json

import numpy as np
import pytest

from luxel import Camera, Cut, Lighting, QuadLight, SavedView, Scene, Select, Sky, SphereLight, Sun, View
from luxel.errors import FormatError, InputError, LuxelError, MissingFileError, StorageError
from tests.scenes import cloud

LIGHTS = (
    Sky(0.5, ground=0.1, axis=(0, 1, 0)),
    Sun((1, 2, 3), 1.5, 7),
    SphereLight((1, 2, 3), 0.5, 2),
    QuadLight((0, 0, 5), (1, 0, 0), (0, 1, 0), 3),
)


def everything():
    view = View(
        camera=Camera((1, 2, 3), (0.5, 0.5, 0.5), up=(0, 1, 0), height=2),
        color_by="value",
        colormap="magma",
        range=(0.1, 0.9),
        exposure=1.5,
        background="white",
        up="y",
        hide=(Cut("x", 0.7),),
    )
    light = Lighting("ao", LIGHTS, 0.4, ao_distance=0.25, hide=(Select("value", 0.2),), radius_scale=1.25)
    return SavedView(view, light, 3)


def test_a_saved_view_makes_the_same_picture_again(tmp_path):
    """The same light key, view and frame: nothing else goes into a picture."""
    saved = everything()
    saved.save(tmp_path / "view.json")
    again = SavedView.load(tmp_path / "view.json")
    particles = cloud()
    assert again.scene(particles).key == saved.scene(particles).key
    assert again.view.to_json() == saved.view.to_json()
    assert again.frame == 3
    again.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_text() == (tmp_path / "view.json").read_text()


def test_the_light_of_a_scene_lights_the_particles_alike():
    scene = everything().scene(cloud())
    light = Lighting.of(scene)
    assert light.scene(cloud()).key == scene.key
    assert light.radius_scale == 1.25
    assert Lighting.of(Scene(cloud())).scene(cloud()).key == Scene(cloud()).key


def test_a_bare_view_is_a_saved_view():
    saved = SavedView.from_json(View(exposure=2).to_json())
    assert (saved.view.exposure, saved.light, saved.frame) == (2, None, None)
    assert saved.scene(cloud()).key == Scene(cloud()).key


def test_what_is_left_out_has_its_default():
    saved = SavedView.from_json({"luxel_view": 1, "view": {}, "light": {"model": "shadows"}})
    assert saved.scene(cloud()).key == Scene(cloud(), model="shadows").key


BAD = [
    [],
    "view",
    {"luxel_view": 2},
    {"luxel_view": 0},
    {"luxel_view": "1"},
    {"luxel_view": True},
    {"luxel_view": 1, "views": {}},
    {"luxel_view": 1, "view": []},
    {"luxel_view": 1, "frame": -1},
    {"luxel_view": 1, "frame": 1.5},
    {"luxel_view": 1, "light": []},
    {"luxel_view": 1, "light": {"albedo": "much"}},
    {"luxel_view": 1, "light": {"radius_scale": True}},
    {"luxel_view": 1, "light": {"lights": "sun"}},
    {"luxel_view": 1, "light": {"lights": [{"kind": "Moon"}]}},
    {"luxel_view": 1, "light": {"lights": [{"kind": "Sky", "levle": 1}]}},
    {"luxel_view": 1, "light": {"lights": [{"kind": "Sun", "direction": "up"}]}},
    {"luxel_view": 1, "light": {"lights": [[]]}},
    {"luxel_view": 1, "light": {"hide": {}}},
    {"luxel_view": 1, "light": {"hide": [{"kind": "slab"}]}},
    {"luxel_view": 1, "light": {"periodic": 3}},
    {"luxel_view": 1, "light": {"colour": "red"}},
    {"exposure": -1},
    {"no such": 1},
]


@pytest.mark.parametrize("data", BAD, ids=json.dumps)
def test_bad_files_are_named_with_what_is_wrong(tmp_path, data):
    with pytest.raises(InputError):
        SavedView.from_json(data)
    path = tmp_path / "view.json"
    path.write_text(json.dumps(data))
    with pytest.raises(FormatError, match=r"view\.json"):
        SavedView.load(path)


@pytest.mark.parametrize(
    "data", [{"model": "phong"}, {"albedo": 2}, {"ao_distance": -1}, {"radius_scale": 0}]
)
def test_what_no_scene_takes_is_refused_when_it_is_lit(data):
    saved = SavedView.from_json({"luxel_view": 1, "light": data})
    with pytest.raises(InputError):
        saved.scene(cloud())


def test_files_that_are_no_views(tmp_path):
    with pytest.raises(MissingFileError):
        SavedView.load(tmp_path / "no.json")
    with pytest.raises(LuxelError):
        SavedView.load(tmp_path)
    for content, where in (
        (b'{"view": \n oops}', "line 2, column 2"),
        (b"\xff\xfe", "no view"),
        (b"[" * 100_000, "no view"),
        (b" " * (2 << 20), "longer"),
        (b"", "line 1"),
    ):
        (tmp_path / "bad.json").write_bytes(content)
        with pytest.raises(FormatError, match=where):
            SavedView.load(tmp_path / "bad.json")
    with pytest.raises(StorageError):
        everything().save(tmp_path / "missing" / "view.json")


def test_lights_keep_every_bit(tmp_path):
    sun = Sun(np.random.default_rng(0).normal(size=3), level=1 / 3)
    SavedView(View(), Lighting(lights=[sun])).save(tmp_path / "view.json")
    again = SavedView.load(tmp_path / "view.json").light.lights[0]
    np.testing.assert_array_equal(again.direction, sun.direction)
    assert again.level == sun.level


def test_whole_numbers_are_the_same_light_however_they_are_written():
    """A browser writes 20.0 as 20."""
    exact = Lighting("ao", (Sky(1.0, ground=0.0), Sun((1, 2, 3), 2.0, 20.0)), 1.0, ao_distance=3.0)
    whole = Lighting("ao", (Sky(1, ground=0), Sun((1, 2, 3), 2, 20)), 1, ao_distance=3)
    assert whole.scene(cloud()).key == exact.scene(cloud()).key
