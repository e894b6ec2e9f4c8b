import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import luxel
from luxel import Cut, Particles, Scene, Select, View
from luxel.errors import InputError, ScalarError
from luxel.scene.hiding import hidden
from tests.scenes import cloud, lattice


def line(**scalars):
    """Particles at x = 0, 1, 2, 3, 4."""
    return Particles(np.arange(5)[:, None] * [1.0, 0.0, 0.0], 0.4, scalars)


def shown(condition, particles):
    return np.flatnonzero(~condition.hides(particles)).tolist()


@pytest.mark.parametrize(
    "cut, kept",
    [
        (Cut("x", 2), [0, 1, 2]),
        (Cut("-x", -2), [2, 3, 4]),
        (Cut((5, 0, 0), 2), [0, 1, 2]),
        (Cut("y", 0), [0, 1, 2, 3, 4]),
        (Cut("y", -1), []),
        (Cut((1, 1, 0), 2.5), [0, 1, 2, 3]),  # along the diagonal, x counts by a factor of 1/sqrt(2)
    ],
)
def test_cut_hides_what_lies_beyond(cut, kept):
    assert shown(cut, line()) == kept


def test_a_layer_in_the_plane_stays_whole():
    """0.3 in single precision is larger than 0.3; far from zero positions are coarser still."""
    for far in (0.0, 1e6):
        grid = np.stack(np.meshgrid(*[0.1 * np.arange(7)] * 3, indexing="ij"), -1).reshape(-1, 3)
        particles = Particles(grid + far, 0.05)
        assert (~Cut("x", far + 0.3).hides(particles)).sum() == 4 * 49
        assert (~Cut("-x", -far - 0.3).hides(particles)).sum() == 4 * 49


def test_blocks_agree_with_one_pass(monkeypatch):
    cut = Cut((1, 2, 3), 1.5)
    whole = cut.hides(cloud())
    monkeypatch.setattr("luxel.scene.hiding._BLOCK", 7)
    assert np.array_equal(cut.hides(cloud()), whole)


@given(st.tuples(*[st.floats(-3, 3)] * 3).filter(lambda n: np.linalg.norm(n) > 1e-3), st.floats(-2, 2))
def test_opposite_cuts_leave_only_the_plane(normal, offset):
    particles = cloud()
    one = Cut(normal, offset).hides(particles)
    other = Cut(-np.array(normal), -offset).hides(particles)
    assert not (one & other).any()
    in_plane = ~one & ~other
    distance = particles.positions[in_plane] @ (np.array(normal) / np.linalg.norm(normal)) - offset
    assert (np.abs(distance) < 1e-5).all()


@pytest.mark.parametrize(
    "text, cut",
    [
        ("x>0.5", Cut("x", 0.5)),
        (" z < -2 ", Cut("-z", 2)),
        ("y>=1e3", Cut("y", 1000)),
        ("1,1,0>3", Cut((1, 1, 0), 3)),
        ("0,0,2<1", Cut((0, 0, -1), -1)),
    ],
)
def test_cuts_from_text(text, cut):
    assert Cut.parse(text) == cut


@pytest.mark.parametrize(
    "text", ["", "x", "x>", "w>1", "x>nan", "x=1", "1,1>3", "0,0,0>1", "0.1<x<2", "x>1>2"]
)
def test_bad_cuts_are_refused_with_examples(text):
    with pytest.raises(InputError, match=r"x>0\.5"):
        Cut.parse(text)


VALUES = [0.0, 0.7, 1.0, np.nan, np.inf]


@pytest.mark.parametrize(
    "text, kept",
    [
        ("t>0.7", [2, 4]),
        ("t>=0.7", [1, 2, 4]),
        ("t<0.7", [0]),
        ("t<=0.7", [0, 1]),
        ("t=1", [2]),
        ("t==1.0", [2]),
        ("0<t<1", [1]),
        ("0<=t<=1", [0, 1, 2]),
    ],
)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_selections_from_text(text, kept, dtype):
    """Strict limits are strict in single precision, where 0.7 is another number, too; no data is never selected."""
    assert shown(Select.parse(text), line(t=np.array(VALUES, dtype))) == kept


def test_whole_numbers_are_compared_exactly():
    ids = line(id=np.arange(5) + 20_000_000)
    assert shown(Select.parse("id>20000001"), ids) == [2, 3, 4]
    assert shown(Select.parse("id=20000001"), ids) == [1]
    assert shown(Select.parse("1<id<20000001"), ids) == [0]


