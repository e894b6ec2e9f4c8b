"""Uintah data archives (UDA): directories of XML with raw arrays beside it.

There is no document of the bytes; the source is: https://github.com/Uintah/Uintah,
CCA/Components/DataArchiver/DataArchiver.cc, Core/DataArchive/DataArchive.cc, Core/Grid/Variables/ParticleVariable.h.
"""

from __future__ import annotations

import logging
import os
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from luxel.errors import FormatError
from luxel.io.columns import Columns
from luxel.io.frame import Frame
from luxel.io.stream import guard

__all__ = ["UintahReader"]

_log = logging.getLogger(__name__)

_DTYPES: dict[str, tuple[str, int]] = {  # Uintah's type -> NumPy's, and components
    "double": ("f8", 1),
    "float": ("f4", 1),
    "int": ("i4", 1),
    "long64": ("i8", 1),
    "Point": ("f8", 3),
    "Vector": ("f8", 3),
    "IntVector": ("i4", 3),
    "Matrix3": ("f8", 9),
}
_MOST_ZLIB_GAINS = 1032  # bytes out per byte in


@dataclass(frozen=True)
class UintahReader:
    """Uintah UDAs: the directory or its index.xml.

    Particles of all levels, patches and materials make one set, in the order of p.particleID where it was saved (the
    order in the files differs between steps), with the material's number as the scalar ``material``. Variables lose their
    ``p.`` prefix: ``stress``, ``temperature``. A variable that was not saved for a material is NaN there. The radius is that of
    the sphere of volume p.volume. Grid variables are not read.
    """

    name: str = "uintah uda"
    suffixes: tuple[str, ...] = (".uda",)

    def sniff(self, head: bytes, path: Path) -> bool | None:
        """Recognise a directory with an index.xml, or that index itself."""
        if path.is_dir():
            return (path / "index.xml").is_file()
        return b"<Uintah_DataArchive" in head

    def open(self, path: Path) -> UintahSource:
        """Read index.xml only."""
        return UintahSource(path / "index.xml" if path.is_dir() else path)


@dataclass(frozen=True)
class _Step:
    href: str
    time: float | None


@dataclass(frozen=True)
class _Entry:
    """Where one variable of one material on one patch lies."""

    variable: str
    type: str
    material: int
    count: int
    file: Path
    start: int
    end: int
    compressed: bool
    chunk: tuple[int, str, int]  # material, file, patch: what p.x and all else share


