"""The pictures of one page that the server draws for it: which to draw next, at what size, and in which format they travel."""

from __future__ import annotations

import io
import math
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from luxel.app.baked import fits_page
from luxel.app.stream_messages import Stream, StreamedFrame
from luxel.picture.drawing import Crew
from luxel.picture.frames import Frame, Frames
from luxel.scene.scene import Scene
from luxel.scene.view import View
from luxel.session import Session, SessionTextures, Status
from luxel.textures.textures import TextureSource, TextureTable

__all__ = ["BesideLight", "PageStream", "SessionLight"]

_ANTIALIAS = 3
_MOVING_S = 0.05  # that a picture may take while the view moves
_REDUCTIONS = (2, 3, 4, 6)  # of width and height, while the view moves
_LEAST_SIDE = 32
_RATE_SHARE = 0.3  # of the latest picture in the running mean of pixels a second
_SEND_S = 0.25  # between pictures at rest that are not complete yet
_LOOK_S = 0.5  # between looks for light at rest; requests lapse after two seconds
_QUALITY_MOVING, _QUALITY_REST = 80, 90
_PNG_LEVEL = 1


class _StoredTextures:
    """The textures of a stored frame, all there at once; a :class:`luxel.textures.textures.TextureSource`."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._table: tuple[str, TextureTable] | None = None

    @property
    def key(self) -> str:
        """The session's current light key."""
        return self._session.key

    def snapshot(self, key: str) -> TextureTable:
        """Return the table of the current frame, made once for each; who asked for another `key` asks again."""
        table = self._table
        if table is None or table[0] != key:
            stored = self._session.stored
            assert stored is not None
            table = (stored.key, stored.compressed.snapshot(stored.key))
            self._table = table
        return table[1]

    def sighted(self, ids: NDArray[np.int32], eye: NDArray[np.float64]) -> None:
        """All textures are there: nothing to request."""


class SessionLight:
    """A session as one renderer sees it; a :class:`luxel.picture.lit.Lit`.

    Textures of a bake that fits memory are looked up as they are stored, others in the session's cache.

    Parameters
    ----------
    session, client
        What to draw, and the name under which sightings are noted.
    """

    def __init__(self, session: Session, client: str) -> None:
        self._session = session
        stored = session.stored
        self.source: TextureSource = (
            _StoredTextures(session)
            if stored is not None and fits_page(stored)
            else SessionTextures(session, client)
        )

    @property
    def scene(self) -> Scene:
        """What to draw now."""
        return self._session.scene

    def status(self) -> Status:
        """How far the light is."""
        return self._session.status()

    def run_for(self, budget_s: float, helpers: object = None) -> None:
        """Light is computed by the session's own threads."""

    def take_in(self) -> None:
        """They take sightings in, too."""


class _BesideTextures(SessionTextures):
    """Textures of the light that is compared with; those of the session's own while there is none."""

    @property
    def key(self) -> str:
        """Its light key."""
        return self._session.key_beside or self._session.key

    def sighted(self, ids: NDArray[np.int32], eye: NDArray[np.float64]) -> None:
        """Note which particles were seen, (K,) int32, and from where, (3,) file units."""
        self._session.sighted(ids, eye, self._client, self.key)


class BesideLight(SessionLight):
    """The light that is compared with, as one renderer sees it; a :class:`luxel.picture.lit.Lit`.

    Parameters
    ----------
    session, client
        What to draw, and the name under which sightings are noted.
    """

    def __init__(self, session: Session, client: str) -> None:
        self._session = session
        self.source: TextureSource = _BesideTextures(session, client)

    @property
    def scene(self) -> Scene:
        """What to draw now."""
        return self._session.scene_beside or self._session.scene

    def status(self) -> Status:
        """How far the light is."""
        return self._session.status(beside=True)


