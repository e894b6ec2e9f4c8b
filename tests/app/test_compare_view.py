"""Two shading models side by side in a real headless Chromium: each half is the picture of its own model, and of no other."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import luxel
from luxel.app.viewer import Viewer, view
from luxel.session import Session
from luxel.textures.bake import Baker
from luxel.textures.spec import TextureSpec
from luxel.textures.store.bake import bake_to
from tests.app.chromium import Browser, Page
from tests.app.pictures import WAIT_S, agree, capture, choose, settle
from tests.scenes import cloud

pytestmark = pytest.mark.browser

WINDOW = (240, 180)
MIDDLE = WINDOW[0] // 2
SPEC = TextureSpec(mode="paper", samples=1, texels=8)
LIGHTS = (luxel.Sky(0.8), luxel.Sun((1, -2, 2), 1.5, 15))
LOOK = luxel.View(color_by="value", colormap="plasma", background="#203040")

HELD = threading.Event()
HELD.set()


class HeldBaker(Baker):
    """Bakes nothing under soft shadows while `HELD` is clear."""

    def bake_into(self, ids: np.ndarray, codes: np.ndarray) -> int:
        if self.scene.model == "shadows":
            assert HELD.wait(WAIT_S)
        return super().bake_into(ids, codes)


@pytest.fixture(scope="module")
def viewer() -> Iterator[Viewer]:
    with (
        Session(
            cloud(400, radius=0.07),
            lights=LIGHTS,
            spec=SPEC,
            view=LOOK,
            threads=2,
            make_baker=HeldBaker,
        ) as session,
        view(session, block=False, open_browser=False, announce=lambda url: None) as opened,
    ):
        yield opened
        HELD.set()


@pytest.fixture(scope="module")
def page(viewer: Viewer, browser: Browser) -> Iterator[Page]:
    with Page(viewer.url, WINDOW, browser=browser) as opened:
        opened.wait("window.luxel && luxel.state().loaded > 0", WAIT_S)
        opened.run("document.getElementById('fold').click()")
        yield opened
        assert [text for text in opened.messages if "performance warning" not in text] == []


@pytest.fixture(scope="module")
def alone(page: Page, viewer: Viewer) -> dict[str, np.ndarray]:
    """The picture of each model without a divider."""
    found = {}
    for model in ("lambertian", "shadows", "ao", "interreflection"):
        choose(page, "model", model)
        page.wait("luxel.state().model", WAIT_S, lambda now, model=model: now == model)
        lit(page, viewer)
        found[model] = capture(page)[0]
    assert len({each.tobytes() for each in found.values()}) == 4
    return found


@pytest.fixture(autouse=True)
def one_picture(page: Page, viewer: Viewer, alone: dict[str, np.ndarray]) -> None:
    choose(page, "beside", "")
    page.run("luxel.app.beside.divider.move(0.5)")
    viewer.session.relight(model="interreflection", lights=LIGHTS, hide=())
    lit(page, viewer)


def lit(page: Page, viewer: Viewer) -> None:
    """Wait until the page has the session's lights, and all that it shows of both is lit."""
    page.run("luxel.synced()")
    page.wait("luxel.state().key", WAIT_S, lambda key: key == viewer.session.key)
    lambertian = viewer.session.scene.model == "lambertian"
    page.wait("luxel.state()", WAIT_S, lambda s: s["known"] and (lambertian or s["ready"] == s["visible"]))
    if page.run("luxel.app.beside.model"):
        page.wait(
            "luxel.state()",
            WAIT_S,
            lambda s: (
                (b := s["beside"]) and b["key"] == viewer.session.key_beside and b["ready"] == s["visible"]
            ),
        )


def halves(page: Page, left: np.ndarray, right: np.ndarray, middle: int = MIDDLE) -> None:
    pixels = capture(page)[0]
    np.testing.assert_array_equal(pixels[:, :middle], left[:, :middle])
    np.testing.assert_array_equal(pixels[:, middle:], right[:, middle:])


@pytest.mark.parametrize("right", ["shadows", "ao", "lambertian", "interreflection"])
def test_each_half_is_the_picture_of_its_model(
    page: Page, viewer: Viewer, alone: dict[str, np.ndarray], right: str
) -> None:
    assert page.run("document.getElementById('divider').hidden")
    choose(page, "beside", right)
    lit(page, viewer)
    halves(page, alone["interreflection"], alone[right])
    # The left changes, the right stays; what was baked under either stays baked.
    choose(page, "model", "ao")
    page.wait("luxel.state().model === 'ao'", WAIT_S)
    lit(page, viewer)
    halves(page, alone["ao"], alone[right])
    choose(page, "beside", "")
    page.run("luxel.synced()")
    np.testing.assert_array_equal(capture(page)[0], alone["ao"])
    assert viewer.session.key_beside is None


