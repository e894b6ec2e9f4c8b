"""Counter-based random numbers: a path's numbers depend on its key alone, never on threads or batches.

SplitMix64 (Steele, Lea, Flood 2014) keyed by (seed, particle, texel, sample, purpose); successive draws add the golden gamma.
"""

from __future__ import annotations

import numpy as np

from luxel.kernels.jit import kernel

__all__ = ["PURPOSE_COARSE", "PURPOSE_PIXEL", "PURPOSE_TEXEL", "next_state", "path_key", "uniform"]

PURPOSE_TEXEL = 1
PURPOSE_PIXEL = 2
PURPOSE_COARSE = 3

_GAMMA = np.uint64(0x9E3779B97F4A7C15)
_MIX_A = np.uint64(0xBF58476D1CE4E5B9)
_MIX_B = np.uint64(0x94D049BB133111EB)
_UNIT = np.float32(1.0 / (1 << 24))


@kernel(inline=True)
def _mix(z):
    z = (z ^ (z >> np.uint64(30))) * _MIX_A
    z = (z ^ (z >> np.uint64(27))) * _MIX_B
    return z ^ (z >> np.uint64(31))


@kernel(inline=True)
def path_key(seed, item, texel, sample, purpose):
    """Key of one path: its state before the first draw (uint64)."""
    state = _mix(np.uint64(seed) + _GAMMA * np.uint64(purpose))
    state = _mix(state ^ np.uint64(item))
    return _mix(state ^ (np.uint64(texel) << np.uint64(32)) ^ np.uint64(sample))


@kernel(inline=True)
def next_state(state):
    """Advance the counter of a path."""
    return state + _GAMMA


@kernel(inline=True)
def uniform(state):
    """Two numbers in [0, 1) for the present counter (float32 each)."""
    z = _mix(state)
    return np.float32(z >> np.uint64(40)) * _UNIT, np.float32(
        (z >> np.uint64(8)) & np.uint64(0xFFFFFF)
    ) * _UNIT
