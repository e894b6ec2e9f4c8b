"""Photograph the viewer for docs/: a real page of ``luxel demo`` in headless Chromium.

    python tools/make_screenshots.py

Needs Chromium, and three minutes on two cores, most of them spent drawing without a graphics card.
"""

from __future__ import annotations

import sys
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))  # the driver of Chromium is the tests'

from luxel.app.viewer import view  # noqa: E402
from luxel.data import demo_particles, demo_view  # noqa: E402
from luxel.scene.lights import Sky, Sun, sun_direction  # noqa: E402
from luxel.session import Session  # noqa: E402
from tests.app.chromium import Page  # noqa: E402
from tests.app.pictures import choose, settle  # noqa: E402

IMAGES = ROOT / "docs" / "images"
SIZE = (1280, 720)
PATIENCE_S = 300.0


def main() -> None:
    """Take all pictures, in one visit."""
    lights = [Sky(1.0), Sun(sun_direction(155.0, 32.0), level=2.0, angular_diameter=15.0)]
    look = demo_view()
    with (
        Session(demo_particles(), lights=lights, view=look) as session,
        view(session, look, block=False, open_browser=False, announce=lambda url: None) as viewer,
        Page(viewer.url, SIZE) as page,
    ):
        page.wait("window.luxel && luxel.state().loaded > 0", PATIENCE_S)
        _take(page, "viewer-start")
        _rest(page)
        _take(page, "viewer-demo")
        choose(page, "beside", "shadows")
        _rest(page)
        _take(page, "viewer-compare")
        choose(page, "beside", "")
        choose(page, "cut", "y")
        page.run("document.getElementById('particles-part').open = true")
        _rest(page)
        _take(page, "viewer-cut")


def _rest(page: Page) -> None:
    """Wait until everything in the picture is lit and its edges are smooth."""
    page.run("luxel.synced()")
    settle(page)
    page.wait(
        "luxel.state()",
        PATIENCE_S,
        lambda s: (
            s["samples"] >= 8
            and s["estimates"] == 0
            and (s["beside"] is None or s["beside"]["ready"] >= s["visible"])
        ),
    )


def _take(page: Page, name: str) -> None:
    path = page.screenshot(IMAGES / f"{name}.png")
    with Image.open(path) as picture:
        picture.convert("RGB").save(path.with_suffix(".webp"), quality=88, method=6)
    path.unlink()


if __name__ == "__main__":
    main()
