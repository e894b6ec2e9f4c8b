"""Rows of texels near the poles of latitude-longitude maps, smoothed along themselves (see ``light.poles``)."""

from __future__ import annotations

import numpy as np

from luxel.kernels.jit import kernel

__all__ = ["smooth_rows"]


@kernel
def smooth_rows(textures, exposed, least, rows, shares):
    """Smooth `rows` of textures (K, T, T) in place; `shares` (T, T, T) says what each texel of each row gives to each.

    Rows keep their mean, and no texel leaves the range of its row. Those of which fewer than `least` texels have samples that are `exposed`
    (K, T, T) stay as they are.
    """
    texels = textures.shape[2]
    smooth = np.zeros(texels, np.float32)
    for n in range(textures.shape[0]):
        for r in rows:
            row, share = textures[n, r], shares[r]
            known = 0
            for t in range(texels):
                known += exposed[n, r, t] > 0
            if known < least:
                continue
            low = high = row[0]
            before = after = np.float32(0)
            smooth[:] = np.float32(0)
            for giver in range(texels):
                value = row[giver]
                low, high, before = min(low, value), max(high, value), before + value
                for taker in range(texels):
                    smooth[taker] += value * share[giver, taker]
            for t in range(texels):
                smooth[t] = min(max(smooth[t], low), high)
                after += smooth[t]
            # What has been cut off is taken back from all the others, in proportion to how far from that end they are.
            end = low if after > before else high
            room = np.float32(texels) * end - after
            scale = (np.float32(texels) * end - before) / room if abs(room) > 0 else np.float32(1)
            for t in range(texels):
                row[t] = end - (end - smooth[t]) * min(scale, np.float32(1))
