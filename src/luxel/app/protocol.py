"""Messages between the viewer's server and its page: what they say. How they become bytes is in ``wire``.

Positions, radii and eyes travel in normalised units (:class:`luxel.trace.spheres.SphereSet`). The version is in the name of the WebSocket subprotocol: what changes the meaning of a message changes the name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from luxel.app.wire import pack, unpack
from luxel.errors import ProtocolError

__all__ = [
    "CLIENT_BYTES_MAX",
    "SUBPROTOCOL",
    "ClientMessage",
    "Coarse",
    "CodecState",
    "Colormap",
    "ColormapRequest",
    "Confirm",
    "Error",
    "Geometry",
    "Hello",
    "Inspect",
    "LightState",
    "LoadView",
    "Message",
    "ParticleState",
    "Payload",
    "Report",
    "Scalar",
    "ScalarRequest",
    "SceneState",
    "SetFrame",
    "SetLight",
    "SetView",
    "Sighted",
    "Status",
    "Tiles",
    "ViewState",
    "decode",
    "decode_client",
]

SUBPROTOCOL = "luxel.v3"
#: Longest message that a client may send: the ids of two million visible particles.
CLIENT_BYTES_MAX = 8 << 20
_TEXT_MAX = 4000
_NAME_MAX = 500
_LIST_MAX = 64


@dataclass(frozen=True, eq=False)
class Message:
    """Base of all messages: fields that are arrays travel raw, the others as JSON."""

    kind: ClassVar[int]

    def encode(self) -> bytes:
        """Return the message as bytes."""
        head: dict[str, Any] = {}
        arrays: dict[str, NDArray[Any]] = {}
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                arrays[field.name] = value
            else:
                head[field.name] = value
        return pack(self.kind, head, arrays)


# From the page ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Hello(Message):
    """First message of a page: what draws there."""

    kind: ClassVar[int] = 1
    renderer: str = ""


@dataclass(frozen=True, eq=False)
class Sighted(Message):
    """Visible particles that have no texture of this light yet.

    Parameters
    ----------
    key
        The light that the page shows; a late message about another light is ignored.
    ids
        (K,) int32.
    eye
        (3,) where they are seen from, normalised units.
    """

    kind: ClassVar[int] = 2
    key: str
    ids: NDArray[np.int32]
    eye: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Confirm(Message):
    """The page has taken in so many messages since it connected.

    Parameters
    ----------
    batches, coarse, parts
        Of tiles, of first light, and of baked textures.
    """

    kind: ClassVar[int] = 3
    batches: int
    coarse: int
    parts: int = 0


@dataclass(frozen=True, eq=False)
class SetLight(Message):
    """A change of light; None leaves a part as it is.

    Parameters
    ----------
    model, albedo
        As of :class:`luxel.Scene`.
    sky
        Level.
    sun
        Azimuth and elevation in degrees, level, angular diameter in degrees.
    up
        The axis that azimuth and elevation, and a sky's gradient, go by; None means that of the session's view.
    hide
        As of :class:`luxel.Scene`, in JSON.
    radius_scale
        Factor on all radii.
    """

    kind: ClassVar[int] = 4
    model: str | None = None
    albedo: float | None = None
    sky: float | None = None
    sun: tuple[float, float, float, float] | None = None
    up: str | None = None
    hide: Sequence[Any] | None = None
    radius_scale: float | None = None


@dataclass(frozen=True, eq=False)
class SetFrame(Message):
    """Show another time step."""

    kind: ClassVar[int] = 5
    frame: int


@dataclass(frozen=True, eq=False)
class ScalarRequest(Message):
    """Send the values of a scalar."""

    kind: ClassVar[int] = 6
    name: str


@dataclass(frozen=True, eq=False)
class ColormapRequest(Message):
    """Send the colours of a map."""

    kind: ClassVar[int] = 7
    name: str


@dataclass(frozen=True, eq=False)
class Report(Message):
    """Something that the server's log should know: a shader that fails to compile, a lost context."""

    kind: ClassVar[int] = 8
    text: str


@dataclass(frozen=True, eq=False)
class SetView(Message):
    """How the page looks at the particles now, as of ``View.to_json()``, in file units."""

    kind: ClassVar[int] = 40
    view: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class LoadView(Message):
    """Show a saved view, as of ``SavedView.to_json()``; the server answers with a `ViewState`."""

    kind: ClassVar[int] = 41
    saved: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Inspect(Message):
    """Tell everything about one particle."""

    kind: ClassVar[int] = 42
    id: int


# From the server ----------------------------------------------------------------------------------------------------


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
    """Values of one scalar, (N,) float32, and their range, twice: for linear and for logarithmic scales.

    `whole` tells that the values are whole numbers, which qualitative colour maps show as codes.
    """

    kind: ClassVar[int] = 19
    epoch: int
    name: str
    values: NDArray[np.float32]
    range: tuple[float, float]
    log_range: tuple[float, float]
    whole: bool


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
    """

    kind: ClassVar[int] = 21
    key: str
    ids: NDArray[np.int32]
    codes: NDArray[np.uint8]
    estimate: NDArray[np.uint8]


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
    position, radius
        In file units.
    values
        Name and value of each scalar; components of vectors in one.
    """

    kind: ClassVar[int] = 51
    epoch: int
    id: int
    position: str
    radius: str
    values: Sequence[tuple[str, str]]


