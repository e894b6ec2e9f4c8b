"""What a store holds, as plain values fit for JSON."""

from __future__ import annotations

from typing import Any

import numpy as np

from luxel.textures.store.reader import Baked

__all__ = ["describe_baked"]


def describe_baked(baked: Baked) -> dict[str, Any]:
    """Describe a store with values that JSON can hold.

    Returns
    -------
    dict
        ``path``, ``source`` (file name), ``luxel`` (version), ``settings`` (scene, spec and codec), and ``frames``, a
        list: ``source_frame``, ``time``, ``particles``, ``scalars``, ``key``, ``raw_bytes``, ``payload_bytes`` and
        ``shared_bytes`` of all its textures, ``ratio`` (raw over compressed), ``clipped`` texels, ``distortion`` by
        the codec, and the expected error of a texel in luminance: ``error_mean`` and ``error_max``.
    """
    frames = []
    for frame in baked:
        raw = frame.count * baked.spec.texels**2
        payload = frame.count * frame.payload_bytes
        frames.append(
            {
                "source_frame": frame.source_frame,
                "time": frame.time,
                "particles": frame.count,
                "scalars": frame.scalar_names,
                "key": frame.key,
                "raw_bytes": raw,
                "payload_bytes": payload,
                "shared_bytes": frame.shared_bytes,
                "ratio": raw / (payload + frame.shared_bytes),
                "clipped": frame.clipped_count,
                "distortion": dict(frame.distortion),
                "error_mean": float(np.mean(frame.errors, dtype=np.float64)),
                "error_max": float(np.max(frame.errors)),
            }
        )
    return {
        "path": baked.path,
        "source": baked.source,
        "luxel": baked.luxel,
        "settings": baked.settings.to_json(),
        "frames": frames,
    }