def test_components_magnitudes_and_codes_can_be_selected():
    particles = line(v=np.arange(15).reshape(5, 3), material=np.array([0, 1, 1, 2, 0]))
    assert shown(Select("v.y", 4, 10), particles) == [1, 2, 3]
    assert shown(Select("v", None, 10), particles) == [0, 1]
    assert shown(Select.parse("material=1"), particles) == [1, 2]


@pytest.mark.parametrize("text", ["", "t", "t>", "t>x", ">1", "1<t>2", "2<t<1", "1<t<2<3", "t>inf"])
def test_bad_selections_are_refused_with_examples(text):
    with pytest.raises(InputError, match="stress>1e6"):
        Select.parse(text)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Cut("w", 1),
        lambda: Cut((0, 0, 0), 1),
        lambda: Cut("x", np.nan),
        lambda: Cut("x", "far"),
        lambda: Cut("x", True),
        lambda: Select("t", 2, 1),
        lambda: Select("t", np.inf),
        lambda: Select(""),
        lambda: View(hide=["x>1"]),
        lambda: View(hide=1),
        lambda: Scene(cloud(), hide="x"),
    ],
)
def test_wrong_conditions_are_refused(make):
    with pytest.raises(InputError):
        make()


def test_unknown_scalars_are_named():
    view = View(hide=Select("pressure", 1))
    with pytest.raises(ScalarError, match="pressure"):
        view.hidden(line(t=np.arange(5)))


def test_several_conditions_hide_what_any_hides():
    particles = line(t=np.array([5.0, 4, 3, 2, 1]))
    both = (Cut("x", 3), Select("t", None, 4))
    assert np.flatnonzero(hidden(particles, both)).tolist() == [0, 4]
    assert hidden(particles, ()) is None
    assert hidden(particles, [Cut("x", 10)]) is None


def test_views_with_conditions_survive_json():
    view = View(hide=(Cut((1, 2, 3), 0.1), Select("velocity.x", low=-1), Select("t")))
    again = View.from_json(json.loads(json.dumps(view.to_json())))
    assert again.conditions == view.conditions
    assert View(hide=Cut("x", 1)).conditions == (Cut("x", 1),)


@pytest.mark.parametrize(
    "data",
    [
        "cut",
        {"kind": "cut"},
        {"kind": "cut", "normal": "x"},
        {"kind": "cut", "normal": [1, 0], "offset": 1},
        {"kind": "cut", "normal": [1, 0, 0], "offset": None},
        {"kind": "cut", "normal": [1, 0, 0], "offset": 1, "colour": 2},
        {"kind": "select"},
        {"kind": "select", "scalar": 3},
        {"kind": "slab"},
        {"kind": ["cut"]},
    ],
)
def test_bad_conditions_in_json_are_refused(data):
    with pytest.raises(InputError):
        View.from_json({"hide": [data]})


def test_hiding_in_a_view_is_no_part_of_the_light_key_and_in_a_scene_it_is():
    particles = lattice()
    scene = Scene(particles)
    cut = scene.with_changes(hide=Cut("x", 1))
    assert cut.key != scene.key
    assert cut.with_changes(hide=Cut("x", 1.5)).key == cut.key  # the same particles
    assert cut.with_changes(hide=Cut("x", 2)).key != cut.key
    assert scene.with_changes(hide=Cut("x", 99)).key == scene.key  # hides nothing
    assert luxel.View(hide=Cut("x", 1)).hidden(particles).sum() == 32


def test_scaled_particles_share_all_but_radii():
    particles = cloud(spread=0.5)
    double = particles.scaled(2)
    np.testing.assert_array_equal(double.radii, 2 * particles.radii)
    assert double.local is particles.local
    assert double.scalars is particles.scalars
    assert double.unscaled is particles
    assert double.scaled(1) is particles
    np.testing.assert_array_equal(double.scaled(3).radii, 3 * particles.radii)  # never a scale of a scale
    assert Scene(double).key != Scene(particles).key
    assert (particles.radius_scale, double.radius_scale) == (1, 2)
    assert "times 2" in double.radii_source
    for wrong in (0, -1, np.nan, np.inf, 1e39):
        with pytest.raises(InputError):
            particles.scaled(wrong)
