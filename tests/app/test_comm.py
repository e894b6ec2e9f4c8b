"""A notebook's pages over a fake comm: the messages are the socket's, and closing frees everything."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import luxel
from luxel.app import notebook, protocol
from luxel.app.comm import CommServer
from luxel.app.limits import PAGES_MAX
from luxel.errors import InputError, MissingExtraError
from luxel.session import Session
from luxel.textures.spec import TextureSpec
from tests.app.socket_client import InstantBaker
from tests.scenes import cloud

COUNT = 60
GUARD_S = 15.0


class Front:
    """The front end of one notebook, which may show several pages."""

    def __init__(self) -> None:
        self.heard: dict[str, queue.Queue[tuple[str, Any]]] = {}
        self.broken = False

    def send(self, content: dict[str, Any], buffers: list[bytes]) -> None:
        if self.broken:
            raise ConnectionError("nobody there")
        value = protocol.decode(buffers[0]) if buffers else content.get("text")
        self.heard.setdefault(content["page"], queue.Queue()).put((content["do"], value))

    def next(self, page: str, kind: str | type[protocol.Message]) -> Any:
        """Wait for the next message of a kind for a page."""
        inbox = self.heard.setdefault(page, queue.Queue())
        while True:
            what, value = inbox.get(timeout=GUARD_S)
            if what == kind or (isinstance(kind, type) and isinstance(value, kind)):
                return value


@pytest.fixture
def front() -> Front:
    return Front()


@pytest.fixture
def session() -> Iterator[Session]:
    spec = TextureSpec(texels=4, samples=1)
    frames = [cloud(COUNT), cloud(COUNT // 2, seed=1)]
    with Session(frames, spec=spec, threads=1, make_baker=lambda scene, spec: InstantBaker()) as made:
        yield made


@pytest.fixture
def server(session: Session, front: Front) -> Iterator[CommServer]:
    made = CommServer(session, front.send)
    yield made
    made.close()


def say(server: CommServer, page: str, message: protocol.Message) -> None:
    # Buffers come as memory views, from wherever the kernel's sockets keep them.
    server.receive({"page": page, "do": "message"}, [memoryview(message.encode())])


def come(server: CommServer, front: Front, page: str) -> None:
    server.receive({"page": page, "do": "open", "version": protocol.SUBPROTOCOL}, [])
    front.next(page, "opened")
    say(server, page, protocol.Hello("test"))


def test_a_page_is_told_all_and_gets_its_light(server: CommServer, front: Front, session: Session) -> None:
    come(server, front, "a")
    scene = front.next("a", protocol.SceneState)
    light = front.next("a", protocol.LightState)
    geometry = front.next("a", protocol.Geometry)
    assert (scene.count, len(geometry.radii), light.key) == (COUNT, COUNT, session.key)
    ids = np.arange(0, COUNT, 7, dtype=np.int32)
    say(server, "a", protocol.Sighted(light.key, ids, (0.0, 0.0, 3.0)))
    tiles = front.next("a", protocol.Tiles)
    np.testing.assert_array_equal(np.sort(tiles.ids), ids)
    np.testing.assert_array_equal(tiles.codes[:, 0, 0], tiles.ids % 251)


def test_pages_are_told_apart_and_follow_the_session(
    server: CommServer, front: Front, session: Session
) -> None:
    come(server, front, "a")
    come(server, front, "b")
    for page in "ab":
        front.next(page, protocol.Geometry)
    say(server, "b", protocol.ScalarRequest("value"))
    front.next("b", protocol.Scalar)
    session.set_frame(1)  # from Python, as a cell does
    for page in "ab":
        assert front.next(page, protocol.SceneState).count == COUNT // 2
    assert not any(isinstance(value, protocol.Scalar) for _, value in front.heard["a"].queue)


def test_a_ping_is_answered_without_the_servers_thread(server: CommServer, front: Front) -> None:
    server.receive({"page": "a", "do": "ping"}, [])
    assert front.heard["a"].get_nowait()[0] == "pong"


def test_a_bad_message_ends_its_page_only(server: CommServer, front: Front) -> None:
    come(server, front, "a")
    come(server, front, "b")
    server.receive({"page": "a", "do": "message"}, [b"nonsense"])
    assert "refused" in front.next("a", "end")
    for content in (None, 3, {"page": 3}, {"page": "b"}, {"page": "x" * 1000, "do": "open"}, {"do": "open"}):
        server.receive(content, [])
    say(server, "b", protocol.ColormapRequest("magma"))
    assert front.next("b", protocol.Colormap).name == "magma"
    say(server, "gone", protocol.Hello("test"))  # never opened: nothing happens


def test_another_version_is_told_so(server: CommServer, front: Front) -> None:
    server.receive({"page": "a", "do": "open", "version": "luxel.v0"}, [])
    assert "luxel.v0" in front.next("a", "end")


def test_pages_are_bounded(server: CommServer, front: Front) -> None:
    for k in range(PAGES_MAX):
        come(server, front, f"page {k}")
    server.receive({"page": "one more", "do": "open", "version": protocol.SUBPROTOCOL}, [])
    assert "close one" in front.next("one more", "end")
    server.receive({"page": "page 0", "do": "close"}, [])
    come(server, front, "one more")


def test_a_page_that_leaves_wants_nothing_any_more(
    server: CommServer, front: Front, session: Session
) -> None:
    forgotten = threading.Event()
    forget = session.forget
    session.forget = lambda client: (forget(client), forgotten.set())  # type: ignore[method-assign]
    come(server, front, "a")
    server.receive({"page": "a", "do": "close"}, [])
    assert forgotten.wait(GUARD_S)


def test_a_front_end_that_is_gone_harms_nobody(server: CommServer, front: Front, session: Session) -> None:
    forgotten = threading.Event()
    forget = session.forget
    session.forget = lambda client: (forget(client), forgotten.set())  # type: ignore[method-assign]
    come(server, front, "a")
    front.broken = True
    session.set_frame(1)
    assert forgotten.wait(GUARD_S)  # the page was let go
    front.broken = False
    come(server, front, "b")
    front.next("b", protocol.Geometry)


def test_closing_says_so_and_ends_the_thread(session: Session, front: Front) -> None:
    server = CommServer(session, front.send)
    come(server, front, "a")
    thread = server._thread
    server.close()
    server.close()
    assert "closed" in front.next("a", "end")
    assert not thread.is_alive()
    server.receive(
        {"page": "a", "do": "open", "version": protocol.SUBPROTOCOL}, []
    )  # too late: nothing happens


def test_closing_the_widget_frees_the_session_it_made() -> None:
    before = set(threading.enumerate())
    widget = luxel.view(cloud(COUNT), widget=True, threads=2, height=300)
    assert widget.get_state()["height"] == 300
    assert "60 particles" in repr(widget)
    assert set(threading.enumerate()) > before
    widget.close()
    widget.close()
    assert set(threading.enumerate()) <= before
    with pytest.raises(luxel.LuxelError, match="closed"):
        widget.session.set_frame(0)


def test_closing_the_widget_leaves_the_session_it_was_given(session: Session) -> None:
    with luxel.view(session, widget=True):
        pass
    session.set_frame(1)
    with pytest.raises(InputError, match="options for a new session"):
        luxel.view(session, widget=True, threads=1)


class Shell:
    kernel = object()


def test_a_notebook_is_told_from_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not notebook.in_notebook()
    import IPython

    monkeypatch.setattr(IPython, "get_ipython", lambda: None)
    assert not notebook.in_notebook()
    monkeypatch.setattr(IPython, "get_ipython", object)  # a terminal's shell has no kernel
    assert not notebook.in_notebook()
    monkeypatch.setattr(IPython, "get_ipython", Shell)
    assert notebook.in_notebook()
    with luxel.view(cloud(COUNT), threads=1) as widget:
        assert type(widget).__name__ == "ViewerWidget"


def test_without_anywidget_the_remedy_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(notebook.importlib.util, "find_spec", lambda name: None)
    before = set(threading.enumerate())
    with pytest.raises(MissingExtraError, match=r"pip install 'luxel\[jupyter\]'"):
        luxel.view(cloud(COUNT), widget=True)
    assert set(threading.enumerate()) <= before
