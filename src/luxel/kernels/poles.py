"""Rows of texels near the poles of latitude-longitude maps, smoothed along themselves (see ``light.poles``)."""

from __future__ import annotations

import numpy as np

from luxel.kernels.jit import kernel

__all__ = ["smooth_rows"]


@kernel
def smooth_rows(textures, rows, shares):
    """Smooth rows of textures (K, T, T) in place; rows[i] by shares[i], (T, T): what each texel gives to each.

    No texel leaves the range of its row.
    """
    texels = textures.shape[2]
    smooth = np.zeros(texels, np.float32)
    for n in range(textures.shape[0]):
        for i in range(rows.shape[0]):
            row, share = textures[n, rows[i]], shares[i]
            low = high = row[0]
            smooth[:] = np.float32(0)
            for giver in range(texels):
                value = row[giver]
                low, high = min(low, value), max(high, value)
                for taker in range(texels):
                    smooth[taker] += value * share[giver, taker]
            for t in range(texels):
                row[t] = min(max(smooth[t], low), high)
