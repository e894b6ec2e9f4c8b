"""Stand-in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Codes = NDArray[np.uint8]


class Codec(Protocol):
    """Codec."""

    @property
    def kind(self) -> str: ...
    @property
    def texels(self) -> int: ...
    @property
    def shared(self) -> dict[str, NDArray[Any]]: ...
    @property
    def payload_bytes(self) -> int: ...
    @property
    def shared_bytes(self) -> int: ...
    def encode(self, codes: Codes) -> Codes: ...
    def decode(self, payload: Codes) -> Codes: ...
    def describe(self) -> dict[str, Any]: ...


@dataclass(frozen=True, eq=False)
class Raw:
    """Raw."""

    texels: int
    kind: str = "raw"
    shared: dict[str, NDArray[Any]] = field(default_factory=dict)
    shared_bytes: int = 0

    @property
    def payload_bytes(self) -> int:
        return self.texels**2

    def encode(self, codes: Codes) -> Codes:
        return codes.reshape(len(codes), -1)

    def decode(self, payload: Codes) -> Codes:
        return payload.reshape(len(payload), self.texels, self.texels)

    def describe(self) -> dict[str, Any]:
        return {"kind": "raw", "texels": self.texels}


@dataclass(frozen=True, eq=False)
class VQ:
    """VQ."""

    texels: int
    shared: dict[str, NDArray[Any]]
    kind: str = "vq"
    payload_bytes: int = 2

    @property
    def shared_bytes(self) -> int:
        return self.shared["codebook"].nbytes

    def encode(self, codes: Codes) -> Codes:
        book = self.shared["codebook"].astype(np.int64)
        flat = codes.reshape(len(codes), -1).astype(np.int64)
        d = (book**2).sum(1)[None] - 2 * flat @ book.T
        return d.argmin(1).astype("<u2")[:, None].view(np.uint8)

    def decode(self, payload: Codes) -> Codes:
        ids = np.ascontiguousarray(payload).view("<u2")[:, 0]
        return self.shared["codebook"][ids].reshape(-1, self.texels, self.texels)

    def describe(self) -> dict[str, Any]:
        return {"kind": "vq", "texels": self.texels}


def restore(description: Mapping[str, Any], shared: Mapping[str, NDArray[Any]]) -> Codec:
    """Restore."""
    if description["kind"] == "raw":
        return Raw(description["texels"])
    return VQ(description["texels"], dict(shared))


def train(kind: str, codes: Codes, *, seed: int = 0, progress: Any = None, **options: Any) -> Codec:
    """Train."""
    texels = codes.shape[1]
    if kind == "raw":
        return Raw(texels)
    words = options.get("codewords") or max(1, len(codes) // 8)
    flat = codes.reshape(len(codes), -1)
    return VQ(texels, {"codebook": flat[:: max(1, len(codes) // words)][:words].copy()})
