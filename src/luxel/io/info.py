"""What a file holds, as plain values fit for JSON."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxel.io.series import Series

__all__ = ["describe"]


def describe(series: Series, frame: int | None = None) -> dict[str, Any]:
    """Describe one time step of a series with values that JSON can hold.

    Parameters
    ----------
    series
        What :func:`luxel.open` returned.
    frame
        The step; None takes the first that has particles.

    Returns
    -------
    dict
        ``format``, ``path``, ``frames`` (how many), ``frame``, ``particles``, ``bounds`` (lowest and highest corner of the spheres, or
        None without particles), ``radii`` (min, max, mean, source), ``scalars`` (name to components, dtype, min, max,
        no_data, and categories where it has labels), ``time`` and ``cell`` (vectors, origin, periodic). Numbers that
        do not exist, such as the minimum of nothing, are None. The range of a vector is that of its magnitude.
    """
    if frame is None:
        frame = series.first_frame()
    particles = series[frame]
    count = len(particles)
    cell = particles.cell
    return {
        "format": series.format,
        "path": series.path,
        "frames": len(series),
        "frame": frame if frame >= 0 else frame + len(series),
        "particles": count,
        "bounds": particles.bounds.tolist() if count else None,
        "radii": {**_range(particles.radii, mean=True), "source": particles.radii_source},
        "scalars": {
            name: _scalar(values, particles.scalar(name), particles.categories.get(name))
            for name, values in particles.scalars.items()
        },
        "time": particles.time if particles.time is not None and math.isfinite(particles.time) else None,
        "cell": None
        if cell is None
        else {
            "vectors": cell.vectors.tolist(),
            "origin": cell.origin.tolist(),
            "periodic": [bool(flag) for flag in cell.periodic],
        },
    }


def _scalar(values: NDArray[Any], magnitude: NDArray[Any], labels: tuple[str, ...] | None) -> dict[str, Any]:
    described: dict[str, Any] = {
        "components": 1 if values.ndim == 1 else values.shape[1],
        "dtype": values.dtype.name,
        **_range(magnitude),
        "no_data": int(np.count_nonzero(np.isnan(magnitude))) if magnitude.dtype.kind == "f" else 0,
    }
    if labels is not None:
        described["categories"] = list(labels)
    return described


def _range(values: NDArray[Any], *, mean: bool = False) -> dict[str, float | int | None]:
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return {"min": None, "max": None, **({"mean": None} if mean else {})}
    low, high = finite.min().item(), finite.max().item()
    return {"min": low, "max": high, **({"mean": float(finite.mean(dtype=np.float64))} if mean else {})}
