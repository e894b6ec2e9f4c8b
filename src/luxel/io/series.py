"""A lazy series of time steps, and `open`, which makes one from a file, a directory, a pattern or a list."""

from __future__ import annotations

import difflib
import glob
import math
import operator
import os
import re
import threading
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from itertools import accumulate
from numbers import Real
from pathlib import Path
from typing import Any, overload

from luxel.errors import FrameError, InputError, MissingFileError
from luxel.io.frame import Radius, to_particles
from luxel.io.registry import Reader, Source, find_reader, named_reader
from luxel.io.stream import guard
from luxel.particles import Particles

__all__ = ["Series", "open_series"]

_NEIGHBOURS_LISTED = 10_000  # names looked at when a file is missing
PathLike = str | os.PathLike[str]


class Series(Sequence[Particles]):
    """The time steps of one data set, decoded one at a time on demand.

    Made by :func:`luxel.open`. ``series[k]`` is a :class:`luxel.Particles`; ``series[a:b]`` a shorter series over the
    same files. Only the step decoded last is kept in memory. Safe to use from several threads (one lock
    per data set) and to send to another process (which opens the files again).

    Attributes
    ----------
    path
        What was opened: a path, or the pattern.
    format
        Short name of the file format, such as ``"lammps dump"``.
    """

    def __init__(
        self, path: str, paths: Sequence[Path], reader: Reader, sources: Sequence[Source], radius: Radius
    ) -> None:
        self._files = _Files(paths, sources)
        self._frames: range = range(self._files.frame_count)
        self._reader = reader
        self._radius = radius
        self.path = path

    @property
    def format(self) -> str:
        """Short name of the file format."""
        return self._reader.name

    @property
    def times(self) -> list[float | None]:
        """The time of every step in the simulation's own unit; None where only decoding would tell."""
        times = self._files.times
        return [times[k] for k in self._frames]

    def first_frame(self) -> int:
        """Return the index of the first step with particles; 0 if no step has any."""
        for k, frame in enumerate(self._frames):
            count = self._files.particle_count(frame)
            if count is None:
                count = len(self[k])
            if count:
                return k
        return 0

    def particle_count(self, k: int) -> int | None:
        """Return the number of particles in step `k`, or None where only decoding would tell."""
        return self._files.particle_count(self._frames[k])

    def __len__(self) -> int:
        return len(self._frames)

    @overload
    def __getitem__(self, index: int) -> Particles: ...
    @overload
    def __getitem__(self, index: slice) -> Series: ...
    def __getitem__(self, index: int | slice) -> Particles | Series:
        if isinstance(index, slice):
            part = object.__new__(Series)
            part.__dict__.update(self.__dict__, _frames=self._frames[index])
            return part
        try:
            frame = self._frames[operator.index(index)]
        except TypeError:
            raise InputError(f"a frame is a whole number, got {index!r}") from None
        except IndexError:
            have = f"frames are 0..{len(self) - 1}" if len(self) else "there are no frames"
            raise FrameError(f"{self.path}: no frame {index} — {have}") from None
        return self._files.read(frame, self._radius)

    def __iter__(self) -> Iterator[Particles]:
        return (self[k] for k in range(len(self)))

    def __repr__(self) -> str:
        return f"Series({self.path!r}, format={self.format!r}, frames={len(self)})"

    def __reduce__(self) -> tuple[Any, ...]:
        paths = [os.fspath(path) for path in self._files.paths]
        return _reopen, (self.path, paths, self._radius, self._reader.name, self._frames)


class _Files:
    """The sources behind a series and its slices; holds the lock, the open file and the frame decoded last."""

    def __init__(self, paths: Sequence[Path], sources: Sequence[Source]) -> None:
        self.paths = list(paths)
        self._sources = list(sources)
        self._ends = list(accumulate(source.frame_count for source in sources))
        self._lock = threading.RLock()
        self._active: Source | None = None
        self._last: tuple[int, Particles] | None = None

    @property
    def frame_count(self) -> int:
        return self._ends[-1] if self._ends else 0

    @property
    def times(self) -> list[float | None]:
        return [time for source in self._sources for time in source.times]

    def particle_count(self, frame: int) -> int | None:
        which, local = self._locate(frame)
        return self._sources[which].particle_count(local)

    def read(self, frame: int, radius: Radius) -> Particles:
        with self._lock:
            if self._last is not None and self._last[0] == frame:
                return self._last[1]
            self._last = None  # let go of the old frame before the new one takes memory
            which, local = self._locate(frame)
            source, path = self._sources[which], self.paths[which]
            if self._active is not source:
                if self._active is not None:
                    self._active.close()
                self._active = source
            with guard(path, f"frame {local}"):
                decoded = source.read(local)
            particles = to_particles(decoded, path, local, radius)
            self._last = (frame, particles)
            return particles

    def _locate(self, frame: int) -> tuple[int, int]:
        which = bisect_right(self._ends, frame)
        return which, frame - (self._ends[which - 1] if which else 0)


