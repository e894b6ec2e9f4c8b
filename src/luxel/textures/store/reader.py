"""Reading a store: `open_baked`, and the frames that it gives."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import NDArray

from luxel.errors import FormatError, FrameError, MissingFileError
from luxel.particles import Particles
from luxel.scene.scene import Scene
from luxel.textures.spec import TextureSpec
from luxel.textures.store.layout import FORMAT, VERSION, BakeSettings, particles_options
from luxel.textures.textures import Encoding, LuminanceTextures

if TYPE_CHECKING:
    from luxel.textures.codecs import Codec
    from luxel.textures.compressed import CompressedTextures
    from luxel.textures.store.arrays import StoredArray

__all__ = ["Baked", "BakedFrame", "check_header", "is_store", "open_baked"]

_BLOCK = 4096  # particles decoded at once
_FOREIGN = "luxel opens what luxel bake wrote; give another path"


def is_store(path: str | os.PathLike[str]) -> bool:
    """Whether a path is meant as a Zarr store and not as a particle file; opens nothing."""
    text = os.fspath(path)
    if "://" in text or text.rstrip("/\\").endswith(".zarr"):
        return True
    return os.path.isfile(os.path.join(text, "zarr.json"))


def open_baked(path: str | os.PathLike[str]) -> Baked:
    """Open baked textures with their particles and scene.

    Parameters
    ----------
    path
        A store's directory, or any address that Zarr can open with fsspec.

    Raises
    ------
    MissingFileError
        If there is nothing at that path.
    FormatError
        If it is no store of luxel's, of another version, not complete, or damaged.
    """
    import zarr

    from luxel.textures.store.arrays import reading

    shown = os.fspath(path)
    if "://" not in shown and not Path(shown).is_dir():
        if Path(shown).exists():
            raise FormatError(shown, "is a file, where a store is a directory", remedy=_FOREIGN)
        raise MissingFileError(f"{shown}: no such store — luxel bake FILE -o {shown} makes one")
    try:
        group = zarr.open_group(shown, mode="r")
    except (KeyError, FileNotFoundError, zarr.errors.NodeNotFoundError):
        raise FormatError(shown, "is not a Zarr group", remedy=_FOREIGN) from None
    except (ValueError, TypeError, RuntimeError, OSError, ImportError) as error:
        raise FormatError(shown, f"cannot be opened: {error}", remedy=_FOREIGN) from error
    with reading(shown):
        header = check_header(shown, dict(group.attrs))
    if not header.get("complete"):
        raise FormatError(
            shown, "this bake is not finished", remedy="run the same luxel bake or luxel encode command again"
        )
    return Baked(shown, group, header)


def check_header(path: str, attributes: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return luxel's part of a store's attributes.

    Raises
    ------
    FormatError
        If there is none, or it is of another version.
    """
    header = attributes.get("luxel")
    if not isinstance(header, Mapping) or header.get("format") != FORMAT:
        raise FormatError(path, "is a Zarr store, but not one of baked textures", remedy=_FOREIGN)
    if header.get("version") != VERSION:
        raise FormatError(
            path,
            f"is a store of version {header.get('version')!r}; this luxel reads version {VERSION}",
            remedy="use the luxel that made it, or bake again with --overwrite",
        )
    return header


