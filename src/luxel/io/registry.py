"""Which reader understands a file: its content decides, its suffix where the content cannot."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from luxel.errors import FormatError, InputError
from luxel.io.frame import Frame
from luxel.io.stream import Stream, bare_suffix

__all__ = ["Reader", "Source", "find_reader", "named_reader", "readers"]


class Source(Protocol):
    """An opened file: one or more time steps."""

    @property
    def frame_count(self) -> int:
        """The number of time steps."""

    @property
    def times(self) -> Sequence[float | None]:
        """The time of every step; None where it is not known without decoding it."""

    def particle_count(self, frame: int) -> int | None:
        """Return the number of particles in a step, or None where it is not known without decoding it."""

    def read(self, frame: int) -> Frame:
        """Decode step `frame` in [0, frame_count); raises FormatError for what cannot be understood."""

    def close(self) -> None:
        """Close open files; a later `read` opens them again."""


class Reader(Protocol):
    """A file format."""

    @property
    def name(self) -> str:
        """A short name: ``"lammps dump"``."""

    @property
    def suffixes(self) -> tuple[str, ...]:
        """Usual suffixes, lower case, without any compression suffix."""

    def sniff(self, head: bytes, path: Path) -> bool | None:
        """Say whether this is the format: yes, no, or None if the content (first bytes) cannot tell."""

    def open(self, path: Path) -> Source:
        """Open a file of this format. Cheap: it indexes time steps but decodes none."""


def readers() -> tuple[Reader, ...]:
    """Return all readers; the earlier one wins a tie."""
    # Imported here because each reader imports this module's protocols.
    from luxel.io import csv, gsd, lammps, npz, uintah, vtk_legacy, vtk_xml, xyz

    return (
        uintah.UintahReader(),
        lammps.LammpsReader(),
        gsd.GsdReader(),
        npz.NpzReader(),
        vtk_legacy.VtkLegacyReader(),
        vtk_xml.VtkXmlReader(),
        xyz.XyzReader(),
        csv.CsvReader(),
    )


def named_reader(name: str) -> Reader:
    """Return the reader with that short name or suffix.

    Raises
    ------
    InputError
        If there is none; the message lists them.
    """
    wanted = name.lower()
    for reader in readers():
        if wanted == reader.name or f".{wanted.lstrip('.')}" in reader.suffixes:
            return reader
    raise InputError(f"format must be one of {_known()}, got {name!r}")


def find_reader(path: Path) -> Reader:
    """Return the reader for an existing file or directory.

    Raises
    ------
    FormatError
        If no reader claims it; the message lists the formats.
    """
    if path.is_dir():
        head = b""
    else:
        stream = Stream(path)
        try:
            head = stream.head()
        finally:
            stream.close()
        if not head:
            raise FormatError(path, "the file is empty")
    unsure = []
    for reader in readers():
        verdict = reader.sniff(head, path)
        if verdict:
            return reader
        if verdict is None:
            unsure.append(reader)
    for reader in unsure:
        if bare_suffix(path) in reader.suffixes:
            return reader
    if (path / "zarr.json").exists():
        raise FormatError(path, "is a Zarr store", remedy="luxel.open_baked opens what luxel bake made")
    if path.is_dir():
        raise FormatError(
            path,
            "is a directory without index.xml, so it is not a Uintah UDA",
            remedy=f"for a series of files give a pattern, such as '{path.name}/*.vtu'",
        )
    raise FormatError(
        path, "unknown format", remedy=f"the formats known are {_known()}; name one with --format"
    )


def _known() -> str:
    return ", ".join(f"{reader.name} ({' '.join(reader.suffixes)})" for reader in readers())
