"""Messages between the viewer's server and its page: what they say. How they become bytes is in ``wire``.

Positions, radii and eyes travel in normalised units (:class:`luxel.trace.spheres.SphereSet`). The version is in the name of the WebSocket subprotocol: what changes the meaning of a message changes the name.
"""

from __future__ import annotations

from typing import get_args

from luxel.app.message import Given, Message, PageMessage
from luxel.app.page_messages import (
    ColormapRequest,
    Compare,
    Confirm,
    GeometryRequest,
    Hello,
    Inspect,
    LoadView,
    Report,
    ScalarRequest,
    SetFrame,
    SetLight,
    SetView,
    Sighted,
)
from luxel.app.server_messages import (
    BesideState,
    Coarse,
    CodecState,
    Colormap,
    Error,
    Geometry,
    LightState,
    ParticleState,
    Payload,
    Scalar,
    SceneState,
    Status,
    Tiles,
    ViewState,
)
from luxel.app.stream_messages import (
    CancelScreenshot,
    ConfirmFrame,
    ConfirmParts,
    DrawBy,
    PickAt,
    Picked,
    ScreenshotPart,
    ScreenshotState,
    StopStream,
    Stream,
    StreamedFrame,
    TakeScreenshot,
)
from luxel.app.wire import unpack
from luxel.errors import ProtocolError

__all__ = [
    "CLIENT_BYTES_MAX",
    "SUBPROTOCOL",
    "BesideState",
    "CancelScreenshot",
    "ClientMessage",
    "Coarse",
    "CodecState",
    "Colormap",
    "ColormapRequest",
    "Compare",
    "Confirm",
    "ConfirmFrame",
    "ConfirmParts",
    "DrawBy",
    "Error",
    "Geometry",
    "GeometryRequest",
    "Hello",
    "Inspect",
    "LightState",
    "LoadView",
    "Message",
    "PageMessage",
    "ParticleState",
    "Payload",
    "PickAt",
    "Picked",
    "Report",
    "Scalar",
    "ScalarRequest",
    "SceneState",
    "ScreenshotPart",
    "ScreenshotState",
    "SetFrame",
    "SetLight",
    "SetView",
    "Sighted",
    "Status",
    "StopStream",
    "Stream",
    "StreamedFrame",
    "TakeScreenshot",
    "Tiles",
    "ViewState",
    "decode",
    "decode_client",
]

SUBPROTOCOL = "luxel.v5"
#: Longest message that a client may send: the ids of two million visible particles.
CLIENT_BYTES_MAX = 8 << 20

ClientMessage = (
    Hello
    | Sighted
    | Confirm
    | SetLight
    | SetFrame
    | ScalarRequest
    | GeometryRequest
    | ColormapRequest
    | Report
    | SetView
    | LoadView
    | Inspect
    | Compare
    | DrawBy
    | Stream
    | StopStream
    | ConfirmFrame
    | PickAt
    | TakeScreenshot
    | CancelScreenshot
    | ConfirmParts
)
_PAGE_KINDS: dict[int, type[PageMessage]] = {each.kind: each for each in get_args(ClientMessage)}
_SERVER_KINDS: dict[int, type[Message]] = {
    each.kind: each
    for each in (
        SceneState,
        LightState,
        BesideState,
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
        StreamedFrame,
        Picked,
        ScreenshotState,
        ScreenshotPart,
    )
}


def decode_client(data: bytes) -> PageMessage:
    """Read a message from a page, which may be anything at all.

    Raises
    ------
    ProtocolError
        For anything that is not a well-formed message with sensible values.
    """
    if len(data) > CLIENT_BYTES_MAX:
        raise ProtocolError(f"message of {len(data)} bytes; at most {CLIENT_BYTES_MAX} are taken")
    kind, head, arrays = unpack(data)
    if kind not in _PAGE_KINDS:
        raise ProtocolError(f"message of unknown kind {kind}")
    return _PAGE_KINDS[kind].read(Given(head, arrays))


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
