"""Luminance as 8-bit codes."""

from __future__ import annotations

import numpy as np

from luxel.kernels.jit import kernel
from luxel.kernels.memory import float_lines, int_lines
from luxel.kernels.simd import LANES, load, splat, store, to_int, vmax, vmin, vsqrt

__all__ = ["pack_codes"]

_ZERO, _HALF, _ONE, _MOST = (np.float32(x) for x in (0, 0.5, 1, 255))


@kernel
def pack_codes(luminance, scale, unit, root, codes):
    """Write the codes of luminance, both (n,), see ``textures.encode``; returns how many are above `scale`, whose inverse is `unit`.

    Sixteen at a time, also the last, so that a square root does not depend on what stands beside it.
    """
    values, rounded = float_lines(LANES), int_lines(LANES)
    clipped, count = 0, luminance.shape[0]
    for first in range(0, count, LANES):
        last = min(count, first + LANES)
        for k in range(first, last):
            values[k - first] = luminance[k]
            clipped += luminance[k] > scale
        share = vmin(vmax(splat(unit) * load(values, 0), splat(_ZERO)), splat(_ONE))
        if root:
            share = vsqrt(share)
        store(rounded, 0, to_int(share * splat(_MOST) + splat(_HALF)))
        for k in range(first, last):
            codes[k] = np.uint8(rounded[k - first])
    return clipped
