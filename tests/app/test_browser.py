"""The whole viewer in a real headless Chromium: light arrives, and the picture is the ray tracer's."""

from __future__ import annotations

import os
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import luxel
from luxel.app.viewer import Viewer, view
from luxel.scene.scene import Scene
from luxel.session import Session
from luxel.textures.bake import Baker
from luxel.textures.spec import TextureSpec
from tests.app.chromium import Browser, Page
from tests.app.pictures import WAIT_S, agree, choose, settle
from tests.conftest import shared_data

pytestmark = [pytest.mark.browser, pytest.mark.shared_data]

WINDOW = (420, 300)


# Hold the light back until the page knows all that it sees, and textures until it has shown their first light.
SIGHTED, DAWNED = threading.Event(), threading.Event()


class PatientBaker(Baker):
    def __init__(self, scene: Scene, spec: TextureSpec) -> None:
        super().__init__(scene, spec)
        assert SIGHTED.wait(WAIT_S)

    def preparation(self, threads: int) -> Iterator[None]:
        assert DAWNED.wait(WAIT_S)  # one thread waits here; the other goes on with first light
        yield from super().preparation(threads)


@pytest.fixture(scope="module")
def viewer() -> Iterator[Viewer]:
    series = luxel.open(shared_data("mpm_generated/bullet_008.npz"))
    look = luxel.View(color_by="velocity_magnitude", colormap="plasma")
    spec = TextureSpec(mode="paper", samples=1, texels=8)
    with (
        Session(series, spec=spec, view=look, threads=2, make_baker=PatientBaker) as session,
        view(session, block=False, open_browser=False, announce=lambda url: None) as opened,
    ):
        yield opened
        SIGHTED.set()
        DAWNED.set()


@pytest.fixture(scope="module")
def page(viewer: Viewer, browser: Browser, request: pytest.FixtureRequest) -> Iterator[Page]:
    with Page(viewer.url, WINDOW, browser=browser) as opened:
        opened.wait("window.luxel && document.getElementById('fold').click() === undefined", WAIT_S)
        failed_before = request.session.testsfailed
        yield opened
        if request.session.testsfailed > failed_before:
            folder = Path(os.environ.get("LUXEL_PICTURES", tempfile.gettempdir()))
            saved = opened.screenshot(folder / "luxel-browser-failure.png")
            print(f"screenshot: {saved}; the page said: {opened.messages}")  # noqa: T201


LOOK = luxel.View(color_by="velocity_magnitude", colormap="plasma")


def test_light_arrives(page: Page, viewer: Viewer) -> None:
    """First the particles without global light, then first light, then a texture for every visible one."""
    page.wait("window.luxel && luxel.state().loaded > 0 && luxel.state().frames > 0", WAIT_S)
    first = page.wait("luxel.state()", WAIT_S, lambda state: state["settled"] and state["visible"] > 100)
    assert first["ready"] == first["coarse"] == 0
    agree(page, viewer, LOOK, "bare")
    page.wait("0", WAIT_S, lambda _: viewer.session.status().queued == first["visible"])
    SIGHTED.set()
    dawned = page.wait("luxel.state()", WAIT_S, lambda state: state["coarse"] == state["visible"])
    assert dawned["ready"] == 0
    agree(page, viewer, LOOK, "first-light")
    DAWNED.set()
    last = settle(page)
    assert last["received"] >= last["visible"] > 1000
    assert last["visible"] < 0.5 * last["particles"]  # what is hidden was never asked for
    assert last["requested"] < 0.5 * last["particles"]
    assert last["troubles"] == {}
    agree(page, viewer, LOOK, "start")


def test_recolouring_costs_no_light(page: Page, viewer: Viewer) -> None:
    before = settle(page, fully=True)
    choose(page, "color-by", "pressure")
    choose(page, "colormap", "coolwarm")
    page.wait("luxel.state().coloring", WAIT_S, lambda text: "pressure" in text and "coolwarm" in text)
    after = settle(page)
    assert (after["requested"], after["received"], after["key"]) == (
        before["requested"],
        before["received"],
        before["key"],
    )
    agree(page, viewer, luxel.View(color_by="pressure", colormap="coolwarm"), "recoloured")
    choose(page, "colormap", "tab10")
    choose(page, "color-by", "material")
    page.wait("luxel.state().coloring", WAIT_S, lambda text: "material" in text and "tab10" in text)
    agree(page, viewer, luxel.View(color_by="material", colormap="tab10"), "categorical")


