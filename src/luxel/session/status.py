"""Status: what a session is doing."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Status"]


@dataclass(frozen=True)
class Status:
    """What a session is doing, for status lines.

    Parameters
    ----------
    key
        The current light key.
    particles
        Particles in the frame.
    ready, queued, baking, failed
        How many of them have a texture, wait for one, are being baked, or were given up after errors.
    refining
        How many of those that are ready have an estimate and wait for something better.
    evicted
        Textures of any light key given up for room since the session began.
    textures_per_s
        Over the last few seconds.
    over_budget
        Visible particles that stay without texture because the cache is full of visible ones.
    clipped
        Texels brighter than the scale since the session began.
    error
        What went wrong last, in words.
    """

    key: str
    particles: int
    ready: int = 0
    queued: int = 0
    baking: int = 0
    failed: int = 0
    refining: int = 0
    evicted: int = 0
    textures_per_s: float = 0.0
    over_budget: int = 0
    clipped: int = 0
    error: str | None = None
