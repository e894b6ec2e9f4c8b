"""The command line: ``luxel info | render | view | demo | movie | bake | encode | figure | plan | export``."""

from __future__ import annotations

import argparse
import io
import os
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

import luxel
from luxel.app import bake_commands, export_commands, look_commands, movie_commands
from luxel.app.command import Command
from luxel.app.options import protect_numbers
from luxel.errors import LuxelError

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code: 0, 2 for bad input, 130 when interrupted."""
    given = sys.argv[1:] if arguments is None else arguments
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # odd file names and plain terminals
    options = _parser().parse_args(protect_numbers(given))
    try:
        options.run(options)
        sys.stdout.flush()
    except LuxelError as error:
        if options.debug:
            raise
        return _fail(str(error))
    except MemoryError:
        if options.debug:
            raise
        return _fail("not enough memory — choose fewer particles or a smaller picture")
    except KeyboardInterrupt:
        if options.debug:
            raise
        print("\nluxel: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of our output, such as `head`, has left
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    return 0


def _fail(message: str) -> int:
    print(f"luxel: error: {' '.join(message.split())}", file=sys.stderr)
    return 2


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """Say what is wrong in one line instead of repeating all options."""
        self.exit(2, f"luxel: error: {message} (see {self.prog} --help)\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="luxel", description="Global illumination on particles.", allow_abbrev=False)
    parser.add_argument("--version", action="version", version=f"luxel {luxel.__version__}")
    parser.add_argument("--debug", action="store_true", help="show tracebacks")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for command in (
        *look_commands.COMMANDS,
        *movie_commands.COMMANDS,
        *bake_commands.COMMANDS,
        *export_commands.COMMANDS,
    ):
        _add(commands, command)
    return parser


def _add(commands: Any, command: Command) -> None:
    summary = command.summary
    parser: argparse.ArgumentParser = commands.add_parser(
        command.name, help=summary, description=f"{summary[0].upper()}{summary[1:]}.", allow_abbrev=False
    )
    parser.add_argument("--debug", action="store_true", default=argparse.SUPPRESS, help="show tracebacks")
    command.add_options(parser)
    parser.set_defaults(run=command.run)
