import json
import os
import subprocess
import sys
from typing import get_args

import numpy as np
import pytest
from PIL import Image as Pillow

import luxel
from luxel import Camera, Scene, Sky, Sun, View
from luxel.app import cli, options, talk
from luxel.app.hub import Renderer
from luxel.errors import LuxelError
from luxel.light.mapping import Mapping
from luxel.scene.lights import default_lights, sun_direction
from luxel.scene.scene import MODELS
from luxel.session import Session
from tests.app.command_line import COUNT, refused, run

# info


def test_info(file, capsys):
    assert run("info", file) == 0
    text = capsys.readouterr().out
    for part in ("npz", "1 frame", "40", "time 0.5", "column radius", "stress", "velocity", "float64 x 3"):
        assert part in text


def test_info_json(file, capsys):
    assert run("info", file, "--json", "--radius", 0.25) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["particles"] == COUNT
    assert found["radii"]["max"] == 0.25
    assert found["scalars"]["velocity"]["components"] == 3


def test_several_files_are_one_series(tmp_path, capsys):
    for k in range(3):
        np.savez(tmp_path / f"step{k}.npz", position=np.eye(3) * (k + 1), radius=0.1)
    assert run("info", *(tmp_path / f"step{k}.npz" for k in range(3)), "--json", "--frame", -1) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["frames"], found["frame"]) == (3, 2)


def test_first_frame_with_particles_is_chosen_with_a_note(tmp_path, capsys):
    np.savez(tmp_path / "a0.npz", position=np.empty((0, 3)), radius=np.empty(0))
    np.savez(tmp_path / "a1.npz", position=np.eye(3), radius=np.full(3, 0.1))
    assert run("info", tmp_path / "a*.npz", "--json") == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["frame"] == 1
    assert "this is frame 1" in err


# render


def test_render_passes_everything_on(file, tmp_path, rendered, capsys):
    out = tmp_path / "a.png"
    given = "--size 64x48 --model shadows --color-by velocity.x --colormap magma --range -1e-1 2.5 --samples 25 --albedo 0.3"
    given += " --sun -30,40,1.5,10 --sky 0.5 --background white --exposure 2 --no-colorbar --threads 1 --seed 7 --mode paper --mapping octahedral"
    given += " --antialias 2 --light texture --up y"
    assert run("render", file, "-o", out, *given.split()) == 0
    (call,) = rendered
    scene, view = call["scene"], call["view"]
    assert (scene.model, scene.albedo) == ("shadows", 0.3)
    sky, sun = scene.lights
    assert sky.level == 0.5
    np.testing.assert_allclose(sun.direction, sun_direction(-30, 40, "y"))
    assert (sun.level, sun.angular_diameter) == (1.5, 10)
    assert (view.color_by, view.colormap, view.range, view.exposure) == (
        "velocity.x",
        "magma",
        (-0.1, 2.5),
        2,
    )
    assert (view.background, view.up, view.camera) == ("#ffffff", "y", None)
    expected = {
        "size": (64, 48),
        "samples": 25,
        "mode": "paper",
        "mapping": "octahedral",
        "seed": 7,
        "threads": 1,
        "antialias": 2,
        "colorbar": False,
        "light": "texture",
    }
    assert {name: call[name] for name in expected} == expected
    assert Pillow.open(out).size == (64, 48)
    assert "40 particles" in capsys.readouterr().out


def test_render_defaults_are_the_librarys(file, tmp_path, rendered):
    assert run("render", file, "-o", tmp_path / "a.png") == 0
    (call,) = rendered
    assert call["scene"].key == Scene(call["scene"].particles).key
    assert call["view"].to_json() == View().to_json()
    assert call["size"] == (1280, 720)


def test_render_json(file, tmp_path, rendered, capsys):
    assert (
        run("render", file, "-o", tmp_path / "a.png", "--size", "20x10", "--json", "--color-by", "stress")
        == 0
    )
    found = json.loads(capsys.readouterr().out)
    assert (found["size"], found["particles"], found["model"]) == ([20, 10], COUNT, "interreflection")
    assert luxel.SavedView.from_json(found["view"]).view.color_by == "stress"


