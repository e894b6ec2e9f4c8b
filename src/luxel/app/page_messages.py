"""What a page says to the viewer's server."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from luxel.app.message import KEY_MAX, NAME_MAX, Given, PageMessage, drawer

__all__ = [
    "ColormapRequest",
    "Compare",
    "Confirm",
    "GeometryRequest",
    "Hello",
    "Inspect",
    "LoadView",
    "Report",
    "ScalarRequest",
    "SetFrame",
    "SetLight",
    "SetView",
    "Sighted",
]

_TEXT_MAX = 4000
_PART_MAX = 1 << 18  # particles that are asked for at a time


@dataclass(frozen=True, eq=False)
class Hello(PageMessage):
    """First message of a page.

    Parameters
    ----------
    renderer
        What could draw there.
    by
        Who shall draw, ``"browser"`` or ``"server"``; None leaves it to the server.
    """

    kind: ClassVar[int] = 1
    renderer: str = ""
    by: str | None = None

    @classmethod
    def read(cls, given: Given) -> Self:
        """See :meth:`PageMessage.read`."""
        return cls(given.text("renderer", NAME_MAX), drawer(given) if given.has("by") else None)


@dataclass(frozen=True, eq=False)
class Sighted(PageMessage):
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

    @classmethod
    def read(cls, given: Given) -> Self:
        """See :meth:`PageMessage.read`."""
        eye = given.numbers("eye", 3)
        return cls(given.text("key", KEY_MAX), given.ids(), (eye[0], eye[1], eye[2]))


@dataclass(frozen=True, eq=False)
class Confirm(PageMessage):
    """The page has taken in so many messages since it connected.

    Parameters
    ----------
    batches, coarse, parts, beside
        Of tiles, of first light, of baked textures, and of tiles of the light that is compared with.
    """

    kind: ClassVar[int] = 3
    batches: int
    coarse: int
    parts: int = 0
    beside: int = 0

    @classmethod
    def read(cls, given: Given) -> Self:
        """See :meth:`PageMessage.read`."""
        return cls(*(given.whole(name) for name in ("batches", "coarse", "parts", "beside")))


@dataclass(frozen=True, eq=False)
class SetLight(PageMessage):
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

    @classmethod
    def read(cls, given: Given) -> Self:
        """See :meth:`PageMessage.read`."""
        sun = given.numbers("sun", 4) if given.has("sun") else None
        return cls(
            given.text("model", 64) if given.has("model") else None,
            given.number("albedo") if given.has("albedo") else None,
            given.number("sky") if given.has("sky") else None,
            None if sun is None else (sun[0], sun[1], sun[2], sun[3]),
            given.text("up", 8) if given.has("up") else None,
            given.list("hide") if given.has("hide") else None,
            given.number("radius_scale") if given.has("radius_scale") else None,
        )


@dataclass(frozen=True, eq=False)
class SetFrame(PageMessage):
    """Show another time step."""

    kind: ClassVar[int] = 5
    frame: int

    @classmethod
    def read(cls, given: Given) -> Self:
        """See :meth:`PageMessage.read`."""
        return cls(given.whole("frame"))


@dataclass(frozen=True, eq=False)
class ScalarRequest(PageMessage):
    """Send the values of a scalar: all, or those of `count` particles from `start` on."""

    kind: ClassVar[int] = 6
    name: str
    start: int = 0
    count: int | None = None

    @classmethod
    def read(cls, given: Given) -> Self:
        """See :meth:`PageMessage.read`."""
        name = given.text("name", NAME_MAX)
        return cls(name, *_part(given)) if given.has("count") else cls(name)


@dataclass(frozen=True, eq=False)
class GeometryRequest(PageMessage):
    """Send `count` particles of data set `epoch` from `start` on: where the scene says that they are to be asked for."""

    kind: ClassVar[int] = 9
    epoch: int
    start: int
    count: int

    @classmethod
    def read(cls, given: Given) -> Self:
        """See :meth:`PageMessage.read`."""
        return cls(given.whole("epoch"), *_part(given))


@dataclass(frozen=True, eq=False)
class ColormapRequest(PageMessage):
    """Send the colours of a map."""

    kind: ClassVar[int] = 7
    name: str

    @classmethod
    def read(cls, given: Given) -> Self:
        """See :meth:`PageMessage.read`."""
        return cls(given.text("name", NAME_MAX))


@dataclass(frozen=True, eq=False)
class Report(PageMessage):
    """Something that the server's log should know: a shader that fails to compile, a lost context."""

    kind: ClassVar[int] = 8
    text: str

    @classmethod
    def read(cls, given: Given) -> Self:
        """See :meth:`PageMessage.read`."""
        return cls(given.text("text", _TEXT_MAX))


@dataclass(frozen=True, eq=False)
class SetView(PageMessage):
    """How the page looks at the particles now, as of ``View.to_json()``, in file units."""

    kind: ClassVar[int] = 40
    view: Mapping[str, Any]

    @classmethod
    def read(cls, given: Given) -> Self:
        """See :meth:`PageMessage.read`."""
        return cls(given.object("view"))


@dataclass(frozen=True, eq=False)
class LoadView(PageMessage):
    """Show a saved view, as of ``SavedView.to_json()``; the server answers with a `ViewState`."""

    kind: ClassVar[int] = 41
    saved: Mapping[str, Any]

    @classmethod
    def read(cls, given: Given) -> Self:
        """See :meth:`PageMessage.read`."""
        return cls(given.object("saved"))


@dataclass(frozen=True, eq=False)
class Inspect(PageMessage):
    """Tell everything about one particle."""

    kind: ClassVar[int] = 42
    id: int

    @classmethod
    def read(cls, given: Given) -> Self:
        """See :meth:`PageMessage.read`."""
        return cls(given.whole("id"))


@dataclass(frozen=True, eq=False)
class Compare(PageMessage):
    """Light the scene under a second shading model as well, for this page to show beside the first; None ends that."""

    kind: ClassVar[int] = 60
    model: str | None = None

    @classmethod
    def read(cls, given: Given) -> Self:
        """See :meth:`PageMessage.read`."""
        return cls(given.text("model", 64) if given.has("model") else None)


def _part(given: Given) -> tuple[int, int]:
    """Return the fields ``start`` and ``count``."""
    return given.whole("start"), given.whole("count", 1, _PART_MAX)
