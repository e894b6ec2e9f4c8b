"""All pages that watch one session: what each has been told, and what it gets next."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import itertools
import logging
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from luxel.app import baked, order, parts, protocol, state
from luxel.app.comparison import Comparison
from luxel.app.page import Page
from luxel.app.streaming import Streaming
from luxel.dynamic.work import CoarseBatch, TileBatch
from luxel.errors import LuxelError, ProtocolError
from luxel.kernels.jit import cold
from luxel.particles import Particles
from luxel.scene.saved import SavedView
from luxel.scene.view import View
from luxel.session import Session
from luxel.textures.store.reader import BakedFrame
from luxel.trace.spheres import SphereSet

__all__ = ["Hub", "Page", "Renderer", "cold_notice"]

Renderer = Literal["browser", "raytrace"]

_log = logging.getLogger(__name__)
_DRAWERS = {"browser": "browser", "raytrace": "server"}
_STATUS_PERIOD_S = 0.25
_IDLE_PERIOD_S = 0.5  # between looks whether somebody changed the session from Python


def cold_notice() -> str:
    """Return what pages say until the first textures arrive, if kernels have to be compiled first."""
    return "Compiling light kernels for this machine (once) …" if cold() else ""


class Hub:
    """Carries messages between a session and its pages.

    Everything runs on the event loop but the session's own calls, which may take long and go to threads. Only
    `_hear`, the session's listener, is called from elsewhere.

    Parameters
    ----------
    session
        What pages show.
    notice
        What they say until the first textures arrive.
    renderer
        What draws: ``"browser"``, or ``"raytrace"`` on the server, until a page wants it otherwise.
    """

    def __init__(self, session: Session, notice: str = "", renderer: Renderer = "browser") -> None:
        self.session = session
        self.notice = notice
        self.renderer: Renderer = renderer
        self.pages: set[Page] = set()
        self._streaming = Streaming(session, self.pages)
        self._comparison = Comparison(session, self.pages)
        self._numbers = itertools.count(1)
        self._epoch = 0
        self._particles: Particles | None = None
        self._order: order.Order | None = None  # in which pages have them, if not that of the file
        self._key = ""
        self._baked: BakedFrame | None = None  # what pages get whole, instead of tiles
        self._baked_read = False
        self._loop: asyncio.AbstractEventLoop | None = None
        self._unsubscribe: tuple[Callable[[], None], ...] = ()
        self._status_timer: asyncio.TimerHandle | None = None
        self._status_sent: protocol.Status | None = None
        self._chase: asyncio.Future[None] | None = None
        self._reading: asyncio.Future[None] | None = None

    def start(self) -> None:
        """Begin to listen to the session; called on the event loop."""
        self._loop = asyncio.get_running_loop()
        session = self.session
        self._unsubscribe = (session.subscribe(self._hear), session.subscribe_coarse(self._hear))
        self._streaming.start()

    def stop(self) -> None:
        """Stop listening and drawing."""
        self._streaming.stop()
        for unsubscribe in self._unsubscribe:
            unsubscribe()
        if self._status_timer is not None:
            self._status_timer.cancel()

    def join(self) -> Page:
        """Add a page; it is told everything once it has said hello."""
        page = Page(f"page {next(self._numbers)}")
        self.pages.add(page)
        return page

    async def leave(self, page: Page) -> None:
        """Remove a page; what only it wanted is not worth computing any more."""
        self.pages.discard(page)
        self._streaming.leave(page)
        await asyncio.to_thread(self.session.forget, page.name)
        await self._comparison.choose(page, None)

    async def receive(self, page: Page, data: bytes) -> None:
        """Act on a message from a page.

        Raises
        ------
        ProtocolError
            If the message is malformed; the caller closes the connection.
        """
        message = protocol.decode_client(data)
        if not page.greeted and not isinstance(message, protocol.Hello):
            raise ProtocolError("the first message must be a hello")
        try:
            await self._act(page, message)
        except ProtocolError:
            raise
        except LuxelError as error:
            page.post("error", functools.partial(protocol.Error, str(error)))

    def next_message(self, page: Page) -> protocol.Message | None:
        """Return what to send to `page` now, if anything."""
        message = self._next(page)
        if self._order is not None and isinstance(message, protocol.Tiles | protocol.Coarse):
            return replace(message, ids=self._order.to_page[message.ids])
        return message

    def _next(self, page: Page) -> protocol.Message | None:
        posted = page.next_posted()
        if posted is not None or not page.greeted:
            return posted
        if (part := page.download.take()) is not None:
            return part
        while (ids := page.coarse.take()) is not None:
            first = self.session.first_light(ids, self._key)
            if len(first):
                return protocol.Coarse.of(self._key, first.ids, first.records, self.session.scale)
            page.coarse.withdraw()  # the light has just changed
        while (ids := page.feed.take()) is not None:
            batch = self.session.tiles(ids, self._key)
            if len(batch.ids):
                page.feed.estimated(batch.ids, batch.estimate)
                return protocol.Tiles(self._key, batch.ids, batch.codes, batch.estimate.astype(np.uint8))
            page.feed.withdraw()  # evicted meanwhile; the page will ask again
        if (tiles := self._comparison.next_tiles(page)) is not None:
            return tiles
        if self._baked is not None and (block := page.parts.take(page.held)) is not None:
            return baked.payload(self._baked, block, self._order)
        return None

    async def _act(self, page: Page, message: protocol.PageMessage) -> None:
        match message:
            case protocol.Hello():
                _log.info(
                    "%s connected, drawing with %s", page.name, _clean(message.renderer) or "unknown hardware"
                )
                await self._catch_up()
                page.greeted = True
                page.streamed = (message.by or _DRAWERS[self.renderer]) == "server"
                self._introduce(page)
                self._status_soon()
            case protocol.Sighted():
                await self._sighted(page, message)
            case protocol.Confirm():
                page.feed.confirm(message.batches)
                page.coarse.confirm(message.coarse)
                page.parts.confirm(message.parts)
                page.beside.confirm(message.beside)
                page.wake.set()
            case protocol.SetLight():
                await self._set_light(message)
            case protocol.SetFrame():
                await asyncio.to_thread(self.session.set_frame, message.frame)
                await self._catch_up()
            case protocol.ScalarRequest():
                await parts.send_scalar(page, self.session.particles, message, self._epoch, self._order)
            case protocol.GeometryRequest():
                # Else it crossed another time step on its way, or the server draws.
                if self._particles is not None and message.epoch == self._epoch == page.epoch:
                    parts.send_geometry(page, self._particles, message, self._order)
            case protocol.ColormapRequest():
                found = await asyncio.to_thread(state.colormap, message.name)
                page.post(("colormap", message.name), lambda: found)
            case protocol.SetView():
                page.view = await asyncio.to_thread(View.from_json, message.view)
            case protocol.LoadView():
                await self._load_view(page, message.saved)
            case protocol.Inspect():
                numbers = None if page.streamed else self._order
                told = state.particle(self.session.particles, message.id, self._epoch, numbers)
                page.post("particle", lambda: told)
            case protocol.Compare():
                begins = await self._comparison.choose(page, message.model)
                await self._catch_up()
                if begins:
                    self._comparison.introduce(page)
                self._streaming.news()
            case protocol.Report():
                _log.warning("%s reports: %s", page.name, _clean(message.text))
            case protocol.DrawBy():
                self._draw_by(page, streamed=message.by == "server")
            case _:
                self._streaming.act(page, message)

    def _draw_by(self, page: Page, *, streamed: bool) -> None:
        """Draw for a page, or let it draw."""
        page.streamed = streamed
        if not streamed:
            self._streaming.draw_no_more(page)
            if page.epoch != self._epoch:
                self._introduce(page)  # particles and all, which it has not been sent

    async def _sighted(self, page: Page, message: protocol.Sighted) -> None:
        await self._catch_up()
        particles = self._particles
        beside = message.key != self._key and page.compares and message.key == self._comparison.key
        if not (beside or message.key == self._key) or particles is None:
            return  # it crossed a change of light on its way
        ids = np.unique(message.ids)
        if len(ids) and (ids[0] < 0 or ids[-1] >= len(particles)):
            raise ProtocolError(f"ids must lie in 0..{len(particles) - 1}, got {ids[0]}..{ids[-1]}")
        if self._baked is not None:
            page.parts.want(ids)
            return
        if self._order is not None:
            ids = np.sort(self._order.to_file[ids])
        spheres = SphereSet.of(particles)
        eye = spheres.center + spheres.unit * np.asarray(message.eye)
        if beside:
            await self._comparison.sighted(page, ids, eye, message.key)
            return
        page.feed.want(ids)
        page.coarse.want(ids)
        await asyncio.to_thread(self.session.sighted, ids, eye, page.name, message.key)
        ready = await asyncio.to_thread(self.session.tiles, ids, message.key)
        first = await asyncio.to_thread(self.session.first_light, ids, message.key)
        if message.key == self._key:
            page.feed.publish(ready.ids, ready.estimate)
            page.coarse.publish(np.setdiff1d(first.ids, ready.ids, assume_unique=True))
            page.wake.set()
        self._status_soon()

    async def _set_light(self, message: protocol.SetLight) -> None:
        changes = state.light_changes(self.session, message)
        await asyncio.to_thread(functools.partial(self.session.relight, **changes))
        await self._catch_up()

    async def _load_view(self, page: Page, data: Mapping[str, Any]) -> None:
        """Show a saved view: its light and frame on all pages, its camera and colours on this one."""
        view, note = await asyncio.to_thread(lambda: state.restore(self.session, SavedView.from_json(data)))
        await self._catch_up()
        page.view = view
        page.post("view", lambda: protocol.ViewState(view.to_json()))
        if note:
            page.post("error", lambda: protocol.Error(note))

    async def _catch_up(self) -> None:
        """Tell all pages if the session's frame or light is not what they were told last."""
        session = self.session
        if session.particles.unscaled is not self._particles:
            # The first look at new particles normalises them, which takes a while for millions.
            particles = session.particles.unscaled
            numbers = await asyncio.to_thread(order.order_of, particles)
            if particles is self._particles:
                return  # two pages came at once, and all is told already
            self._particles, self._key, self._order = particles, session.key, numbers
            self._comparison.key = session.key_beside
            self._epoch += 1
            self._streaming.epoch = self._epoch
            stored = session.stored
            self._baked = stored if stored is not None and baked.fits_page(stored) else None
            self._baked_read = False
            if self._baked is not None:
                self._reading = asyncio.ensure_future(self._read_baked(self._baked))
            for page in self.pages:
                if page.greeted:
                    page.clear()
                    self._streaming.dropped(page)
                    self._introduce(page)
            self._streaming.news()
            return
        if session.key != self._key:
            self._key = session.key
            self._streaming.news()
            made = state.light_state(session)
            for page in self.pages:
                if page.greeted:
                    page.reset(len(session.particles))
                    page.post("light", lambda: made)
            self._status_soon()
        self._comparison.catch_up()

    def _introduce(self, page: Page) -> None:
        """Post the whole scene."""
        particles = self.session.particles
        page.reset(len(particles))
        epoch = self._epoch
        parted = self._order is not None and not page.streamed
        how = functools.partial(state.scene_state, streamed=page.streamed, first=order.FIRST if parted else 0)
        scene = functools.partial(how, self.session, epoch, self.notice)
        page.post("scene", scene)
        page.post("light", functools.partial(state.light_state, self.session))
        page.post("status", functools.partial(state.status, self.session))
        self._comparison.introduce(page)
        if page.streamed:
            return
        page.epoch = epoch
        page.held = 0 if parted else len(particles)
        for part in () if parted else state.geometry(particles, epoch):
            page.post(("geometry", part.start), functools.partial(_same, part))
        if self._baked_read:
            self._offer(page)

    async def _read_baked(self, frame: BakedFrame) -> None:
        """Read textures from disk, which takes a while for millions, then offer them to all pages."""
        try:
            await asyncio.to_thread(lambda: (frame.codec, frame.payload))
        except LuxelError as error:
            text = str(error)
            for page in self.pages:
                page.post("error", lambda: protocol.Error(text))
            return
        if frame is self._baked:
            self._baked_read = True
            for page in self.pages:
                if page.greeted and page.epoch == self._epoch:
                    self._offer(page)

    def _offer(self, page: Page) -> None:
        """Post how textures are decoded; the textures follow."""
        frame = self._baked
        assert frame is not None
        page.post("codec", functools.partial(baked.codec_state, frame))
        page.parts.reset(frame.count, baked.part_size(frame.count, frame.payload_bytes))

    def _hear(self, batch: TileBatch | CoarseBatch) -> None:
        """Hear of finished work; called from the worker threads of the session."""
        self._streaming.news()
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # the loop has just closed
                self._loop.call_soon_threadsafe(self._publish, batch)

    def _publish(self, batch: TileBatch | CoarseBatch) -> None:
        if isinstance(batch, TileBatch):
            self.notice = ""  # what there was to wait for is over
        if batch.key == self._key:
            for page in self.pages:
                if isinstance(batch, CoarseBatch):
                    news = page.coarse.publish(batch.ids)
                else:
                    news = page.feed.publish(batch.ids, batch.estimate)
                if news:
                    page.wake.set()
        elif isinstance(batch, TileBatch) and batch.key == self._comparison.key:
            self._comparison.publish(batch)
        self._status_soon()

    def _status_soon(self, period_s: float = _STATUS_PERIOD_S) -> None:
        if self._loop is None or not self.pages:
            return
        if self._status_timer is not None:
            if self._status_timer.when() <= self._loop.time() + period_s:
                return
            self._status_timer.cancel()
        self._status_timer = self._loop.call_later(period_s, self._send_status)

    def _send_status(self) -> None:
        self._status_timer = None
        session = self.session
        keys = self._key, self._comparison.key
        if session.particles.unscaled is not self._particles or keys != (session.key, session.key_beside):
            self._chase = asyncio.ensure_future(self._catch_up())  # changed from Python, not by a page
        now = state.status(session)
        if self._status_sent is None or vars(now) != vars(self._status_sent):
            self._status_sent = now
            for page in self.pages:
                if page.greeted:
                    page.post("status", lambda: now)
        self._status_soon(
            _STATUS_PERIOD_S if now.queued or now.baking or now.textures_per_s else _IDLE_PERIOD_S
        )


def _same(message: protocol.Message) -> protocol.Message:
    return message


def _clean(text: str) -> str:
    """Make text from a page fit for one line of a log."""
    return "".join(c if c.isprintable() else " " for c in text).encode(errors="replace").decode()
