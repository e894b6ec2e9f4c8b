"""Hidden and resized particles in a real headless Chromium, against the ray tracer; and views saved and loaded."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import luxel
from luxel import Cut, SavedView, Select, render
from luxel.app.viewer import Viewer, view
from luxel.session import Session
from luxel.textures.spec import TextureSpec
from tests.app.chromium import Browser, Page
from tests.app.pictures import WAIT_S, agree, capture, choose, settle
from tests.scenes import cloud

pytestmark = pytest.mark.browser

WINDOW = (240, 180)
LOOK = luxel.View(color_by="value", colormap="plasma", background="#203040")


@pytest.fixture(scope="module")
def viewer() -> Iterator[Viewer]:
    frames = []
    for seed in (3, 4):
        made = cloud(400, radius=0.07, seed=seed)
        material = np.arange(400) % 3
        scalars = {**made.scalars, "material": material}
        frames.append(
            luxel.Particles(
                made.positions, made.radii, scalars, categories={"material": ("ice", "sand", "steel")}
            )
        )
    spec = TextureSpec(mode="paper", samples=1, texels=8)
    with (
        Session(frames, spec=spec, view=LOOK, threads=2) as session,
        view(session, block=False, open_browser=False, announce=lambda url: None) as opened,
    ):
        yield opened


@pytest.fixture(scope="module")
def page(viewer: Viewer, browser: Browser) -> Iterator[Page]:
    with Page(viewer.url, WINDOW, browser=browser) as opened:
        opened.wait("window.luxel && luxel.state().loaded > 0", WAIT_S)
        opened.run("document.getElementById('fold').click()")
        yield opened
        assert [text for text in opened.messages if "performance warning" not in text] == []


@pytest.fixture(autouse=True)
def nothing_hidden(page: Page, viewer: Viewer) -> None:
    """Every test starts from the whole data set."""
    page.run("document.getElementById('show-all').click()")
    for control in ("cut-light", "select-light"):
        choose(page, control, "opens")
    viewer.session.relight(hide=(), radius_scale=1.0)
    viewer.session.set_frame(0)
    lit(page, viewer)


def lit(page: Page, viewer: Viewer) -> dict[str, Any]:
    """Wait until all changes are made, the page has taken on the session's light, and all that it shows is lit."""
    page.run("luxel.synced()")
    page.wait("luxel.state().key", WAIT_S, lambda key: key == viewer.session.key)
    return settle(page)


def slide(page: Page, control: str, values: list[int]) -> None:
    for value in values:
        choose(page, control, str(value), "input")


def test_a_cut_that_opens_light(page: Page, viewer: Viewer) -> None:
    before = viewer.session.key
    choose(page, "cut", "-y")
    assert lit(page, viewer)["hidden"] > 100
    assert viewer.session.key != before
    (cut,) = viewer.session.scene.conditions
    assert cut.normal == (0.0, -1.0, 0.0)
    agree(page, viewer, LOOK, "cut-opens")
    slide(page, "cut-slider", [200, 150, 100])
    lit(page, viewer)
    agree(page, viewer, LOOK, "cut-opens-moved")
    low, high = viewer.session.particles.bounds[:, 1]
    assert -viewer.session.scene.conditions[0].offset == pytest.approx(low + 0.25 * (high - low), rel=1e-3)


def test_a_cut_that_keeps_light(page: Page, viewer: Viewer) -> None:
    before = settle(page)
    choose(page, "cut-light", "keeps")
    choose(page, "cut", "-y")
    after = settle(page)
    assert after["hidden"] > 100
    assert after["key"] == before["key"] == viewer.session.key
    assert viewer.session.scene.conditions == ()
    saved = SavedView.from_json(page.run("luxel.savedView()"))
    assert len(saved.view.conditions) == 1
    agree(page, viewer, LOOK.with_changes(hide=saved.view.hide), "cut-keeps")
    kept = capture(page)[0].astype(int)
    choose(page, "cut-light", "opens")
    lit(page, viewer)
    agree(page, viewer, LOOK, "cut-opens-after")
    assert capture(page)[0].astype(int).mean() > kept.mean() + 1  # light has fallen into the cut


