"""SessionTextures: a session as renderers see it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from luxel.textures.textures import TextureTable

if TYPE_CHECKING:
    from luxel.session.session import Session

__all__ = ["SessionTextures"]


class SessionTextures:
    """A session's textures as renderers see them; a :class:`luxel.textures.textures.TextureSource`.

    Parameters
    ----------
    session
        Whose textures.
    client
        The name under which sightings of this renderer are noted.
    """

    def __init__(self, session: Session, client: str = "renderer") -> None:
        self._session = session
        self._client = client

    @property
    def key(self) -> str:
        """The session's current light key."""
        return self._session.key

    def snapshot(self, key: str) -> TextureTable:
        """See :meth:`Session.snapshot`."""
        return self._session.snapshot(key)

    def sighted(self, ids: NDArray[np.int32], eye: NDArray[np.float64]) -> None:
        """Note which particles were seen, (K,) int32, and from where, (3,) file units."""
        self._session.sighted(ids, eye, self._client)
