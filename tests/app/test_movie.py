"""luxel movie: pictures that are render's, light that is computed once, files that survive interruptions."""

from __future__ import annotations

import json
import os
import stat
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import luxel
from luxel.app import movie, movie_files
from luxel.app.movie_path import orbited
from luxel.errors import InputError
from luxel.textures import growing
from luxel.textures.spec import TextureSpec
from luxel.textures.store.bake import bake_to
from tests.app.command_line import refused, run
from tests.scenes import cloud

SIZE = (64, 48)
FAST = ("--size", "64x48", "--antialias", "1", "--samples", "1", "--mode", "paper", "--model", "shadows")
COUNT = 150


@pytest.fixture
def file(tmp_path: Path) -> Path:
    particles = cloud(COUNT)
    path = tmp_path / "cloud.npz"
    np.savez(path, positions=particles.positions, radii=particles.radii, value=particles.scalars["value"])
    return path


@pytest.fixture
def series(tmp_path: Path) -> Path:
    folder = tmp_path / "steps"
    folder.mkdir()
    for k in range(4):
        particles = cloud(COUNT, seed=k)
        value = particles.scalars["value"] * (k + 1)
        np.savez(folder / f"{k}.npz", positions=particles.positions, radii=particles.radii, value=value)
    return folder


def shown(folder: Path) -> list[np.ndarray]:
    return [np.asarray(Image.open(path)) for path in sorted(folder.glob("*.png"))]


def rendered(path: Path, view: luxel.View) -> np.ndarray:
    scene = luxel.Scene(luxel.open(str(path))[0], model="shadows")
    return luxel.render(scene, view, size=SIZE, antialias=1, samples=1, mode="paper").pixels