def test_selection_by_range_and_by_label(page: Page, viewer: Viewer) -> None:
    choose(page, "select", "value")
    page.wait("luxel.app.coloring.scalars.has('value')", WAIT_S)
    slide(page, "low-slider", [40, 160])
    slide(page, "high-slider", [300])
    lit(page, viewer)
    (select,) = viewer.session.scene.conditions
    assert isinstance(select, Select)
    values = viewer.session.particles.scalar("value")
    span = values.max() - values.min()
    assert select.low == pytest.approx(values.min() + 0.4 * span, abs=1e-3)
    assert select.high == pytest.approx(values.min() + 0.75 * span, abs=1e-3)
    shown = page.run("luxel.state()")
    assert shown["particles"] - shown["hidden"] == ((values >= select.low) & (values <= select.high)).sum()
    agree(page, viewer, LOOK, "selected")
    choose(page, "select", "material")
    choose(page, "select-label", "2")
    lit(page, viewer)
    assert viewer.session.scene.conditions == (Select("material", 2, 2),)
    assert set(capture(page)[1].ravel() % 3) == {2}  # -1 % 3 is 2: the background
    agree(page, viewer, LOOK, "one-material")


def test_cut_and_selection_compose_and_survive_a_change_of_frame(page: Page, viewer: Viewer) -> None:
    choose(page, "cut", "z")
    choose(page, "cut-light", "keeps")
    choose(page, "select", "material")
    lit(page, viewer)
    kept = SavedView.from_json(page.run("luxel.savedView()")).view.conditions
    agree(page, viewer, LOOK.with_changes(hide=kept), "composed")
    viewer.session.set_frame(1)
    lit(page, viewer)
    assert SavedView.from_json(page.run("luxel.savedView()")).view.conditions == kept
    agree(page, viewer, LOOK.with_changes(hide=kept), "composed-next-frame")


def test_radius_scale(page: Page, viewer: Viewer) -> None:
    slide(page, "radius", [0, -1])
    lit(page, viewer)
    assert viewer.session.particles.radius_scale == 0.5
    agree(page, viewer, LOOK, "half-radii")


def test_python_hides_and_the_page_follows(page: Page, viewer: Viewer) -> None:
    viewer.session.relight(hide=(Cut((1, 1, 0), 0.9), Cut("-x", -0.1)))
    lit(page, viewer)
    agree(page, viewer, LOOK, "from-python")
    # A condition that the panel has no control for stays when another is moved.
    choose(page, "cut-at", "0.7")
    page.wait(
        "0", WAIT_S, lambda _: viewer.session.scene.conditions == (Cut("-x", -0.1), Cut((1, 1, 0), 0.7))
    )
    lit(page, viewer)
    agree(page, viewer, LOOK, "from-python-moved")


