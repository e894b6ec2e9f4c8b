"""In a real headless Chromium: estimates are replaced, and what is shown of the light before is marked until there is new."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

import luxel
from luxel.app.viewer import view
from luxel.scene.scene import Scene
from luxel.session import Session
from luxel.textures.bake import Baker
from luxel.textures.spec import TextureSpec
from tests.app.chromium import Browser, Page
from tests.app.pictures import WAIT_S
from tests.scenes import cloud

pytestmark = pytest.mark.browser

# Mean level of the picture, 0 to 255.
LEVEL = (
    "(s => { let sum = 0; for (let k = 0; k < s.length; k += 4) sum += s.charCodeAt(k); return 4 * sum / s.length; })"
    "(atob(luxel.capture().pixels))"
)
SPEC = TextureSpec(mode="paper", samples=1, texels=8)


@contextmanager
def shown(
    browser: Browser, make: Callable[[Scene, TextureSpec], Baker], **options: bool
) -> Iterator[tuple[Page, Session]]:
    with (
        Session(cloud(80), spec=SPEC, threads=1, make_baker=make, **options) as session,
        view(session, block=False, open_browser=False, announce=lambda url: None) as viewer,
        Page(viewer.url, (420, 300), browser=browser) as page,
    ):
        page.wait("Boolean(window.luxel)", WAIT_S)
        yield page, session


def wait(page: Page, condition: str) -> None:
    page.wait(f"(s => s.known && s.visible > 10 && {condition})(luxel.state())", WAIT_S)


def test_the_page_asks_again_for_what_it_has_an_estimate_of(browser: Browser) -> None:
    go = threading.Event()

    class Slow(Baker):
        def bake_into(self, ids, codes):  # type: ignore[no-untyped-def]
            assert go.wait(WAIT_S)
            return super().bake_into(ids, codes)

    with shown(browser, Slow, estimates=True) as (page, session):
        try:
            wait(page, "s.estimates > 0")
            page.wait("document.getElementById('counts').textContent.includes('to be refined')", WAIT_S)
            asked = page.run("luxel.app.light.requests.sentAt")
            page.wait(f"luxel.app.light.requests.sentAt > {asked}", WAIT_S)
        finally:
            go.set()
        wait(page, "s.ready === s.visible && s.estimates === 0")
        ids = page.run("[...luxel.app.light.sight.ids.subarray(0, luxel.app.light.sight.count)]")
        batch = session.tiles(ids)
        assert not batch.estimate.any()
        assert len(batch) == len(ids)


def test_old_light_is_marked_until_there_is_new(browser: Browser) -> None:
    go = threading.Event()

    def make(scene: Scene, spec: TextureSpec) -> Baker:
        assert scene.albedo == 0.7 or go.wait(WAIT_S)
        return Baker(scene, spec)

    with shown(browser, make) as (page, session):
        wait(page, "s.ready === s.visible")
        assert not page.run("document.getElementById('status').classList.contains('stale')")
        try:
            session.relight(albedo=0.2)
            wait(page, "s.ready === 0 && s.stale === s.visible")
            page.wait("document.getElementById('status').classList.contains('stale')", WAIT_S)
            assert "in the light before" in page.run("document.getElementById('counts').textContent")
        finally:
            go.set()
        wait(page, "s.ready === s.visible && s.stale === 0")
        page.wait("!document.getElementById('status').classList.contains('stale')", WAIT_S)
        assert page.messages == [] or all("performance warning" in text for text in page.messages)


def test_first_light_goes_before_textures_of_another_light(browser: Browser) -> None:
    go = threading.Event()

    class Dawning(Baker):
        def preparation(self, threads: int) -> Iterator[None]:
            assert self.scene_albedo == 0.7 or go.wait(WAIT_S)
            yield from super().preparation(threads)

        def __init__(self, scene: Scene, spec: TextureSpec) -> None:
            super().__init__(scene, spec)
            self.scene_albedo = scene.albedo

    light = [luxel.Sky(8.0)]
    dark = [luxel.Sky(0.25)]
    with shown(browser, Dawning) as (page, session):
        session.relight(lights=light)
        wait(page, "s.ready === s.visible")
        try:
            session.relight(lights=dark, albedo=0.2)
            wait(page, "s.coarse === s.visible && s.stale === 0")
            first = page.run(LEVEL)
        finally:
            go.set()
        wait(page, "s.ready === s.visible")
        # Were the old textures shown, many times as bright, the picture would be far from what it becomes.
        assert abs(first - page.run(LEVEL)) < 6
