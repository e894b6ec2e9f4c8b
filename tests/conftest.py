"""Fixtures for all tests."""

from __future__ import annotations

import os
from pathlib import Path

import hypothesis
import pytest

# A busy machine is slow, not wrong.
hypothesis.settings.register_profile("luxel", deadline=None, derandomize=True)
hypothesis.settings.load_profile("luxel")

_SHARED = Path(__file__).parents[2] / "shared" / "data"


def shared_data(path: str) -> Path:
    """Return a file of the shared data; skip without it, or fail if LUXEL_NO_SKIP=1 is set."""
    found = _SHARED / path
    if not found.exists():
        reason = f"the shared data file {path} is not here"
        if os.environ.get("LUXEL_NO_SKIP") == "1":
            pytest.fail(reason)
        pytest.skip(reason)
    return found
