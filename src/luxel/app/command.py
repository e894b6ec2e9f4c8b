"""Command: one subcommand of ``luxel``, as the modules of commands hand it to the command line."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import NamedTuple

__all__ = ["Command"]


class Command(NamedTuple):
    """A subcommand: its name, what it does in a few words, what adds its options, and what runs it."""

    name: str
    summary: str
    add_options: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], None]
