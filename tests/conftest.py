"""Fixtures for all tests."""

from __future__ import annotations

import os
from pathlib import Path

import hypothesis
import pytest

from luxel.app.warm import compile_ahead
from luxel.kernels.jit import cold
from luxel.trace.tree import thread_count

# A busy machine is slow, not wrong.
hypothesis.settings.register_profile("luxel", deadline=None, derandomize=True)
hypothesis.settings.load_profile("luxel")


_MOST_PROCESSES = 4  # each compiles kernels of its own and may run a browser


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Share all tests out to a few processes; those that are named run in this one."""
    return min(thread_count(None), _MOST_PROCESSES) if _runs_all(config) else 0


def pytest_sessionstart(session: pytest.Session) -> None:
    """On a machine that has no kernels yet, compile what most tests need, before they are shared out to processes that would all do so."""
    if _runs_all(session.config) and not hasattr(session.config, "workerinput") and cold():
        compile_ahead()


def _runs_all(config: pytest.Config) -> bool:
    return config.args_source is not pytest.Config.ArgsSource.ARGS


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
