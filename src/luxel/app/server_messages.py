"""What the viewer's server says to its pages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from luxel.app.message import Message

__all__ = [
    "BesideState",
    "Coarse",
    "CodecState",
    "Colormap",
    "Error",
    "Geometry",
    "LightState",
    "ParticleState",
    "Payload",
    "Scalar",
    "SceneState",
    "Status",
    "Tiles",
    "ViewState",
]


@dataclass(frozen=True, eq=False)
class SceneState(Message):
    """What there is to see; the geometry follows in parts.

    Parameters
    ----------
    epoch
        Counts data sets and frames, so that parts of an old one are told apart.
    count
        Particles.
    center, unit
        file units = center + unit · normalised units.
    bounds
        (2, 3) in normalised units.
    texels, mapping
        Rows and columns of a tile, and how they map to directions, see :class:`luxel.TextureSpec`.
    scalars
        For each scalar ``{"name": ..., "labels": [...] or None, "colors": whether its components can be shown as colours}``.
    view
        As of ``View.to_json()``, in file units.
    light_fixed
        Whether the light is baked in, so that nobody can change it.
    streamed
        The server draws: no particles follow, and scalars come without values.
    first
        How many particles a page should take in at once; 0 for all, which follow. Else it asks for them, and for values of scalars, by
        parts: so many, and then as many more as it can take. Their numbers are not those of the file: whatever has been
        asked for from 0 on is spread evenly over the data. All ids in messages are these numbers.
    """

    kind: ClassVar[int] = 16
    epoch: int
    title: str
    count: int
    center: tuple[float, ...]
    unit: float
    bounds: tuple[tuple[float, ...], ...]
    texels: int
    mapping: str
    frame: int
    frame_count: int
    time: float | None
    scalars: tuple[Mapping[str, Any], ...]
    colormaps: tuple[str, ...]
    models: tuple[str, ...]
    view: Mapping[str, Any]
    light_fixed: bool = False
    notice: str = ""
    streamed: bool = False
    first: int = 0


@dataclass(frozen=True, eq=False)
class LightState(Message):
    """The light of the scene.

    Parameters
    ----------
    key
        Names it; tiles carry the same.
    white
        Luminance that the tone curve displays as white.
    decoding
        (256,) float32: luminance of each code of a tile.
    sky
        (5,) level, ground level, axis.
    suns
        (S, 6) direction, level, sine and cosine of half the angular diameter.
    globes
        (S, 5) centre, radius, level.
    quads
        (S, 14) corner, two edges, normal, area, level.
    lighting
        All of it as of ``Lighting.to_json()``, in file units.
    """

    kind: ClassVar[int] = 17
    key: str
    model: str
    albedo: float
    white: float
    decoding: NDArray[np.float32]
    sky: NDArray[np.float32]
    suns: NDArray[np.float32]
    globes: NDArray[np.float32]
    quads: NDArray[np.float32]
    lighting: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class BesideState(LightState):
    """The light that is compared with; sent to pages that asked for one."""

    kind: ClassVar[int] = 61


@dataclass(frozen=True, eq=False)
class Geometry(Message):
    """A part of the particles: those from `start` on.

    Parameters
    ----------
    positions, radii
        (K, 3) and (K,) float32 in normalised units.
    """

    kind: ClassVar[int] = 18
    epoch: int
    start: int
    positions: NDArray[np.float32]
    radii: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Scalar(Message):
    """Values of one scalar, (K,) float32 of particles from `start` on, and the range of all, twice: for linear and for logarithmic scales.

    `whole` tells that the values are whole numbers, which qualitative colour maps show as codes; `missing`, that some
    are NaN. There are no values where the server draws.
    """

    kind: ClassVar[int] = 19
    epoch: int
    name: str
    values: NDArray[np.float32]
    range: tuple[float, float]
    log_range: tuple[float, float]
    whole: bool
    missing: bool
    start: int = 0


@dataclass(frozen=True, eq=False)
class Colormap(Message):
    """Rows of a colour map, (n, 3) uint8 sRGB."""

    kind: ClassVar[int] = 20
    name: str
    lut: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Tiles(Message):
    """Luminance textures under the light `key`.

    Parameters
    ----------
    ids
        (K,) int32.
    codes
        (K, texels, texels) uint8.
    estimate
        (K,) uint8: 1 for those that will be replaced by better ones if the page goes on asking.
    beside
        Whether this is the light compared with.
    """

    kind: ClassVar[int] = 21
    key: str
    ids: NDArray[np.int32]
    codes: NDArray[np.uint8]
    estimate: NDArray[np.uint8]
    beside: bool = False


@dataclass(frozen=True, eq=False)
class Status(Message):
    """How far the light is."""

    kind: ClassVar[int] = 22
    key: str
    ready: int
    queued: int
    baking: int
    evicted: int
    textures_per_s: float
    error: str | None = None


@dataclass(frozen=True, eq=False)
class Error(Message):
    """Something went wrong that the user can do something about; the connection stays."""

    kind: ClassVar[int] = 23
    text: str


@dataclass(frozen=True, eq=False)
class Coarse(Message):
    """First light under the light `key`: what the page shows of particles whose texture has not come yet.

    Parameters
    ----------
    ids
        (K,) int32; each is sent once to a page and light.
    records
        (K, 4) float16 (c0, c1, c2, c3): luminance towards the unit normal n is the last entry of the light's
        `decoding` times max(0, c0 + c1 nx + c2 ny + c3 nz); c0 >= 0. Half precision is 11 bits, more than tiles
        have, and eight bytes a particle is what a page uploads as it is.
    """

    kind: ClassVar[int] = 24
    key: str
    ids: NDArray[np.int32]
    records: NDArray[np.float16]

    @classmethod
    def of(cls, key: str, ids: NDArray[np.int32], records: NDArray[np.float32], scale: float) -> Coarse:
        """Pack (K, 4) records of luminance, where `scale` is the luminance of code 255."""
        half = np.finfo(np.float16).max
        return cls(key, ids, np.clip(records / np.float32(scale), -half, half).astype(np.float16))


@dataclass(frozen=True, eq=False)
class CodecState(Message):
    """Baked textures of the light `key` follow, as they are stored: the page decodes them and asks for no light.

    Parameters
    ----------
    description
        What the codec says of itself.
    particles, payload_bytes
        How many, and bytes of a record; particle k has record k.
    part
        Records in a message; the last has what is left.
    decoding
        (256,) float32: luminance of each code.
    codebook, offset, basis, center, count, scale, width, levels
        What the codec's textures share, see :mod:`luxel.textures.codecs`; None where it has no such array.
    """

    kind: ClassVar[int] = 32
    key: str
    description: Mapping[str, Any]
    particles: int
    payload_bytes: int
    part: int
    decoding: NDArray[np.float32]
    codebook: NDArray[np.uint8] | None = None
    offset: NDArray[np.int32] | None = None
    basis: NDArray[Any] | None = None
    center: NDArray[np.int16] | None = None
    count: NDArray[np.uint16] | None = None
    scale: NDArray[np.float32] | None = None
    width: NDArray[np.uint8] | None = None
    levels: NDArray[np.float32] | None = None


@dataclass(frozen=True, eq=False)
class Payload(Message):
    """A part of the baked textures of the light `key`: (K, payload_bytes) uint8 records from particle `start` on."""

    kind: ClassVar[int] = 33
    key: str
    start: int
    records: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class ViewState(Message):
    """Look at the particles like this from now on: as of ``View.to_json()``, in file units."""

    kind: ClassVar[int] = 50
    view: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class ParticleState(Message):
    """Everything about one particle, as texts for people.

    Parameters
    ----------
    number
        Its number in the file.
    position, radius
        In file units.
    values
        Name and value of each scalar; components of vectors in one.
    """

    kind: ClassVar[int] = 51
    epoch: int
    id: int
    number: int
    position: str
    radius: str
    values: Sequence[tuple[str, str]]
