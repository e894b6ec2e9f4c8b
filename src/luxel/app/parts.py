"""Particles and scalars that a page asks for part by part."""

from __future__ import annotations

import asyncio
import functools

from luxel.app import protocol, state
from luxel.app.order import Order
from luxel.app.page import Page
from luxel.errors import ProtocolError
from luxel.particles import Particles

__all__ = ["send_geometry", "send_scalar"]


async def send_scalar(
    page: Page, particles: Particles, message: protocol.ScalarRequest, epoch: int, numbers: Order | None
) -> None:
    """Send a page values of a scalar; their ranges alone while the server draws for it.

    Raises
    ------
    LuxelError
        If there is no such scalar, or the page does not take in what it has asked for.
    """
    page.bear()
    made = await asyncio.to_thread(state.scalar, particles, message, epoch, numbers, not page.streamed)
    page.post(("scalar", message.name, message.start), lambda: made)


def send_geometry(
    page: Page, particles: Particles, message: protocol.GeometryRequest, numbers: Order | None
) -> None:
    """Send a page the particles that it asks for.

    Raises
    ------
    ProtocolError
        If there are no such particles, or the page does not take in what it has asked for.
    """
    if message.start >= len(particles):
        raise ProtocolError(f"no particle {message.start}: there are {len(particles)}")
    page.bear()
    page.held = max(page.held, message.start + message.count)
    part = functools.partial(
        state.geometry_part, particles, message.epoch, message.start, message.count, numbers
    )
    page.post(("geometry", message.start), part)
