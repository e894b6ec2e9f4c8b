"""The one thread of a server that draws pictures for its pages, turn by turn."""

from __future__ import annotations

import functools
import logging
import math
import threading
import time
from collections.abc import Callable

from luxel.app.stream import PageStream
from luxel.app.stream_messages import PickAt, Stream, StreamedFrame
from luxel.errors import LuxelError, SessionClosedError
from luxel.picture.drawing import Crew
from luxel.session import Session

__all__ = ["FrameThread", "beside_of"]

_log = logging.getLogger(__name__)
_IN_FLIGHT_MAX = 2  # pictures that a page has not confirmed
_NEWS_S = 0.05  # after news of light before it is drawn: more will have come by then
_STOP_TIMEOUT_S = 10.0
_BESIDE = ", beside"


class _Seat:
    """What one page wants; guarded by the thread's lock, but for the stream, which belongs to the thread itself."""

    def __init__(self, stream: PageStream) -> None:
        self.stream = stream
        self.wish: Stream | None = None  # not yet begun
        self.pick: PickAt | None = None
        self.watches = False
        self.sent = 0
        self.confirmed = 0
        self.due_s = math.inf


class FrameThread:
    """Draws what pages watch. The newest view of a page replaces older ones that have not been drawn.

    Without anybody who watches, or anything that changes, the thread sleeps. It is started by the first view.

    Parameters
    ----------
    session
        What to draw.
    deliver
        Called on the thread, as ``deliver(page, message)``, with pictures. Pages that compare are two, see :func:`beside_of`.
    picked
        Called on the thread, as ``picked(page, id)``.
    failed
        Called on the thread, as ``failed(page, text)``.
    clock
        Seconds, never going backwards.

    Notes
    -----
    All methods may be called from any thread. The lock is held for no longer than a look at these few numbers.
    """

    def __init__(
        self,
        session: Session,
        deliver: Callable[[str, StreamedFrame], None],
        picked: Callable[[str, int], None],
        failed: Callable[[str, str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._session = session
        self._deliver, self._picked, self._failed = deliver, picked, failed
        self._clock = clock
        self._crew = Crew()
        self._seats: dict[str, _Seat] = {}
        self._gone: list[str] = []
        self._changed = threading.Condition()
        self._closed = False
        self._thread: threading.Thread | None = None

    def watch(self, page: str, wish: Stream) -> None:
        """Draw this for a page."""
        with self._changed:
            seat = self._seat(page)
            seat.wish, seat.watches, seat.due_s = wish, True, self._clock()
            self._changed.notify()

    def pick(self, page: str, where: PickAt) -> None:
        """Find what a page shows at a point; a newer question replaces an older one."""
        with self._changed:
            self._seat(page).pick = where
            self._changed.notify()

    def confirm(self, page: str, frame: int) -> None:
        """Take a page's word that it shows picture number `frame`."""
        with self._changed:
            seat = self._seats.get(page)
            if seat is not None:
                seat.confirmed = min(max(seat.confirmed, frame), seat.sent)
                self._changed.notify()

    def rest(self, page: str) -> None:
        """Draw nothing for a page until it wants something again."""
        with self._changed:
            if page in self._seats:
                self._seats[page].watches = False

    def forget(self, page: str) -> None:
        """Drop a page."""
        with self._changed:
            if self._seats.pop(page, None) is not None:
                self._gone.append(page)
                self._changed.notify()

    def news(self) -> None:
        """Look at the light again: some has come, or it is another."""
        with self._changed:
            soon_s = self._clock() + _NEWS_S
            for seat in self._seats.values():
                seat.due_s = min(seat.due_s, soon_s)
            self._changed.notify()

    def close(self) -> None:
        """End the thread, after the picture at hand."""
        with self._changed:
            self._closed = True
            self._seats.clear()
            self._changed.notify()
            thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join(_STOP_TIMEOUT_S)

    def _seat(self, page: str) -> _Seat:
        if page not in self._seats:
            beside = page.endswith(_BESIDE)
            made = PageStream(self._session, _client(page), self._crew, self._clock, beside=beside)
            self._seats[page] = _Seat(made)
        if self._thread is None and not self._closed:
            self._thread = threading.Thread(target=self._run, name="luxel-frames", daemon=True)
            self._thread.start()
        return self._seats[page]

    def _run(self) -> None:
        try:
            while (job := self._next()) is not None:
                job()
        finally:
            self._crew.close()

    def _next(self) -> Callable[[], None] | None:
        """Wait for something to do; None when all is over."""
        with self._changed:
            while not self._closed:
                if self._gone:
                    # Here, since a picture that was under way has noted what it saw after the page had gone.
                    return functools.partial(self._session.forget, _client(self._gone.pop()))
                now_s, soonest_s = self._clock(), math.inf
                for page, seat in self._seats.items():
                    ready_s = _ready_s(seat)
                    if ready_s <= now_s:
                        del self._seats[page]
                        self._seats[page] = seat  # to the end of the queue
                        wish, pick = seat.wish, seat.pick
                        seat.wish, seat.pick, seat.due_s = None, None, math.inf
                        return functools.partial(self._serve, page, seat, wish, pick)
                    soonest_s = min(soonest_s, ready_s)
                self._changed.wait(None if math.isinf(soonest_s) else soonest_s - now_s)
        return None

    def _serve(self, page: str, seat: _Seat, wish: Stream | None, pick: PickAt | None) -> None:
        """Draw for a page, or answer its question; what fails is told, and tried again when the page wants something."""
        wait_s = math.inf
        try:
            if wish is not None:
                seat.stream.show(wish)
            if pick is not None:
                asked = Stream(pick.view, pick.width, pick.height)
                self._picked(page, seat.stream.id_at(asked, pick.x, pick.y))
                wait_s = 0.0
            else:
                message, wait_s = seat.stream.step()
                if message is not None:
                    with self._changed:
                        seat.sent = message.frame
                    self._deliver(page, message)
        except SessionClosedError:
            with self._changed:
                self._closed = True
        except LuxelError as error:
            self._give_up(page, seat, str(error))
        except Exception:  # noqa: BLE001 - reported, and must not end the pictures of all other pages
            _log.exception("drawing for %s failed", page)
            self._give_up(page, seat, "the server could not draw this picture; its log says why")
        with self._changed:
            seat.due_s = min(seat.due_s, self._clock() + wait_s)

    def _give_up(self, page: str, seat: _Seat, text: str) -> None:
        with self._changed:
            seat.watches = seat.wish is not None
        self._failed(page, text)


def beside_of(page: str) -> str:
    """Return the name under which the light is drawn that a page compares with."""
    return f"{page}{_BESIDE}"


def _ready_s(seat: _Seat) -> float:
    """Return when it is a page's turn."""
    if seat.pick is not None:
        return -math.inf
    if not seat.watches or seat.sent - seat.confirmed >= _IN_FLIGHT_MAX:
        return math.inf
    return seat.due_s


def _client(page: str) -> str:
    """Return the name under which a stream notes what it sees: the page itself may draw too, and has its own."""
    return f"{page}, stream"
