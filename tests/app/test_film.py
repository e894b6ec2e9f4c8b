"""When the page draws what: slow renderers and light share the same cores."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import luxel
from luxel.app.viewer import view
from luxel.session import Session
from luxel.textures.spec import TextureSpec
from tests.app.chromium import Browser, Page
from tests.app.pictures import WAIT_S
from tests.scenes import cloud

pytestmark = pytest.mark.browser

# A film of a renderer that takes a second a frame, and a clock that stands still unless told otherwise.
FILM = """
(awaited => {
  const nothing = () => {};
  const renderer = {
    frameMs: 1000, count: 4, loaded: 4, spheres: {}, busy: false, frames: [], times: new Map(), canvas: {width: 8, height: 8},
    readback: {pending: false, poll: () => null}, sweep: () => true, setList: nothing, present: nothing, endFrame: nothing,
    drawSample: () => { renderer.drawn++; }, drawn: 0, awaited,
  };
  const film = new luxel.app.drawing.film.constructor(renderer, nothing, () => new Int32Array(0), () => renderer.awaited);
  let now = 1e6;
  const steps = (count) => {
    const clock = performance.now;
    performance.now = () => now;
    try {
      for (let k = 0; k < count; k++) film.step();
    } finally {
      performance.now = clock;
    }
    return renderer.drawn;
  };
  film.restart();
  film.camera = {};
  return {film, renderer, steps, later: (milliseconds) => { now += milliseconds; }};
})
"""


@pytest.fixture(scope="module")
def page(browser: Browser) -> Iterator[Page]:
    spec = TextureSpec(mode="paper", samples=1, texels=4)
    with (
        Session(luxel.Scene(cloud(20)), spec=spec, threads=1) as session,
        view(session, block=False, open_browser=False, announce=lambda url: None) as viewer,
        Page(viewer.url, (200, 150), browser=browser) as opened,
    ):
        opened.wait("window.luxel && luxel.state().frames > 0", WAIT_S)
        yield opened


def test_a_slow_renderer_gives_way_until_what_it_knows_of_is_lit(page: Page) -> None:
    page.run(f"window.slow = {FILM}(true), undefined")
    assert page.run("slow.steps(9)") == 1  # what is at pixel centres is known: now it is light's turn
    page.run("slow.film.lightChanged(), slow.later(3000)")
    assert page.run("slow.steps(9)") == 1
    page.run("slow.later(1001)")
    assert page.run("slow.steps(1)") == 2
    assert page.run(
        "slow.film.shown.light === slow.film.light"
    )  # shown before what lies between is looked for
    assert page.run("slow.steps(9)") == 2  # light's turn again
    page.run("slow.later(4001)")
    assert page.run("slow.steps(9)") == 3
    page.run("slow.film.lightChanged(), slow.renderer.awaited = false, slow.later(4001)")
    assert page.run("slow.steps(30)") == 19  # all is lit: all samples, without another pause
    assert page.run("slow.film.settled")
    page.run("slow.film.forget(), slow.renderer.awaited = true")  # the camera moves: once more
    assert page.run("slow.steps(9)") == 20


def test_a_slow_renderer_does_not_wait_for_ever(page: Page) -> None:
    page.run(f"window.slow = {FILM}(true), undefined")
    for _ in range(12):
        page.run("slow.steps(9), slow.later(4001)")
    assert page.run("slow.steps(9)") == 16
    assert page.run("slow.film.settled")


def test_where_no_light_is_awaited_nobody_gives_way(page: Page) -> None:
    page.run(f"window.slow = {FILM}(false), undefined")
    assert page.run("slow.steps(30)") == 16
    assert page.run("slow.film.settled")
