"""What a store says about itself, as JSON: scene, spec and particles there and back, and how two bakes differ."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxel.errors import InputError
from luxel.particles import Cell, Particles
from luxel.scene.lights import Light, Up, light_from_json, light_json
from luxel.scene.scene import Model, Scene
from luxel.textures.spec import TextureSpec

__all__ = [
    "FORMAT",
    "VERSION",
    "BakeSettings",
    "CodecChoice",
    "differences",
    "fingerprint",
    "particles_json",
    "particles_options",
]

FORMAT = "luxel baked textures"
#: Of the store's layout; a reader refuses any other.
VERSION = 1

_PAPER_RATIO = 4.0  # figure 3


@dataclass(frozen=True)
class CodecChoice:
    """Which codec a bake stores its textures with, and how hard that is to press; if nothing is given, to a fourth.

    Parameters
    ----------
    kind
        ``"raw"`` stores every texel; other kinds are those of ``luxel.textures.codecs``.
    ratio
        Raw bytes over compressed ones.
    error
        Root mean squared error to stay below, in codes.
    codewords, components
        Sizes of a codebook and of a basis.
    """

    kind: str = "raw"
    ratio: float | None = None
    error: float | None = None
    codewords: int | None = None
    components: int | None = None

    def __post_init__(self) -> None:
        given = [f.name for f in fields(self) if f.name != "kind" and getattr(self, f.name) is not None]
        for name in given:
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InputError(f"{name} must be a positive number, got {value!r}")
        if self.kind != "raw" and not given:
            object.__setattr__(self, "ratio", _PAPER_RATIO)
        if self.kind == "raw" and given:
            raise InputError(
                f"codec raw keeps every texel: {', '.join(given)} needs another codec, such as vq"
            )

    @property
    def options(self) -> dict[str, Any]:
        """What is given besides the kind, as keyword arguments of ``codecs.train``."""
        return {name: value for name, value in asdict(self).items() if name != "kind" and value is not None}


@dataclass(frozen=True)
class BakeSettings:
    """All that a bake depends on but the particles: two bakes may share a store only if these are equal.

    Parameters
    ----------
    lights, model, albedo, ao_distance, periodic, periodic_images
        See :class:`luxel.Scene`.
    up
        Which axis points up in pictures, unless they say otherwise.
    spec
        How textures are made.
    codec
        How they are stored.
    chunk
        Particles in a chunk.
    keep_raw
        Whether raw textures stay beside compressed ones.
    frames
        Which time steps of the series.
    """

    lights: tuple[Light, ...]
    model: Model
    albedo: float
    ao_distance: float | None
    periodic: str
    periodic_images: int
    spec: TextureSpec
    frames: tuple[int, ...] = (0,)
    up: Up = "z"
    codec: CodecChoice = field(default_factory=CodecChoice)
    chunk: int = 4096
    keep_raw: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.chunk, int) or not 1 <= self.chunk <= 1 << 20:
            raise InputError(f"chunk must be 1..{1 << 20} particles, got {self.chunk!r}")

    @classmethod
    def of(cls, scene: Scene, spec: TextureSpec, **more: Any) -> BakeSettings:
        """Return the settings of a scene.

        Raises
        ------
        InputError
            If it hides particles: a store has a texture for every one.
        """
        if scene.conditions:
            raise InputError(
                "a store holds textures of all particles, and this scene hides some"
                " — leave hide out, or bake a file without them"
            )
        return cls(
            scene.sources,
            scene.model,
            float(scene.albedo),
            None if scene.ao_distance is None else float(scene.ao_distance),
            scene.axes,
            scene.periodic_images,
            spec,
            **more,
        )

    def scene(self, particles: Particles) -> Scene:
        """Return these particles under this light."""
        return Scene(
            particles,
            self.lights,
            self.model,
            self.albedo,
            self.ao_distance,
            self.periodic,
            self.periodic_images,
        )

    def to_json(self) -> dict[str, Any]:
        """Return plain values that :meth:`from_json` understands."""
        return {
            "model": self.model,
            "lights": [light_json(light) for light in self.lights],
            "albedo": self.albedo,
            "ao_distance": self.ao_distance,
            "periodic": self.periodic,
            "periodic_images": self.periodic_images,
            "up": self.up,
            "spec": asdict(self.spec),
            "codec": asdict(self.codec),
            "chunk": self.chunk,
            "keep_raw": self.keep_raw,
            "frames": list(self.frames),
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> BakeSettings:
        """Inverse of :meth:`to_json`; whatever is wrong with `data` is a KeyError, TypeError or ValueError."""
        values = dict(data)
        values["lights"] = tuple(light_from_json(light) for light in values["lights"])
        values["spec"] = TextureSpec(**values["spec"])
        values["codec"] = CodecChoice(**values["codec"])
        values["frames"] = tuple(int(frame) for frame in values["frames"])
        return cls(**values)


def differences(stored: Mapping[str, Any], given: Mapping[str, Any], prefix: str = "") -> list[str]:
    """Say in words where two JSON objects differ: ``"spec.samples is 4 in the store and 9 here"``."""
    found: list[str] = []
    for name in [*stored, *(name for name in given if name not in stored)]:
        a, b = stored.get(name), given.get(name)
        if isinstance(a, Mapping) and isinstance(b, Mapping):
            found += differences(a, b, f"{prefix}{name}.")
        elif json.dumps(a) != json.dumps(b):
            found.append(f"{prefix}{name} is {json.dumps(a)} in the store and {json.dumps(b)} here")
    return found


def fingerprint(particles: Particles) -> dict[str, str]:
    """Hex digests of what the particles hold: their geometry, and everything else."""
    geometry, rest = hashlib.blake2b(digest_size=16), hashlib.blake2b(digest_size=16)
    for array in (particles.origin, particles.local, particles.radii):
        _digest(geometry, array)
    for name, values in particles.scalars.items():
        rest.update(repr(name).encode())
        _digest(rest, values)
    rest.update(json.dumps(particles_json(particles), sort_keys=True).encode())
    return {"positions and radii": geometry.hexdigest(), "scalars, cell and time": rest.hexdigest()}


def particles_json(particles: Particles) -> dict[str, Any]:
    """Return all of the particles that is not an array a particle long."""
    cell = particles.cell
    time = particles.time
    return {
        "count": len(particles),
        "origin": particles.origin.tolist(),
        "time": time if time is not None and math.isfinite(time) else None,
        "radii_source": particles.radii_source,
        "categories": {name: list(labels) for name, labels in particles.categories.items()},
        "cell": None
        if cell is None
        else {
            "vectors": cell.vectors.tolist(),
            "origin": cell.origin.tolist(),
            "periodic": [bool(flag) for flag in cell.periodic],
        },
    }


def particles_options(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keyword arguments of :meth:`Particles.from_local` that :func:`particles_json` holds."""
    cell = data["cell"]
    return {
        "origin": data["origin"],
        "time": data["time"],
        "radii_source": data["radii_source"],
        "categories": {name: tuple(labels) for name, labels in data["categories"].items()},
        "cell": None if cell is None else Cell(cell["vectors"], cell["origin"], tuple(cell["periodic"])),
    }


def _digest(digest: Any, array: NDArray[Any]) -> None:
    same = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))  # whatever the file's byte order
    digest.update(f"{same.dtype.str} {same.shape}".encode())
    digest.update(same.data)
