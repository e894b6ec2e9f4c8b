"""Screenshots: pictures of any size that the server draws for its pages, one after the other."""

from __future__ import annotations

import asyncio
import contextlib
import io
import logging
import threading
from collections.abc import Callable

from luxel.app.page import Page
from luxel.app.protocol import Error
from luxel.app.stream import SessionLight
from luxel.app.stream_messages import ScreenshotState, TakeScreenshot
from luxel.errors import InputError, LuxelError
from luxel.picture.bands import draw_bands
from luxel.picture.colorbar import draw_colorbar
from luxel.picture.lit import lit_now
from luxel.scene.view import View
from luxel.session import Session

__all__ = ["Screenshots"]


_log = logging.getLogger(__name__)


class _CancelledError(Exception):
    """Nobody wants the picture any more."""


class Screenshots:
    """Belongs to the event loop; pictures are drawn on threads, with the textures that there are when their turn comes.

    A picture of 8192 x 8192 takes 0.5 GB while it is drawn and packed: one is under way at a time, and one a page
    may be asked for.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._turn = asyncio.Lock()
        self._wanted: dict[Page, tuple[asyncio.Task[None], threading.Event]] = {}

    def take(self, page: Page, wish: TakeScreenshot) -> None:
        """Draw a picture and send it.

        Raises
        ------
        InputError
            If the page waits for one already.
        """
        if page in self._wanted:
            raise InputError("a screenshot is being drawn already — wait for it, or cancel it")
        cancelled = threading.Event()
        task = asyncio.ensure_future(self._draw(page, wish, cancelled))
        self._wanted[page] = (task, cancelled)

    def cancel(self, page: Page) -> None:
        """Stop drawing for a page, if something is drawn."""
        if page in self._wanted:
            self._wanted.pop(page)[1].set()
        page.download.begin(b"")

    def close(self) -> None:
        """Stop drawing for all pages."""
        for page in list(self._wanted):
            self.cancel(page)

    async def _draw(self, page: Page, wish: TakeScreenshot, cancelled: threading.Event) -> None:
        loop = asyncio.get_running_loop()

        def report(done: int, total: int) -> None:
            if cancelled.is_set():
                raise _CancelledError
            with contextlib.suppress(RuntimeError):  # the loop has closed
                loop.call_soon_threadsafe(tell, done, total)

        def tell(done: int, total: int) -> None:
            if not cancelled.is_set():
                page.post("screenshot", lambda: ScreenshotState(done, total))

        try:
            async with self._turn:
                data = await asyncio.to_thread(_png, self._session, wish, report)
        except _CancelledError:
            return
        except (LuxelError, MemoryError) as error:
            text = str(error) or "there is not enough memory for a screenshot of this size"
            page.post("error", lambda: Error(text))
            tell(0, 0)
        except Exception:  # noqa: BLE001 - reported, and must not leave a page that waits for ever
            _log.exception("a screenshot for %s failed", page.name)
            page.post("error", lambda: Error("the server could not draw the screenshot; its log says why"))
            tell(0, 0)
        else:
            if not cancelled.is_set():
                page.download.begin(data)
                page.wake.set()
        if not cancelled.is_set():
            self._wanted.pop(page, None)


def _png(session: Session, wish: TakeScreenshot, report: Callable[[int, int], None]) -> bytes:
    """Draw, and return a PNG file."""
    from PIL import Image

    report(0, 1)
    view = View.from_json(wish.view)
    scene, _, table = lit_now(SessionLight(session, "screenshot"))
    pixels = draw_bands(scene, view, table, (wish.width, wish.height), progress=report)
    pixels = draw_colorbar(pixels, view, scene.particles)
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG")
    return buffer.getvalue()
