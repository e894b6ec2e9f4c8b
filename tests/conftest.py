"""Fixtures for all tests."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import hypothesis
import pytest

from luxel.kernels.jit import cold

# A busy machine is slow, not wrong.
hypothesis.settings.register_profile("luxel", deadline=None, derandomize=True)
hypothesis.settings.load_profile("luxel")

_helper: subprocess.Popen[bytes] | None = None


def pytest_sessionstart(session: pytest.Session) -> None:
    """Where all must be compiled, have a second core compile ahead."""
    global _helper
    if cold() and (os.cpu_count() or 1) > 1 and not session.config.option.collectonly:
        null = subprocess.DEVNULL
        command = [sys.executable, "-m", "tests.compile_ahead"]
        _helper = subprocess.Popen(command, cwd=Path(__file__).parents[1], stdout=null, stderr=null)


def pytest_sessionfinish() -> None:
    """End it, if it has not ended yet."""
    if _helper is not None:
        _helper.kill()
        _helper.wait()


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
