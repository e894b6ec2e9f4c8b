"""One Chromium for all tests that need one."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from tests.app.chromium import Browser, find


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """A running Chromium; tests open tabs in it."""
    if find() is None:
        if os.environ.get("LUXEL_NO_SKIP") == "1":
            pytest.fail("no Chromium found; set LUXEL_CHROMIUM")
        pytest.skip("no Chromium found")
    with Browser() as opened:
        yield opened
