"""Textures as they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxel.textures.codecs.protocol import Codes, as_codes, as_payload, setting

__all__ = ["RawCodec"]


@dataclass(frozen=True)
class RawCodec:
    """One byte a texel; see :class:`luxel.textures.codecs.Codec`.

    Parameters
    ----------
    texels
        Rows and columns.
    """

    texels: int = 16
    kind = "raw"

    @property
    def payload_bytes(self) -> int:
        """Bytes a texture."""
        return self.texels**2

    @property
    def shared(self) -> dict[str, NDArray[Any]]:
        """Nothing."""
        return {}

    @property
    def shared_bytes(self) -> int:
        """0."""
        return 0

    def describe(self) -> dict[str, Any]:
        """Settings fit for JSON."""
        return {"kind": self.kind, "texels": self.texels}

    @classmethod
    def restore(cls, description: dict[str, Any], shared: dict[str, NDArray[Any]]) -> RawCodec:
        """Rebuild from what :meth:`describe` gave."""
        del shared
        return cls(setting(description, "texels", 1, 64))

    def encode(self, codes: Codes) -> NDArray[np.uint8]:
        """Turn (K, T, T) codes into records (K, T²)."""
        return np.asarray(as_codes(codes, self.texels)).reshape(-1, self.payload_bytes)

    def decode(self, payload: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Turn records (K, T²) into codes (K, T, T)."""
        return as_payload(payload, self.payload_bytes).reshape(-1, self.texels, self.texels)

    def lookup(self, payload: NDArray[np.uint8]) -> Any:
        """Return the codes themselves."""
        return self.decode(payload)
