"""Fixtures for all tests."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import hypothesis
import pytest

# A busy machine is slow, not wrong.
hypothesis.settings.register_profile("luxel", deadline=None, derandomize=True)
hypothesis.settings.load_profile("luxel")

# What compiles most, and comes late: kernels for periodic cells, and for each way of keeping textures.
_COMPILE_AHEAD = (
    "dynamic/test_compressor.py",
    "light/test_periodic.py",
    "picture/test_hidden.py",
    "picture/test_folded.py",
    "textures/codecs/test_contract.py",
    "textures/test_picture_error.py",
    "textures/test_mapping.py",
    "trace/test_tracers.py",
)
_WHOLE_RUN = 1000  # tests

_SHARED = Path(__file__).parents[2] / "shared" / "data"


def pytest_collection_finish(session: pytest.Session) -> None:
    """While a whole run begins, have another process run what compiles most, for the sake of the kernels that it leaves in the cache."""
    if session.config.option.collectonly or len(session.items) < _WHOLE_RUN or (os.cpu_count() or 1) < 2:
        return
    politely = [] if (nice := shutil.which("nice")) is None else [nice, "-n", "10"]
    files = [str(Path(__file__).parent / name) for name in _COMPILE_AHEAD]
    ahead = subprocess.Popen(
        [*politely, sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *files],
        cwd=session.config.rootpath,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )

    def end() -> None:
        ahead.kill()
        ahead.wait()

    session.config.add_cleanup(end)


def shared_data(path: str) -> Path:
    """Return a file of the shared data; skip without it, or fail if LUXEL_NO_SKIP=1 is set."""
    found = _SHARED / path
    if not found.exists():
        reason = f"the shared data file {path} is not here"
        if os.environ.get("LUXEL_NO_SKIP") == "1":
            pytest.fail(reason)
        pytest.skip(reason)
    return found
