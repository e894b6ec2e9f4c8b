"""Baked textures in a real headless Chromium: the shader decodes them all, and nothing is asked of the server."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import luxel
from luxel.app.viewer import view
from luxel.light.mapping import Mapping
from luxel.session import Session
from luxel.textures.spec import TextureSpec
from luxel.textures.store.bake import bake_to, encode_to
from luxel.textures.store.layout import CodecChoice
from luxel.textures.store.reader import Baked
from tests.app.chromium import Browser, Page
from tests.app.pictures import WAIT_S, agree, capture, choose, settle

pytestmark = pytest.mark.browser

WINDOW = (240, 180)
# From below: the south pole of one map and the corners of the other.
LOOK = luxel.View(camera=luxel.Camera((0.3, -0.4, -6.0), (0, 0, 0), up=(0, 1, 0)))
CODECS = {
    "raw": CodecChoice(),
    "vq": CodecChoice("vq", codewords=40),
    "pca": CodecChoice("pca", components=6),  # no whole number of words
    "cpca": CodecChoice("cpca", error=5.0),
    "sh": CodecChoice("sh", ratio=2.0),
}


def spheres(seed: int) -> luxel.Particles:
    """Few large ones, so that every part of the map shows, its edges and corners included."""
    return luxel.Particles(np.random.default_rng(seed).uniform(-1, 1, (150, 3)), 0.22)


@pytest.fixture(scope="module")
def bakes(tmp_path_factory: pytest.TempPathFactory) -> dict[Mapping, Baked]:
    """Raw textures of two time steps under both maps."""
    folder = tmp_path_factory.mktemp("bakes")
    mappings: tuple[Mapping, ...] = ("latlong", "octahedral")
    return {
        mapping: bake_to(
            folder / f"{mapping}.zarr",
            [spheres(4), spheres(5)],
            frames=[0, 1],
            model="shadows",
            spec=TextureSpec(mode="paper", samples=1, texels=8, mapping=mapping),
        )
        for mapping in mappings
    }


@pytest.mark.parametrize("mapping", ["latlong", "octahedral"])
@pytest.mark.parametrize("kind", list(CODECS))
def test_page_decodes_as_the_ray_tracer_does(
    bakes: dict[Mapping, Baked], mapping: Mapping, kind: str, tmp_path: Path, browser: Browser
) -> None:
    baked = bakes[mapping] if kind == "raw" else encode_to(tmp_path / "b.zarr", bakes[mapping], CODECS[kind])
    with (
        Session(baked, view=LOOK) as session,
        view(session, block=False, open_browser=False, announce=lambda url: None) as viewer,
        Page(viewer.url, WINDOW, browser=browser) as page,
    ):
        page.wait("window.luxel && luxel.state().baked", WAIT_S, lambda found: found == kind)
        state = settle(page)
        agree(page, viewer, LOOK, f"{mapping}-{kind}", baked[0].compressed, mean_max=0.5)
        assert state["received"] == 0
        assert state["troubles"] == {}
        # The server was asked for nothing, so it has computed nothing.
        status = session.status()
        assert (status.ready, status.queued, status.baking) == (0, 0, 0)
        page.wait("document.getElementById('counts').textContent", WAIT_S, lambda text: "baked light" in text)
        assert [text for text in page.messages if "performance warning" not in text] == []


def test_frames_bring_their_own_textures(
    bakes: dict[Mapping, Baked], tmp_path: Path, browser: Browser
) -> None:
    baked = encode_to(tmp_path / "b.zarr", bakes["latlong"], CODECS["pca"])
    with (
        Session(baked, view=LOOK) as session,
        view(session, block=False, open_browser=False, announce=lambda url: None) as viewer,
        Page(viewer.url, WINDOW, browser=browser) as page,
    ):
        page.wait("window.luxel && luxel.state().baked", WAIT_S)
        first = settle(page)
        before = capture(page)[1]
        choose(page, "frame", "1", "input")
        page.wait("luxel.state()", WAIT_S, lambda s: s["key"] != first["key"] and s["baked"])
        settle(page)
        agree(page, viewer, LOOK, "baked-frame", baked[1].compressed, mean_max=0.5)
        assert (capture(page)[1] != before).any()
        # And what is shown is not light in closed form, from which the bake must differ.
        with pytest.raises(AssertionError):
            agree(page, viewer, LOOK, "not-lambertian", session.source, mean_max=0.5)
