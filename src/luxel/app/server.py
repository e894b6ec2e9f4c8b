"""The viewer's web server: one page, its modules and one socket, for those who know the token."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import hmac
import logging
from collections.abc import AsyncIterator
from http.cookies import CookieError, SimpleCookie
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from luxel.app.bundle import CLIENT_FOLDER
from luxel.app.hub import Hub, Page
from luxel.app.limits import PAGES_MAX, Allowance
from luxel.app.protocol import SUBPROTOCOL
from luxel.errors import ProtocolError, SessionClosedError

__all__ = [
    "CLOSE_BAD_MESSAGE",
    "CLOSE_TOO_MANY",
    "CLOSE_UNAUTHORISED",
    "CLOSE_WRONG_VERSION",
    "LOOPBACK",
    "make_app",
]

CLOSE_BAD_MESSAGE = 4400
CLOSE_UNAUTHORISED = 4401
CLOSE_WRONG_VERSION = 4406
CLOSE_TOO_MANY = 4429

_log = logging.getLogger(__name__)
_CLOSE_GOING_AWAY = 1001
_REASON_BYTES_MAX = 120  # a close frame holds 123
#: Hosts that only this machine reaches.
LOOPBACK = frozenset({"127.0.0.1", "localhost", "::1"})
# Named here because the guess of `mimetypes` depends on the machine (on Windows, on its registry).
_MEDIA_TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}


def make_app(hub: Hub, token: str, host: str = "127.0.0.1") -> Starlette:
    """Return the web application.

    Parameters
    ----------
    hub
        What the pages talk to.
    token
        Secret that every request must bring: as ``?token=`` or in the cookie that the page sets.
    host
        Address the server listens on. Requests must name it, or a loopback name, as their ``Host``; any name is
        taken when it is not a loopback address, since nobody can list the names of such a machine.
    """

    async def index(request: Request) -> Response:
        response = _file(CLIENT_FOLDER / "index.html")
        # The modules' addresses hold no token: the browser proves itself by this cookie.
        response.set_cookie(_cookie_name(token), token, httponly=True, samesite="strict")
        return response

    async def module(request: Request) -> Response:
        # Only names of a listing are opened, so no name leads out of the folder.
        wanted = CLIENT_FOLDER / request.path_params["name"]
        if wanted not in set(CLIENT_FOLDER.iterdir()) or wanted.suffix not in _MEDIA_TYPES:
            return PlainTextResponse("not found", 404)
        return _file(wanted)

    async def icon(request: Request) -> Response:
        return _file(CLIENT_FOLDER / "icon.svg")

    async def socket(websocket: WebSocket) -> None:
        await _serve(hub, websocket)

    @contextlib.asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        hub.start()
        try:
            yield
        finally:
            hub.stop()

    return Starlette(
        routes=[
            Route("/", index),
            Route("/favicon.ico", icon),
            Route("/client/{name}", module),
            WebSocketRoute("/ws", socket),
        ],
        middleware=[Middleware(_Guard, token=token, host=host)],
        lifespan=lifespan,
    )


class _Guard:
    """Lets nobody in without the token, from another site, or by a name that is not this server's."""

    def __init__(self, app: ASGIApp, token: str, host: str) -> None:
        self._app = app
        self._token = token
        self._hosts = LOOPBACK | {host} if host in LOOPBACK else None

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "websocket":
            scope["luxel.refusal"] = self._refusal(scope)
        elif scope["type"] == "http" and (refusal := self._refusal(scope)):
            await PlainTextResponse(refusal + "\n", 403)(scope, receive, _hardened(scope, send))
            return
        await self._app(scope, receive, _hardened(scope, send) if scope["type"] == "http" else send)

    def _refusal(self, scope: Scope) -> str:
        """Say why not, or nothing."""
        headers = Headers(scope=scope)
        host = headers.get("host", "")
        # A page of another site can make its own name point here; it cannot choose the name in this header.
        if self._hosts is not None and _split(f"//{host}")[1] not in self._hosts:
            return "this server answers to localhost only; open the address it printed"
        origin = headers.get("origin")
        if origin is not None and _split(origin)[0] != host:
            return "requests from other sites are refused"
        if not self._token_given(scope, headers):
            return "token missing or wrong; open the whole address that the viewer printed, with its ?token="
        return ""

    def _token_given(self, scope: Scope, headers: Headers) -> bool:
        given = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [])
        with contextlib.suppress(CookieError):
            cookie = SimpleCookie(headers.get("cookie", "")).get(_cookie_name(self._token))
            given += [] if cookie is None else [cookie.value]
        return any(hmac.compare_digest(each.encode(), self._token.encode()) for each in given)


