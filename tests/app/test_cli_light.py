"""What the command line says about light: periodic cells, hidden particles, saved views."""

import json

import numpy as np
import pytest

import luxel
from luxel import Cut, Select, Sky, Sun, View
from tests.app.command_line import refused, run

# periodic cells


@pytest.fixture
def celled(tmp_path):
    path = tmp_path / "cell.xyz"
    path.write_text(
        '2\nLattice="4 0 0 0 4 0 0 0 4" Properties=species:S:1:pos:R:3\nAr 1 1 1\nAr 3 3 3\n',
        encoding="utf-8",
    )
    return str(path)


def test_periodic_reaches_the_scene(celled, tmp_path, rendered, served, capsys):
    assert run("render", celled, "-o", tmp_path / "a.png", "--periodic", "yX") == 0
    assert run("view", celled, "--no-browser", "--periodic", "z", "--threads", 1) == 0
    assert [call["scene"].axes for call in (*rendered, *served)] == ["xy", "z"]
    assert "note" not in capsys.readouterr().err


@pytest.mark.parametrize("given, dark", [([], True), (["--model", "ao", "--ao-distance", "2"], False)])
def test_a_note_says_that_no_light_reaches_into_a_closed_cell(
    celled, tmp_path, rendered, capsys, given, dark
):
    assert run("render", celled, "-o", tmp_path / "a.png", "--periodic", "xyz", *given) == 0
    assert ("neither sky nor sun" in capsys.readouterr().err) == dark


@pytest.mark.parametrize("axes", ["xw", "xx", "", "1"])
def test_periodic_wants_axes(celled, tmp_path, capsys, axes):
    message = refused(capsys, "render", celled, "-o", tmp_path / "a.png", "--periodic", axes)
    assert "xy or xyz" in message


def test_periodic_wants_a_cell(file, tmp_path, capsys):
    for command in (["render", file, "-o", tmp_path / "a.png"], ["demo", "--render", tmp_path / "a.png"]):
        assert "needs a simulation cell" in refused(capsys, *command, "--periodic", "xy")


# hidden particles, saved views


@pytest.mark.parametrize(
    "given, kept, opened",
    [
        (["--cut", "x>0.5"], [], [Cut("x", 0.5)]),
        (["--cut", "x>0.5", "--cut-light", "keeps"], [Cut("x", 0.5)], []),
        (["--cut", "-1,0,0>-2", "--cut", "z<0"], [], [Cut("-x", -2), Cut("-z", 0)]),
        (
            ["--cut", "x>1", "--select", "0<=stress<=1", "--select-light", "keeps"],
            [Select("stress", 0, 1)],
            [Cut("x", 1)],
        ),
        (["--select", "velocity.x=2"], [], [Select("velocity.x", 2, 2)]),
    ],
)
def test_what_is_hidden_and_for_whom(file, tmp_path, rendered, given, kept, opened):
    assert run("render", file, "-o", tmp_path / "a.png", *given) == 0
    assert list(rendered[0]["view"].conditions) == kept
    assert list(rendered[0]["scene"].conditions) == opened


def test_radius_scale(file, tmp_path, rendered, served):
    assert run("render", file, "-o", tmp_path / "a.png", "--radius-scale", 1.5) == 0
    assert (
        run("view", file, "--no-browser", "--radius-scale", 1.5, "--cut", "x>1", "--cut-light", "opens") == 0
    )
    for scene in (rendered[0]["scene"], served[0]["scene"]):
        np.testing.assert_allclose(scene.particles.radii, 0.15, rtol=1e-6)
    assert served[0]["scene"].conditions == (Cut("x", 1),)


@pytest.mark.parametrize(
    "given, message",
    [
        (["--cut", "w>1"], "x>0.5"),
        (["--select", "stress"], "stress>1e6"),
        (["--select", "strain>1"], "no scalar 'strain'"),
        (["--select", "strain>1", "--select-light", "keeps"], "no scalar 'strain'"),
        (["--radius-scale", "0"], "positive"),
        (["--cut-light", "maybe"], "keeps"),
    ],
)
def test_bad_hiding_is_refused(file, tmp_path, rendered, capsys, given, message):
    assert message in refused(capsys, "render", file, "-o", tmp_path / "a.png", *given)


def test_a_saved_view_brings_its_light_and_options_override_it(tmp_path, rendered, capsys):
    for k in range(3):
        np.savez(tmp_path / f"step{k}.npz", position=np.eye(3) * (k + 1), radius=0.1, t=np.arange(3.0))
    steps = str(tmp_path / "step*.npz")
    sun, glow = Sun((0, 0, 1), 0.5), luxel.SphereLight((0, 0, 9), 1)
    light = luxel.Lighting("ao", (Sky(0.25), sun, glow), 0.3, ao_distance=2, hide=Cut("x", 2), radius_scale=2)
    view = View(exposure=2, color_by="t", hide=Cut("y", 2.5))
    luxel.SavedView(view, light, 2).save(tmp_path / "view.json")
    saved = ["render", steps, "-o", tmp_path / "a.png", "--view", tmp_path / "view.json"]
    assert run(*saved) == 0
    scene, shown = rendered[0]["scene"], rendered[0]["view"]
    assert luxel.Lighting.of(scene).to_json() == light.with_changes(hide=(Cut("x", 2),)).to_json()
    assert scene.particles.bounds[1].max() == pytest.approx(3.2)  # frame 2, radii doubled
    assert shown.to_json() == view.to_json()
    assert (
        run(
            *saved,
            "--frame",
            0,
            "--model",
            "shadows",
            "--sky",
            2,
            "--cut",
            "x>9",
            "--cut-light",
            "keeps",
            "--exposure",
            1,
        )
        == 0
    )
    scene, shown = rendered[1]["scene"], rendered[1]["view"]
    assert scene.model == "shadows"
    assert [type(each) for each in scene.sources] == [Sky, Sun, luxel.SphereLight]
    assert scene.sources[0].level == 2
    assert scene.sources[1].level == 0.5
    assert scene.particles.bounds[1].max() == pytest.approx(1.2)
    assert shown.conditions == (Cut("y", 2.5), Cut("x", 9))
    assert shown.exposure == 1
    # The view of frame 2 on a single file: the frame is left out, and it says so.
    capsys.readouterr()
    assert run("render", tmp_path / "step0.npz", *saved[2:]) == 0
    assert "frame 2" in capsys.readouterr().err


def test_what_render_prints_can_be_rendered_again(file, tmp_path, rendered, capsys):
    given = ["--model", "ao", "--cut", "x>0.5", "--select", "stress>0", "--select-light", "keeps"]
    assert run("render", file, "-o", tmp_path / "a.png", "--json", *given) == 0
    printed = json.loads(capsys.readouterr().out)
    (tmp_path / "view.json").write_text(json.dumps(printed["view"]))
    assert run("render", file, "-o", tmp_path / "b.png", "--view", tmp_path / "view.json") == 0
    first, second = rendered
    assert second["scene"].key == first["scene"].key
    assert second["view"].to_json() == {
        **first["view"].to_json(),
        "camera": printed["view"]["view"]["camera"],
    }
