"""Pictures that the server draws, in a real headless Chromium: they are the ray tracer's, also without WebGL."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import luxel
from luxel.app.viewer import Viewer, view
from luxel.light.lights import scene_white
from luxel.session import Session
from luxel.textures.spec import TextureSpec
from luxel.textures.store.bake import bake_to
from luxel.textures.textures import TextureSource
from tests.app.chromium import Browser, Page
from tests.app.pictures import WAIT_S, agree, capture, choose, match, settle
from tests.scenes import cloud

pytestmark = pytest.mark.browser

WINDOW = (240, 180)
# Before black, the page's grading of the background changes nothing: pictures must be equal everywhere.
LOOK = luxel.View(color_by="value", background="#000000")


@pytest.fixture
def viewer() -> Iterator[Viewer]:
    spec = TextureSpec(mode="paper", samples=1, texels=8)
    scene = luxel.Scene(cloud(300, spread=0.3), model="shadows")
    with (
        Session(scene, spec=spec, view=LOOK, threads=1) as session,
        view(
            session, renderer="raytrace", block=False, open_browser=False, announce=lambda url: None
        ) as opened,
    ):
        yield opened


@pytest.fixture
def page(viewer: Viewer, browser: Browser) -> Iterator[Page]:
    with Page(viewer.url, WINDOW, browser=browser) as opened:
        opened.wait("window.luxel && document.getElementById('fold').click() === undefined", WAIT_S)
        yield opened
        assert opened.messages == []


def rest(page: Page) -> dict[str, Any]:
    """Wait for the last picture of what the page shows; return what is known of it, with its pixels."""
    remote = page.wait(
        "window.luxel && luxel.remote()",
        WAIT_S,
        lambda r: r and r["active"] and r["current"] and r["shown"] and r["shown"]["final"],
    )
    return {**remote, "pixels": pixels(page, remote)}


def pixels(page: Page, remote: dict[str, Any], side: str = "left") -> np.ndarray:
    raw = np.frombuffer(base64.b64decode(page.run(f"luxel.remotePixels({side!r})")), np.uint8)
    return raw.reshape(remote["height"], remote["width"], 4)[..., :3]


def equal(page: Page, viewer: Viewer, look: luxel.View = LOOK) -> np.ndarray:
    """The page shows exactly what the ray tracer draws; return it."""
    remote = rest(page)
    assert remote["shown"]["lossless"]
    camera = luxel.Camera(**page.run("luxel.camera()"))
    session = viewer.session
    size = (remote["width"], remote["height"])
    expected = luxel.render(
        session.scene, look.with_changes(camera=camera), session.source, size, colorbar=False, key=session.key
    )
    np.testing.assert_array_equal(remote["pixels"], expected.pixels, str(remote["shown"]))
    return remote["pixels"]


def test_picture_is_the_ray_tracers_whatever_is_changed(page: Page, viewer: Viewer) -> None:
    first = equal(page, viewer)
    assert first.any()
    state = page.run("luxel.state()")
    assert (state["loaded"], state["particles"]) == (0, 300)
    assert state["ready"] == state["visible"] > 50
    page.wait(
        "document.getElementById('counts').textContent", WAIT_S, lambda text: "drawn by the server" in text
    )
    choose(page, "colormap", "magma")
    page.run("luxel.setCamera({...luxel.camera(), fov: 25})")
    choose(page, "exposure", "1", "input")
    changed = LOOK.with_changes(colormap="magma", exposure=2.0)
    assert (equal(page, viewer, changed) != first).any()
    choose(page, "cut", "x")
    choose(page, "cut-light", "keeps")
    assert page.run("luxel.synced()")
    saved = luxel.SavedView.from_json(page.run("luxel.savedView()"))
    assert len(saved.view.conditions) == 1
    equal(page, viewer, saved.view)
    choose(page, "model", "lambertian")
    page.wait("luxel.state().model", WAIT_S, lambda model: model == "lambertian")
    equal(page, viewer, saved.view)
    page.run("luxel.app.connection.socket.close()")
    page.wait("luxel.state().connected && Object.keys(luxel.state().troubles).length === 0", WAIT_S)
    equal(page, viewer, saved.view)


def right(
    page: Page, viewer: Viewer, scene: luxel.Scene, source: TextureSource | None, key: str
) -> np.ndarray:
    """The page shows exactly what the ray tracer draws of another light, right of the divider; return all of that picture."""
    page.wait("luxel.remote()", WAIT_S, lambda r: r["current"] and r["right"] and r["right"]["final"])
    remote = rest(page)
    camera = luxel.Camera(**page.run("luxel.camera()"))
    size = (remote["width"], remote["height"])
    expected = luxel.render(scene, LOOK.with_changes(camera=camera), source, size, colorbar=False, key=key)
    found = pixels(page, remote, "right")
    np.testing.assert_array_equal(found, expected.pixels, str(remote["right"]))
    return found


def test_two_lights_are_drawn_side_by_side(page: Page, viewer: Viewer, tmp_path: Path) -> None:
    session = viewer.session
    left = equal(page, viewer)
    page.run("document.getElementById('overlay').style.display = 'none'")
    for model in ("ao", "lambertian"):
        choose(page, "beside", model)
        page.wait("luxel.state().beside", WAIT_S, lambda now, model=model: now and now["model"] == model)
        scene, key = session.scene_beside, session.key_beside
        assert scene is not None
        assert key is not None
        other = right(page, viewer, scene, session.source, key)
        np.testing.assert_array_equal(equal(page, viewer), left)
        # What is on screen is the one left of the divider, and the other right of it.
        page.run("luxel.app.beside.divider.move(0.25)")
        shown = np.asarray(Image.open(page.screenshot(tmp_path / "both.png")).convert("RGB"))
        middle = WINDOW[0] // 4
        for part, picture in ((slice(20, middle - 20), left), (slice(middle + 20, 160), other)):
            band = (slice(60, 120), part)  # without labels, status line and colour bar
            np.testing.assert_array_equal(shown[band], picture[band])
    assert (left != other).any()
    page.run("luxel.setCamera({...luxel.camera(), fov: 25})")
    right(page, viewer, scene, session.source, key)
    choose(page, "drawn-by", "browser")
    settle(page)
    assert not page.run("luxel.remote().active")
    page.run("luxel.app.beside.divider.move(0)")
    camera = luxel.Camera(**page.run("luxel.camera()"))
    look = LOOK.with_changes(camera=camera)
    match(
        *capture(page), luxel.render(scene, look, size=WINDOW, antialias=1, colorbar=False), "beside-browser"
    )
    choose(page, "drawn-by", "server")
    right(page, viewer, scene, session.source, key)
    choose(page, "beside", "")
    page.wait("luxel.remote()", WAIT_S, lambda r: r["right"] is None)
    assert page.run("document.getElementById('remote-right').hidden")
    equal(page, viewer)


def test_while_it_moves_pictures_are_small_and_about_right(page: Page, viewer: Viewer) -> None:
    equal(page, viewer)
    page.run("luxel.app.remote.restMs = 1e6")  # it never rests
    before = page.run("luxel.camera()")
    page.drag((120, 90), (150, 100))
    remote = page.wait(
        "luxel.remote()",
        WAIT_S,
        lambda r: r["shown"]["rays"] == 1 and r["current"] and r["width"] < WINDOW[0],
    )
    camera = luxel.Camera(**page.run("luxel.camera()"))
    assert before != page.run("luxel.camera()")
    session = viewer.session
    size = (remote["width"], remote["height"])
    shown = pixels(page, remote).astype(int)
    look = LOOK.with_changes(camera=camera)
    expected = luxel.render(session.scene, look, session.source, size, antialias=1, colorbar=False)
    assert np.abs(shown - expected.pixels).mean() < 6  # JPEG
    page.run("luxel.app.remote.restMs = 0; luxel.setCamera({...luxel.camera(), fov: 31})")
    equal(page, viewer)


def test_a_page_that_nobody_sees_gets_no_pictures(page: Page, viewer: Viewer) -> None:
    equal(page, viewer)
    hide = "Object.defineProperty(document, 'hidden', {value: %s, configurable: true}); document.dispatchEvent(new Event('visibilitychange'))"
    page.run(hide % "true")
    assert page.run("luxel.synced()")
    before = page.run("luxel.remote().shown.frame")
    key = viewer.session.relight(model="lambertian")
    page.wait("luxel.state().key", WAIT_S, lambda now: now == key)
    page.run("luxel.setCamera({...luxel.camera(), fov: 25})")
    for _ in range(3):
        assert page.run("luxel.synced()")
    assert page.run("luxel.remote().shown.frame") == before
    page.run(hide % "false")
    equal(page, viewer)


def test_picking_asks_the_server(page: Page, viewer: Viewer) -> None:
    equal(page, viewer)
    camera = luxel.Camera(**page.run("luxel.camera()"))
    look = LOOK.with_changes(camera=camera)
    ids = luxel.render(viewer.session.scene, look, viewer.session.source, WINDOW, antialias=1).ids
    y, x = np.argwhere(ids >= 0)[300]
    page.click((x + 0.5, y + 0.5))
    text = page.wait(
        "document.getElementById('readout').textContent", WAIT_S, lambda text: "radius" in (text or "")
    )
    assert text.startswith(f"particle {ids[y, x]}\n")
    ring = page.run(
        "(r => [r.getAttribute('visibility'), Number(r.getAttribute('cx')), Number(r.getAttribute('cy')),"
        " Number(r.getAttribute('r'))])(document.querySelector('.ring'))"
    )
    assert ring[0] == "visible"
    assert np.hypot(ring[1] - x, ring[2] - y) <= ring[3] + 1
    page.press("Escape")
    page.wait("document.getElementById('readout').hidden", WAIT_S)


def test_browser_and_server_take_turns(page: Page, viewer: Viewer) -> None:
    equal(page, viewer)
    choose(page, "drawn-by", "browser")
    page.wait("luxel.state().loaded === 300 && luxel.state().coloring", WAIT_S)
    settle(page)
    agree(page, viewer, LOOK, "remote-off")
    assert page.run("document.getElementById('remote').hidden")
    choose(page, "drawn-by", "server")
    choose(page, "color-by", "vector.x")  # its values are not sent now, and are when they are needed
    equal(page, viewer, LOOK.with_changes(color_by="vector.x"))
    choose(page, "drawn-by", "browser")
    page.wait("luxel.state().coloring", WAIT_S, lambda text: "vector.x" in text)
    settle(page)
    agree(page, viewer, LOOK.with_changes(color_by="vector.x"), "remote-off-again")


def test_screenshots_are_downloaded_in_the_size_asked_for(page: Page, viewer: Viewer, tmp_path: Path) -> None:
    equal(page, viewer)
    page.call("Page.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path))
    for side, value in (("width", "320"), ("height", "200")):
        choose(page, f"save-{side}", value, "input")
    page.run("document.getElementById('save').click()")
    file = tmp_path / "particles.png"
    page.wait("document.getElementById('save').textContent", WAIT_S, lambda text: text == "Save PNG")
    page.wait("0", WAIT_S, lambda _: file.exists())
    camera = luxel.Camera(**page.run("luxel.camera()"))
    session = viewer.session
    expected = luxel.render(session.scene, LOOK.with_changes(camera=camera), session.source, (320, 200))
    np.testing.assert_array_equal(np.asarray(Image.open(file)), expected.pixels)


def test_time_steps_play_and_studies_run(browser: Browser) -> None:
    spec = TextureSpec(mode="paper", samples=1, texels=8)
    steps = [cloud(150, seed=k, radius=0.08) for k in range(3)]
    with (
        Session(steps, spec=spec, model="shadows", view=LOOK, threads=1) as session,
        view(
            session, renderer="raytrace", block=False, open_browser=False, announce=lambda url: None
        ) as viewer,
        Page(viewer.url, WINDOW, browser=browser) as page,
    ):
        equal(page, viewer)
        page.run("document.getElementById('study-add').click()")
        choose(page, "rate", "10")
        page.run("document.getElementById('play').click()")
        for frame in (1, 2, 0):
            page.wait("luxel.app.scene.frame", WAIT_S, lambda now, frame=frame: now == frame)
        page.run("document.getElementById('play').click()")
        assert page.run("luxel.synced()")
        equal(page, viewer)
        page.run(
            "document.querySelectorAll('#study-models input').forEach(box => {"
            " box.checked = ['lambertian', 'shadows'].includes(box.value); })"
        )
        page.run("document.getElementById('study-start').click()")
        for count in (1, 2):
            page.wait(
                "luxel.app.study.run && [luxel.app.study.run.rows.length, luxel.app.study.shownAt]",
                WAIT_S,
                lambda now, count=count: now and now[0] == count and now[1] is not None and now[1] > 0,
            )
            assert rest(page)["shown"]["final"]
            page.press("1")
        page.wait("luxel.state().troubles.study", WAIT_S, lambda text: text and "2 of 2 answers" in text)
        assert page.messages == []


def test_without_webgl_the_server_draws(viewer: Viewer) -> None:
    with Session(viewer.session.scene, spec=viewer.session.spec, view=LOOK, threads=1) as session:
        plain = view(session, block=False, open_browser=False, announce=lambda url: None)
        with plain, Browser("--disable-3d-apis") as blind, Page(plain.url, WINDOW, browser=blind) as page:
            page.wait("window.luxel && luxel.state().particles", WAIT_S)
            assert page.run("document.createElement('canvas').getContext('webgl2') === null")
            page.run("document.getElementById('fold').click()")
            assert "no WebGL2" in page.run("luxel.state().troubles.drawing")
            assert page.run("document.getElementById('drawn-by').disabled")
            first = equal(page, plain)
            page.drag((60, 165), (110, 150))  # below the banner
            assert (equal(page, plain) != first).any()
            assert [text for text in page.messages if "WebGL" not in text] == []


def test_baked_light_is_drawn_beside_lambert(tmp_path: Path, browser: Browser) -> None:
    spec = TextureSpec(mode="paper", samples=1, texels=8)
    baked = bake_to(tmp_path / "b.zarr", cloud(150, radius=0.08), model="shadows", spec=spec)
    with (
        Session(baked, view=LOOK) as session,
        view(
            session, renderer="raytrace", block=False, open_browser=False, announce=lambda url: None
        ) as viewer,
        Page(viewer.url, WINDOW, browser=browser) as page,
    ):
        page.wait("window.luxel && luxel.app.scene", WAIT_S)
        rest(page)
        choose(page, "beside", "lambertian")
        flat = luxel.Scene(
            session.particles, model="lambertian", lights=session.scene.sources, albedo=session.scene.albedo
        )
        # As bright as the light beside it, by the same tone curve.
        assert scene_white(flat) == scene_white(session.scene)
        picture = right(page, viewer, flat, None, "")
        assert (picture != rest(page)["pixels"]).any()