def _hardened(scope: Scope, send: Send) -> Send:
    host = Headers(scope=scope).get("host", "")

    async def send_with_headers(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            headers["Content-Security-Policy"] = (
                f"default-src 'self'; connect-src 'self' ws://{host} wss://{host}; img-src 'self' data: blob:; "
                "base-uri 'none'; form-action 'none'; frame-ancestors 'self'; object-src 'none'"
            )
            headers["X-Content-Type-Options"] = "nosniff"
            headers["Referrer-Policy"] = "no-referrer"
            headers["Cross-Origin-Opener-Policy"] = "same-origin"
            headers["Cross-Origin-Resource-Policy"] = "same-origin"
            headers["Cache-Control"] = "no-store"
        await send(message)

    return send_with_headers


async def _serve(hub: Hub, websocket: WebSocket) -> None:
    offered = list(websocket.scope.get("subprotocols", []))
    if refusal := websocket.scope.get("luxel.refusal"):
        _log.warning("refused a socket: %s", refusal)
        await _refuse(websocket, offered, CLOSE_UNAUTHORISED, refusal)
        return
    if SUBPROTOCOL not in offered:
        await _refuse(
            websocket, offered, CLOSE_WRONG_VERSION, f"this server speaks {SUBPROTOCOL}; reload the page"
        )
        return
    if len(hub.pages) >= PAGES_MAX:
        await _refuse(
            websocket, offered, CLOSE_TOO_MANY, f"{PAGES_MAX} pages are open already; close one and reload"
        )
        return
    page = hub.join()  # before anything is awaited, so that the count above stays true
    tasks: set[asyncio.Task[None]] = set()
    try:
        await websocket.accept(SUBPROTOCOL)
        tasks = {
            asyncio.create_task(_read(hub, page, websocket)),
            asyncio.create_task(_write(hub, page, websocket)),
        }
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            await task
    except ProtocolError as error:
        _log.warning("%s sent a bad message: %s", page.name, error)
        await _close(websocket, CLOSE_BAD_MESSAGE, str(error))
    except SessionClosedError:
        await _close(websocket, _CLOSE_GOING_AWAY, "the session has ended")
    except WebSocketDisconnect:
        pass
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await hub.leave(page)


async def _read(hub: Hub, page: Page, websocket: WebSocket) -> None:
    allowance = Allowance()
    clock = asyncio.get_running_loop().time
    while True:
        message = await websocket.receive()
        if message["type"] == "websocket.disconnect":
            return
        data = message.get("bytes")
        if data is None:
            raise ProtocolError("messages must be binary")
        if wait_s := allowance.spend(len(data), clock()):
            await asyncio.sleep(wait_s)
        await hub.receive(page, data)


async def _write(hub: Hub, page: Page, websocket: WebSocket) -> None:
    while True:
        await page.wake.wait()
        page.wake.clear()
        while (message := hub.next_message(page)) is not None:
            await websocket.send_bytes(message.encode())


async def _refuse(websocket: WebSocket, offered: list[str], code: int, reason: str) -> None:
    # Accepted first: a browser tells its page the code and the reason only of an open socket.
    await websocket.accept(offered[0] if offered else None)
    await _close(websocket, code, reason)


async def _close(websocket: WebSocket, code: int, reason: str) -> None:
    short = reason.encode()[:_REASON_BYTES_MAX].decode(errors="ignore")
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):  # gone already
        await websocket.close(code, short)


def _cookie_name(token: str) -> str:
    # Cookies ignore ports: two viewers on one machine must not overwrite each other's.
    return "luxel-" + hashlib.sha256(token.encode()).hexdigest()[:12]


def _file(path: Path) -> FileResponse:
    return FileResponse(path, media_type=_MEDIA_TYPES[path.suffix])


def _split(address: str) -> tuple[str, str | None]:
    """Return network location and host name of an address; blank for one that is malformed."""
    try:
        parts = urlsplit(address)
        return parts.netloc, parts.hostname
    except ValueError:
        return "", None
