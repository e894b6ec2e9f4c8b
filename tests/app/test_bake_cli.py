"""``luxel bake | encode | plan`` and what other commands make of a store; real processes that are really killed."""

import json
import os
import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image as Pillow

import luxel
from luxel.app import bake_commands
from luxel.app.parse import frame_range
from luxel.app.report import bytes_text, time_text
from luxel.textures.store.files import lock
from tests.app.command_line import refused, run
from tests.textures.stores import hashes

COUNT = 40
QUICK = ["--samples", "1", "--mode", "paper", "--threads", "1", "--chunk", "16"]


def write(path, count=COUNT, seed=1):
    rng = np.random.default_rng(seed)
    np.savez(
        path,
        position=rng.random((count, 3)),
        radius=np.full(count, 0.1),
        stress=rng.normal(size=count),
        time=seed,
    )
    return str(path)


@pytest.fixture
def file(tmp_path):
    return write(tmp_path / "cloud.npz")


@pytest.fixture(scope="module")
def baked(tmp_path_factory):
    """A store of what `file` holds, baked once for all."""
    folder = tmp_path_factory.mktemp("baked")
    path = folder / "baked.zarr"
    given = [write(folder / "cloud.npz"), "-o", path, *QUICK, "--sky", "0.8", "--up", "y"]
    assert run("bake", *given) == 0
    return path


@pytest.fixture
def store(baked, tmp_path, capsys):
    capsys.readouterr()
    return str(shutil.copytree(baked, tmp_path / "baked.zarr"))


# real processes


def start(*arguments):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.Popen(
        [sys.executable, "-m", "luxel", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    )


def stopped(process, sign, file):
    """Send a signal as soon as `file` is there; return exit code and stderr."""
    while not file.exists():
        assert process.poll() is None, process.communicate()
    process.send_signal(sign)
    _, err = process.communicate(timeout=120)
    return process.returncode, err


@pytest.fixture(scope="module")
def long(tmp_path_factory):
    """Arguments of a bake that takes a while, and what it comes to when nothing stops it."""
    folder = tmp_path_factory.mktemp("long")
    file = write(folder / "long.npz", 1200)
    given = [file, "--mode", "paper", "--samples", "9", "--chunk", "64"]
    assert run("bake", *given, "-o", folder / "whole.zarr") == 0
    return given, hashes(folder / "whole.zarr")


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="there is no kill -9 on this system")
def test_kill_9_loses_no_finished_chunk(long, tmp_path, capsys):
    given, whole = long
    path = tmp_path / "a.zarr"
    chunks = path / "frames/0000/payload/c"
    for k in (1, 6, 11):
        code, _ = stopped(start("bake", *given, "-o", path), signal.SIGKILL, chunks / str(k) / "0")
        assert code == -signal.SIGKILL
        assert all((chunks / str(before) / "0").exists() for before in range(k))
    assert "not finished" in refused(capsys, "info", path)
    assert run("bake", *given, "-o", path) == 0
    assert hashes(path) == whole
    assert run("bake", *given, "-o", path) == 0
    assert "complete already" in capsys.readouterr().out


@pytest.mark.skipif(os.name == "nt", reason="signals are otherwise on Windows")
def test_ctrl_c_says_how_to_go_on(long, tmp_path):
    given, whole = long
    path = tmp_path / "a.zarr"
    code, err = stopped(start("bake", *given, "-o", path), signal.SIGINT, path / "frames/0000/payload/c/2/0")
    assert code == 130
    assert f"finished chunks are kept in {path} — run the same command again" in err
    assert "Traceback" not in err
    assert run("bake", *given, "-o", path) == 0
    assert hashes(path) == whole


# bake