class Baked(Sequence["BakedFrame"]):
    """Baked textures of one or more time steps, read from disk on demand. Made by :func:`luxel.open_baked`.

    Attributes
    ----------
    path
        What was opened.
    settings
        All that the bake depended on but the particles.
    source
        Name of the file that the particles came from.
    luxel
        Version of luxel that made it.
    """

    def __init__(self, path: str, group: Any, header: Mapping[str, Any]) -> None:
        from luxel.textures.store.arrays import reading

        self.path = path
        self._group = group
        with reading(path, "zarr.json"):
            self.settings = BakeSettings.from_json(header["settings"])
            self.source = str(header["source"])
            self.luxel = str(header["luxel"])
        self._last: BakedFrame | None = None

    @property
    def spec(self) -> TextureSpec:
        """How the textures were made."""
        return self.settings.spec

    @property
    def series(self) -> BakedSeries:
        """The particles of every frame, as a series of time steps."""
        return BakedSeries(self)

    def __len__(self) -> int:
        return len(self.settings.frames)

    @overload
    def __getitem__(self, index: int) -> BakedFrame: ...
    @overload
    def __getitem__(self, index: slice) -> list[BakedFrame]: ...
    def __getitem__(self, index: int | slice) -> BakedFrame | list[BakedFrame]:
        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        if not -len(self) <= index < len(self):
            raise FrameError(f"{self.path}: no frame {index} — frames are 0..{len(self) - 1}")
        index %= len(self)
        last = self._last  # only the frame used last stays in memory
        if last is None or last.index != index:
            last = self._last = BakedFrame(self, index)
        return last

    def __repr__(self) -> str:
        return f"Baked({self.path!r}, frames={len(self)}, codec={self.settings.codec.kind!r})"


class BakedFrame:
    """One time step of a store. Everything is read when it is first asked for.

    Attributes
    ----------
    index
        In the store.
    source_frame
        In the series that was baked.
    time
        In the simulation's own unit, if known.
    scalar_names
        Of the particles.
    fingerprint
        Digests of what the particles hold.
    key
        The light key.
    count
        Number of particles.
    scale, encoding
        How codes become luminance.
    clipped_count
        Texels brighter than `scale`.
    payload_bytes, shared_bytes
        Compressed bytes of a particle, and of what all particles share.
    distortion
        What the codec changed: the values of :meth:`luxel.textures.codecs.Distortion.to_json`.
    """

    def __init__(self, baked: Baked, index: int) -> None:
        from luxel.textures.store.arrays import reading

        self._baked, self.index = baked, index
        self.source_frame = baked.settings.frames[index]
        place = f"frames/{index:04d}"
        with reading(baked.path, place):
            self._group = baked._group[place]
            about = self._group.attrs["luxel"]
            self._particles_json: Mapping[str, Any] = about["particles"]
            self.time: float | None = about["particles"]["time"]
            self.scalar_names: list[str] = list(about["scalars"])
            self._codec_json: Mapping[str, Any] = about["codec"]
            self.count = int(about["particles"]["count"])
            self.key = str(about["key"])
            self.scale = float(about["scale"])
            self.encoding: Encoding = about["encoding"]
            self.clipped_count = int(about["clipped"])
            self.payload_bytes = int(about["payload_bytes"])
            self.shared_bytes = int(about["shared_bytes"])
            self.distortion: Mapping[str, Any] = dict(about["distortion"])
            self.fingerprint: Mapping[str, str] = dict(about["fingerprint"])

    @property
    def settings(self) -> BakeSettings:
        """All that the bake depended on but the particles."""
        return self._baked.settings

    @cached_property
    def particles(self) -> Particles:
        """The particles, bit for bit as they were baked."""
        from luxel.textures.store.arrays import reading

        scalars = {name: self._whole(f"scalars/{k:03d}") for k, name in enumerate(self.scalar_names)}
        local, radii = self._whole("positions"), self._whole("radii")
        with reading(self._baked.path, self._group.path):
            return Particles.from_local(
                local, radii=radii, scalars=scalars, **particles_options(self._particles_json)
            )

    @cached_property
    def scene(self) -> Scene:
        """The particles under the light that they were baked with."""
        return self.settings.scene(self.particles)

    @cached_property
    def errors(self) -> NDArray[np.float32]:
        """(N,) expected standard error of a texel in luminance, before compression."""
        return self._whole("errors")

    @cached_property
    def clipped(self) -> NDArray[np.uint32]:
        """(chunks,) clipped texels in each chunk of particles."""
        return self._whole("clipped")

    @cached_property
    def codec(self) -> Codec:
        """What turns payload into texels."""
        from luxel.textures import codecs
        from luxel.textures.store.arrays import reading

        shared = {name: self._whole(f"codec/{name}") for name in self._codec_json["shared"]}
        with reading(self._baked.path, f"{self._group.path}/codec"):
            return codecs.restore(self._codec_json["description"], shared)

    @cached_property
    def payload(self) -> NDArray[np.uint8]:
        """(N, B) compressed textures."""
        return self._whole("payload")

    @cached_property
    def compressed(self) -> CompressedTextures:
        """The textures of all particles as they are stored: what pictures are drawn from."""
        from luxel.textures.compressed import CompressedTextures

        return CompressedTextures(
            np.arange(self.count, dtype=np.int32),
            self.payload,
            self.codec,
            self.scale,
            self.encoding,
            self.count,
            self.key,
            self.settings.spec.mapping,
        )

    @cached_property
    def textures(self) -> LuminanceTextures:
        """The textures of all particles, decompressed: (N, T, T) bytes."""
        texels = self.settings.spec.texels
        codes = np.empty((self.count, texels, texels), np.uint8)
        for rows, block in self.blocks():
            codes[rows] = block
        return LuminanceTextures(
            np.arange(self.count, dtype=np.int32),
            codes,
            self.scale,
            self.encoding,
            self.count,
            self.key,
            self.clipped_count,
            self.settings.spec.mapping,
            self.errors,
        )

    @property
    def has_raw(self) -> bool:
        """Whether the textures are here as they were before compression."""
        return self.settings.keep_raw or self.settings.codec.kind == "raw"

    def original(self) -> StoredCodes:
        """Return the best codes that there are: raw ones if they were kept, else those that the codec gives back."""
        return StoredCodes(self, raw=self.has_raw)

    def blocks(self) -> Iterator[tuple[slice, NDArray[np.uint8]]]:
        """Yield rows of particles and their codes (K, T, T), as the codec gives them back."""
        codes = StoredCodes(self, raw=False)
        for start in range(0, self.count, _BLOCK):
            rows = slice(start, min(start + _BLOCK, self.count))
            yield rows, codes[rows]

    def array(self, name: str) -> StoredArray:
        """Return an array of this frame, unread."""
        from luxel.textures.store.arrays import StoredArray

        return StoredArray(self._group, name, self._baked.path)

    def _whole(self, name: str) -> NDArray[Any]:
        return self.array(name)[:]

    def __repr__(self) -> str:
        return f"BakedFrame({self._baked.path!r}, {self.index}, particles={self.count})"