def test_what_is_on_the_screen_is_what_is_captured(
    page: Page, viewer: Viewer, alone: dict[str, np.ndarray], tmp_path: Path
) -> None:
    choose(page, "beside", "lambertian")
    lit(page, viewer)
    page.wait("(s => s.settled && s.samples === 16 && !luxel.app.drawing.scheduled)(luxel.state())", WAIT_S)
    page.run(
        "document.getElementById('status').style.display = document.getElementById('bar').style.display = 'none'"
    )
    shown = np.asarray(Image.open(page.screenshot(tmp_path / "page.png")).convert("RGB")).astype(int)
    ids = capture(page)[1]
    inside = (ids >= 0) & np.logical_and.reduce(
        [np.roll(ids, k, axis) == ids for k in (-1, 1) for axis in (0, 1)]
    )
    # Edges and the divider apart, each half is nearer to its own model than to the other.
    for part, own, other in (
        (np.s_[:150, 60:100], "interreflection", "lambertian"),
        (np.s_[:150, 140:180], "lambertian", "interreflection"),
    ):
        away = {
            model: np.abs(shown[part] - alone[model][part].astype(int))[inside[part]].mean()
            for model in (own, other)
        }
        assert away[own] < 0.5 * away[other]


def test_light_that_streams_in_stays_on_its_side(
    page: Page, viewer: Viewer, alone: dict[str, np.ndarray]
) -> None:
    """Until its own textures come, the right is without global light; then the left is what it was."""
    HELD.clear()
    viewer.session.relight(albedo=0.45)
    lit(page, viewer)
    left = capture(page)[0]
    assert (left != alone["interreflection"]).any()
    choose(page, "beside", "shadows")
    page.wait("luxel.state().beside", WAIT_S)
    page.run("luxel.synced()")
    page.wait(
        "0", WAIT_S, lambda _: viewer.session._engine_beside.cache.counts(viewer.session.key_beside).baking
    )
    assert page.run("luxel.state().beside.ready") == 0
    halves(page, left, alone["lambertian"])
    HELD.set()
    lit(page, viewer)
    right = capture(page)[0]
    np.testing.assert_array_equal(right[:, :MIDDLE], left[:, :MIDDLE])
    np.testing.assert_array_equal(
        right[:, MIDDLE:], alone["shadows"][:, MIDDLE:]
    )  # soft shadows know no albedo
    viewer.session.relight(albedo=0.7)


def test_both_sides_follow_the_sun_and_a_cut(page: Page, viewer: Viewer) -> None:
    choose(page, "beside", "shadows")
    choose(page, "azimuth", "40", "input")
    choose(page, "cut", "-y")
    lit(page, viewer)
    both = capture(page)[0]
    agree_on_the_left(page, viewer)
    choose(page, "beside", "")
    choose(page, "model", "shadows")
    page.wait("luxel.state().model === 'shadows'", WAIT_S)
    lit(page, viewer)
    np.testing.assert_array_equal(capture(page)[0][:, MIDDLE:], both[:, MIDDLE:])


def agree_on_the_left(page: Page, viewer: Viewer) -> None:
    page.run("luxel.app.beside.divider.move(1)")
    agree(page, viewer, LOOK, "compare-left")
    page.run("luxel.app.beside.divider.move(0.5)")


def test_the_divider_is_a_slider_for_mouse_and_keys(
    page: Page, viewer: Viewer, alone: dict[str, np.ndarray]
) -> None:
    choose(page, "beside", "lambertian")
    lit(page, viewer)
    left, right = alone["interreflection"], alone["lambertian"]
    page.drag((MIDDLE, 60), (MIDDLE - 60, 90))
    assert page.run("luxel.state().split") == 0.25
    halves(page, left, right, 60)
    assert page.run("document.activeElement.id") == "divider"
    about = "(d => ['role', 'aria-valuemin', 'aria-valuemax', 'aria-valuenow'].map(a => d.getAttribute(a)))(document.activeElement)"
    assert page.run(about) == ["slider", "0", "100", "25"]
    page.press("ArrowRight")
    assert page.run(about)[3] == "27"
    assert "Global illumination" in page.run("document.activeElement.getAttribute('aria-valuetext')")
    for _ in range(2):
        page.press("ArrowLeft")
    assert page.run("luxel.state().split") == 0.23
    halves(page, left, right, round(0.23 * WINDOW[0]))
    camera = page.run("luxel.camera()")
    page.press("Home")
    halves(page, left, right, 0)
    page.press("End")
    halves(page, left, right, WINDOW[0])
    assert page.run("luxel.camera()") == camera  # none of these keys moved it
    assert page.run("document.getElementById('divider').getAttribute('aria-valuenow')") == "100"


