"""What tests of the viewer's page do with it: wait, look, compare with the ray tracer."""

from __future__ import annotations

import base64
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import luxel
from luxel import render
from luxel.app.viewer import Viewer
from luxel.picture.image import Image as RayTraced
from luxel.textures.textures import TextureSource
from tests.app.chromium import Page

__all__ = ["WAIT_S", "agree", "capture", "choose", "match", "settle"]

WAIT_S = 300.0  # only ever waited for when a test is about to fail


def settle(page: Page, *, fully: bool = False) -> dict[str, Any]:
    """Wait until all that the middles of pixels show is known and lit; return the page's state.

    Fully: also what only shows between them, so that nothing is left to ask for.
    """
    known = "settled" if fully else "known"
    return page.wait(
        "window.luxel && luxel.state()",
        WAIT_S,
        lambda s: s and s[known] and s["visible"] > 0 and s["ready"] == s["visible"],
    )


def capture(page: Page) -> tuple[np.ndarray, np.ndarray]:
    """The page's picture (H, W, 3) uint8 and ids (H, W) int32, one ray through the middle of every pixel."""
    found = page.run("luxel.capture()")
    shape = (found["height"], found["width"])
    pixels = np.frombuffer(base64.b64decode(found["pixels"]), np.uint8).reshape(*shape, 4)
    ids = np.frombuffer(base64.b64decode(found["ids"]), np.int32).reshape(shape)
    return pixels[::-1, :, :3], ids[::-1]


def choose(page: Page, control: str, value: str, event: str = "change") -> None:
    """Set a control of the panel."""
    page.run(
        f"(() => {{ const c = document.getElementById({control!r}); c.value = {value!r};"
        f" c.dispatchEvent(new Event({event!r})); }})()"
    )


def agree(
    page: Page,
    viewer: Viewer,
    look: luxel.View,
    what: str,
    source: TextureSource | None = None,
    mean_max: float = 2.0,
) -> None:
    """The page and the ray tracer draw the same picture, from the page's camera and `source`, or the session's textures."""
    pixels, ids = capture(page)
    camera = luxel.Camera(**page.run("luxel.camera()"))
    session = viewer.session
    height, width = ids.shape
    picture = render(
        session.scene,
        look.with_changes(camera=camera),
        session.source if source is None else source,
        (width, height),
        antialias=1,
        colorbar=False,
        key=session.key,
    )
    match(pixels, ids, picture, what, mean_max)


def match(pixels: np.ndarray, ids: np.ndarray, picture: RayTraced, what: str, mean_max: float = 2.0) -> None:
    """A page's capture is a picture of the ray tracer."""
    folder = Path(os.environ.get("LUXEL_PICTURES", tempfile.gettempdir()))
    try:
        covered = (ids >= 0) | (picture.ids >= 0)
        assert covered.mean() > 0.1
        same = (ids == picture.ids) & covered
        assert same.sum() >= 0.99 * covered.sum()
        difference = np.abs(pixels.astype(int) - picture.pixels[..., :3].astype(int))[same]
        assert difference.mean() <= mean_max
        assert (difference.max(axis=1) > 12).mean() < 0.01
    except AssertionError:
        Image.fromarray(np.ascontiguousarray(pixels)).save(folder / f"luxel-{what}-page.png")
        picture.save(folder / f"luxel-{what}-ray-tracer.png")
        raise