@pytest.mark.parametrize(
    "given, kinds",
    [
        ([], [Sky, Sun]),
        (["--sky", "0"], [Sun]),
        (["--sun", "none"], [Sky]),
        (["--sun", "0,90", "--sun", "90,10"], [Sky, Sun, Sun]),
        (["--sky", "1,0.2"], [Sky, Sun]),
    ],
)
def test_a_given_light_replaces_that_default_only(file, tmp_path, rendered, given, kinds):
    assert run("render", file, "-o", tmp_path / "a.png", *given) == 0
    lights = rendered[0]["scene"].lights
    assert [type(light) for light in lights] == kinds
    defaults = dict(zip((Sky, Sun), default_lights(), strict=True))
    if "--sky" not in given:
        assert lights[0].level == defaults[Sky].level
    if "--sun" not in given:
        np.testing.assert_array_equal(lights[-1].direction, defaults[Sun].direction)


@pytest.mark.parametrize(
    "given", [["--azimuth", "-120"], ["--elevation", "80"], ["--orthographic"], ["--azimuth=10", "--up", "x"]]
)
def test_camera_angles(file, tmp_path, rendered, given):
    assert run("render", file, "-o", tmp_path / "a.png", "--size", "100x100", *given) == 0
    call = rendered[0]
    up = "x" if "--up" in given else "z"
    angles = {"azimuth": -60.0, "elevation": 25.0}
    if "-120" in given:
        angles["azimuth"] = -120.0
    if "80" in given:
        angles["elevation"] = 80.0
    if "--azimuth=10" in given:
        angles["azimuth"] = 10.0
    expected = Camera.framing(
        call["scene"].particles.bounds, aspect=1, up=up, orthographic="--orthographic" in given, **angles
    )
    np.testing.assert_allclose(call["view"].camera.eye, expected.eye)
    assert call["view"].camera.height == expected.height


def test_saved_view_and_what_overrides_it(file, tmp_path, rendered):
    saved = View(camera=Camera((9, 0, 0), (0, 0, 0)), color_by="stress", range=(0, 1), colormap="magma")
    (tmp_path / "view.json").write_text(json.dumps(saved.to_json()))
    given = ["render", file, "-o", tmp_path / "a.png", "--view", tmp_path / "view.json"]
    assert run(*given) == 0
    assert rendered[0]["view"].to_json() == saved.to_json()
    assert run(*given, "--colormap", "plasma") == 0
    assert rendered[1]["view"].to_json() == saved.with_changes(colormap="plasma").to_json()
    assert run(*given, "--color-by", "velocity", "--elevation", "10") == 0
    assert rendered[2]["view"].range is None
    assert rendered[2]["view"].camera.eye[0] != 9


@pytest.mark.parametrize(
    "given, message",
    [
        (["--color-by", "strain"], "stress"),
        (["--colormap", "viridi"], "viridis"),
        (["--samples", "50", "--mode", "paper"], "49"),
        (["--range", "2", "1"], "lo < hi"),
        (["--range", "0", "1", "--log"], "positive"),
        (["--albedo", "2"], "albedo"),
        (["--albedo", "much"], "albedo"),
        (["--exposure", "0"], "exposure"),
        (["--size", "100"], "1280x720"),
        (["--size", "0x10"], "16384"),
        (["--size", "99999x10"], "16384"),
        (["--sun", "1"], "AZIMUTH"),
        (["--sun", "a,b"], "AZIMUTH"),
        (["--sun", "1,2,-3"], "level"),
        (["--sky", "-1"], "level"),
        (["--sky", "bright"], "LEVEL"),
        (["--background", "whyte"], "white"),
        (["--frame", "3"], "frame"),
        (["--radius", "-1"], "radius"),
        (["--radius", "big"], "radius"),
        (["--threads", "0"], "threads"),
        (["--model", "phong"], "lambertian"),
        (["--seed", "-1"], "seed"),
        (["--ao-distance", "-1"], "ao_distance"),
        (["--view", "missing.json"], "missing.json"),
        (["--nonsense"], "nonsense"),
        (["--frame", "nan"], "frame"),
    ],
)
def test_bad_options_are_one_clear_line(file, tmp_path, rendered, capsys, given, message):
    assert message in refused(capsys, "render", file, "-o", tmp_path / "a.png", *given)
    assert rendered == []
    assert not (tmp_path / "a.png").exists()


@pytest.mark.parametrize(
    "text", ["{", "[1]", '{"colour": 1}', '{"camera": {"eye": [0]}}', "[" * 100_000, "\xff"]
)
def test_bad_view_files(file, tmp_path, rendered, capsys, text):
    (tmp_path / "view.json").write_bytes(text.encode("latin-1"))
    refused(capsys, "render", file, "-o", tmp_path / "a.png", "--view", tmp_path / "view.json")


