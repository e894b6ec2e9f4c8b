"""One Chromium for all tests that need one."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

import luxel
from luxel.session import Session
from luxel.textures.spec import TextureSpec
from tests.app.chromium import Browser, find
from tests.scenes import cloud


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """A running Chromium; tests open tabs in it."""
    if find() is None:
        if os.environ.get("LUXEL_NO_SKIP") == "1":
            pytest.fail("no Chromium found; set LUXEL_CHROMIUM")
        pytest.skip("no Chromium found")
    with Browser() as opened:
        yield opened


@pytest.fixture(scope="session")
def warm() -> None:
    """Kernels of frames are compiled, which may take longer than tests wait for a picture."""
    spec = TextureSpec(mode="paper", samples=1, texels=8)
    with Session(luxel.Scene(cloud(5), model="shadows"), spec=spec, threads=1) as session:
        for frame in luxel.Frames(session, size=(16, 16)):
            assert frame.visible <= 5
