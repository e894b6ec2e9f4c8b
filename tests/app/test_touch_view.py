"""The page on a tablet: fingers orbit, pinch, pick and move the divider, in a real headless Chromium."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from luxel.app.viewer import Viewer, view
from luxel.session import Session
from tests.app.chromium import Browser, Page
from tests.app.pictures import WAIT_S, capture, choose
from tests.scenes import cloud

pytestmark = pytest.mark.browser

WINDOW = (1024, 768)
Point = tuple[float, float]


@pytest.fixture(scope="module")
def viewer() -> Iterator[Viewer]:
    with (
        Session(cloud(200, radius=0.09), model="lambertian", threads=1) as session,
        view(session, block=False, open_browser=False, announce=lambda url: None) as opened,
    ):
        yield opened


@pytest.fixture(scope="module")
def page(viewer: Viewer, browser: Browser) -> Iterator[Page]:
    with Page(viewer.url, WINDOW, browser=browser) as opened:
        opened.call("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=5)
        opened.wait("window.luxel && luxel.state().loaded > 0 && luxel.state().frames > 0", WAIT_S)
        yield opened
        assert [text for text in opened.messages if "performance warning" not in text] == []


@pytest.fixture(autouse=True)
def whole(page: Page) -> None:
    page.run("document.getElementById('frame-all').click()")


def swipe(page: Page, *fingers: tuple[Point, Point], steps: int = 5) -> None:
    """Move fingers from their first points to their second ones, all at once."""

    def at(k: int) -> list[dict[str, float]]:
        return [
            {"x": a[0] + (b[0] - a[0]) * k / steps, "y": a[1] + (b[1] - a[1]) * k / steps, "id": number}
            for number, (a, b) in enumerate(fingers)
        ]

    page.call("Input.dispatchTouchEvent", type="touchStart", touchPoints=at(0))
    for k in range(1, steps + 1):
        page.call("Input.dispatchTouchEvent", type="touchMove", touchPoints=at(k))
    page.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])


def camera(page: Page) -> tuple[np.ndarray, np.ndarray]:
    found = page.run("luxel.camera()")
    return np.array(found["eye"]), np.array(found["target"])


def test_one_finger_orbits(page: Page) -> None:
    eye, target = camera(page)
    swipe(page, ((300, 300), (420, 330)))
    turned, same = camera(page)
    np.testing.assert_allclose(same, target)
    assert np.linalg.norm(turned - target) == pytest.approx(np.linalg.norm(eye - target))
    assert np.linalg.norm(turned - eye) > 0.2 * np.linalg.norm(eye - target)


def test_two_fingers_zoom_by_their_distance_and_pan(page: Page) -> None:
    eye, target = camera(page)
    swipe(page, ((300, 384), (200, 384)), ((440, 384), (540, 384)))
    near, _ = camera(page)
    assert np.linalg.norm(near - target) / np.linalg.norm(eye - target) == pytest.approx(140 / 340, rel=0.15)
    page.run("document.getElementById('frame-all').click()")
    swipe(page, ((300, 300), (360, 340)), ((440, 300), (500, 340)))
    moved, aside = camera(page)
    np.testing.assert_allclose(moved - aside, eye - target, rtol=0.05)
    assert np.linalg.norm(aside - target) > 0.01


def test_a_tap_picks(page: Page) -> None:
    ids = capture(page)[1]
    row, column = np.argwhere(ids >= 0)[len(np.argwhere(ids >= 0)) // 2]
    swipe(page, ((column + 0.5, row + 0.5), (column + 0.5, row + 0.5)), steps=1)
    assert page.run("luxel.app.pick.id") == ids[row, column]
    page.wait("document.getElementById('readout').textContent", WAIT_S, lambda text: "radius" in text)


def test_a_finger_moves_the_divider_and_not_the_camera(page: Page) -> None:
    choose(page, "beside", "ao")
    page.wait("luxel.state().beside", WAIT_S)
    before = page.run("luxel.camera()")
    width = page.run("document.getElementById('stage').clientWidth")
    swipe(page, ((width / 2, 300), (width / 4, 320)))
    assert page.run("luxel.state().split") == pytest.approx(0.25, abs=0.01)
    assert page.run("luxel.camera()") == before
    choose(page, "beside", "")


def test_nothing_is_cut_off_or_scrolls_sideways(page: Page) -> None:
    page.run("document.querySelectorAll('details').forEach(each => { each.open = true; })")
    beyond = page.run(
        """(panel => [...panel.querySelectorAll('*')].filter(e => e.checkVisibility() && e.tagName !== 'OPTION'
          && e.getBoundingClientRect().right > panel.getBoundingClientRect().left + panel.clientWidth + 1)
          .map(e => e.id || e.outerHTML.slice(0, 60)))(document.getElementById('panel'))"""
    )
    assert beyond == []
    assert page.run("document.documentElement.scrollWidth") == WINDOW[0]
