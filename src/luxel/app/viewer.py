"""`luxel.view`: show particles in a browser tab."""

from __future__ import annotations

import contextlib
import logging
import os
import secrets
import socket
import sys
import threading
import webbrowser
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import TYPE_CHECKING, Any, get_args

import uvicorn
from numpy.typing import ArrayLike

from luxel.app.hub import Hub, Renderer, cold_notice
from luxel.app.limits import PAGES_MAX
from luxel.app.notebook import in_notebook, make_widget
from luxel.app.protocol import CLIENT_BYTES_MAX
from luxel.app.server import LOOPBACK, make_app
from luxel.errors import InputError, LuxelError
from luxel.scene.from_arrays import looked_at
from luxel.scene.view import View
from luxel.session import Session
from luxel.textures.spec import TextureSpec
from luxel.textures.store.reader import Baked

if TYPE_CHECKING:
    from luxel.app.widget import ViewerWidget

__all__ = ["Viewer", "make_session", "view"]

_log = logging.getLogger(__name__)
_START_TIMEOUT_S = 30.0
_STOP_TIMEOUT_S = 5.0


class Viewer:
    """A running viewer; :meth:`close` or leaving a ``with`` block stops it.

    Attributes
    ----------
    url
        Address of the page, token included.
    session
        The session it shows: change frames and lights through it, and the page follows.
    """

    def __init__(
        self, session: Session, host: str, port: int, owns_session: bool, renderer: Renderer = "browser"
    ) -> None:
        self.session = session
        self._owns_session = owns_session
        self._socket = _listen(host, port)
        if host not in LOOPBACK:
            _log.warning(
                "serving on %s without encryption: whoever can read this network's traffic can read the address with its "
                "token, and look — an SSH tunnel to 127.0.0.1 is safer",
                host,
            )
        token = secrets.token_urlsafe(24)
        bound = self._socket.getsockname()[1]
        shown = {"0.0.0.0": socket.gethostname(), "::": socket.gethostname()}.get(host, host)
        self.url = f"http://{f'[{shown}]' if ':' in shown else shown}:{bound}/?token={token}"
        config = uvicorn.Config(
            make_app(Hub(session, cold_notice(), renderer), token, host),
            log_config=None,
            log_level="warning",
            access_log=False,
            server_header=False,
            ws_max_size=CLIENT_BYTES_MAX,
            limit_concurrency=4 * PAGES_MAX,
            ws_per_message_deflate=False,  # tiles hardly shrink, and packing them would cost the light a thread
            timeout_graceful_shutdown=1,
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._run, name="luxel-viewer", daemon=True)
        self._started = threading.Event()
        self._thread.start()
        if not (self._started.wait(_START_TIMEOUT_S) and self._server.started):
            self.close()
            raise LuxelError(f"the viewer's server did not start on {host} port {bound}; see the log")

    def close(self) -> None:
        """Stop serving, and end the session if the viewer made it."""
        self._server.should_exit = True
        if threading.current_thread() is not self._thread:
            self._thread.join(_STOP_TIMEOUT_S)
        self._socket.close()
        if self._owns_session:
            self.session.close()

    def wait(self) -> None:
        """Serve until the server ends; Ctrl-C raises KeyboardInterrupt here as anywhere."""
        while self._thread.is_alive():
            self._thread.join(1.0)  # on Windows, Ctrl-C cannot interrupt an endless join

    def __enter__(self) -> Viewer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Viewer({self.url!r})"

    def _run(self) -> None:
        server = self._server
        startup = server.startup

        async def startup_then_tell(*args: Any, **kwargs: Any) -> None:
            await startup(*args, **kwargs)
            self._started.set()

        server.startup = startup_then_tell  # type: ignore[method-assign]
        try:
            server.run(sockets=[self._socket])
        finally:
            self._started.set()