def test_clicks_pick_what_is_seen(page: Page, viewer: Viewer) -> None:
    choose(page, "cut-light", "keeps")
    choose(page, "cut", "-y")
    settle(page)
    ids = capture(page)[1]
    seen = np.argwhere(ids >= 0)
    for row, column in [*seen[:: len(seen) // 4], np.argwhere(ids < 0)[0]]:
        page.click((column + 0.5, row + 0.5))
        k = int(ids[row, column])
        assert page.run("luxel.app.pick.id") == k
        if k >= 0:
            told = page.wait(
                "document.getElementById('readout').innerText", WAIT_S, lambda text: "value" in text
            )
            particles = viewer.session.particles
            assert told.startswith(f"particle {k}\nat ")
            assert f"material {('ice', 'sand', 'steel')[k % 3]}" in told
            assert f"value {particles.scalar('value')[k]:.6g}" in told
            # The ring is around it.
            ring = page.run(
                "(r => [r.cx, r.cy, r.r].map(x => x.baseVal.value))(document.querySelector('.ring'))"
            )
            assert np.hypot(ring[0] - column - 0.5, ring[1] - row - 0.5) < ring[2] + 1
    assert page.run("document.getElementById('readout').hidden")
    # What was picked and is hidden then has no tooltip; Enter picks what is in the middle.
    page.run("document.getElementById('view').focus()")
    page.press("Enter")
    assert page.run("luxel.app.pick.id") == ids[WINDOW[1] // 2, WINDOW[0] // 2] >= 0
    choose(page, "cut", "y")
    page.wait("document.getElementById('readout').hidden", WAIT_S)
    page.press("Escape")
    assert page.run("luxel.app.pick.id") == -1


def test_a_view_is_saved_and_loaded(page: Page, viewer: Viewer) -> None:
    """What the page saves draws the same picture, and brings the page back to it."""
    session = viewer.session
    session.set_frame(1)
    session.relight(model="ao", lights=[luxel.Sky(0.5), luxel.Sun((1, 2, 3), 1.0, 20)])
    lit(page, viewer)
    choose(page, "cut", "x")
    choose(page, "cut-light", "keeps")
    choose(page, "select", "material")
    choose(page, "color-by", "vector.x")
    choose(page, "colormap", "coolwarm")
    choose(page, "exposure", "0.5", "input")
    choose(page, "background", "#ffffff", "input")
    choose(page, "up", "y")
    slide(page, "radius", [0.5])
    page.run("document.getElementById('orthographic').click()")
    page.wait("luxel.state().coloring", WAIT_S, lambda text: "vector.x" in text and "coolwarm" in text)
    lit(page, viewer)
    text = json.dumps(page.run("luxel.savedView()"))
    saved = SavedView.from_json(json.loads(text))
    assert saved.frame == 1
    assert saved.view.up == "y"
    scene = saved.scene(session.series[1])
    assert luxel.Lighting.of(scene).to_json() == luxel.Lighting.of(session.scene).to_json()
    assert scene.key == session.scene.key
    pixels, ids = capture(page)
    size = (ids.shape[1], ids.shape[0])
    picture = render(scene, saved.view, session.source, size, antialias=1, colorbar=False)
    assert (picture.ids == ids).mean() > 0.995
    same = (picture.ids == ids) & (ids >= 0)
    assert np.abs(picture.pixels.astype(int) - pixels)[same].mean() < 1
    # Everything changes, and comes back.
    page.run("document.getElementById('show-all').click()")
    choose(page, "color-by", "")
    choose(page, "exposure", "0", "input")
    choose(page, "up", "z")
    session.relight(model="shadows", radius_scale=1.0)
    session.set_frame(0)
    lit(page, viewer)
    page.run(f"luxel.app.saved.load({text!r})")
    lit(page, viewer)
    assert session.scene.key == scene.key
    page.wait("luxel.state().coloring", WAIT_S, lambda found: "vector.x" in found)
    again = page.run("luxel.savedView()")
    eye = again["view"].pop("camera")["eye"]
    before = json.loads(text)
    np.testing.assert_allclose(eye, before["view"].pop("camera")["eye"])
    assert again == before
    np.testing.assert_array_equal(capture(page)[1], ids)


@pytest.mark.parametrize(
    "text, message",
    [
        ("{", "no view"),
        ("[]", "JSON object"),
        ('{"luxel_view": 7}', "version"),
        ('{"luxel_view": 1, "view": {"colormap": "viridsi"}}', "viridis"),
    ],
)
def test_a_bad_view_file_is_explained_in_the_page(page: Page, text: str, message: str) -> None:
    page.run(f"luxel.app.saved.load({text!r})")
    page.wait("document.getElementById('banner').textContent", WAIT_S, lambda said: message in said)
    page.run("luxel.app.notices.trouble('server', null)")


def test_what_was_drawn_before_the_camera_rests_is_looked_at_again(page: Page) -> None:
    """A fast renderer draws several samples before that; what is visible must become known all the same."""
    settle(page, fully=True)
    page.run(
        "luxel.setCamera(luxel.camera()), luxel.app.drawing.film.restAt = Infinity, luxel.app.drawing.schedule()"
    )
    page.wait(
        "(p => p.count > 1 && p.epoch === luxel.app.drawing.film.epoch)(luxel.app.drawing.film.pass)", WAIT_S
    )
    assert not page.run("luxel.state().known")
    page.run("luxel.app.drawing.film.restAt = 0")
    settle(page, fully=True)
