"""Time steps in a real headless Chromium: the slider, and playing, which never runs ahead of the picture."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import numpy as np
import pytest

import luxel
from luxel.app.viewer import Viewer, view
from luxel.particles import Particles
from luxel.session import Session
from luxel.textures.spec import TextureSpec
from tests.app.chromium import Browser, Page
from tests.app.pictures import WAIT_S, agree, choose, settle
from tests.scenes import cloud

pytestmark = pytest.mark.browser

WINDOW = (240, 180)
STEPS = 4
LOOK = luxel.View(color_by="value", colormap="plasma")
OPEN = threading.Event()
OPEN.set()


class Steps(list[Particles]):
    """A series whose last step takes as long to read as `OPEN` says."""

    def __getitem__(self, k):  # type: ignore[no-untyped-def,override]
        if k == STEPS - 1:
            assert OPEN.wait(WAIT_S)
        return super().__getitem__(k)


@pytest.fixture(scope="module")
def viewer() -> Iterator[Viewer]:
    steps = Steps([cloud(150 + 10 * k, radius=0.09, seed=k) for k in range(STEPS)])
    spec = TextureSpec(mode="paper", samples=1, texels=8)
    with (
        Session(steps, model="shadows", spec=spec, view=LOOK, threads=2) as session,
        view(session, block=False, open_browser=False, announce=lambda url: None) as opened,
    ):
        yield opened
        OPEN.set()


# Note what was on the screen whenever the page asks for a step: kind 5 is SetFrame.
NOTE = """
window.noted = [];
(connection => {
  const send = connection.send.bind(connection);
  connection.send = message => {
    if (new DataView(message).getUint8(0) === 5) {
      const {app} = luxel, {film, renderer} = app.drawing;
      const whole = renderer.loaded === app.scene.count && film.shown !== null && film.shown.epoch <= film.epoch;
      noted.push({at: app.scene.frame, to: app.player.awaited, drawn: whole && app.coloring.current !== "" });
    }
    send(message);
  };
})(luxel.app.connection)
"""


@pytest.fixture(scope="module")
def page(viewer: Viewer, browser: Browser) -> Iterator[Page]:
    with Page(viewer.url, WINDOW, browser=browser) as opened:
        opened.wait("window.luxel && luxel.state().loaded > 0", WAIT_S)
        opened.run("document.getElementById('fold').click()")
        opened.run(NOTE)
        choose(opened, "rate", "30")
        yield opened
        assert [text for text in opened.messages if "performance warning" not in text] == []


@pytest.fixture(autouse=True)
def first_step(page: Page) -> None:
    page.run("luxel.app.player.stop()")
    choose(page, "frame", "0", "input")
    page.run("luxel.synced()")
    page.wait("luxel.state().frame === 0", WAIT_S)
    page.run("noted.length = 0")


def test_the_slider_shows_a_step(page: Page, viewer: Viewer) -> None:
    choose(page, "frame", "2", "input")
    page.wait("luxel.state().frame === 2", WAIT_S)
    page.wait("luxel.state().coloring", WAIT_S)
    settle(page)
    assert page.run("luxel.state().particles") == 170
    assert viewer.session.frame == 2
    agree(page, viewer, LOOK, "step")
    assert page.run("document.getElementById('frame-out').textContent") == "2 / 3"


def test_playing_asks_for_the_next_step_once_the_last_is_drawn_and_begins_again(page: Page) -> None:
    page.run("document.getElementById('play').click()")
    assert page.run("document.getElementById('play').textContent") == "Pause"
    noted = page.wait("window.noted", WAIT_S, lambda found: len(found) >= 2 * STEPS + 1)
    assert [(each["at"], each["to"]) for each in noted] == [
        (k % STEPS, (k + 1) % STEPS) for k in range(len(noted))
    ]
    assert all(each["drawn"] for each in noted)


def test_playing_waits_for_a_step_that_takes_long(page: Page) -> None:
    OPEN.clear()
    page.run("document.getElementById('play').click()")
    page.wait("window.noted", WAIT_S, lambda found: len(found) == STEPS - 1)
    for _ in range(20):
        page.run("new Promise(requestAnimationFrame)")
    state = page.run("({...luxel.state(), noted: noted.length})")
    assert (state["noted"], state["frame"], state["playing"]) == (STEPS - 1, STEPS - 2, True)
    OPEN.set()
    page.wait("window.noted", WAIT_S, lambda found: len(found) > STEPS)


def test_a_touch_of_the_slider_stops_it_and_space_toggles(page: Page) -> None:
    page.run("document.getElementById('view').focus()")
    page.press(" ")
    assert page.run("luxel.state().playing")
    page.wait("window.noted.length > 1", WAIT_S)
    choose(page, "frame", "3", "input")
    assert not page.run("luxel.state().playing")
    page.run("luxel.synced()")
    page.wait("luxel.state().frame === 3", WAIT_S)
    page.run("document.getElementById('view').focus()")
    page.press(" ")
    assert page.run("luxel.state().playing")
    page.press(" ")
    assert not page.run("luxel.state().playing")
    page.run("luxel.synced()")
    count = page.run("noted.length")
    for _ in range(5):
        page.run("new Promise(requestAnimationFrame)")
    assert page.run("noted.length") == count
    # On the button itself the space bar presses it: once, not twice.
    page.run("document.getElementById('fold').click(), document.getElementById('play').focus()")
    page.press(" ")
    assert page.run("luxel.state().playing")
    page.run("document.getElementById('fold').click()")


def test_keys_step_forth_and_back(page: Page) -> None:
    page.run("document.getElementById('view').focus()")
    for key, frame in ((".", 1), (".", 2), (",", 1), (",", 0), (",", STEPS - 1), (".", 0)):
        page.press(key)
        page.run("luxel.synced()")
        page.wait("luxel.state().frame", WAIT_S, lambda now, frame=frame: now == frame)


def test_playing_goes_on_after_a_lost_connection(page: Page) -> None:
    page.run("document.getElementById('play').click()")
    page.wait("window.noted.length > 0", WAIT_S)
    page.run("luxel.app.connection.socket.close()")
    page.wait("!luxel.state().connected", WAIT_S)
    page.wait("luxel.state().connected", WAIT_S)
    count = page.run("noted.length")
    page.wait("window.noted.length", WAIT_S, lambda now: now > count + 2)


def test_the_last_step_stays_until_the_next_is_complete(page: Page) -> None:
    """No flash of the background, nor of wrong colours, between two steps."""
    settle(page)
    page.run(
        """window.shown = [];
        (drawing => {
          const present = drawing.renderer.present;
          drawing.renderer.present = function (...args) {
            const {app} = luxel;
            shown.push(drawing.renderer.loaded === app.scene.count && app.coloring.current !== "");
            present.apply(this, args);
          };
        })(luxel.app.drawing)"""
    )
    page.run("document.getElementById('play').click()")
    page.wait("window.noted.length > 4", WAIT_S)
    page.run("luxel.app.player.stop()")
    shown = page.run("shown")
    assert len(shown) >= 4
    assert all(shown)


@pytest.mark.parametrize(("empty", "shown"), [((1,), [0, 2, 0, 2]), ((1, 2), [0])])
def test_steps_that_cannot_be_shown_are_left_out(
    browser: Browser, empty: tuple[int, ...], shown: list[int]
) -> None:
    """Where others are left; else playing ends."""
    steps = [Particles(np.empty((0, 3)), 1.0) if k in empty else cloud(100, radius=0.1) for k in range(3)]
    with (
        Session(steps, model="lambertian", threads=1) as session,
        view(session, block=False, open_browser=False, announce=lambda url: None) as opened,
        Page(opened.url, WINDOW, browser=browser) as page,
    ):
        page.wait("window.luxel && luxel.state().frames > 0", WAIT_S)
        page.run(NOTE)
        choose(page, "rate", "30")
        page.run("luxel.app.player.start()")
        if len(shown) > 1:
            page.wait("window.noted.length > 6", WAIT_S)
        else:
            page.wait("!luxel.state().playing", WAIT_S)
        at = [each["at"] for each in page.run("noted")]
        found = [k for k, before in zip(at, [None, *at], strict=False) if k != before]
        assert found[: len(shown)] == shown
        assert "no particles" in page.run("document.getElementById('banner').textContent")
