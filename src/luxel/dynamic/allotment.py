"""What a cache's byte budget is spent on: textures and their slots, and tables of particles, which are set aside first."""

from __future__ import annotations

from luxel.dynamic.arena import SLOT_BYTES
from luxel.dynamic.compressor import Compressor
from luxel.dynamic.entries import ENTRY_BYTES
from luxel.dynamic.shard import kept_slots

__all__ = [
    "ALL_BYTES",
    "COARSE_BYTES",
    "COPY_BYTES",
    "LEAST_COPIES",
    "LIGHT_BYTES",
    "MAX_LIGHTS",
    "OTHER_BYTES",
    "bytes_for",
    "set_aside",
    "slot_count",
]

# What a particle's tables cost: coarse record, a copy of its slot for frames.
COARSE_BYTES, COPY_BYTES = 16, 4
LEAST_COPIES = 2
#: Light keys at a time.
MAX_LIGHTS = 16
# Set aside for them: room for so many light keys, but no more than a quarter of the budget, unless one key needs that.
LIGHT_BYTES = ENTRY_BYTES + LEAST_COPIES * COPY_BYTES
OTHER_BYTES = ENTRY_BYTES + COPY_BYTES
ALL_BYTES = LIGHT_BYTES + COPY_BYTES + COARSE_BYTES + (MAX_LIGHTS - 1) * OTHER_BYTES


def bytes_for(textures: int, texels: int, particles: int, components: int = 0) -> int:
    """Return the least budget with which a cache has a capacity of so many textures of one light key.

    Parameters
    ----------
    textures
        At least 1.
    texels
        Rows and columns of a texture.
    particles
        In the scene.
    components
        See :class:`TextureCache`.
    """
    each, fixed = texels * texels, 0
    if components:
        compressor = Compressor(texels, components)
        each, fixed = compressor.record_bytes, compressor.most_bytes
    low, high = 0, 1
    while _capacity(high, each, particles) < textures:
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        if _capacity(middle, each, particles) < textures:
            low = middle
        else:
            high = middle
    return fixed + high


def set_aside(max_bytes: int, particles: int) -> int:
    """Return the bytes of a budget that tables of particles get."""
    return max(LIGHT_BYTES * particles, min(max_bytes // 4, ALL_BYTES * particles))


def slot_count(max_bytes: int, texture_bytes: int, particles: int) -> int:
    """Return how many textures of so many bytes the rest has room for."""
    left = max_bytes - set_aside(max_bytes, particles)
    return min(max(0, left) // (texture_bytes + SLOT_BYTES), 2**31 - 1)


def _capacity(max_bytes: int, texture_bytes: int, particles: int) -> int:
    return kept_slots(slot_count(max_bytes, texture_bytes, particles))