class UintahSource:
    """The time steps of a UDA."""

    def __init__(self, index: Path) -> None:
        self._index = index
        root = _parse(index, index)
        self._endian = _endian(root, "<")
        self._position = (root.findtext("ParticlePosition") or "p.x").strip()
        self._steps = [
            _Step(element.get("href", "").strip(), _float(element.get("time")))
            for element in root.iterfind("timesteps/timestep")
        ]
        names = {
            element.get("name"): element.get("type", "") for element in root.iterfind("variables/variable")
        }
        if self._position not in names:
            have = (
                f"it holds {', '.join(str(name) for name in names)[:200]}"
                if names
                else "it names no variables"
            )
            raise FormatError(
                index,
                f"no particles: particle positions {self._position} were not saved; {have}",
                remedy=f"add <save label='{self._position}'/> to the <DataArchiver> of the run",
            )
        if not self._steps:
            raise FormatError(index, "lists no time steps", remedy="the archive may be unfinished")
        self.times: Sequence[float | None] = [step.time for step in self._steps]

    @property
    def frame_count(self) -> int:
        """The number of time steps."""
        return len(self._steps)

    def particle_count(self, frame: int) -> int | None:
        """Return None: only the step's files tell."""
        return None

    def close(self) -> None:
        """Do nothing: no file stays open."""

    def read(self, frame: int) -> Frame:
        """Decode a step."""
        step = self._steps[frame]
        path = self._inside(self._index.parent, step.href)
        root = _parse(path, self._index)
        meta = root.find("Meta")
        endian = _endian(root, self._endian)
        bits = (meta.findtext("nBits") if meta is not None else None) or "64"
        time = step.time if step.time is not None else _float(root.findtext("Time/currentTime"))
        entries = self._entries(path, root)
        if not any(entry.variable == self._position for entry in entries):
            raise FormatError(path, f"no variable {self._position}: this step holds no particle positions")
        values = _Payloads(endian, 4 if bits.strip() == "32" else 8).read(entries)
        return self._assemble(path, entries, values, time)

    def _entries(self, path: Path, root: ElementTree.Element) -> list[_Entry]:
        """List the particle variables of a step; old archives name the files in timestep.xml, new ones in data.xml."""
        data = root.find("Data")
        if data is None:
            listing = path.with_name("data.xml")
            data = _parse(listing, path)
            if data.tag != "Data":
                raise FormatError(listing, f"the root element is {data.tag!r}, expected 'Data'")
        entries: list[_Entry] = []
        for element in data.iterfind("Datafile"):
            href = element.get("href", "").strip()
            if os.path.basename(href) == "global.xml":  # reductions
                continue
            file = self._inside(path.parent, href)
            for number, variable in enumerate(_parse(file, path).iterfind("Variable"), 1):
                with guard(file, f"variable {number} of the list"):
                    entry = _entry(variable, file, href)
                if entry is not None:
                    entries.append(entry)
        return entries

    def _assemble(
        self, path: Path, entries: Sequence[_Entry], values: Sequence[NDArray[Any]], time: float | None
    ) -> Frame:
        """Concatenate chunks, fill what a material lacks, bring all into the order of the ids."""
        by_variable: dict[str, dict[tuple[int, str, int], NDArray[Any]]] = {}
        for entry, array in zip(entries, values, strict=True):
            by_variable.setdefault(entry.variable, {})[entry.chunk] = array
        places = by_variable.pop(self._position)
        chunks = sorted(places)
        positions = np.concatenate([places[chunk] for chunk in chunks])
        if positions.ndim != 2 or positions.shape[1] != 3:
            raise FormatError(path, "the positions are no points", place=f"variable {self._position}")
        sizes = [len(places[chunk]) for chunk in chunks]
        material = np.repeat(np.array([chunk[0] for chunk in chunks], dtype=np.int32), sizes)
        scalars: Columns = {"material": material}
        partial = set()
        for variable, found in by_variable.items():
            parts, missing = [], False
            example = next(iter(found.values()))
            for chunk, size in zip(chunks, sizes, strict=True):
                part = found.get(chunk)
                if part is None:
                    part = np.full((size, *example.shape[1:]), np.nan)
                    missing = missing or size > 0
                elif len(part) != size or part.shape[1:] != example.shape[1:]:
                    raise FormatError(
                        path,
                        f"{len(part)} values for {size} particles on patch {chunk[2]} of material {chunk[0]}",
                        place=f"variable {variable}",
                        remedy="the archive is damaged",
                    )
                parts.append(part if part.size or part.dtype.kind == "f" else part.astype(example.dtype))
            if missing:
                partial.add(variable)
            else:  # an empty stand-in must not turn integers into floats
                parts = [part for part in parts if len(part)] or [example[:0]]
            scalars[variable.removeprefix("p.")] = np.concatenate(parts)
        radii, source = None, None
        if "p.volume" in partial:
            _log.warning(
                "%s: p.volume was not saved for all materials; radii are estimated from the spacing", path
            )
        elif "p.volume" in by_variable and scalars["volume"].ndim == 1:
            radii = np.cbrt(scalars["volume"].astype(np.float64) * (3 / (4 * np.pi)))
            source = "file variable p.volume"
        ids = scalars.get("particleID")
        if ids is not None and ids.ndim == 1 and "p.particleID" not in partial:
            order = np.argsort(ids, kind="stable")
            positions = positions[order]
            scalars = {name: array[order] for name, array in scalars.items()}
            radii = None if radii is None else radii[order]
        return Frame(positions, scalars, radii, source, {}, None, time)

    def _inside(self, folder: Path, href: str) -> Path:
        """Resolve an href; one that leaves the archive is refused."""
        path = Path(os.path.normpath(folder / href))
        if not href or os.path.isabs(href) or not path.is_relative_to(os.path.normpath(self._index.parent)):
            raise FormatError(
                self._index,
                f"href {href!r} points outside the archive",
                remedy="check where the file comes from",
            )
        return path