class PageStream:
    """The stream of one page. Belongs to the thread that draws.

    While the view moves there is one quick picture for each new view: reduced, with one ray a pixel, as JPEG. Once it
    rests, full pictures follow, until the last is antialiased, has all light, and travels as PNG: it is then, pixel
    for pixel, what :func:`luxel.render` draws.

    Parameters
    ----------
    session, client
        What to draw, and the name under which sightings are noted.
    crew
        Drawing threads, shared by all streams.
    clock
        Seconds, never going backwards.
    beside
        Draw the light that is compared with. Where light is baked in, there is no other: then that is Lambert's.
    """

    def __init__(
        self,
        session: Session,
        client: str,
        crew: Crew,
        clock: Callable[[], float] = time.monotonic,
        *,
        beside: bool = False,
    ) -> None:
        self._clock = clock
        self._beside = beside
        other = beside and not session.light_fixed
        self._light: SessionLight | BesideLight = (BesideLight if other else SessionLight)(session, client)
        self._frames = Frames(
            self._light,
            shading="lambertian" if beside and session.light_fixed else "textures",
            antialias=_ANTIALIAS,
            crew=crew,
            clock=clock,
        )
        self._wish: Stream | None = None
        self._fresh = False  # nothing has been drawn of it yet
        self._count = 0
        self._key = ""  # of the light, or an older one
        self._rate = math.inf  # pixels a second while the view moves
        # What the page has:
        self._pixels: NDArray[np.uint8] | None = None
        self._lossless = False
        self._told: tuple[object, ...] = ()
        self._sent_s = -math.inf

    def show(self, wish: Stream) -> None:
        """Draw this from now on.

        Raises
        ------
        LuxelError
            If it is no view.
        """
        frames = self._frames
        frames.view = View.from_json(wish.view)
        frames.grading = wish.grading
        frames.size = self._reduced(wish) if wish.moving else (wish.width, wish.height)
        if wish.moving:
            frames.restart()  # new colours at once: not after half the rays of a good picture
        self._wish, self._fresh = wish, True

    def step(self) -> tuple[StreamedFrame | None, float]:
        """Draw; return what to send, and how many seconds later there is more to do.

        That is sooner when light has come, and never (infinite) if only another view or light can change the picture.

        Raises
        ------
        LuxelError
            If the particles lack what the view shows.
        """
        wish, frames = self._wish, self._frames
        if wish is None or (wish.moving and not self._fresh):
            return None, math.inf
        self._fresh = False
        began_s = self._clock()
        self._key = self._light.source.key
        frame = frames.draw()
        took_s = self._clock() - began_s
        if wish.moving:
            self._learn(frame, took_s)
            return self._message(frame, _encoded(frame, _QUALITY_MOVING), lossless=False), math.inf
        message = self._at_rest(frame)
        if not frames.drawing:
            return message, math.inf if frame.final else _LOOK_S
        return message, frames.pause_s  # light comes from the same processors

    def id_at(self, wish: Stream, x: float, y: float) -> int:
        """Return the particle at a point of the picture that somebody wished for, -1 for none.

        Raises
        ------
        LuxelError
            If it is no view, or the particles lack what it shows.
        """
        now = self._wish
        if now is None or now.moving or vars(now) != vars(wish):
            self.show(wish)
        self._frames.draw()
        found = self._frames.id_at(x, y)
        if now is not None and self._wish is not now:
            self.show(now)
        return found

    def close(self) -> None:
        """Give everything back."""
        self._frames.close()

    def _at_rest(self, frame: Frame) -> StreamedFrame | None:
        """Return what the page should be told of a frame while the view rests, if anything."""
        whole = frame.final or frame.rays == _ANTIALIAS**2
        late = self._clock() - self._sent_s > _SEND_S
        if frame.pixels is not self._pixels:
            if whole or late or frame.rays == 1:
                image = _encoded(frame, None if whole else _QUALITY_REST)
                return self._message(frame, image, lossless=whole)
            return None
        if whole and not self._lossless:
            return self._message(frame, _encoded(frame, None), lossless=True)
        if (frame.final or late) and self._words(frame) != self._told:
            return self._message(frame, b"", lossless=self._lossless)
        return None

    def _message(self, frame: Frame, image: bytes, *, lossless: bool) -> StreamedFrame:
        self._count += 1
        self._pixels, self._lossless, self._told = frame.pixels, lossless, self._words(frame)
        self._sent_s = self._clock()
        height, width = frame.pixels.shape[:2]
        return StreamedFrame(
            self._count,
            0 if self._wish is None else self._wish.wish,
            self._key,
            width,
            height,
            np.frombuffer(image, np.uint8),
            lossless,
            frame.rays,
            frame.final,
            frame.visible,
            frame.ready,
            frame.dim,
            frame.stale,
            self._beside,
        )

    def _words(self, frame: Frame) -> tuple[object, ...]:
        """Return what a message says of a frame beside its picture."""
        lit = frame.visible, frame.ready, frame.dim, frame.stale
        return self._wish, self._key, frame.rays, frame.final, *lit

    def _reduced(self, wish: Stream) -> tuple[int, int]:
        """Return a size that can be drawn quickly."""
        pixels, room = wish.width * wish.height, self._rate * _MOVING_S
        factor = next((each for each in _REDUCTIONS if pixels <= room * each * each), _REDUCTIONS[-1])
        width, height = (
            max(min(side, _LEAST_SIDE), round(side / factor)) for side in (wish.width, wish.height)
        )
        return width, height

    def _learn(self, frame: Frame, took_s: float) -> None:
        height, width = frame.pixels.shape[:2]
        rate = height * width / max(took_s, 1e-6)
        self._rate = rate if math.isinf(self._rate) else self._rate + _RATE_SHARE * (rate - self._rate)


def _encoded(frame: Frame, quality: int | None) -> bytes:
    """Return the picture as a JPEG file of some quality, or as PNG."""
    from PIL import Image

    buffer = io.BytesIO()
    picture = Image.fromarray(frame.pixels)
    if quality is None:
        picture.save(buffer, "PNG", compress_level=_PNG_LEVEL)
    else:
        # Colour at full resolution: half of it would smear colour maps over single particles.
        picture.save(buffer, "JPEG", quality=quality, subsampling=0)
    return buffer.getvalue()
