"""``luxel export`` on particle files and stores; and what a picture of nothing says."""

from __future__ import annotations

import numpy as np
import pytest

from tests.app.command_line import run

COUNT = 60
QUICK = ("--samples", "1", "--mode", "paper", "--threads", "1")


@pytest.fixture
def file(tmp_path):
    rng = np.random.default_rng(1)
    path = tmp_path / "cloud.npz"
    np.savez(
        path,
        position=rng.random((COUNT, 3)),
        radius=np.full(COUNT, 0.1),
        stress=rng.random(COUNT),
        heat=rng.random(COUNT),
    )
    return path


def test_a_file_becomes_a_page(file, tmp_path, capsys):
    page = tmp_path / "page.html"
    assert run("export", file, "-o", page, *QUICK, "--color-by", "stress", "--title", "A <cloud>") == 0
    out, err = capsys.readouterr()
    assert f"{page}: {COUNT} particles" in out
    assert "textures within" in out
    for part in ("stress 2", "light 8", "before compression"):
        assert part in err
    text = page.read_text(encoding="utf-8")
    assert "A &lt;cloud&gt;" in text
    assert run("export", file, "-o", page, *QUICK, "--scalars", "stress, heat", "--codec", "raw") == 0
    assert "heat 2" in capsys.readouterr().err


def test_a_store_becomes_a_page_with_its_own_codec(file, tmp_path, capsys):
    store, page = tmp_path / "baked.zarr", tmp_path / "page.html"
    assert run("bake", file, "-o", store, *QUICK, "--codec", "pca", "--components", "4") == 0
    capsys.readouterr()
    assert run("export", store, "-o", page) == 0
    assert "light 4" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["--scalars", "stres"], "no scalar 'stres'"),
        (["--scalars", "stress,,heat"], "expected names"),
        (["--components", "0", "--codec", "pca"], "--components"),
    ],
)
def test_bad_options_leave_no_page(file, tmp_path, capsys, given, message):
    page = tmp_path / "page.html"
    try:
        code = run("export", file, "-o", page, *QUICK, *given)
    except SystemExit as stop:  # argparse
        code = stop.code
    assert code == 2
    assert message in capsys.readouterr().err
    assert not page.exists()


def test_a_picture_without_particles_says_so(file, tmp_path, capsys):
    picture = tmp_path / "picture.png"
    given = ("-o", picture, *QUICK, "--size", "32x24", "--antialias", "1")
    assert run("render", file, *given) == 0
    assert "no particle" not in capsys.readouterr().err
    assert run("render", file, *given, "--cut", "x>-9") == 0
    assert "no particle is in the picture" in capsys.readouterr().err
