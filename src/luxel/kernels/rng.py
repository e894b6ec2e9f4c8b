"""Counter-based random numbers: a path's numbers depend on its key alone, never on threads or batches.

SplitMix64 (Steele, Lea, Flood 2014) keyed by (seed, particle, texel, sample, purpose); successive draws add the golden gamma.
"""

from __future__ import annotations

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.simd import top_fraction

__all__ = [
    "PURPOSE_COARSE",
    "PURPOSE_PIXEL",
    "PURPOSE_TEXEL",
    "next_state",
    "path_key",
    "sample_key",
    "texel_key",
    "uniform",
    "uniforms",
]

PURPOSE_TEXEL = 1
PURPOSE_PIXEL = 2
PURPOSE_COARSE = 3

_GAMMA = np.uint64(0x9E3779B97F4A7C15)
_MIX_A = np.uint64(0xBF58476D1CE4E5B9)
_MIX_B = np.uint64(0x94D049BB133111EB)
_UNIT = np.float32(1.0 / (1 << 24))
_LOWER = np.uint64(1 << 32)  # moves bits 8 … 31 to the top


@kernel(inline=True)
def _mix(z):
    z = (z ^ (z >> np.uint64(30))) * _MIX_A
    z = (z ^ (z >> np.uint64(27))) * _MIX_B
    return z ^ (z >> np.uint64(31))


@kernel(inline=True)
def path_key(seed, item, texel, sample, purpose):
    """Key of one path: its state before the first draw (uint64)."""
    return sample_key(texel_key(seed, item, texel, purpose), np.uint64(sample))


@kernel(inline=True)
def texel_key(seed, item, texel, purpose):
    """What the keys of all samples of a texel share, see `sample_key`."""
    state = _mix(np.uint64(seed) + _GAMMA * np.uint64(purpose))
    return _mix(state ^ np.uint64(item)) ^ (np.uint64(texel) << np.uint64(32))


@kernel(inline=True)
def sample_key(key, sample):
    """`path_key` of one sample, uint64, of a texel, or of sixteen."""
    return _mix(key ^ sample)


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


@kernel(inline=True)
def uniforms(states):
    """As `uniform`, of sixteen counters."""
    z = _mix(states)
    return top_fraction(z), top_fraction(z * _LOWER)
