"""axe-core finds nothing serious in the page: light and dark, with all panels open, while comparing, and in a study."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

import luxel
from luxel.app.viewer import Viewer, view
from luxel.session import Session
from luxel.textures.spec import TextureSpec
from tests.app.chromium import Browser, Page
from tests.app.pictures import WAIT_S, choose, settle
from tests.scenes import cloud

pytestmark = pytest.mark.browser

ROOT = Path(__file__).parents[2]
INSTALL = (
    "npm",
    "install",
    "--no-audit",
    "--no-fund",
    "--no-package-lock",
    "--silent",
)  # as in `make client`
CHECK = """axe.run(document, {resultTypes: ["violations"]}).then(found => found.violations
  .filter(each => ["serious", "critical"].includes(each.impact))
  .map(each => `${each.id}: ${each.help}: ${each.nodes.map(node => node.target.join(" ")).join(", ")}`))"""


@pytest.fixture(scope="module")
def axe() -> str:
    """The source of axe-core, from npm."""
    script = ROOT / "node_modules" / "axe-core" / "axe.min.js"
    if not script.exists() and shutil.which("npm"):
        subprocess.run(INSTALL, cwd=ROOT, timeout=300, check=False, capture_output=True)
    if not script.exists():
        reason = f"axe-core is not here: {' '.join(INSTALL)}"
        if os.environ.get("LUXEL_NO_SKIP") == "1":
            pytest.fail(reason)
        pytest.skip(reason)
    return script.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def viewer() -> Iterator[Viewer]:
    steps = [cloud(200, radius=0.09, seed=k) for k in range(2)]
    spec = TextureSpec(mode="paper", samples=1, texels=8)
    with (
        Session(steps, model="shadows", spec=spec, view=luxel.View(color_by="value"), threads=2) as session,
        view(session, block=False, open_browser=False, announce=lambda url: None) as opened,
    ):
        yield opened


@pytest.fixture(scope="module", params=["dark", "light"])
def page(viewer: Viewer, browser: Browser, axe: str, request: pytest.FixtureRequest) -> Iterator[Page]:
    with Page(viewer.url, (1280, 720), dark=request.param == "dark", browser=browser) as opened:
        opened.wait("window.luxel && luxel.state().loaded > 0", WAIT_S)
        opened.run(f"{axe}; 0")
        opened.run("document.querySelectorAll('details').forEach(each => { each.open = true; })")
        settle(opened)
        yield opened


def violations(page: Page) -> list[str]:
    found: list[str] = page.run(CHECK)
    return found


def test_it_finds_what_is_wrong(page: Page) -> None:
    """The check itself works: a button without a name is found."""
    page.run("document.getElementById('save').textContent = '', document.getElementById('save').title = ''")
    assert any("button-name" in each for each in violations(page))
    page.run("document.getElementById('save').textContent = 'PNG'")


def test_nothing_serious_with_all_panels_open(page: Page) -> None:
    choose(page, "cut", "-y")
    choose(page, "select", "value")
    assert page.run(
        "document.querySelector('.cutting').offsetHeight > 0 && document.querySelector('.ranged').offsetHeight > 0"
    )
    assert violations(page) == []
    page.run("document.getElementById('show-all').click()")


def test_nothing_serious_while_comparing_with_a_banner_and_a_tooltip(page: Page) -> None:
    choose(page, "beside", "lambertian")
    page.run("luxel.app.notices.trouble('server', 'Something went wrong'), luxel.app.pick.set(0)")
    page.wait("document.getElementById('readout').textContent", WAIT_S, lambda text: "radius" in text)
    assert not page.run("document.getElementById('divider').hidden")
    assert violations(page) == []
    page.run("luxel.app.notices.trouble('server', null), luxel.app.notices.trouble('notice', 'Please wait')")
    page.run("document.getElementById('fold').click()")
    assert violations(page) == []
    page.run(
        "document.getElementById('fold').click(), luxel.app.notices.trouble('notice', null), luxel.app.pick.set(-1)"
    )
    choose(page, "beside", "")


def test_nothing_serious_in_a_study(page: Page) -> None:
    page.run("document.getElementById('study-add').click(), document.getElementById('study-start').click()")
    assert not page.run("document.getElementById('curtain').hidden")
    assert violations(page) == []
    page.wait("document.getElementById('curtain').hidden", WAIT_S)
    assert violations(page) == []
    page.press("Escape")
    page.run("document.getElementById('study-clear').click()")


def test_everything_is_reached_with_the_tab_key(page: Page) -> None:
    """Whatever a mouse can use has the focus once on a walk through the page, and says what it is."""
    choose(page, "beside", "lambertian")
    wanted = set(
        page.run(
            "[...document.querySelectorAll('button, select, input, summary, canvas[tabindex], [role=slider]')]"
            ".filter(e => e.checkVisibility() && !e.disabled).map((e, k) => e.id || (e.id = `seen-${k}`))"
        )
    )
    page.run("document.activeElement.blur()")
    reached = set()
    for _ in range(2 * len(wanted)):
        page.press("Tab")
        reached.add(page.run("document.activeElement.id"))
    assert wanted <= reached
    choose(page, "beside", "")
