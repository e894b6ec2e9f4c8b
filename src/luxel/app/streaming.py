"""What pages say about pictures that the server draws for them, and who draws these: the hub's part of streaming."""

from __future__ import annotations

import asyncio
import contextlib
import functools
from collections.abc import Callable, Iterable

from luxel.app import protocol
from luxel.app.frame_thread import FrameThread, beside_of
from luxel.app.page import Page
from luxel.app.screenshots import Screenshots
from luxel.app.stream_messages import Picked, StreamedFrame
from luxel.session import Session
from luxel.trace.spheres import SphereSet

__all__ = ["Streaming"]


class Streaming:
    """Everything but :meth:`news` belongs to the event loop.

    Parameters
    ----------
    session
        What pages watch.
    pages
        Those that are there; may change.
    """

    def __init__(self, session: Session, pages: Iterable[Page]) -> None:
        self._session = session
        self._pages = pages
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread = FrameThread(
            session,
            lambda name, message: self._on_loop(self._deliver, name, message),
            lambda name, found: self._on_loop(self._picked, name, found),
            lambda name, text: self._on_loop(self._failed, name, text),
        )
        self._screenshots = Screenshots(session)
        self.epoch = 0  # of the particles that pages are told of

    def start(self) -> None:
        """Begin; called on the event loop."""
        self._loop = asyncio.get_running_loop()

    def stop(self) -> None:
        """End the thread that draws, and all screenshots."""
        self._screenshots.close()
        self._thread.close()

    def news(self) -> None:
        """Look at the light again. May be called from any thread."""
        self._thread.news()

    def leave(self, page: Page) -> None:
        """Draw no more for a page."""
        self.draw_no_more(page)
        self._screenshots.cancel(page)

    def dropped(self, page: Page) -> None:
        """What was to be sent to a page has been dropped: it will not confirm it."""
        for name in (page.name, beside_of(page.name)):
            self._thread.confirm(name, 1 << 53)

    def draw_no_more(self, page: Page) -> None:
        """Stop the stream of a page that draws by itself from now on."""
        for name in (page.name, beside_of(page.name)):
            self._thread.forget(name)

    def act(self, page: Page, message: protocol.PageMessage) -> None:
        """Act on a message that is about streams and screenshots.

        Raises
        ------
        InputError
            For a screenshot while another is drawn.
        """
        name = page.name
        match message:
            case protocol.Stream() if page.streamed:
                self._thread.watch(name, message)
                if message.beside:
                    self._thread.watch(beside_of(name), message)
                else:
                    self._thread.forget(beside_of(name))
            case protocol.StopStream():
                for each in (name, beside_of(name)):
                    self._thread.rest(each)
            case protocol.ConfirmFrame():
                self._thread.confirm(beside_of(name) if message.beside else name, message.frame)
            case protocol.PickAt() if page.streamed:
                self._thread.pick(name, message)
            case protocol.TakeScreenshot():
                self._screenshots.take(page, message)
            case protocol.CancelScreenshot():
                self._screenshots.cancel(page)
            case protocol.ConfirmParts():
                page.download.confirm(message.parts)
                page.wake.set()

    def _on_loop(self, act: Callable[..., None], *arguments: object) -> None:
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # the loop has just closed
                self._loop.call_soon_threadsafe(act, *arguments)

    def _page(self, name: str) -> Page | None:
        return next(
            (page for page in self._pages if page.streamed and name in (page.name, beside_of(page.name))),
            None,
        )

    def _deliver(self, name: str, message: StreamedFrame) -> None:
        if (page := self._page(name)) is not None:
            page.post(
                ("frame", message.beside, message.frame), lambda: message
            )  # few at a time, and none replaces another

    def _picked(self, name: str, found: int) -> None:
        page = self._page(name)
        particles = self._session.particles
        if page is None or found >= len(particles):
            return
        spheres = SphereSet.of(particles)
        x, y, z = spheres.centers[found].tolist() if found >= 0 else (0.0, 0.0, 0.0)
        radius = float(spheres.radii[found]) if found >= 0 else 0.0
        told = Picked(self.epoch, found, (x, y, z), radius)
        page.post("picked", lambda: told)

    def _failed(self, name: str, text: str) -> None:
        if (page := self._page(name)) is not None:
            page.post("error", functools.partial(protocol.Error, text))
