"""The widget in a real JupyterLab page: the same picture, over the notebook's own channel."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import luxel
from tests.app.chromium import Browser, Page
from tests.app.jupyter import Lab
from tests.app.pictures import WAIT_S, capture, match

pytestmark = pytest.mark.browser

_ARRAYS = """
import numpy as np
rng = np.random.default_rng(3)
positions, colors = rng.uniform(-1, 1, (300, 3)), rng.random((300, 3))
"""
_CELLS = [
    f"import luxel\n{_ARRAYS}",
    "options = dict(radii=0.12, colors=colors, model='shadows', threads=2, height=320)\n"
    "w = luxel.view(positions, spec=luxel.TextureSpec(mode='paper', samples=1, texels=8), **options)\nw",
    "w",
    "print('ready:', w.session.status().ready)",
    "import threading\nw.close()\nprint('left:', [t.name for t in threading.enumerate() if 'luxel' in t.name])",
]


_PANEL = "[...(window.jupyterapp?.shell.widgets('main') ?? [])].find((each) => each.content?.widgets)"
_NOTEBOOK = f"({_PANEL})?.content"
_IDLE = f"({_PANEL}).sessionContext.session?.kernel?.status === 'idle'"


@pytest.fixture(scope="module")
def page(
    browser: Browser, tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest
) -> Iterator[Page]:
    with (
        Lab(tmp_path_factory.mktemp("lab"), _CELLS) as lab,
        Page(lab.url, (1100, 800), dark=False, browser=browser) as opened,
    ):
        opened.call("Emulation.setFocusEmulationEnabled", enabled=True)  # what is current follows the focus
        opened.wait(f"{_NOTEBOOK}?.widgets?.length === {len(_CELLS)} && {_IDLE}", WAIT_S)
        opened.wait(
            f"jupyterapp.shell.activateById(({_PANEL}).id), jupyterapp.shell.currentWidget === ({_PANEL})"
            " && jupyterapp.commands.isEnabled('notebook:run-cell')",
            WAIT_S,
        )
        failed_before = request.session.testsfailed
        yield opened
        if request.session.testsfailed > failed_before or "LUXEL_PICTURES" in os.environ:
            folder = Path(os.environ.get("LUXEL_PICTURES", tempfile.gettempdir()))
            saved = opened.screenshot(folder / "luxel-jupyter.png")
            print(f"screenshot: {saved}; the page said: {opened.messages}")  # noqa: T201


def run_cell(page: Page, k: int) -> None:
    """Run one cell and wait until the kernel is done with it."""
    page.run(
        f"(() => {{ const notebook = {_NOTEBOOK}; notebook.deselectAll(); notebook.activeCellIndex = {k};"
        " void jupyterapp.commands.execute('notebook:run-cell'); })()"
    )
    page.wait(f"{_NOTEBOOK}.widgets[{k}].model.executionCount > 0 && {_IDLE}", WAIT_S)


def attend(page: Page, k: int) -> None:
    """Make `luxel` in the page mean the k-th widget, once it is lit."""
    widget = f"document.querySelectorAll('.luxel-widget')[{k}]"
    page.wait(f"{widget}?.luxel && (window.luxel = {widget}.luxel) && true", WAIT_S)
    page.wait("(s => s.known && s.visible > 0 && s.ready === s.visible)(luxel.state())", WAIT_S)


def test_the_widget_shows_the_ray_tracers_picture(page: Page) -> None:
    run_cell(page, 0)
    run_cell(page, 1)
    attend(page, 0)
    assert page.run("luxel.state().troubles") == {}
    pixels, ids = capture(page)
    arrays: dict[str, np.ndarray] = {}
    exec(_ARRAYS, arrays)
    scene = luxel.Scene(luxel.Particles(arrays["positions"], 0.12), model="shadows")
    textures = luxel.bake(scene, samples=1, mode="paper", texels=8)
    camera = luxel.Camera(**page.run("luxel.camera()"))
    particles = luxel.Particles(arrays["positions"], 0.12, {"color": arrays["colors"]})
    look = luxel.View(color_by="color", colormap="rgb", camera=camera)
    picture = luxel.render(
        scene.with_changes(particles=particles), look, textures, ids.shape[::-1], antialias=1
    )
    match(pixels, ids, picture, "jupyter")


def test_keys_are_the_widgets_while_it_has_the_focus(page: Page) -> None:
    """In a cell, JupyterLab would take x for cutting the cell."""
    cells = f"{_NOTEBOOK}.widgets.length"
    before, camera = page.run(cells), page.run("luxel.camera()")
    page.run("luxel.app.drawing.canvas.focus()")
    for kind in ("keyDown", "keyUp"):
        page.call("Input.dispatchKeyEvent", type=kind, key="x", code="KeyX", windowsVirtualKeyCode=88)
    page.wait("luxel.camera().eye[1]", WAIT_S, lambda y: y != camera["eye"][1])
    assert page.run(cells) == before


def test_a_second_view_has_a_camera_of_its_own(page: Page) -> None:
    run_cell(page, 2)
    first = page.run("luxel.camera().eye")
    attend(page, 1)
    assert page.run("luxel.camera().eye") != first
    assert page.run("luxel.state().received") > 0
    run_cell(page, 3)
    output = page.run(f"{_NOTEBOOK}.widgets[3].outputArea.node.textContent")
    assert int(output.removeprefix("ready:")) >= page.run("luxel.state().visible")


def test_other_styles_stay_outside(page: Page) -> None:
    """Ids and rules of the page do not reach JupyterLab's, nor the other way round."""
    assert page.run("document.getElementById('panel')") is None
    assert page.run("document.querySelectorAll('.luxel-widget').length") == 2
    assert (
        page.run("getComputedStyle(luxel.app.element('panel')).colorScheme") == "light"
    )  # JupyterLab's theme


def test_closing_in_python_is_seen_in_the_page(page: Page) -> None:
    run_cell(page, 4)
    page.wait("!document.querySelector('.luxel-widget')", WAIT_S)
    assert "left: []" in page.run(f"{_NOTEBOOK}.widgets[4].outputArea.node.textContent")


def test_the_page_reports_no_errors(page: Page) -> None:
    ours = [text for text in page.messages if "luxel" in text.lower() or "GL" in text]
    assert [text for text in ours if "performance warning" not in text] == []
