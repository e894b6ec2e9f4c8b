"""The command line, called from within."""

from __future__ import annotations

from typing import Any

from luxel.app import cli

__all__ = ["COUNT", "refused", "run"]

COUNT = 40  # particles in the fixture `file`


def run(*arguments: object) -> int:
    return cli.main([str(argument) for argument in arguments])


def refused(capsys: Any, *arguments: object) -> str:
    """Run, expect exit code 2 and one line on stderr, beside what the first run on a machine says; return that line."""
    try:
        code = run(*arguments)
    except SystemExit as stop:  # argparse
        code = stop.code
    assert code == 2
    out, err = capsys.readouterr()
    assert out == ""
    said = [line for line in err.splitlines() if not line.startswith("luxel: compiling kernels")]
    assert len(said) == 1
    assert said[0].startswith("luxel: error: ")
    return str(said[0])
