"""The study mode in a real headless Chromium: every view under every model once, in an order of the seed; timed answers as CSV."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import luxel
from luxel.app.viewer import Viewer, view
from luxel.session import Session
from luxel.textures.spec import TextureSpec
from luxel.textures.store.bake import bake_to
from tests.app.chromium import Browser, Page
from tests.app.pictures import WAIT_S, capture, choose, settle
from tests.scenes import cloud

pytestmark = pytest.mark.browser

WINDOW = (420, 300)
TRIAL = "(s => s.run && ({...s.trial, count: s.run.rows.length, shown: Number.isFinite(s.shownAt ?? NaN)}))(luxel.app.study)"


@pytest.fixture(scope="module")
def viewer() -> Iterator[Viewer]:
    spec = TextureSpec(mode="paper", samples=1, texels=8)
    look = luxel.View(color_by="value")
    with (
        Session(cloud(150, radius=0.1), spec=spec, view=look, threads=2) as session,
        view(session, block=False, open_browser=False, announce=lambda url: None) as opened,
    ):
        yield opened


@pytest.fixture(scope="module")
def page(viewer: Viewer, browser: Browser) -> Iterator[Page]:
    with Page(viewer.url, WINDOW, browser=browser) as opened:
        opened.wait("window.luxel && luxel.state().loaded > 0", WAIT_S)
        opened.run(
            """window.files = [];
            (make => { URL.createObjectURL = blob => { blob.text().then(text => files.push(text)); return make.call(URL, blob); }; })(URL.createObjectURL)"""
        )
        settle(opened)
        for axis in "xz":
            opened.run(f"document.querySelector('[data-axis={axis}]').click()")
            opened.run("document.getElementById('study-add').click()")
        opened.run("document.querySelector('[data-axis=y]').click()")
        assert opened.run("document.getElementById('study-views').textContent") == "2 views"
        yield opened
        assert [text for text in opened.messages if "performance warning" not in text] == []


@pytest.fixture(autouse=True)
def settings(page: Page) -> None:
    page.run("files.length = 0, luxel.app.study.end('over')")
    choose(page, "study-seed", "7")
    page.run(
        "document.querySelectorAll('#study-models input').forEach(b => { b.checked = ['lambertian', 'shadows'].includes(b.value); })"
    )


def test_the_order_is_of_the_seed_and_every_pair_comes_once(page: Page) -> None:
    ask = "import('/client/study.js').then(m => m.trials(3, ['a', 'b', 'c'], {seed}).map(t => t.view + t.model))"
    orders = [page.run(ask.format(seed=seed)) for seed in (7, 7, 8)]
    assert orders[0] == orders[1] != orders[2]
    for order in orders:
        assert sorted(order) == [f"{k}{model}" for k in range(3) for model in "abc"]
        assert order != sorted(order)


def test_a_study_shows_complete_pictures_and_writes_timed_answers(page: Page, viewer: Viewer) -> None:
    order = page.run("import('/client/study.js').then(m => m.trials(2, ['lambertian', 'shadows'], 7))")
    before = page.run("luxel.savedView()")
    choose(page, "beside", "ao")
    choose(page, "study-question", 'A "crack", or not?')
    choose(page, "study-answers", "yes, no, cannot say")
    page.run("document.getElementById('study-start').click()")
    assert page.run("getComputedStyle(document.getElementById('panel')).display") == "none"
    cameras = []
    for k, expected in enumerate(order):
        trial = page.wait(TRIAL, WAIT_S, lambda t, k=k: t and t["shown"] and t["count"] == k + 1)
        assert {"view": trial["view"], "model": trial["model"]} == expected
        assert viewer.session.scene.model == expected["model"]
        state = page.run("luxel.state()")
        assert expected["model"] == "lambertian" or state["ready"] >= state["visible"]
        assert state["visible"] > 0
        assert page.run(
            "document.getElementById('curtain').hidden && document.getElementById('divider').hidden"
        )
        cameras.append(page.run("luxel.camera()")["eye"])
        if k == 0:
            page.press("4")  # no such answer
            assert page.run(TRIAL)["count"] == 1
            page.press("2")
        else:
            page.run("document.querySelector('#trial-answers button').click()")
        if k + 1 < len(order):
            assert not page.run("document.getElementById('curtain').hidden")
            page.press("1")  # nothing is shown: nothing to answer
            assert page.run(TRIAL)["count"] == k + 2
    assert len({tuple(eye) for eye in cameras}) == 2
    page.wait("window.files.length === 1", WAIT_S)
    rows = list(csv.DictReader(io.StringIO(page.run("files[0]"), newline="")))
    assert [(int(row["view"]) - 1, row["model"]) for row in rows] == [
        (each["view"], each["model"]) for each in order
    ]
    assert [row["answer"] for row in rows] == ["no", "yes", "yes", "yes"]
    assert [row["trial"] for row in rows] == ["1", "2", "3", "4"]
    assert {(row["seed"], row["question"]) for row in rows} == {("7", 'A "crack", or not?')}
    assert all(float(row["seconds"]) >= 0 for row in rows)
    page.run("luxel.synced()")
    page.wait("luxel.state().model", WAIT_S, lambda model: model == before["light"]["model"])
    assert page.run("luxel.savedView()") == before
    assert page.run("luxel.app.beside.model") == "ao"  # out of the way meanwhile
    choose(page, "beside", "")
    assert page.run("getComputedStyle(document.getElementById('panel')).display") != "none"


def test_escape_ends_it_and_saves_what_was_answered(page: Page) -> None:
    choose(page, "study-answers", "yes, no")
    page.run("document.getElementById('study-start').click()")
    page.wait(TRIAL, WAIT_S, lambda t: t and t["shown"])
    page.press("1")
    page.press("Escape")
    page.wait("window.files.length === 1", WAIT_S)
    assert len(page.run("files[0]").splitlines()) == 2
    assert page.run("document.getElementById('trial').hidden && document.getElementById('curtain').hidden")
    assert "1 of 4" in page.run("document.getElementById('banner').textContent")


def test_a_study_of_baked_light_shows_lambert_as_well(tmp_path: Path, browser: Browser) -> None:
    positions = np.random.default_rng(4).uniform(-1, 1, (150, 3))
    spec = TextureSpec(mode="paper", samples=1, texels=8)
    baked = bake_to(tmp_path / "b.zarr", luxel.Particles(positions, 0.22), model="ao", spec=spec)
    with (
        Session(baked) as session,
        view(session, block=False, open_browser=False, announce=lambda url: None) as opened,
        Page(opened.url, WINDOW, browser=browser) as page,
    ):
        page.wait("window.luxel && luxel.state().baked", WAIT_S)
        settle(page)
        page.run(
            "document.getElementById('study-add').click(), document.getElementById('study-start').click()"
        )
        size = page.run("document.getElementById('stage').clientWidth")
        assert size == WINDOW[0]
        shown = {}
        for k in range(2):
            trial = page.wait(TRIAL, WAIT_S, lambda t, k=k: t and t["shown"] and t["count"] == k + 1)
            shown[trial["model"]] = capture(page)[0]
            page.press("1")
        assert set(shown) == {"ao", "lambertian"}
        page.wait("luxel.app.study.run === null", WAIT_S)
        page.run("document.getElementById('fold').click()")
        page.wait("luxel.state().known", WAIT_S)
        np.testing.assert_array_equal(capture(page)[0], shown["ao"])
        choose(page, "beside", "lambertian")
        page.run("luxel.app.beside.divider.move(0)")
        np.testing.assert_array_equal(capture(page)[0], shown["lambertian"])


@pytest.mark.parametrize(
    ("control", "value", "message"),
    [("study-answers", "yes", "two answers"), ("study-seed", "-1", "seed"), ("study-seed", "", "seed")],
)
def test_a_study_that_cannot_be_is_explained(page: Page, control: str, value: str, message: str) -> None:
    before = page.run(f"document.getElementById({control!r}).value")
    choose(page, control, value)
    page.run("document.getElementById('study-start').click()")
    assert page.run("luxel.app.study.run") is None
    assert message in page.run("document.getElementById('banner').textContent")
    choose(page, control, before)


def add_files(page: Page, *files: tuple[str, str]) -> None:
    made = ", ".join(f"new File([{text!r}], {name!r})" for name, text in files)
    page.run(f"luxel.app.study.addFiles([{made}])")


def test_saved_views_are_added_from_files(page: Page) -> None:
    page.run("document.getElementById('study-clear').click()")
    view = page.run("luxel.savedView()")
    for key in ("light", "frame"):
        del view[key]
    add_files(page, ("from, above.json", json.dumps(view)), ("notes.json", '{"a": 1}'), ("x.json", "{"))
    said = page.run("document.getElementById('banner').textContent")
    assert "x.json" in said
    assert page.run("document.getElementById('study-views').textContent") == "1 view"
    page.run("document.getElementById('study-start').click()")
    for k in range(2):
        page.wait(TRIAL, WAIT_S, lambda t, k=k: t and t["shown"] and t["count"] == k + 1)
        page.press("1")
    page.wait("window.files.length === 1", WAIT_S)
    rows = list(csv.DictReader(io.StringIO(page.run("files[0]"), newline="")))
    assert {row["view"] for row in rows} == {"from, above.json"}
    # One that the server refuses ends the study, and says which it was.
    page.run("document.getElementById('study-clear').click()")
    add_files(page, ("other.json", json.dumps({**view, "view": {**view["view"], "color_by": "no such"}})))
    page.run("document.getElementById('study-start').click()")
    page.wait("luxel.app.study.run === null", WAIT_S)
    said = page.run("document.getElementById('banner').textContent")
    assert "no such" in said
    assert "other.json cannot be shown" in said
