"""What tests of the front ends share: one Chromium, and a command line without its renderer and viewer."""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np
import pytest

import luxel
from luxel.app.warm import compile_ahead
from luxel.kernels.jit import cold
from luxel.picture.image import Image
from luxel.session import Session
from luxel.textures.spec import TextureSpec
from tests.app.chromium import Browser, find
from tests.app.command_line import COUNT
from tests.scenes import cloud


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """A running Chromium; tests open tabs in it."""
    if find() is None:
        if os.environ.get("LUXEL_NO_SKIP") == "1":
            pytest.fail("no Chromium found; set LUXEL_CHROMIUM")
        pytest.skip("no Chromium found")
    with Browser() as opened:
        yield opened


@pytest.fixture(scope="session", autouse=True)
def compiled() -> None:
    """On a machine that has no kernels yet, those that all need are compiled on two cores, as by the first command there."""
    if cold():
        compile_ahead()


@pytest.fixture(scope="session")
def warm() -> None:
    """Kernels of frames are compiled, which may take longer than tests wait for a picture."""
    spec = TextureSpec(mode="paper", samples=1, texels=8)
    with Session(luxel.Scene(cloud(5), model="shadows"), spec=spec, threads=1) as session:
        for frame in luxel.Frames(session, size=(16, 16)):
            assert frame.visible <= 5


@pytest.fixture
def file(tmp_path):
    rng = np.random.default_rng(1)
    path = tmp_path / "cloud.npz"
    np.savez(
        path,
        position=rng.random((COUNT, 3)),
        radius=np.full(COUNT, 0.1),
        stress=rng.normal(size=COUNT),
        velocity=rng.normal(size=(COUNT, 3)),
        time=0.5,
    )
    return str(path)


@pytest.fixture
def rendered(monkeypatch):
    """Replace the renderer by one that notes what it was asked for."""
    calls = []

    def render(scene, view=None, **named):
        calls.append({"scene": scene, "view": view, **named})
        width, height = named["size"]
        return Image(np.zeros((height, width, 3), np.uint8))

    monkeypatch.setattr("luxel.picture.raytrace.render", render)
    return calls


@pytest.fixture
def served(monkeypatch):
    """Replace the viewer by one that notes what it was asked for."""
    calls = []

    def view(target, view=None, **named):
        calls.append({"session": target, "scene": target.scene, "spec": target.spec, "view": view, **named})
        named["announce"]("http://127.0.0.1:1/?token=x")

    monkeypatch.setattr("luxel.app.viewer.view", view)
    return calls
