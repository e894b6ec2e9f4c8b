"""What stands in for a page, and for light, where the server is looked at alone."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import websocket

from luxel.app import protocol
from luxel.app.viewer import Viewer

__all__ = ["GUARD_S", "Client", "InstantBaker"]

GUARD_S = 15.0  # only ever waited for when a test is about to fail


class InstantBaker:
    """Every texel of particle k is k modulo 251."""

    def first_light(self, ids: np.ndarray) -> np.ndarray:
        return np.repeat(ids[:, None] % 251, 4, axis=1).astype(np.float32)

    def preparation(self, threads: int) -> Iterator[None]:
        return iter(())  # nothing to learn

    def bake_into(self, ids: np.ndarray, codes: np.ndarray) -> int:
        codes[:] = (ids % 251).astype(np.uint8)[:, None, None]
        return 0


class Client:
    """A page's side of the socket."""

    def __init__(self, viewer: Viewer, *, hello: bool = True, confirms: bool = False, **options: Any) -> None:
        self.confirms = confirms
        where = urlsplit(viewer.url)
        query = options.pop("query", where.query)
        self.socket = websocket.create_connection(
            f"ws://{where.netloc}/ws?{query}",
            timeout=GUARD_S,
            subprotocols=options.pop("subprotocols", [protocol.SUBPROTOCOL]),
            **{"suppress_origin": True, **options},
        )
        self.heard: list[protocol.Message] = []
        if hello:
            self.send(protocol.Hello("test"))

    def send(self, message: protocol.Message) -> None:
        self.socket.send_binary(message.encode())

    def next(self, kind: type[protocol.Message]) -> Any:
        """Wait for the next message of a kind."""
        deadline = (
            time.monotonic() + GUARD_S
        )  # the server's pings would keep a plain timeout from ever firing
        while time.monotonic() < deadline:
            opcode, data = self.socket.recv_data()
            assert opcode == websocket.ABNF.OPCODE_BINARY, f"closed: {data!r}"
            self.heard.append(protocol.decode(data))
            if self.confirms and isinstance(self.heard[-1], protocol.Tiles | protocol.Coarse):
                self.send(protocol.Confirm(self._count(protocol.Tiles), self._count(protocol.Coarse)))
            if isinstance(self.heard[-1], kind):
                return self.heard[-1]
        raise TimeoutError(f"no {kind.__name__} within {GUARD_S:g} s; heard {self.heard[-5:]}")

    def last(self, kind: type[protocol.Message]) -> Any:
        """The newest message of a kind so far."""
        return next(each for each in reversed(self.heard) if isinstance(each, kind))

    def _count(self, kind: type[protocol.Message]) -> int:
        return sum(isinstance(each, kind) for each in self.heard)

    def closed(self) -> tuple[int, str]:
        """Wait for the close frame; return its code and reason."""
        while True:
            opcode, data = self.socket.recv_data()
            if opcode == websocket.ABNF.OPCODE_CLOSE:
                return int.from_bytes(data[:2], "big"), data[2:].decode()
