"""A session's pages in a notebook: the hub on a thread of its own, over whatever carries messages to the notebook's front end.

The kernel's main thread runs cells, so nothing here waits for it: light goes on streaming while a cell runs. Only what a page says
waits, since kernels take in messages between cells.

A message is a small JSON object and at most one buffer. ``page`` names the page, of which a notebook may show several of one
widget; ``do`` is one of

=========  ============  ==================================================================================================
``do``     from          meaning
=========  ============  ==================================================================================================
open       page          a page is there, and speaks ``version``, see :data:`luxel.app.protocol.SUBPROTOCOL`
opened     kernel        it may say hello
message    both          the buffer is one message of ``protocol``
ping       page          answered at once by ``pong``: the kernel is there and not busy
close      page          the page is gone
end        kernel        the page is let go, for the reason given in ``text``
=========  ============  ==================================================================================================
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
from collections.abc import Callable, Coroutine, Sequence
from typing import Any

from luxel.app.hub import Hub, Page, Renderer
from luxel.app.limits import PAGES_MAX
from luxel.app.protocol import SUBPROTOCOL
from luxel.errors import ProtocolError, SessionClosedError
from luxel.session import Session

__all__ = ["CommServer", "Send"]

#: Carries a JSON object and buffers to the front end; called from the server's own thread and from the kernel's.
Send = Callable[[dict[str, Any], list[bytes]], None]

_log = logging.getLogger(__name__)
_STOP_TIMEOUT_S = 5.0
_NAME_MAX = 100


class CommServer:
    """Serves the pages of one session until :meth:`close`.

    Parameters
    ----------
    session
        What the pages show; stays open after this server.
    send
        Carries messages to the front end.
    notice
        Shown until the first textures arrive.
    renderer
        See :class:`Hub`.

    Notes
    -----
    :meth:`receive` and :meth:`close` may be called from any thread. All other state belongs to the event loop of
    the server's thread.
    """

    def __init__(
        self, session: Session, send: Send, notice: str = "", renderer: Renderer = "browser"
    ) -> None:
        self._hub = Hub(session, notice, renderer)
        self._send = send
        self._pages: dict[str, _Visit] = {}
        self._leaving: set[asyncio.Task[None]] = set()  # or nothing would keep them until they are done
        self._loop = asyncio.new_event_loop()
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="luxel-notebook", daemon=True)
        self._thread.start()

    def receive(self, content: object, buffers: Sequence[Any]) -> None:
        """Take a message from the front end; whatever makes no sense is logged and dropped."""
        match content:
            case {"page": str(page), "do": "ping"}:
                self._send({"page": page, "do": "pong"}, [])
            case {"page": str(page), "do": str(action), **rest} if len(page) <= _NAME_MAX:
                data = bytes(buffers[0]) if len(buffers) == 1 else b""
                with contextlib.suppress(RuntimeError):  # closed already
                    self._loop.call_soon_threadsafe(self._act, page, action, rest.get("version"), data)
            case _:
                _log.warning("ignored a message of no known kind from the notebook")

    def close(self) -> None:
        """Let all pages go and end the thread; closing twice does no harm."""
        if self._closed.is_set():
            return
        self._closed.set()
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._loop.stop)
        if threading.current_thread() is not self._thread:
            self._thread.join(_STOP_TIMEOUT_S)

    def _run(self) -> None:
        loop = self._loop
        asyncio.set_event_loop(loop)
        loop.call_soon(self._hub.start)
        try:
            loop.run_forever()
        finally:
            self._hub.stop()
            for name in list(self._pages):
                self._end(name, "The viewer has been closed in Python.")
            pending = asyncio.all_tasks(loop)
            for task in pending:
                task.cancel()
            loop.run_until_complete(asyncio.gather(*pending, return_exceptions=True))
            loop.close()

    def _act(self, name: str, action: str, version: object, data: bytes) -> None:
        visit = self._pages.get(name)
        if action == "open":
            if visit is not None:
                self._drop(name)  # it opens again after a lost connection
            if version != SUBPROTOCOL:
                self._end(name, f"The page speaks {version}, the kernel {SUBPROTOCOL}: run the cell again.")
            elif len(self._pages) >= PAGES_MAX:
                self._end(name, f"{PAGES_MAX} views are open already: close one.")
            else:
                self._pages[name] = visit = _Visit(self._hub.join())
                for work in (self._read(visit), self._write(name, visit)):
                    visit.tasks.append(self._loop.create_task(self._attend(name, visit, work)))
                self._tell(name, "opened")
        elif action == "close":
            self._drop(name)
        elif action == "message" and visit is not None:
            visit.inbox.put_nowait(data)

    async def _attend(self, name: str, visit: _Visit, work: Coroutine[Any, Any, None]) -> None:
        """Do `work`, and let the page go when it fails."""
        try:
            await work
        except ProtocolError as error:
            _log.warning("%s sent a bad message: %s", visit.page.name, error)
            self._end(name, f"The kernel refused a message: {error}")
        except SessionClosedError:
            self._end(name, "The session has ended.")
        except Exception:  # noqa: BLE001 - reported, and must not leave a page that waits for ever
            _log.exception("%s had to be let go", visit.page.name)
            self._end(name, "The viewer failed; the kernel's log says how.")

    async def _read(self, visit: _Visit) -> None:
        while True:
            await self._hub.receive(visit.page, await visit.inbox.get())

    async def _write(self, name: str, visit: _Visit) -> None:
        page = visit.page
        while True:
            await page.wake.wait()
            page.wake.clear()
            while (message := self._hub.next_message(page)) is not None:
                self._send({"page": name, "do": "message"}, [message.encode()])
                await asyncio.sleep(0)  # other pages have their turn

    def _tell(self, name: str, action: str, **more: str) -> None:
        try:
            self._send({"page": name, "do": action, **more}, [])
        except Exception as error:  # noqa: BLE001 - whatever the front end's library raises when nobody is there any more
            _log.warning("cannot reach the notebook: %s", error)

    def _end(self, name: str, text: str) -> None:
        self._tell(name, "end", text=text)
        self._drop(name)

    def _drop(self, name: str) -> None:
        visit = self._pages.pop(name, None)
        if visit is None:
            return
        running = asyncio.current_task(self._loop)
        for task in visit.tasks:
            if task is not running:
                task.cancel()
        if not self._closed.is_set():
            leaving = self._loop.create_task(self._hub.leave(visit.page))
            self._leaving.add(leaving)
            leaving.add_done_callback(self._leaving.discard)


class _Visit:
    """A page, what it said that is not yet acted on, and the tasks that serve it."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.inbox: asyncio.Queue[bytes] = asyncio.Queue()
        self.tasks: list[asyncio.Task[None]] = []