def test_an_orbit_is_what_render_draws_and_closes(file: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert run("movie", file, "-o", out, "--orbit", 360, "--seconds", 1, "--fps", 6, *FAST) == 0
    pictures = shown(out)
    assert [picture.shape for picture in pictures] == [(48, 64, 3)] * 6
    particles = luxel.open(str(file))[0]
    first = luxel.View(camera=luxel.View().camera_for(particles, SIZE))
    for k, picture in enumerate(pictures):
        np.testing.assert_array_equal(picture, rendered(file, orbited(first, 60.0 * k)))
    # From the last to the first it is one step, as from any other to the next.
    np.testing.assert_array_equal(rendered(file, orbited(orbited(first, 300.0), 60.0)), pictures[0])
    assert all((a != b).any() for a, b in zip(pictures, [*pictures[1:], pictures[0]], strict=True))


def test_light_is_computed_once_a_time_step(
    series: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    baked: list[tuple[str, int]] = []
    plain = growing.bake_with

    def noting(baker: Any, ids: np.ndarray, **options: Any) -> Any:
        baked.extend((baker.key, k) for k in ids.tolist())
        return plain(baker, ids, **options)

    monkeypatch.setattr(growing, "bake_with", noting)
    out = tmp_path / "out"
    options = ("--orbit", 90, "--frames", "1:3", "--seconds", 1, "--fps", 8, "--color-by", "radius")
    assert run("movie", f"{series}/*.npz", "-o", out, *options[:-2], *FAST) == 0
    assert len(shown(out)) == 8
    assert len(baked) == len(set(baked))
    assert len({key for key, _ in baked}) == 2


def framed(steps: list[luxel.Particles]) -> luxel.Camera:
    """The camera that sees all steps."""
    bounds = np.array([step.bounds for step in steps])
    everything = np.stack([bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)])
    return luxel.Camera.framing(everything, aspect=SIZE[0] / SIZE[1])


def test_steps_are_shown_one_by_one_on_one_scale(series: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert run("movie", f"{series}/*.npz", "-o", out, "--frames", ":", "--color-by", "value", *FAST) == 0
    pictures = shown(out)
    assert len(pictures) == 4
    steps = [luxel.open(str(series / f"{k}.npz"))[0] for k in range(4)]
    values = [step.scalar("value") for step in steps]
    ends = min(v.min() for v in values), max(v.max() for v in values)
    view = luxel.View(camera=framed(steps), color_by="value", range=ends)
    for k, picture in enumerate(pictures):
        np.testing.assert_array_equal(picture, rendered(series / f"{k}.npz", view))


def views(folder: Path, *changes: dict[str, Any], lighting: luxel.Lighting | None = None) -> list[Path]:
    paths = []
    bounds = cloud(COUNT).bounds
    for k, change in enumerate(changes):
        camera = luxel.Camera.framing(bounds, azimuth=40.0 * k)
        frame = change.pop("frame", None)
        paths.append(folder / f"{k}.json")
        luxel.SavedView(luxel.View(camera=camera, **change), lighting, frame).save(paths[-1])
    return paths


def test_saved_views_are_keyframes(file: Path, tmp_path: Path) -> None:
    first, last = views(tmp_path, {"exposure": 1.0}, {"exposure": 4.0})
    out = tmp_path / "out"
    options = ("--view", first, "--view", last, "--seconds", 0.5, "--fps", 10)
    assert run("movie", file, "-o", out, *options, *FAST) == 0
    pictures = shown(out)
    assert len(pictures) == 5
    for picture, path in ((pictures[0], first), (pictures[-1], last)):
        np.testing.assert_array_equal(picture, rendered(file, luxel.SavedView.load(path).view))
    brightness = [picture.astype(int).sum() for picture in pictures]
    assert brightness == sorted(brightness)


def test_time_steps_of_saved_views_are_walked_through(series: Path, tmp_path: Path) -> None:
    first, last = views(tmp_path, {"frame": 3}, {"frame": 1})
    out = tmp_path / "out"
    options = ("--view", first, "--view", last, "--seconds", 0.5, "--fps", 10)
    assert run("movie", f"{series}/*.npz", "-o", out, *options, *FAST) == 0
    view = luxel.SavedView.load(last).view
    np.testing.assert_array_equal(shown(out)[-1], rendered(series / "1.npz", view))


def test_stored_light_is_shown_without_computing_any(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    spec = TextureSpec(texels=8, samples=1, mode="paper")
    frames = [cloud(COUNT, seed=k) for k in range(2)]
    store = tmp_path / "b.zarr"
    baked = bake_to(store, frames, frames=[0, 1], model="shadows", spec=spec)
    monkeypatch.setattr(growing, "bake_with", None)
    out = tmp_path / "out"
    assert run("movie", store, "-o", out, "--frames", ":", "--size", "64x48", "--antialias", 1) == 0
    for picture, frame in zip(shown(out), baked, strict=True):
        expected = luxel.render(
            frame.scene, luxel.View(camera=framed(frames)), frame.compressed, SIZE, antialias=1
        ).pixels
        np.testing.assert_array_equal(picture, expected)


@pytest.mark.parametrize("model", ["lambertian", "ao"])
def test_pixels_can_be_traced_and_all_models_shown(file: Path, tmp_path: Path, model: str) -> None:
    out = tmp_path / "out"
    options = ("--orbit", 30, "--seconds", 0.1, "--fps", 20, "--size", "32x24", "--antialias", 1)
    light = ("pixel", 2) if model == "ao" else ("texture", 1)
    options += ("--light", light[0], "--samples", light[1], "--model", model)
    assert run("movie", file, "-o", out, *options) == 0
    assert len(shown(out)) == 2


def test_an_interrupted_sequence_goes_on_where_it_was(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ("--orbit", 360, "--seconds", 0.5, "--fps", 10, *FAST)
    whole, out = tmp_path / "whole", tmp_path / "out"
    assert run("movie", file, "-o", whole, *options) == 0
    drawn: list[int] = []
    plain = movie._Step.draw

    def interrupted(step: Any, view: Any, progress: Any) -> np.ndarray:
        drawn.append(1)
        if len(drawn) == 3:
            raise KeyboardInterrupt
        return plain(step, view, progress)

    monkeypatch.setattr(movie._Step, "draw", interrupted)
    capsys.readouterr()
    assert run("movie", file, "-o", out, *options) == 130
    assert "2 of 5 pictures" in capsys.readouterr().err
    kept = {path.name: path.stat().st_mtime_ns for path in out.glob("*.png")}
    assert sorted(kept) == ["000000.png", "000001.png"]
    assert sorted(path.name for path in out.iterdir()) == [*sorted(kept), "movie.json"]
    assert run("movie", file, "-o", out, *options) == 0
    assert len(drawn) == 3 + 3
    for path in sorted(whole.glob("*")):
        assert (out / path.name).read_bytes() == path.read_bytes()
    assert {name: (out / name).stat().st_mtime_ns for name in kept} == kept
    assert run("movie", file, "-o", out, *options) == 0
    assert len(drawn) == 6
    assert "complete already" in capsys.readouterr().out


def test_pictures_of_another_movie_are_not_mixed_in(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    options = ["--orbit", 360, "--seconds", 0.2, "--fps", 10, *FAST]
    assert run("movie", file, "-o", out, *options) == 0
    capsys.readouterr()
    for changed in (["--orbit", 90], ["--exposure", 2], ["--sky", 2], ["--seed", 1], ["--antialias", 2]):
        assert "another movie" in refused(capsys, "movie", file, "-o", out, *options, *changed)
    particles = cloud(COUNT, seed=9)
    np.savez(file, positions=particles.positions, radii=particles.radii)
    assert "another movie" in refused(capsys, "movie", file, "-o", out, *options)
    other = tmp_path / "other"
    other.mkdir()
    (other / "notes.txt").write_text("mine")
    assert "other files" in refused(capsys, "movie", file, "-o", other, *options)


@pytest.mark.parametrize("suffix", [".gif", ".webp"])
def test_animations_hold_all_pictures_for_their_time(file: Path, tmp_path: Path, suffix: str) -> None:
    out = tmp_path / f"orbit{suffix}"
    assert run("movie", file, "-o", out, "--orbit", 360, "--seconds", 0.2, "--fps", 30, *FAST) == 0
    durations = []
    with Image.open(out) as animation:
        assert animation.size == SIZE
        assert animation.n_frames == 6
        for k in range(6):
            animation.seek(k)
            animation.load()
            durations.append(animation.info["duration"])
    assert sum(durations) == pytest.approx(200, abs=5)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cloud.npz", out.name]


FFMPEG = """#!{python}
import sys
if "-encoders" in sys.argv:
    print(" V..... {encoder} a codec")
    sys.exit()
data = sys.stdin.buffer.read()
if {fails}:
    print("no space left", file=sys.stderr)
    sys.exit(1)
open(sys.argv[-1], "wb").write(data)
open({log!r}, "w").write(" ".join(sys.argv))
"""


def ffmpeg(folder: Path, *, encoder: str = "libx264", fails: bool = False) -> Path:
    """Make a program that takes pictures as ffmpeg does, and writes them down."""
    program = folder / "ffmpeg"
    text = FFMPEG.format(python=sys.executable, encoder=encoder, fails=fails, log=str(folder / "log"))
    program.write_text(text)
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    return program


def test_mp4_is_piped_through_ffmpeg(file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tools = tmp_path / "tools"
    tools.mkdir()
    ffmpeg(tools)
    monkeypatch.delenv("LUXEL_FFMPEG", raising=False)
    monkeypatch.setenv("PATH", str(tools), prepend=os.pathsep)
    out, folder = tmp_path / "a.mp4", tmp_path / "a"
    options = ("--orbit", 360, "--seconds", 0.3, "--fps", 10, *FAST)
    assert run("movie", file, "-o", out, *options) == 0
    assert run("movie", file, "-o", folder, *options) == 0
    raw = np.frombuffer(out.read_bytes(), np.uint8).reshape(3, 48, 64, 3)
    np.testing.assert_array_equal(raw, shown(folder))
    log = (tools / "log").read_text()
    assert "-s 64x48" in log
    assert "-framerate 10" in log
    assert "libx264" in log


def test_mp4_says_what_it_needs(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "a.mp4"
    options = (file, "-o", out, "--orbit", 360, "--seconds", 0.2, "--fps", 10, *FAST)
    monkeypatch.delenv("LUXEL_FFMPEG", raising=False)
    monkeypatch.setenv("PATH", "")
    said = refused(capsys, "movie", *options)
    assert "install it" in said
    assert "folder of PNGs" in said
    monkeypatch.setenv("LUXEL_FFMPEG", str(ffmpeg(tmp_path, encoder="theora")))
    assert "encoders" in refused(capsys, "movie", *options)
    monkeypatch.setenv("LUXEL_FFMPEG", str(ffmpeg(tmp_path, fails=True)))
    assert "no space left" in refused(capsys, "movie", *options)
    assert "even" in refused(capsys, "movie", *options, "--size", "63x48")
    monkeypatch.setenv("LUXEL_FFMPEG", str(tmp_path / "nowhere"))
    assert "does not work" in refused(capsys, "movie", *options)
    assert not [path for path in tmp_path.iterdir() if "mp4" in path.name]


def test_bad_input_is_told_before_any_work(
    file: Path,
    series: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(movie, "pictures", None)
    out = tmp_path / "out"
    orbit = ("--orbit", 360, *FAST)
    assert "nothing moves" in refused(capsys, "movie", file, "-o", out)
    assert "nothing moves" in refused(capsys, "movie", file, "-o", out, "--frames", "0")
    assert "none of them" in refused(capsys, "movie", file, "-o", out, "--frames", "5:9")
    assert "no movie format" in refused(capsys, "movie", file, "-o", tmp_path / "a.avi", *orbit)
    assert "no directory" in refused(capsys, "movie", file, "-o", tmp_path / "no" / "a.gif", *orbit)
    assert "no directory" in refused(capsys, "movie", file, "-o", tmp_path / "no" / "a", *orbit)
    assert "too much" in refused(
        capsys, "movie", file, "-o", tmp_path / "a.gif", *orbit, "--size", "8000x8000"
    )
    assert "pictures a second" in refused(capsys, "movie", file, "-o", out, *orbit, "--fps", 0)
    assert "seconds" in refused(capsys, "movie", file, "-o", out, *orbit, "--seconds", -1)
    assert "lower" in refused(capsys, "movie", file, "-o", out, *orbit, "--seconds", 30_000, "--fps", 240)
    assert "no scalar" in refused(capsys, "movie", file, "-o", out, *orbit, "--color-by", "nothing")
    first, last = views(tmp_path, {"frame": 0}, {"frame": 9})
    assert "frame 9" in refused(
        capsys, "movie", f"{series}/*.npz", "-o", out, "--view", first, "--view", last
    )
    dim = views(tmp_path, {}, lighting=luxel.Lighting(albedo=0.2))[0].rename(tmp_path / "dim.json")
    bright = views(tmp_path, {}, lighting=luxel.Lighting())[0]
    assert "one light" in refused(capsys, "movie", file, "-o", out, "--view", bright, "--view", dim)
    assert not out.exists()


def test_a_folder_says_what_it_holds(tmp_path: Path) -> None:
    movie_files.movie_file(tmp_path / "out", SIZE, 5, 25.0, {"digest": "a"})
    assert json.loads((tmp_path / "out" / "movie.json").read_text()) == {"digest": "a"}
    assert movie_files.movie_file(tmp_path / "out", SIZE, 3, 25.0, {"digest": "a"}).missing(3) == [0, 1, 2]
    with pytest.raises(InputError, match="another movie"):
        movie_files.movie_file(tmp_path / "out", SIZE, 5, 25.0, {"digest": "b"})