class StoredCodes:
    """Codes of a frame, (N, T, T) uint8, read and unpacked when they are sliced.

    Parameters
    ----------
    frame
        Of a store.
    raw
        Whether to read the textures from before compression.
    """

    def __init__(self, frame: BakedFrame, *, raw: bool) -> None:
        texels = frame.settings.spec.texels
        self.shape, self.dtype = (frame.count, texels, texels), np.dtype(np.uint8)
        beside = raw and frame.settings.codec.kind != "raw"
        self._stored = frame.array("raw" if beside else "payload")
        self._codec = None if beside else frame.codec

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, rows: slice) -> NDArray[np.uint8]:
        """Return the codes of some particles."""
        stored = self._stored[rows]
        return stored if self._codec is None else self._codec.decode(stored)


class BakedSeries(Sequence[Particles]):
    """The time steps of a store as a series, such as sessions take.

    Attributes
    ----------
    baked
        The store.
    path
        Of the store.
    """

    def __init__(self, baked: Baked) -> None:
        self.baked = baked
        self.path = baked.path

    def __len__(self) -> int:
        return len(self.baked)

    @overload
    def __getitem__(self, index: int) -> Particles: ...
    @overload
    def __getitem__(self, index: slice) -> list[Particles]: ...
    def __getitem__(self, index: int | slice) -> Particles | list[Particles]:
        if isinstance(index, slice):
            return [frame.particles for frame in self.baked[index]]
        return self.baked[index].particles