def open_series(
    path: PathLike | Iterable[PathLike],
    *,
    radius: Radius = None,
    format: str | None = None,  # noqa: A002
) -> Series:
    """Open particle data as a lazy series of time steps.

    Parameters
    ----------
    path
        A file; a Uintah UDA directory or its index.xml; a pattern such as ``"dump.*.gz"``, whose files in natural
        order (2 before 10) make one series; or a list of files in the order given.
        Files compressed with gzip, bzip2 or xz are read as they are.
    radius
        A number in file units overrides the file's radii; ``"auto"`` estimates one radius from the spacing of
        neighbours; None takes the file's radii where it has any and estimates otherwise.
    format
        Short name or suffix of a format; None decides by content, and by suffix where that is not enough.

    Returns
    -------
    Series

    Raises
    ------
    MissingFileError
        If there is no such file, or the pattern matches none.
    FormatError
        If the format is unknown or the file is broken.
    MissingExtraError
        If the format's reader needs a package that is not installed.
    InputError
        For a radius or format that makes no sense.

    Examples
    --------
    >>> series = luxel.open("pour.lammpstrj.gz")  # doctest: +SKIP
    >>> particles = series[series.first_frame()]  # doctest: +SKIP
    """
    checked = _check_radius(radius)
    paths, shown = _expand(path)
    reader = named_reader(format) if format is not None else find_reader(paths[0])
    sources = []
    for each in paths:
        with guard(each):
            source = reader.open(each)
            source.close()  # a series of thousands of files must not hold thousands open
        sources.append(source)
    return Series(shown, paths, reader, sources, checked)


def _reopen(shown: str, paths: list[str], radius: Radius, name: str, frames: range) -> Series:
    series = open_series(paths, radius=radius, format=name)
    series.path, series._frames = shown, frames
    return series


def _check_radius(radius: Radius) -> Radius:
    if radius is None or radius == "auto":
        return radius
    if isinstance(radius, bool) or not isinstance(radius, Real):
        raise InputError(f'radius must be a positive number, "auto" or None, got {radius!r}')
    value = float(radius)
    if not (math.isfinite(value) and value > 0):
        raise InputError(f"radius must be positive and finite, got {radius!r}")
    return value


def _expand(path: PathLike | Iterable[PathLike]) -> tuple[list[Path], str]:
    """Return the files meant, in order, and how to call them all."""
    if not isinstance(path, str | os.PathLike):
        try:
            paths = [Path(each) for each in path]
        except TypeError:
            raise InputError(f"path must be a path, a pattern or a list of paths, got {path!r}") from None
        if not paths:
            raise InputError("path is an empty list; give at least one file")
        for each in paths:
            _require(each)
        return paths, f"{paths[0]} … {paths[-1]}" if len(paths) > 1 else str(paths[0])
    text = os.fspath(path)
    if not os.path.lexists(text) and glob.has_magic(text):
        found = sorted(glob.glob(text, recursive=True), key=_natural)
        if not found:
            raise MissingFileError(f"{text}: no file matches this pattern" + _nearest(Path(text)))
        return [Path(each) for each in found], text
    _require(Path(text))
    return [Path(text)], text


def _natural(text: str) -> list[tuple[int, int, str]]:
    parts = re.split(r"(\d+)", text)
    return [(1, int(part), part) if part.isdecimal() else (0, 0, part) for part in parts]


def _require(path: Path) -> None:
    try:
        exists = path.exists()
    except (OSError, ValueError):  # a name too long, or with a NUL in it
        exists = False
    if not exists:
        raise MissingFileError(f"{path}: no such file or directory" + _nearest(path))


def _nearest(path: Path) -> str:
    folder = path.parent
    try:
        with os.scandir(folder) as entries:
            names = [entry.name for entry, _ in zip(entries, range(_NEIGHBOURS_LISTED), strict=False)]
    except (OSError, ValueError):
        return f" — nor is there a folder {folder}"
    close = difflib.get_close_matches(path.name, names, n=3)
    return f" — did you mean {' or '.join(close)}?" if close else ""