@pytest.mark.parametrize("name", ["a.xyz", "missing/a.png", "a", "."])
def test_unwritable_output_is_found_before_anything_is_read(tmp_path, rendered, capsys, name):
    assert "input.npz" not in refused(capsys, "render", tmp_path / "input.npz", "-o", f"{tmp_path}/{name}")


@pytest.mark.parametrize("command", [["info"], ["render", "-o", "a.png"], ["view"]])
def test_missing_input(tmp_path, monkeypatch, capsys, command):
    monkeypatch.chdir(tmp_path)
    assert "nope.npz: no such file" in refused(capsys, *command, "nope.npz")


def test_broken_input(tmp_path, capsys):
    (tmp_path / "bad.npz").write_bytes(b"PK\x03\x04 no archive")
    assert "bad.npz" in refused(capsys, "info", tmp_path / "bad.npz")


def test_debug_shows_tracebacks(tmp_path):
    for arguments in (["--debug", "info", "nope.npz"], ["info", "nope.npz", "--debug"]):
        with pytest.raises(LuxelError):
            run(*arguments)


@pytest.mark.parametrize("error, code", [(KeyboardInterrupt, 130), (MemoryError, 2)])
def test_interruption(file, tmp_path, monkeypatch, capsys, error, code):
    def stop(*_, **__):
        raise error

    monkeypatch.setattr("luxel.picture.raytrace.render", stop)
    assert run("render", file, "-o", tmp_path / "a.png") == code
    lines = capsys.readouterr().err.strip().splitlines()
    assert len([line for line in lines if line and not line.startswith("luxel: compiling")]) == 1


def test_cold_start_is_announced(file, tmp_path, rendered, monkeypatch, capsys):
    for cold in (True, False):
        monkeypatch.setattr("luxel.kernels.jit.cold", lambda cold=cold: cold)
        assert run("render", file, "-o", tmp_path / "a.png") == 0
        assert ("compiling" in capsys.readouterr().err) is cold


def test_a_process_compiles_ahead_once(file, tmp_path, rendered, monkeypatch, capsys):
    started = []

    class Process:
        def __init__(self, command, **_):
            started.append(command[-1])

        def wait(self):
            pass

        terminate = wait

    monkeypatch.setattr("luxel.kernels.jit._cold", True)
    monkeypatch.setattr("subprocess.Popen", Process)
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    for _ in range(2):
        assert run("render", file, "-o", tmp_path / "a.png") == 0
    assert sorted(started) == ["light", "picture"]
    assert capsys.readouterr().err.count("compiling") == 1


def test_progress_goes_to_stderr_and_only_for_long_work(capsys):
    with talk.Progress() as progress:
        progress(0, 10)
        progress(10, 10)
    assert capsys.readouterr() == ("", "")


# view and demo


def test_view_serves_a_session(file, served, capsys):
    given = "--model ao --samples 4 --color-by stress --port 8123 --no-browser --threads 1 --sky 2 --ao-distance 0.5 --mapping octahedral"
    assert run("view", file, *given.split()) == 0
    (call,) = served
    assert (call["scene"].model, call["scene"].ao_distance, call["scene"].lights[0].level) == ("ao", 0.5, 2)
    assert (call["spec"].samples, call["spec"].mode, call["spec"].mapping) == (4, "fast", "octahedral")
    assert call["view"].color_by == "stress"
    assert (call["host"], call["port"], call["open_browser"], call["block"]) == (
        "127.0.0.1",
        8123,
        False,
        True,
    )
    assert capsys.readouterr().out == "http://127.0.0.1:1/?token=x\n"


@pytest.mark.parametrize("command", ["view", "demo"])
@pytest.mark.parametrize(
    "given, threads, budget_s",
    [
        ([], None, 0),
        (["--threads", "3"], 3, 0),
        (["--threads", "3", "--bake-threads", "1"], 1, 0),
        (["--bake-budget", "33ms"], None, 0.033),
        (["--bake-threads", "2", "--bake-budget", "0.02s"], 2, 0.02),
        (["--bake-budget", "1 s"], None, 1),
    ],
)
def test_light_gets_the_share_that_is_asked_for(file, served, monkeypatch, command, given, threads, budget_s):
    made = []

    class Noted(Session):
        def __init__(self, *what, **options):
            made.append(options)
            super().__init__(*what, **options)

    monkeypatch.setattr("luxel.session.Session", Noted)
    assert cli.main([command, *([file] if command == "view" else []), *given]) == 0
    assert made[0]["threads"] == threads
    assert made[0]["bake_budget_s"] == pytest.approx(budget_s)


