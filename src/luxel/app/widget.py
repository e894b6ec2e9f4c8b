"""The viewer as a notebook widget; needs ``luxel[jupyter]``."""

from __future__ import annotations

from types import TracebackType

import anywidget
import traitlets

from luxel.app.bundle import client_module, markup, stylesheet
from luxel.app.comm import CommServer
from luxel.app.hub import Renderer, cold_notice
from luxel.session import Session

__all__ = ["ViewerWidget"]


class ViewerWidget(anywidget.AnyWidget):  # type: ignore[misc]
    """A viewer in a notebook's cell; :meth:`close` or leaving a ``with`` block ends it.

    It may be shown any number of times. While nobody looks, it costs memory but no time.

    Attributes
    ----------
    session
        The session it shows: change frames and lights through it, and the picture follows.
    height
        Of the picture, in pixels.
    """

    _esm = client_module("widget") + "export default widget;\n"
    _markup = traitlets.Unicode(markup()).tag(sync=True)
    _style = traitlets.Unicode(stylesheet()).tag(sync=True)
    height = traitlets.Int(480, min=120, max=10_000).tag(sync=True)

    def __init__(
        self,
        session: Session,
        *,
        height: int = 480,
        owns_session: bool = False,
        renderer: Renderer = "browser",
    ) -> None:
        super().__init__(height=height)
        self.session = session
        self._owns_session = owns_session
        self._server = CommServer(session, self.send, cold_notice(), renderer)
        self.on_msg(lambda _, content, buffers: self._server.receive(content, buffers))

    def close(self) -> None:
        """Remove the viewer from the notebook, and end the session if the viewer made it."""
        server = getattr(self, "_server", None)  # also called when __init__ fails, or a second time
        if server is not None:
            server.close()
            if self._owns_session:
                self.session.close()
        super().close()

    def __enter__(self) -> ViewerWidget:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        state = self.session.status()
        return f"ViewerWidget({state.particles:,} particles, {state.ready:,} lit)"