def test_orbiting_lights_what_comes_into_sight(page: Page, viewer: Viewer) -> None:
    choose(page, "color-by", "velocity_magnitude")
    choose(page, "colormap", "plasma")
    before = settle(page, fully=True)
    width, height = before["width"], before["height"]
    camera = page.run("luxel.camera()")
    page.drag((0.3 * width, 0.4 * height), (0.8 * width, 0.9 * height))
    assert page.run("luxel.camera()") != camera
    page.wait("luxel.state().requested", WAIT_S, lambda count: count > before["requested"])
    after = settle(page)
    assert after["received"] > before["received"]
    assert after["requested"] - before["requested"] < after["visible"]  # what was lit already stays lit
    agree(page, viewer, LOOK, "orbited")


def test_orthographic_and_close_views_agree(page: Page, viewer: Viewer) -> None:
    page.run("document.getElementById('orthographic').click()")
    settle(page)
    agree(page, viewer, LOOK, "orthographic")
    page.run("document.getElementById('orthographic').click()")
    # Right above the surface, between particles: spheres that reach beside and behind the eye.
    low, high = viewer.session.particles.bounds
    eye = np.array([0.7 * low[0] + 0.3 * high[0], 0.5 * (low[1] + high[1]), 0.5 * (low[2] + high[2])])
    target = 0.5 * (low + high) + [0.0, 0.02, -0.03]
    page.run(
        f"luxel.setCamera({{eye: {eye.tolist()}, target: {target.tolist()}, up: [0, 0, 1], fov: 70, height: null}})"
    )
    settle(page)
    agree(page, viewer, LOOK, "close")


def test_new_light_replaces_the_old(page: Page, viewer: Viewer) -> None:
    page.run("luxel.setCamera({...luxel.camera(), fov: 30})")
    page.run("document.querySelector('[data-axis=z]').click()")
    before = settle(page)
    choose(page, "azimuth", "60", "input")
    page.wait("luxel.state().key", WAIT_S, lambda key: key != before["key"])
    after = settle(page)
    assert after["key"] == viewer.session.key
    agree(page, viewer, LOOK, "relit")
    choose(page, "model", "lambertian")
    page.wait("luxel.state().model === 'lambertian'", WAIT_S)
    agree(page, viewer, LOOK, "lambertian")
    asked = page.run("luxel.state().requested")
    page.run("document.querySelector('[data-axis=x]').click()")
    page.wait("(s => s.known && s.visible > 0)(luxel.state())", WAIT_S)
    assert page.run("luxel.state().requested") == asked  # without shadows there is nothing to wait for


def test_page_reconnects_and_draws_nothing_when_idle(page: Page) -> None:
    page.run("luxel.app.connection.socket.close()")
    page.wait("luxel.state().connected && Object.keys(luxel.state().troubles).length === 0", WAIT_S)
    page.wait("(s => s.settled && s.samples === 16 && !luxel.app.drawing.scheduled)(luxel.state())", WAIT_S)
    frames = page.run("luxel.state().frames")
    for _ in range(20):
        page.run("new Promise(requestAnimationFrame)")
    assert page.run("luxel.state().frames") == frames


def test_page_reports_no_errors(page: Page) -> None:
    assert [text for text in page.messages if "performance warning" not in text] == []


def test_octahedral_textures_agree(browser: Browser) -> None:
    # Few large spheres, so that every part of the map shows, its edges and corners included.
    positions = np.random.default_rng(4).uniform(-1, 1, (60, 3))
    scene = luxel.Scene(luxel.Particles(positions, 0.25), model="shadows")
    spec = TextureSpec(mode="paper", samples=1, texels=8, mapping="octahedral")
    camera = luxel.Camera((0.3, -0.4, -6.0), (0, 0, 0), up=(0, 1, 0))  # from below: -Z is in the corners
    look = luxel.View(camera=camera)
    with (
        Session(scene, spec=spec, view=look, threads=2) as session,
        view(session, block=False, open_browser=False, announce=lambda url: None) as opened,
        Page(opened.url, WINDOW, browser=browser) as page,
    ):
        settle(page)
        agree(page, opened, look, "octahedral")
