"""What page and server say to each other about pictures that the server draws: streamed frames and screenshots."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from luxel.app.message import Given, Message, PageMessage, drawer
from luxel.errors import ProtocolError

__all__ = [
    "SCREENSHOT_SIDE_MAX",
    "STREAM_PIXELS_MAX",
    "STREAM_SIDE_MAX",
    "CancelScreenshot",
    "ConfirmFrame",
    "ConfirmParts",
    "DrawBy",
    "PickAt",
    "Picked",
    "ScreenshotPart",
    "ScreenshotState",
    "StopStream",
    "Stream",
    "StreamedFrame",
    "TakeScreenshot",
]

#: Largest streamed picture: a screen of 3840 x 2400, whichever way it is turned or cut.
STREAM_SIDE_MAX = 8192
STREAM_PIXELS_MAX = 3840 * 2400
#: Largest width and height of a screenshot.
SCREENSHOT_SIDE_MAX = 8192
_CONDITIONS_MAX = 64  # each takes a look at all particles

# From the page ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class DrawBy(PageMessage):
    """Who draws from now on: ``"browser"``, which needs positions and textures, or ``"server"``."""

    kind: ClassVar[int] = 70
    by: str

    @classmethod
    def read(cls, given: Given) -> Self:
        """See :meth:`PageMessage.read`."""
        return cls(drawer(given))


@dataclass(frozen=True, eq=False)
class Stream(PageMessage):
    """Send pictures of this view from now on, until another such message.

    Parameters
    ----------
    view
        As of ``View.to_json()``, in file units, with a camera.
    width, height
        In pixels, at rest.
    moving
        More of the kind will follow soon: rather a quick picture than a good one.
    grading
        See :func:`luxel.picture.drawing.make_tone`.
    wish
        Names the message, for the page; pictures say which one they answer.
    beside
        Draw the light that is compared with too; where light is baked in, that is none.
    """

    kind: ClassVar[int] = 71
    view: Mapping[str, Any]
    width: int
    height: int
    moving: bool = False
    grading: tuple[float, float] = (1.0, 1.0)
    wish: int = 0
    beside: bool = False

    @classmethod
    def read(cls, given: Given) -> Self:
        """See :meth:`PageMessage.read`."""
        width, height = _stream_size(given)
        top, bottom = given.numbers("grading", 2)
        if min(top, bottom) < 0:
            raise ProtocolError("'grading' must be two numbers >= 0")
        how = given.truth("moving"), (top, bottom), given.whole("wish"), given.truth("beside")
        return cls(_view(given), width, height, *how)


@dataclass(frozen=True, eq=False)
class StopStream(PageMessage):
    """Nobody looks at the page now: send no pictures."""

    kind: ClassVar[int] = 72


@dataclass(frozen=True, eq=False)
class ConfirmFrame(PageMessage):
    """The page shows frame number `frame`, of one light; what was sent before it counts as taken in too."""

    kind: ClassVar[int] = 73
    frame: int
    beside: bool = False

    @classmethod
    def read(cls, given: Given) -> Self:
        """See :meth:`PageMessage.read`."""
        return cls(given.whole("frame"), given.truth("beside"))


@dataclass(frozen=True, eq=False)
class PickAt(PageMessage):
    """Tell which particle is at a point of a picture.

    Parameters
    ----------
    view, width, height
        Of the picture, as of `Stream`.
    x, y
        In [0, 1]: from the left and from the top.
    """

    kind: ClassVar[int] = 74
    view: Mapping[str, Any]
    width: int
    height: int
    x: float
    y: float

    @classmethod
    def read(cls, given: Given) -> Self:
        """See :meth:`PageMessage.read`."""
        x, y = given.number("x"), given.number("y")
        if not (0 <= x <= 1 and 0 <= y <= 1):
            raise ProtocolError("'x' and 'y' must lie in 0..1")
        return cls(_view(given), *_stream_size(given), x, y)


@dataclass(frozen=True, eq=False)
class TakeScreenshot(PageMessage):
    """Draw a view as PNG, under the light that is there now.

    Parameters
    ----------
    view
        As of ``View.to_json()``, in file units.
    width, height
        In pixels.
    """

    kind: ClassVar[int] = 75
    view: Mapping[str, Any]
    width: int
    height: int

    @classmethod
    def read(cls, given: Given) -> Self:
        """See :meth:`PageMessage.read`."""
        width, height = (given.whole(side, 1, SCREENSHOT_SIDE_MAX) for side in ("width", "height"))
        return cls(_view(given), width, height)


@dataclass(frozen=True, eq=False)
class CancelScreenshot(PageMessage):
    """The page does not want its screenshot any more."""

    kind: ClassVar[int] = 76


@dataclass(frozen=True, eq=False)
class ConfirmParts(PageMessage):
    """The page has taken in so many parts of screenshots since it connected."""

    kind: ClassVar[int] = 77
    parts: int

    @classmethod
    def read(cls, given: Given) -> Self:
        """See :meth:`PageMessage.read`."""
        return cls(given.whole("parts"))


def _view(given: Given) -> dict[str, Any]:
    view = given.object("view")
    hide = view.get("hide")
    if isinstance(hide, list) and len(hide) > _CONDITIONS_MAX:
        raise ProtocolError(f"a view hides by at most {_CONDITIONS_MAX} conditions")
    return view


def _stream_size(given: Given) -> tuple[int, int]:
    width, height = (given.whole(side, 1, STREAM_SIDE_MAX) for side in ("width", "height"))
    if width * height > STREAM_PIXELS_MAX:
        raise ProtocolError(f"pictures have at most {STREAM_PIXELS_MAX} pixels, not {width} x {height}")
    return width, height


# From the server ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class StreamedFrame(Message):
    """A picture.

    Parameters
    ----------
    frame
        Counts the pictures sent to this page.
    wish
        Which `Stream` it answers.
    key
        Of its light; it may be about to change.
    width, height
        In pixels; smaller than asked for while the view moves.
    image
        (K,) uint8: a JPEG file, or PNG if `lossless`; none where the picture is that of the frame before.
    rays
        Rays a pixel.
    final
        The next picture would be the same: the view rests, and no better light will come.
    visible, ready, coarse, stale
        Particles in sight, and how many of them show a texture, first light, and a texture of the light before.
    beside
        Whether this is the light that is compared with. Its frames are counted apart.
    """

    kind: ClassVar[int] = 80
    frame: int
    wish: int
    key: str
    width: int
    height: int
    image: NDArray[np.uint8]
    lossless: bool
    rays: int
    final: bool
    visible: int
    ready: int
    coarse: int
    stale: int
    beside: bool = False


@dataclass(frozen=True, eq=False)
class Picked(Message):
    """Which particle a `PickAt` met.

    Parameters
    ----------
    id
        -1 for none.
    center, radius
        In normalised units, as it is drawn.
    """

    kind: ClassVar[int] = 81
    epoch: int
    id: int
    center: tuple[float, float, float]
    radius: float


@dataclass(frozen=True, eq=False)
class ScreenshotState(Message):
    """How much of a screenshot is drawn: `done` of `total`; both 0 when there will be none, after an error."""

    kind: ClassVar[int] = 82
    done: int
    total: int


@dataclass(frozen=True, eq=False)
class ScreenshotPart(Message):
    """A part of a PNG file of `size` bytes: those from `start` on."""

    kind: ClassVar[int] = 83
    start: int
    size: int
    data: NDArray[np.uint8]