def test_bake_passes_everything_on(file, tmp_path, monkeypatch, capsys):
    calls = []

    def bake_to(path, target, **named):
        calls.append({"path": path, "target": target, **named})
        raise KeyboardInterrupt

    monkeypatch.setattr("luxel.textures.store.bake.bake_to", bake_to)
    given = (
        "--codec pca --components 8 --keep-raw --frames 0:1 --mode paper --seed 3 --mapping octahedral --up y"
    )
    given += " --model shadows --albedo 0.3 --sun none --sky 2 --chunk 7 --overwrite --threads 2"
    assert run("bake", file, "-o", tmp_path / "a.zarr", *given.split()) == 130
    assert "run the same command again" in capsys.readouterr().err
    (call,) = calls
    assert call["spec"] == luxel.TextureSpec(samples=49, mode="paper", seed=3, mapping="octahedral")
    assert (call["codec"].kind, call["codec"].options) == ("pca", {"components": 8})
    names = ("keep_raw", "frames", "model", "albedo", "chunk", "overwrite", "threads", "up")
    assert [call[name] for name in names] == [True, [0], "shadows", 0.3, 7, True, 2, "y"]
    (sky,) = call["lights"]
    assert sky.level == 2


@pytest.mark.parametrize(
    "given, message",
    [
        ("--ratio 4", "codec raw keeps every texel"),
        ("--codec mp3", "--codec"),
        ("--samples 5 --mode paper", "square"),
        ("--frames 3:9", "frames 0..0"),
        ("--frames x", "expected A:B"),
        ("--chunk 0", "above 0"),
        ("--frame 0", "unrecognized"),
    ],
)
def test_bad_options_are_one_clear_line(file, tmp_path, capsys, given, message):
    assert message in refused(capsys, "bake", file, "-o", tmp_path / "a.zarr", *given.split())
    assert not (tmp_path / "a.zarr").exists()


@pytest.mark.parametrize(
    "text, chosen",
    [(":", [0, 1, 2]), ("1:", [1, 2]), ("0:2", [0, 1]), ("-1", [2]), ("1", [1]), ("::2", [0, 2])],
)
def test_frames(text, chosen):
    assert list(range(3))[frame_range(text)] == chosen


def test_other_settings_and_other_particles_are_refused(file, store, tmp_path, capsys):
    err = refused(capsys, "bake", file, "-o", store, *QUICK, "--up", "y")
    assert f"{store}: this store holds another bake: settings.lights is" in err
    assert "--overwrite" in err
    other = write(tmp_path / "other.npz", seed=2)
    err = refused(capsys, "bake", other, "-o", store, *QUICK, "--sky", "0.8", "--up", "y")
    assert "begun with other particles" in err
    assert run("bake", other, "-o", store, *QUICK, "--overwrite") == 0


def test_two_bakes_at_once(file, store, tmp_path, capsys):
    from pathlib import Path

    with lock(Path(store)):
        assert "another process is baking" in refused(capsys, "bake", file, "-o", store, *QUICK)


def test_what_is_baked_is_not_baked_again(store, tmp_path, capsys):
    assert "is baked already — luxel encode" in refused(capsys, "bake", store, "-o", tmp_path / "b.zarr")


# what the other commands make of it


def test_info(store, capsys):
    assert run("info", store) == 0
    text = capsys.readouterr().out
    for part in ("cloud.npz", "40", "stress", "raw", "ratio 1", "Sky 0.8", "paper", "time 1", "clipped"):
        assert part in text
    assert run("info", store, "--json") == 0
    assert json.loads(capsys.readouterr().out)["frames"][0]["particles"] == COUNT


def test_a_picture_of_a_store_is_that_of_the_file(file, store, tmp_path, capsys):
    look = ["--size", "48x32", "--color-by", "stress", "--azimuth", "20", "--antialias", "1"]
    assert run("render", store, "-o", tmp_path / "a.png", *look) == 0
    light = ["--samples", "1", "--mode", "paper", "--sky", "0.8", "--up", "y"]
    assert run("render", file, "-o", tmp_path / "b.png", *look, *light) == 0
    first, second = (np.asarray(Pillow.open(tmp_path / name)) for name in ("a.png", "b.png"))
    assert np.array_equal(first, second)


