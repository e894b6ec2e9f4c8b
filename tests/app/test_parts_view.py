"""Data sets that come part by part, in a real headless Chromium: first an even beginning, then what fits."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import luxel
from luxel import render
from luxel.app import order
from luxel.app.order import order_of
from luxel.app.viewer import Viewer, view
from luxel.session import Session
from luxel.textures.spec import TextureSpec
from luxel.textures.store.bake import bake_to, encode_to
from luxel.textures.store.layout import CodecChoice
from luxel.textures.textures import TextureSource
from tests.app.chromium import Browser, Page
from tests.app.pictures import WAIT_S, capture, choose, match, settle

pytestmark = pytest.mark.browser

COUNT = 9000
WINDOW = (320, 240)
LOOK = luxel.View(
    color_by="T",
    camera=luxel.Camera((0.5, -1.6, 0.9), (0.5, 0.5, 0.5), fov=40),
    hide=luxel.Select("T", low=0.05, high=None),
)
ARRIVED = "window.luxel && luxel.state()"


@pytest.fixture(autouse=True)
def few_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(order, "FIRST", 4096)


@pytest.fixture(scope="module")
def particles() -> luxel.Particles:
    rng = np.random.default_rng(2)
    return luxel.Particles(rng.random((COUNT, 3)), 0.02, {"T": rng.random(COUNT)})


@pytest.fixture
def viewer(particles: luxel.Particles) -> Iterator[Viewer]:
    with (
        Session(
            luxel.Scene(particles, model="ao"),
            spec=TextureSpec(mode="paper", samples=1, texels=8),
            view=LOOK,
            threads=2,
        ) as session,
        view(session, block=False, open_browser=False, announce=lambda url: None) as opened,
    ):
        yield opened


@pytest.fixture
def page(viewer: Viewer, browser: Browser) -> Iterator[Page]:
    with Page(viewer.url, WINDOW, browser=browser) as opened:
        opened.wait("window.luxel && document.getElementById('fold').click() === undefined", WAIT_S)
        yield opened
        assert not opened.messages


def arrived(page: Page, loaded: int) -> dict[str, object]:
    """Wait until so many particles are here, and no more will come."""
    return page.wait(ARRIVED, WAIT_S, lambda state: state and state["arrived"] and state["loaded"] == loaded)


def check(page: Page, session: Session, what: str, source: TextureSource) -> tuple[np.ndarray, np.ndarray]:
    """The page draws what the ray tracer does; return ids of its pixels, there and in the file."""
    pixels, ids = capture(page)
    numbers = order_of(session.particles)
    assert numbers is not None
    in_file = np.where(ids >= 0, numbers.to_file[ids], -1).astype(np.int32)
    camera = luxel.Camera(**page.run("luxel.camera()"))
    height, width = ids.shape
    look = LOOK.with_changes(camera=camera)
    picture = render(
        session.scene, look, source, (width, height), antialias=1, colorbar=False, key=session.key
    )
    match(pixels, in_file, picture, what)
    return ids, in_file


def test_all_particles_come_and_are_the_ray_tracers(page: Page, viewer: Viewer) -> None:
    arrived(page, COUNT)
    settle(page, fully=True)
    ids, in_file = check(page, viewer.session, "parts", viewer.session.source)
    # What is under the pointer is told by its number in the file.
    at = np.argwhere(ids >= 0)[1000]
    page.click((float(at[1]), float(at[0])))
    text = page.wait("document.getElementById('readout').textContent", WAIT_S, lambda text: "radius" in text)
    assert text.startswith(f"particle {in_file[tuple(at)]}\n")
    assert f"T {viewer.session.particles.scalars['T'][in_file[tuple(at)]]:.6g}" in text


def test_the_user_says_how_many(page: Page) -> None:
    arrived(page, COUNT)
    choose(page, "most", "5000")
    arrived(page, 5000)
    settle(page)
    text = page.wait(
        "document.getElementById('counts').textContent", WAIT_S, lambda text: "as you wish" in text
    )
    assert text.startswith("5,000 of 9,000 particles, as you wish")
    _, ids = capture(page)
    assert ids.max() < 5000
    assert page.run("luxel.app.drawing.renderer.swell") == pytest.approx((COUNT / 5000) ** (1 / 3))
    choose(page, "most", "")
    arrived(page, COUNT)
    assert page.run("luxel.app.drawing.renderer.swell") == 1


def test_what_is_slow_to_draw_stays_a_part(page: Page) -> None:
    """A page that finds its frames slow keeps what it has, and says so."""
    arrived(page, COUNT)
    page.run("""(() => {
      const { renderer } = luxel.app.drawing;
      Object.defineProperty(renderer, "whole", { get: () => ({ count: renderer.loaded, ms: 400 }), set() {} });
      luxel.app.introduce();
    })()""")
    arrived(page, 4096)
    page.wait(
        "document.getElementById('counts').textContent",
        WAIT_S,
        lambda text: text.startswith("4,096 of 9,000 particles, as many as this browser draws fast"),
    )


def test_another_scalar_and_a_lost_context(page: Page, viewer: Viewer) -> None:
    arrived(page, COUNT)
    choose(page, "color-by", "")
    page.wait("luxel.app.drawing.renderer.look.uniform", WAIT_S)
    page.run(
        "window.lost = luxel.app.drawing.renderer.gl.getExtension('WEBGL_lose_context'); lost.loseContext()"
    )
    page.wait("'graphics' in luxel.state().troubles", WAIT_S)
    page.run("lost.restoreContext()")
    page.wait("!('graphics' in luxel.state().troubles)", WAIT_S)
    choose(page, "color-by", "T")
    page.wait("luxel.state().coloring !== ''", WAIT_S)
    settle(page, fully=True)
    check(page, viewer.session, "parts-restored", viewer.session.source)
    page.messages.clear()


def test_baked_textures_come_with_their_particles(
    particles: luxel.Particles, tmp_path: Path, browser: Browser
) -> None:
    spec = TextureSpec(mode="paper", samples=1, texels=8)
    raw = bake_to(tmp_path / "raw.zarr", [particles], frames=[0], model="ao", spec=spec)
    baked = encode_to(tmp_path / "pca.zarr", raw, CodecChoice("pca", components=8))
    with (
        Session(baked, view=LOOK) as session,
        view(session, block=False, open_browser=False, announce=lambda url: None) as viewer,
        Page(viewer.url, WINDOW, browser=browser) as page,
    ):
        page.wait("window.luxel && document.getElementById('fold').click() === undefined", WAIT_S)
        arrived(page, COUNT)
        assert settle(page)["baked"] == "pca"
        check(page, session, "parts-baked", baked[0].compressed)
        choose(page, "most", "5000")
        arrived(page, 5000)
        assert settle(page)["baked"] == "pca"
        assert page.run("luxel.app.light.baked.count") == 5000
        assert not page.messages