ClientMessage = (
    Hello
    | Sighted
    | Confirm
    | SetLight
    | SetFrame
    | ScalarRequest
    | ColormapRequest
    | Report
    | SetView
    | LoadView
    | Inspect
)
_SERVER_KINDS: dict[int, type[Message]] = {
    each.kind: each
    for each in (
        SceneState,
        LightState,
        Geometry,
        Scalar,
        Colormap,
        Tiles,
        Status,
        Error,
        Coarse,
        CodecState,
        Payload,
        ViewState,
        ParticleState,
    )
}


def decode_client(data: bytes) -> ClientMessage:
    """Read a message from a page, which may be anything at all.

    Raises
    ------
    ProtocolError
        For anything that is not a well-formed message with sensible values.
    """
    if len(data) > CLIENT_BYTES_MAX:
        raise ProtocolError(f"message of {len(data)} bytes; at most {CLIENT_BYTES_MAX} are taken")
    kind, head, arrays = unpack(data)
    match kind:
        case Hello.kind:
            return Hello(_text(head, "renderer", _NAME_MAX))
        case Sighted.kind:
            eye = _numbers(head, "eye", 3)
            return Sighted(_text(head, "key", 128), _ids(arrays), (eye[0], eye[1], eye[2]))
        case Confirm.kind:
            return Confirm(*(_whole(head, name) for name in ("batches", "coarse", "parts")))
        case SetLight.kind:
            sun = None if head.get("sun") is None else _numbers(head, "sun", 4)
            return SetLight(
                None if head.get("model") is None else _text(head, "model", 64),
                None if head.get("albedo") is None else _number(head, "albedo"),
                None if head.get("sky") is None else _number(head, "sky"),
                None if sun is None else (sun[0], sun[1], sun[2], sun[3]),
                None if head.get("up") is None else _text(head, "up", 8),
                None if head.get("hide") is None else _list(head, "hide"),
                None if head.get("radius_scale") is None else _number(head, "radius_scale"),
            )
        case SetFrame.kind:
            return SetFrame(_whole(head, "frame"))
        case ScalarRequest.kind:
            return ScalarRequest(_text(head, "name", _NAME_MAX))
        case ColormapRequest.kind:
            return ColormapRequest(_text(head, "name", _NAME_MAX))
        case Report.kind:
            return Report(_text(head, "text", _TEXT_MAX))
        case SetView.kind:
            return SetView(_object(head, "view"))
        case LoadView.kind:
            return LoadView(_object(head, "saved"))
        case Inspect.kind:
            return Inspect(_whole(head, "id"))
    raise ProtocolError(f"message of unknown kind {kind}")


def decode(data: bytes) -> Message:
    """Read a message from the server (what the page does in JavaScript; here for Python clients and tests).

    Raises
    ------
    ProtocolError
        For a malformed message.
    """
    kind, head, arrays = unpack(data)
    if kind not in _SERVER_KINDS:
        raise ProtocolError(f"message of unknown kind {kind}")
    try:
        return _SERVER_KINDS[kind](**head, **arrays)
    except TypeError as error:
        raise ProtocolError(f"fields of a message do not fit its kind: {error}") from None


def _number(head: Mapping[str, Any], name: str) -> float:
    return _checked_number(head.get(name), name)


def _numbers(head: Mapping[str, Any], name: str, count: int) -> list[float]:
    values = head.get(name)
    if not isinstance(values, list) or len(values) != count:
        raise ProtocolError(f"{name!r} must be {count} numbers")
    return [_checked_number(value, name) for value in values]


def _checked_number(value: object, name: str) -> float:
    # Whole numbers of hundreds of digits do not fit a float; a page has no use for large ones.
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e30:
        raise ProtocolError(f"{name!r} must be a number")
    return float(value)


def _whole(head: Mapping[str, Any], name: str) -> int:
    value = head.get(name)
    if type(value) is not int or not 0 <= value < 1 << 53:
        raise ProtocolError(f"{name!r} must be a whole number >= 0")
    return value


def _text(head: Mapping[str, Any], name: str, length_max: int) -> str:
    value = head.get(name)
    if not isinstance(value, str) or len(value) > length_max:
        raise ProtocolError(f"{name!r} must be a text of at most {length_max} characters")
    return value


def _object(head: Mapping[str, Any], name: str) -> dict[str, Any]:
    value = head.get(name)
    if not isinstance(value, dict):
        raise ProtocolError(f"{name!r} must be a JSON object")
    return value


def _list(head: Mapping[str, Any], name: str) -> list[Any]:
    value = head.get(name)
    if not isinstance(value, list) or len(value) > _LIST_MAX:
        raise ProtocolError(f"{name!r} must be a list of at most {_LIST_MAX}")
    return value


def _ids(arrays: Mapping[str, NDArray[Any]]) -> NDArray[np.int32]:
    ids = arrays.get("ids")
    if ids is None or ids.dtype != np.int32 or ids.ndim != 1:
        raise ProtocolError("'ids' must be a flat array of int32")
    return ids