@pytest.mark.parametrize("command", ["render", "view"])
@pytest.mark.parametrize(
    "given",
    [
        "--sun 3,4",
        "--sky 0",
        "--model ao",
        "--samples 4",
        "--albedo 0.7",
        "--seed 0",
        "--radius 1",
        "--periodic x",
    ],
)
def test_light_of_a_store_cannot_be_changed(store, tmp_path, capsys, command, given):
    rest = ["-o", tmp_path / "a.png"] if command == "render" else ["--no-browser"]
    err = refused(capsys, command, store, *rest, *given.split())
    assert f"{given.split()[0]}: the light of {store} is baked in" in err


def test_more_refusals(file, store, tmp_path, capsys):
    out = ["-o", tmp_path / "a.png"]
    assert "--light" in refused(capsys, "render", store, *out, "--light", "pixel")
    assert "looked at alone" in refused(capsys, "render", store, file, *out)
    assert "no frame 3" in refused(capsys, "render", store, *out, "--frame", "3")
    assert "no such store" in refused(capsys, "render", tmp_path / "none.zarr", *out)
    assert "is baked already" in refused(capsys, "plan", str(store)[:-5] + ".zarr/frames")


def test_view_serves_the_store(store, monkeypatch):
    calls = []

    def view(session, view, **named):
        calls.append((session.series.path, session.frame, session.spec.mode, view.up))
        named["announce"]("http://127.0.0.1:1/?token=x")

    monkeypatch.setattr("luxel.app.viewer.view", view)
    assert run("view", store, "--no-browser", "--threads", 1) == 0
    assert calls == [(store, 0, "paper", "y")]


def test_encode(store, tmp_path, capsys):
    path = tmp_path / "small.zarr"
    assert run("encode", store, "-o", path, "--codec", "vq", "--codewords", 5) == 0
    assert "40 textures, vq" in capsys.readouterr().out
    assert luxel.open_baked(path).settings.codec.codewords == 5
    assert run("encode", path, "-o", tmp_path / "again.zarr") == 0
    assert "what its codec vq has lost stays lost" in capsys.readouterr().err


# plan


def test_plan_before_any_work(tmp_path, capsys):
    files = [write(tmp_path / f"step{k}.npz", 40 + k, k) for k in range(3)]
    assert run("plan", *files, "--frames", "1:", "--samples", "1", "--mode", "paper", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["frames"], found["mode"], found["sizes"]["raw"][1]) == (
        2,
        "paper",
        found["particles"] * 256,
    )
    assert found["seconds"] > 0
    assert run("plan", files[0], "--samples", "1", "--mode", "paper") == 0
    text = capsys.readouterr().out
    for part in ("1 frame, 40 particles", "raw", "10.2 kB", "16² bytes a texture", "textures a second"):
        assert part in text


def test_options_name_what_the_library_has():
    from luxel.textures import codecs

    assert set(bake_commands.CODECS) == set(codecs.KINDS)


def test_numbers_for_people():
    assert [bytes_text(n) for n in (0, 999, 1536, 140.9e6, 5e12)] == [
        "0 B",
        "999 B",
        "1.54 kB",
        "141 MB",
        "5 TB",
    ]
    assert [time_text(s) for s in (0.1, 42, 600, 5 * 3600 + 125, 1e7)] == [
        "1 s",
        "42 s",
        "10 min",
        "5 h 2 min",
        "116 days",
    ]


def test_figure(store, tmp_path, capsys):
    out = tmp_path / "figure.png"
    assert run("encode", store, "-o", tmp_path / "small.zarr", "--codec", "pca", "--components", "4") == 0
    capsys.readouterr()
    assert "--keep-raw" in refused(capsys, "figure", tmp_path / "small.zarr", "-o", out)
    assert run("figure", tmp_path / "small.zarr", "--raw", store, "-o", out, "--count", "5") == 0
    pixels = np.asarray(Pillow.open(out))
    assert pixels.shape == (3 * 102 + 6, 112 + 5 * 102, 3)
    assert len(np.unique(pixels)) > 20
    capsys.readouterr()
    assert "has frames 0..0" in refused(capsys, "figure", store, "-o", out, "--frame", "7")