@pytest.mark.parametrize("given", ["33", "0ms", "-1ms", "2s", "1m", "ms", "nan"])
def test_a_budget_needs_a_unit_and_a_range(file, served, capsys, given):
    with pytest.raises(SystemExit):
        cli.main(["view", file, f"--bake-budget={given}"])
    assert "expected a time above 0 and up to 1s" in capsys.readouterr().err


def test_view_checks_the_scalar_first(file, served, capsys):
    assert "stress" in refused(capsys, "view", file, "--color-by", "strain")
    assert served == []


def test_demo_serves_the_shipped_data(served):
    from luxel.data import demo_view

    assert run("demo", "--no-browser", "--threads", "1") == 0
    (call,) = served
    assert len(call["scene"].particles) > 50_000
    assert call["view"].to_json() == demo_view().to_json()


def test_demo_render_draws_the_same_picture(tmp_path, rendered):
    from luxel.data import demo_particles, demo_view

    assert run("demo", "--render", tmp_path / "a.png", "--size", "32x18", "--colormap", "magma") == 0
    (call,) = rendered
    assert call["scene"].particles is demo_particles()
    assert call["view"].to_json() == demo_view().with_changes(colormap="magma").to_json()
    assert call["samples"] == 2
    assert run("demo", "--render", tmp_path / "b.png", "--size", "32x18", "--mode", "paper") == 0
    assert rendered[-1]["samples"] is None


def test_demo_data():
    from luxel.data import demo_particles, demo_view

    particles = demo_particles()
    assert {"stress", "plastic_strain", "velocity", "pressure"} == set(particles.scalars)
    assert particles.radii.min() > 0
    low, high = particles.bounds
    np.testing.assert_allclose(high - low, [0.65, 0.61, 0.33], atol=0.01)
    assert np.isfinite(demo_view().colors(particles)).all()


# The real thing


def test_real_render_end_to_end(file, tmp_path, capsys):
    given = [
        "--size",
        "32x24",
        "--samples",
        "1",
        "--antialias",
        "1",
        "--threads",
        "1",
        "--color-by",
        "stress",
    ]
    for light in ("texture", "pixel"):
        out = tmp_path / f"{light}.png"
        assert run("render", file, "-o", out, "--light", light, *given) == 0
        pixels = np.asarray(Pillow.open(out)).astype(int)
        assert pixels.shape == (24, 32, 3)
        assert (pixels[0, 0] == [0x17, 0x19, 0x1D]).all()
        assert np.abs(pixels - pixels[0, 0]).max() > 60
    capsys.readouterr()


def test_options_name_what_the_library_has():
    assert options.MODELS == MODELS
    assert set(options.MODES) == {"paper", "fast"}
    assert get_args(Mapping) == options.MAPPINGS
    assert get_args(Renderer) == options.RENDERERS


def command(*arguments, **more):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        env=environment,
        timeout=120,
        check=False,
        **more,
    )


def test_module_and_version():
    done = command("-m", "luxel", "--version")
    assert (done.returncode, done.stdout) == (0, f"luxel {luxel.__version__}\n")


def test_no_command_is_an_error():
    done = command("-m", "luxel")
    assert done.returncode == 2
    assert "COMMAND" in done.stderr


@pytest.mark.parametrize("name", [None, "info", "render", "view", "demo", "bake", "encode", "plan"])
def test_help_loads_nothing_heavy(name):
    arguments = [*([name] if name else []), "--help"]
    code = (
        "import sys, luxel.app.cli\n"
        f"try: luxel.app.cli.main({arguments!r})\n"
        "except SystemExit as stop: assert stop.code == 0\n"
        "heavy = {'numba', 'scipy', 'matplotlib', 'starlette', 'PIL', 'numpy'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    done = command("-c", code)
    assert done.returncode == 0, done.stderr
    assert "usage: luxel" in done.stdout


def test_output_pipe_that_closes_early(file):
    code = (
        "import os, sys, luxel.app.cli\n"
        "read, write = os.pipe(); os.close(read); os.dup2(write, 1)\n"
        f"sys.exit(luxel.app.cli.main(['info', {file!r}]))\n"
    )
    done = command("-c", code)
    assert done.returncode == 1
    assert done.stderr == ""
