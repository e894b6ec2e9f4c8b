"""The command line, called from within."""

from __future__ import annotations

from typing import Any

from luxel.app import cli

__all__ = ["COUNT", "refused", "run"]

COUNT = 40  # particles in the fixture `file`


def run(*arguments: object) -> int:
    return cli.main([str(argument) for argument in arguments])


def refused(capsys: Any, *arguments: object) -> str:
    """Run, expect exit code 2 and one line on stderr, and return that line."""
    try:
        code = run(*arguments)
    except SystemExit as stop:  # argparse
        code = stop.code
    assert code == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("luxel: error: ")
    assert err.count("\n") == 1
    return str(err)