@dataclass(frozen=True)
class _Payloads:
    """Decodes arrays: raw, or an uncompressed length and one zlib stream (which Uintah calls gzip)."""

    endian: str
    size_bytes: int

    def read(self, entries: Sequence[_Entry]) -> list[NDArray[Any]]:
        values: list[NDArray[Any]] = [np.empty(0)] * len(entries)
        files: dict[Path, list[int]] = {}
        for k, entry in enumerate(entries):
            files.setdefault(entry.file, []).append(k)
        for path, members in files.items():
            with guard(path), path.open("rb") as file:
                size = os.fstat(file.fileno()).st_size
                for k in members:
                    entry = entries[k]
                    place = f"variable {entry.variable}"
                    if not 0 <= entry.start <= entry.end <= size:
                        raise FormatError(
                            path,
                            f"bytes {entry.start}..{entry.end} are wanted, the file has {size}",
                            place=place,
                            remedy="the file is truncated",
                        )
                    with guard(path, place):
                        file.seek(entry.start)
                        values[k] = self._decode(entry, file.read(entry.end - entry.start))
        return values

    def _decode(self, entry: _Entry, raw: bytes) -> NDArray[Any]:
        code, width = _DTYPES[entry.type]
        dtype = np.dtype(self.endian + code)
        need = entry.count * width * dtype.itemsize
        if entry.compressed and need:
            if need > len(raw) * _MOST_ZLIB_GAINS:
                raise ValueError(f"{entry.count} particles cannot come out of {len(raw)} bytes")
            raw = zlib.decompressobj().decompress(raw[self.size_bytes :], need + 1)
        if need and len(raw) != need:
            raise ValueError(f"{len(raw)} bytes where {entry.count} particles need {need}")
        flat = np.frombuffer(raw[:need], dtype).astype(dtype.newbyteorder("="))
        return flat if width == 1 else flat.reshape(entry.count, width)


def _entry(element: ElementTree.Element, file: Path, href: str) -> _Entry | None:
    """Read one <Variable>; None if it holds no particles, or a type that has no numbers for us."""
    kind = element.get("type", "")
    if not kind.startswith("ParticleVariable<"):
        return None

    def text(tag: str, default: str | None = None) -> str:
        value = element.findtext(tag, default)
        if value is None:
            raise ValueError(f"<{tag}> is missing")
        return value.strip()

    inner = kind[len("ParticleVariable<") :].rstrip("> ").strip()
    variable = text("variable")
    if inner not in _DTYPES:
        _log.info("%s: %s has type %s, which is not read", file, variable, kind)
        return None
    material, patch, count = int(text("index")), int(text("patch", "0")), int(text("numParticles"))
    compression = text("compression", "")
    if compression not in {"", "gzip"}:
        raise ValueError(f"compression {compression!r} of {variable} is not known, only gzip is")
    if count < 0 or abs(material) >= 2**31:
        raise ValueError(f"{variable} of material {material} has {count} particles")
    name = text("filename")
    if os.path.basename(name) != name or not name:
        raise ValueError(f"{name!r} is not the name of a file beside it")
    return _Entry(
        variable,
        inner,
        material,
        count,
        file.with_name(name),
        int(text("start")),
        int(text("end")),
        compression == "gzip",
        (material, href, patch),
    )


def _parse(path: Path, wanted_by: Path) -> ElementTree.Element:
    if not path.is_file():
        raise FormatError(
            wanted_by,
            f"names {path}, which does not exist",
            remedy="the archive is incomplete; copy all of it",
        )
    with guard(path, what="is not valid XML"):
        return ElementTree.parse(path).getroot()


def _endian(root: ElementTree.Element, default: str) -> str:
    text = (root.findtext("Meta/endianness") or "").strip()
    return {"little_endian": "<", "big_endian": ">"}.get(text, default)


def _float(text: str | None) -> float | None:
    try:
        return None if text is None else float(text)
    except ValueError:
        return None
