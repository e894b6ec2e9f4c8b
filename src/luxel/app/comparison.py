"""The light that pages show beside the session's, for comparing: who looks, and what they have been told."""

from __future__ import annotations

import asyncio
from typing import cast

import numpy as np
from numpy.typing import NDArray

from luxel.app import protocol, state
from luxel.app.page import Page
from luxel.dynamic.work import TileBatch
from luxel.errors import LuxelError
from luxel.scene.scene import Model
from luxel.session import Session

__all__ = ["Comparison"]


class Comparison:
    """The second light of a session and the pages that look at it. It is one for all: the last page to choose chooses for all that compare.

    Belongs to the event loop; the session's own calls, which may take long, go to threads.

    Parameters
    ----------
    session
        Whose light.
    pages
        All pages, kept by the caller.

    Attributes
    ----------
    key
        The light key that pages were told last, None while none compares.
    """

    def __init__(self, session: Session, pages: set[Page]) -> None:
        self.key: str | None = None
        self._session = session
        self._pages = pages

    async def choose(self, page: Page, model: str | None) -> bool:
        """Show a page another model beside the session's, or no longer; return whether it has just begun to compare.

        Raises
        ------
        LuxelError
            If that model cannot be shown; then all stays as it was.
        """
        before, page.compares = page.compares, model is not None
        if model is None:
            page.beside.reset(0)
            if before:
                await asyncio.to_thread(self._session.forget, _name(page))
            if before and not any(each.compares for each in self._pages):
                await asyncio.to_thread(self._session.compare, None)
                self.key = None
            return False
        try:
            await asyncio.to_thread(self._session.compare, cast(Model, model))
        except LuxelError:
            page.compares = before
            raise
        return not before

    def catch_up(self) -> None:
        """Tell those who compare, if the light is not what they were told last."""
        if self._session.key_beside != self.key:
            self.key = self._session.key_beside
            for page in self._pages:
                self.introduce(page)

    def introduce(self, page: Page) -> None:
        """Post the light, if the page compares."""
        made = state.beside_state(self._session) if page.compares else None
        if made is not None:
            page.beside.reset(len(self._session.particles))
            page.post("beside", lambda: made)

    async def sighted(self, page: Page, ids: NDArray[np.int32], eye: NDArray[np.float64], key: str) -> None:
        """Note what a page lacks of the second light."""
        page.beside.want(ids)
        await asyncio.to_thread(self._session.sighted, ids, eye, _name(page), key)
        ready = await asyncio.to_thread(self._session.tiles, ids, key)
        if key == self.key:
            page.beside.publish(ready.ids, ready.estimate)
            page.wake.set()

    def publish(self, batch: TileBatch) -> None:
        """Hand finished textures of the second light to those who want them."""
        for page in self._pages:
            if page.beside.publish(batch.ids, batch.estimate):
                page.wake.set()

    def next_tiles(self, page: Page) -> protocol.Tiles | None:
        """Return what to send to a page now, if anything."""
        key = self.key
        while page.compares and key is not None and (ids := page.beside.take()) is not None:
            batch = self._session.tiles(ids, key)
            if len(batch.ids):
                page.beside.estimated(batch.ids, batch.estimate)
                return protocol.Tiles(
                    key, batch.ids, batch.codes, batch.estimate.astype(np.uint8), beside=True
                )
            page.beside.withdraw()  # evicted meanwhile; the page will ask again
        return None


def _name(page: Page) -> str:
    """Under which a page looks at the second light."""
    return f"{page.name}, beside"