def view(
    target: Any,
    view: View | None = None,
    *,
    radii: ArrayLike | None = None,
    colors: ArrayLike | str | None = None,
    color_by: ArrayLike | str | None = None,
    scalars: Mapping[str, ArrayLike] | None = None,
    widget: bool | None = None,
    height: int = 480,
    renderer: Renderer = "browser",
    host: str = "127.0.0.1",
    port: int = 0,
    open_browser: bool = True,
    block: bool = True,
    threads: int | None = None,
    announce: Callable[[str], None] | None = None,
    **session_options: Any,
) -> Viewer | ViewerWidget:
    """Show particles, with light that arrives while you look around: in a notebook's cell, elsewhere in a browser tab.

    >>> luxel.view(positions, radii=0.5, color_by=temperature)

    Parameters
    ----------
    target
        A file or pattern, or a list of them, a `Series`, `Particles` or a list of them, a `Scene`, an (N, 3) array of
        positions, baked textures or their path, or a `Session` that is already there.
    view
        Camera, colours and tone to start with; overrides the session's.
    radii, colors, color_by, scalars
        Of an array of positions, see :func:`luxel.scene.from_arrays.from_arrays`: radii (N,) or one number; sRGB colours
        (N, 3), whole numbers 0..255 or others 0..1, which light makes brighter or darker without changing their hue;
        values (N,) to be shown in the view's colour map; more named values to choose from. With anything else,
        `color_by` is the name of one of its scalars.
    widget
        Whether to return a widget for a notebook, which needs no server and no port; None finds out where this runs.
        What follows, but for `threads`, is then of no use.
    height
        Of the widget in pixels.
    renderer
        What draws at first: ``"browser"``, which is sent all particles; or ``"raytrace"``: this process draws, and
        streams pictures, also of data that no browser could hold.
    host, port
        Where to listen; port 0 takes a free one. Anyone who can reach the address and knows the token can look; an address
        beyond this machine is warned about.
    open_browser
        Open a tab, if this machine has a screen.
    block
        Serve until Ctrl-C. False returns at once; call ``close()`` on the result.
    threads
        Threads that compute light; None takes all cores.
    announce
        Called once with the address when the viewer is ready; None writes it to standard output.
    **session_options
        Passed to :class:`luxel.Session`: ``model``, ``lights``, ``albedo``, ``spec`` ...

    Returns
    -------
    Viewer or ViewerWidget
        The viewer is running, unless `block`. The widget shows itself as the last value of a cell.

    Raises
    ------
    InputError
        If the address cannot be listened on, a `Session` is given together with options for a new one, or arrays
        have wrong shapes.
    MissingExtraError
        In a notebook, without ``luxel[jupyter]``.
    """
    if renderer not in get_args(Renderer):
        raise InputError(f"renderer must be one of {', '.join(get_args(Renderer))}, got {renderer!r}")
    if widget is None:
        widget = in_notebook()
    target, view = looked_at(target, view, radii=radii, colors=colors, color_by=color_by, scalars=scalars)
    owned = not isinstance(target, Session)
    if not owned and (session_options or threads is not None):
        given = ", ".join([*session_options, *(["threads"] if threads is not None else [])])
        raise InputError(f"{given}: options for a new session, but a Session was given — set them there")
    session = make_session(target, view, threads, session_options) if owned else target
    if not owned and view is not None:
        session.view = view
    try:
        if widget:
            return make_widget(session, height, owned, renderer)
        viewer = Viewer(session, host, port, owned, renderer)
    except LuxelError:
        if owned:
            session.close()
        raise
    (announce or _announce)(viewer.url)
    if open_browser:
        _open_tab(viewer.url)
    if block:
        try:
            viewer.wait()
        except KeyboardInterrupt:
            _log.info("interrupted; closing the viewer")
        finally:
            viewer.close()
    return viewer


def make_session(
    target: Any,
    view: View | None,
    threads: int | None,
    options: dict[str, Any],
    spec: TextureSpec | None = None,
) -> Session:
    """Return a session of whatever :func:`view` takes; `options` are those of :class:`luxel.Session`, `spec` is for want of another."""
    if isinstance(target, str | os.PathLike) or (
        isinstance(target, list | tuple) and isinstance(target[0], str)
    ):
        from luxel.io import open as open_series
        from luxel.textures.store.reader import is_store, open_baked

        target = (
            open_baked(target)
            if isinstance(target, str | os.PathLike) and is_store(target)
            else open_series(target)
        )
    if isinstance(target, Baked) and options:
        raise InputError(
            f"{', '.join(options)}: the light of {target.path} is baked in — bake again with another, or leave these out"
        )
    return Session(target, view=view, threads=threads, **{"spec": spec, **options})


def _listen(host: str, port: int) -> socket.socket:
    if not host:
        raise InputError(
            "the host to serve at is empty — 127.0.0.1 is this machine, 0.0.0.0 every network it is in"
        )
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        if os.name != "nt":  # there, the option would let two servers share a port
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen(64)
    except (OSError, OverflowError, ValueError, TypeError) as error:
        listener.close()
        raise InputError(
            f"cannot listen on {host} port {port}: {error} — choose another --port (0 takes a free one)"
        ) from None
    return listener


def _announce(url: str) -> None:
    sys.stdout.write(f"luxel: {url}\n")
    sys.stdout.flush()


def _open_tab(url: str) -> None:
    # Without a screen, `webbrowser` would start a text browser in the user's terminal.
    if sys.platform.startswith("linux") and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        return
    with contextlib.suppress(webbrowser.Error):
        webbrowser.open(url)
