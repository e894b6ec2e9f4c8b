"""The exception tree.

LuxelError
├── InputError            (ValueError)         a bad argument or option
├── FrameError            (IndexError)         a frame outside the series
├── ScalarError           (KeyError)           a scalar that the particles do not have
├── MissingFileError      (FileNotFoundError)  no such file or directory
├── FormatError           (ValueError)         a file that cannot be understood
├── StorageError          (OSError)            a place that cannot be written: full, forbidden, in use
├── MissingExtraError     (ImportError)        an optional reader that is not installed
├── SessionClosedError    (RuntimeError)       use of a session or engine after close()
└── ProtocolError         (ValueError)         a bad message from a viewer's socket

A message says what was given, what was expected, where (file, line, field) and what to do about it.
"""

from __future__ import annotations

import os
from typing import Any

__all__ = [
    "FormatError",
    "FrameError",
    "InputError",
    "LuxelError",
    "MissingExtraError",
    "MissingFileError",
    "ProtocolError",
    "ScalarError",
    "SessionClosedError",
    "StorageError",
]


class LuxelError(Exception):
    """Root of every error that luxel raises on purpose; its text is fit to be shown to a user."""

    def __str__(self) -> str:
        # KeyError would quote its message and OSError would print an errno tuple.
        return str(self.args[0]) if self.args else ""


class InputError(LuxelError, ValueError):
    """A bad argument: wrong shape, dtype, range or choice."""


class FrameError(LuxelError, IndexError):
    """A frame outside the series, or one that holds no particles."""


class ScalarError(LuxelError, KeyError):
    """A scalar or component that the particles do not have; the message lists those they do."""


class MissingFileError(LuxelError, FileNotFoundError):
    """No such file or directory, or a pattern that matches none."""


class FormatError(LuxelError, ValueError):
    """A file whose content cannot be understood.

    Parameters
    ----------
    path
        The file at fault.
    problem
        What was found and what was expected.
    place
        Where in the file: ``"line 9"``, ``"frame 3"``, ``"variable p.x"``.
    remedy
        What the user can do.
    """

    def __init__(
        self, path: str | os.PathLike[str], problem: str, *, place: str = "", remedy: str = ""
    ) -> None:
        where = f"{os.fspath(path)}, {place}" if place else os.fspath(path)
        super().__init__(f"{where}: {problem}" + (f" — {remedy}" if remedy else ""))
        self.path = os.fspath(path)
        self.place = place
        self.remedy = remedy

    def __reduce__(self) -> tuple[Any, ...]:
        return (_rebuild, (type(self), self.args, self.__dict__))


class StorageError(LuxelError, OSError):
    """A place that cannot be written: the disk is full, permission is missing, or another process holds it."""


class MissingExtraError(LuxelError, ImportError):
    """A reader that needs an optional package; the message gives the pip command."""

    def __init__(self, what: str, extra: str) -> None:
        super().__init__(f"{what} needs an optional package — pip install 'luxel[{extra}]'")


class SessionClosedError(LuxelError, RuntimeError):
    """Use of a session or an engine after ``close()``."""


class ProtocolError(LuxelError, ValueError):
    """A malformed or unauthorised message from a viewer's socket; closes that socket only."""


def _rebuild(cls: type[LuxelError], args: tuple[Any, ...], state: dict[str, Any]) -> LuxelError:
    error = cls.__new__(cls)
    error.args = args
    error.__dict__.update(state)
    return error
