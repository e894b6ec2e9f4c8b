"""Writing one frame of a store in steps that each survive whatever ends the process."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from luxel.errors import FormatError, InputError
from luxel.light.lights import luminance_scale
from luxel.scene.scene import Scene
from luxel.textures import codecs
from luxel.textures.codecs.distortion import Distortion, DistortionSum
from luxel.textures.spec import light_key
from luxel.textures.store.arrays import ArrayFiles, StoredArray, write_array, write_group
from luxel.textures.store.files import remove_tree
from luxel.textures.store.layout import BakeSettings, differences, fingerprint, particles_json
from luxel.textures.textures import decoding_table

__all__ = ["Codes", "FrameWriter", "Progress", "read_attributes"]

#: Called as ``progress(stage, done, total)``; stages are ``"lighting"``, ``"training"`` and ``"encoding"``.
Progress = Callable[[str, int, int], None]

# Rows of the other arrays in a chunk: whatever is small comes in few files.
_ROWS = 1 << 18


class Codes(Protocol):
    """Textures before compression, (N, T, T) uint8, that are read when they are sliced."""

    shape: tuple[int, int, int]
    dtype: np.dtype[np.uint8]

    def __len__(self) -> int:
        """Return the number of textures."""
        ...

    def __getitem__(self, rows: slice) -> NDArray[np.uint8]:
        """Return (K, T, T) codes."""
        ...


class FrameWriter:
    """One frame of a store, begun or taken up again.

    Parameters
    ----------
    folder
        Of the frame.
    store
        The store's path, for messages.
    scene, settings
        What is baked, and how.

    Raises
    ------
    InputError
        If the frame is there and holds other particles.
    """

    def __init__(self, folder: Path, store: str, scene: Scene, settings: BakeSettings) -> None:
        self.folder, self.store, self.scene, self.settings = folder, store, scene, settings
        self.count = len(scene.particles)
        self._about = self._begin()
        self.complete = bool(self._about["complete"])
        if self.complete:
            self._tidy()
            return
        texels, chunk = settings.spec.texels, settings.chunk
        self.is_raw = settings.codec.kind == "raw"
        flat, square = (self.count, texels * texels), (self.count, texels, texels)
        self.codes = ArrayFiles(
            folder / ("payload" if self.is_raw else "raw"), flat if self.is_raw else square, np.uint8, chunk
        )
        self.errors = ArrayFiles(folder / "errors", (self.count,), np.float32, chunk)
        self.clipped = ArrayFiles(folder / "clipped", (self.codes.count,), np.uint32, 1)

    def missing(self) -> list[int]:
        """Return the chunks that are still to be lit."""
        parts = (self.codes, self.errors, self.clipped)
        return [k for k in range(self.codes.count) if not all(part.has(k) for part in parts)]

    def put(self, k: int, codes: NDArray[np.uint8], errors: NDArray[np.float32], clipped: int) -> None:
        """Store chunk `k`: codes (K, T, T), errors (K,) and the number of clipped texels."""
        self.errors.write(k, errors)
        self.clipped.write(k, np.array([clipped], np.uint32))
        self.codes.write(k, codes.reshape(len(codes), -1) if self.is_raw else codes)

    def lit(self) -> Codes:
        """Return the codes of all chunks, once none is missing."""
        return _Lit(self._stored("payload" if self.is_raw else "raw"), self.count, self.settings.spec.texels)

    def finish(self, original: Codes, progress: Progress | None = None) -> None:
        """Compress `original` as the settings say, write down what that changed, and mark the frame complete."""
        if self.is_raw:
            codec: codecs.Codec = codecs.RawCodec(self.settings.spec.texels)
            distortion = Distortion.none(ratio=1.0)
        else:
            codec = self._codec(original, progress)
            distortion = self._encode(codec, original, progress)
        clipped = self._stored("clipped")[:]
        self._about |= {
            "complete": True,
            "codec": {"description": codec.describe(), "shared": sorted(codec.shared)},
            "payload_bytes": int(codec.payload_bytes),
            "shared_bytes": int(codec.shared_bytes),
            "clipped": int(clipped.sum()),
            "distortion": distortion.to_json(),
        }
        write_group(self.folder, {"luxel": self._about})
        self._tidy()

    def _begin(self) -> dict[str, Any]:
        particles = self.scene.particles
        found = fingerprint(particles)
        stored = read_attributes(self.folder)
        if stored is not None:
            about: dict[str, Any] = dict(stored["luxel"])
            if different := differences(about["fingerprint"], found):
                what = " and ".join(text.partition(" is ")[0] for text in different)
                raise InputError(
                    f"{self.store}: frame {self.folder.name} was begun with other particles (their {what} differ)"
                    " — give the same file and --radius, add --overwrite to replace the store, or give another -o"
                )
            return about
        chunk = _ROWS
        write_array(
            self.folder / "positions", particles.local, chunk, {"relative_to": particles.origin.tolist()}
        )
        write_array(self.folder / "radii", particles.radii, chunk)
        write_group(self.folder / "scalars")
        for k, (name, values) in enumerate(particles.scalars.items()):
            write_array(self.folder / "scalars" / f"{k:03d}", values, chunk, {"name": name})
        about = {
            "complete": False,
            "particles": particles_json(particles),
            "scalars": list(particles.scalars),
            "fingerprint": found,
            "key": light_key(self.scene, self.settings.spec),
            "scale": float(luminance_scale(self.scene)),
            "encoding": self.settings.spec.encoding,
        }
        write_group(self.folder, {"luxel": about})  # last: it says that the rest is there
        return about

    def _codec(self, original: Codes, progress: Progress | None) -> codecs.Codec:
        """Train, or take up the codec that was trained before the process ended."""
        folder, choice = self.folder / "codec", self.settings.codec
        stored = read_attributes(folder)
        if stored is not None:
            shared = {name: self._stored(f"codec/{name}")[:] for name in stored["shared"]}
            return codecs.restore(stored["description"], shared)
        codec = codecs.train(
            choice.kind,
            original,
            **choice.options,
            seed=self.settings.spec.seed,
            progress=None if progress is None else lambda done, total: progress("training", done, total),
        )
        for name, values in codec.shared.items():
            write_array(folder / name, values, max(1, len(values)))
        # Last: it says that the rest is there.
        write_group(folder, {"description": codec.describe(), "shared": sorted(codec.shared)})
        return codec

    def _encode(self, codec: codecs.Codec, original: Codes, progress: Progress | None) -> Distortion:
        """Write the payload of all chunks; return how far what comes back is from `original`."""
        payload = ArrayFiles(
            self.folder / "payload", (self.count, codec.payload_bytes), np.uint8, self.settings.chunk
        )
        spec = self.settings.spec
        total = DistortionSum(
            spec.texels, decoding_table(self._about["scale"], self._about["encoding"]), spec.mapping
        )
        for k in range(payload.count):
            rows = payload.rows(k)
            codes = original[rows]
            encoded = codec.encode(codes)
            if not payload.has(k):
                payload.write(k, encoded)
            total.add(codes, codec.decode(encoded))
            if progress is not None:
                progress("encoding", rows.stop, self.count)
        return total.result(self.count * codec.payload_bytes + codec.shared_bytes)

    def _tidy(self) -> None:
        if not self.settings.keep_raw:
            remove_tree(self.folder / "raw")

    def _stored(self, name: str) -> StoredArray:
        import zarr

        return StoredArray(zarr.open_group(self.folder, mode="r"), name, str(self.folder))


class _Lit:
    dtype = np.dtype(np.uint8)

    def __init__(self, stored: StoredArray, count: int, texels: int) -> None:
        self._stored, self.shape = stored, (count, texels, texels)

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, rows: slice) -> NDArray[np.uint8]:
        return self._stored[rows].reshape(-1, *self.shape[1:])


def read_attributes(folder: Path) -> Mapping[str, Any] | None:
    """Return the attributes of a group on disk, or None if it is not there.

    Raises
    ------
    FormatError
        If its metadata cannot be understood.
    """
    path = folder / "zarr.json"
    try:
        found = json.loads(path.read_bytes())
        attributes: Mapping[str, Any] = found["attributes"]
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FormatError(
            path, f"cannot be understood: {error}", remedy="add --overwrite to begin anew"
        ) from error
    return attributes