def test_the_picture_keeps_up_with_the_divider(page: Page, viewer: Viewer) -> None:
    """One sample is enough to show where it is, however many a smooth picture would take, and nobody waits for light."""
    choose(page, "beside", "lambertian")
    lit(page, viewer)
    page.wait("(s => s.settled && s.samples === 16 && !luxel.app.drawing.scheduled)(luxel.state())", WAIT_S)
    page.run(
        """(film => {
          window.wants = [];
          film.begin = function (effort, want) { wants.push(want); delete this.begin; return this.begin(effort, want); };
          film.renderer.frameMs = 1;
          luxel.app.beside.divider.move(0.3);
        })(luxel.app.drawing.film)"""
    )
    page.wait("(film => film.shown.light === film.light)(luxel.app.drawing.film)", WAIT_S)
    assert page.run("wants") == [1]


def test_comparison_survives_a_lost_connection_and_a_lost_graphics_context(
    page: Page, viewer: Viewer, alone: dict[str, np.ndarray]
) -> None:
    choose(page, "beside", "shadows")
    page.run("luxel.app.beside.divider.move(0.25)")
    lit(page, viewer)
    page.run("luxel.app.connection.socket.close()")
    page.wait("!luxel.state().connected", WAIT_S)
    page.wait("luxel.state().connected && luxel.state().beside", WAIT_S)
    lit(page, viewer)
    halves(page, alone["interreflection"], alone["shadows"], MIDDLE // 2)
    page.run(
        "window.lose = luxel.app.drawing.renderer.gl.getExtension('WEBGL_lose_context'), lose.loseContext()"
    )
    page.wait("luxel.state().troubles.graphics", WAIT_S)
    page.run("lose.restoreContext()")
    page.wait("!luxel.state().troubles.graphics", WAIT_S)
    lit(page, viewer)
    halves(page, alone["interreflection"], alone["shadows"], MIDDLE // 2)


def test_what_cannot_be_compared_is_said(page: Page) -> None:
    page.run("luxel.app.beside.choose('no such')")
    page.wait("document.getElementById('banner').textContent", WAIT_S, lambda said: "no such" in said)
    page.run("luxel.app.notices.trouble('server', null)")


def test_baked_light_is_compared_with_lambert(tmp_path: Path, browser: Browser) -> None:
    positions = np.random.default_rng(4).uniform(-1, 1, (150, 3))
    baked = bake_to(tmp_path / "b.zarr", luxel.Particles(positions, 0.22), model="shadows", spec=SPEC)
    with (
        Session(baked) as session,
        view(session, block=False, open_browser=False, announce=lambda url: None) as viewer,
        Page(viewer.url, WINDOW, browser=browser) as page,
    ):
        page.wait("window.luxel && luxel.state().baked", WAIT_S)
        page.run("document.getElementById('fold').click()")
        settle(page)
        whole = capture(page)[0]
        assert page.run("[...document.getElementById('beside').options].map(o => o.value)") == [
            "",
            "lambertian",
        ]
        choose(page, "beside", "lambertian")
        both = capture(page)[0]
        np.testing.assert_array_equal(both[:, :MIDDLE], whole[:, :MIDDLE])
        page.run("luxel.app.beside.divider.move(0)")
        camera = luxel.Camera(**page.run("luxel.camera()"))
        flat = luxel.Scene(
            session.particles, model="lambertian", lights=session.scene.sources, albedo=session.scene.albedo
        )
        picture = luxel.render(flat, luxel.View(camera=camera), size=WINDOW, antialias=1, colorbar=False)
        pixels, ids = capture(page)
        same = (picture.ids == ids) & (ids >= 0)
        assert same.sum() >= 0.99 * (ids >= 0).sum()
        assert np.abs(picture.pixels[..., :3].astype(int) - pixels)[same].mean() < 1
        np.testing.assert_array_equal(both[:, MIDDLE:], pixels[:, MIDDLE:])
