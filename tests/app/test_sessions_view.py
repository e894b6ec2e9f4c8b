"""Several tabs on one session, lost connections and lost graphics contexts, in a real headless Chromium."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

import luxel
from luxel.app.viewer import Viewer, view
from luxel.session import Session
from luxel.textures.spec import TextureSpec
from tests.app.chromium import Browser, Page
from tests.app.pictures import WAIT_S, agree, capture, choose, settle
from tests.scenes import cloud

pytestmark = pytest.mark.browser

WINDOW = (240, 180)
LOOK = luxel.View(color_by="value", colormap="plasma")


@pytest.fixture(scope="module")
def viewer() -> Iterator[Viewer]:
    spec = TextureSpec(mode="paper", samples=1, texels=8)
    with (
        Session(cloud(300, radius=0.08), model="shadows", spec=spec, view=LOOK, threads=2) as session,
        view(session, block=False, open_browser=False, announce=lambda url: None) as opened,
    ):
        yield opened


@pytest.fixture(scope="module")
def pages(viewer: Viewer, browser: Browser) -> Iterator[tuple[Page, Page]]:
    with (
        Page(viewer.url, WINDOW, browser=browser) as first,
        Page(viewer.url, WINDOW, browser=browser) as second,
    ):
        for page in (first, second):
            page.wait("window.luxel && luxel.state().loaded > 0", WAIT_S)
            page.run("document.getElementById('fold').click()")
        yield first, second
        for page in (first, second):
            assert [text for text in page.messages if "performance warning" not in text] == []


def lit(page: Page, viewer: Viewer) -> None:
    page.run("luxel.synced()")
    page.wait("luxel.state().key", WAIT_S, lambda key: key == viewer.session.key)
    settle(page)


def test_two_tabs_have_their_own_cameras_and_one_light(pages: tuple[Page, Page], viewer: Viewer) -> None:
    first, second = pages
    lit(first, viewer)
    lit(second, viewer)
    camera = second.run("luxel.camera()")
    first.drag((60, 60), (150, 100))
    choose(first, "colormap", "viridis")
    lit(first, viewer)
    assert first.run("luxel.camera()") != camera
    assert second.run("luxel.camera()") == camera
    assert "plasma" in second.run("luxel.state().coloring")
    # Light that one changes is the other's as well: each lights what it sees itself.
    before = viewer.session.key
    choose(second, "azimuth", "75", "input")
    for page in pages:
        page.wait("luxel.state().key", WAIT_S, lambda key: key != before)
        lit(page, viewer)
    assert first.run("document.getElementById('azimuth').value") == "75"
    agree(second, viewer, LOOK, "second-tab")
    first.wait("luxel.state().coloring", WAIT_S, lambda text: "viridis" in text)
    agree(first, viewer, LOOK.with_changes(colormap="viridis"), "first-tab")


def test_a_tab_that_goes_leaves_the_other_as_it_is(
    viewer: Viewer, browser: Browser, pages: tuple[Page, Page]
) -> None:
    first, _ = pages
    lit(first, viewer)
    picture = capture(first)[0]
    with Page(viewer.url, WINDOW, browser=browser) as third:
        third.wait("window.luxel && luxel.state().loaded > 0", WAIT_S)
    np.testing.assert_array_equal(capture(first)[0], picture)
    assert first.run("luxel.state().connected")


def test_a_lost_connection_loses_nothing_of_the_view(pages: tuple[Page, Page], viewer: Viewer) -> None:
    page, _ = pages
    page.drag((60, 60), (90, 120))
    choose(page, "cut-light", "keeps")
    choose(page, "cut", "-x")
    choose(page, "exposure", "0.5", "input")
    page.run("document.getElementById('orthographic').click()")
    lit(page, viewer)
    view_before, picture = page.run("luxel.savedView()"), capture(page)[0]
    page.run("luxel.app.connection.socket.close()")
    page.wait("!luxel.state().connected", WAIT_S)
    page.wait("luxel.state().connected && luxel.state().loaded > 0 && luxel.state().coloring", WAIT_S)
    lit(page, viewer)
    assert page.run("luxel.savedView()") == view_before
    np.testing.assert_array_equal(capture(page)[0], picture)


def test_a_lost_graphics_context_brings_picture_and_textures_back(
    pages: tuple[Page, Page], viewer: Viewer
) -> None:
    page, _ = pages
    lit(page, viewer)
    settle(page, fully=True)  # nothing is left to ask for
    picture, before = capture(page), page.run("luxel.state()")
    page.run(
        "window.lose = luxel.app.drawing.renderer.gl.getExtension('WEBGL_lose_context'), lose.loseContext()"
    )
    page.wait(
        "document.getElementById('banner').textContent", WAIT_S, lambda said: "context was lost" in said
    )
    page.run("lose.restoreContext()")
    page.wait("document.getElementById('banner').hidden", WAIT_S)
    after = settle(page)
    assert after["received"] == before["received"]  # memory had them all
    again = capture(page)
    for one, other in zip(again, picture, strict=True):
        np.testing.assert_array_equal(one, other)
