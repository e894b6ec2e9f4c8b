"""Colours: named colours, colour maps as tables, and the sRGB curve."""

from __future__ import annotations

import difflib
import re
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from luxel.errors import InputError

__all__ = ["RGB", "colormap_names", "colormap_table", "hex_color", "linear_to_srgb", "rgb", "srgb_to_linear"]

# What a scientist reaches for comes first in menus: perceptually uniform, then diverging, cyclic, grey, categorical.
_SHORTLIST = (
    "viridis",
    "inferno",
    "magma",
    "plasma",
    "cividis",
    "turbo",
    "coolwarm",
    "RdBu_r",
    "Spectral_r",
    "twilight",
    "gray",
    "bone",
    "tab10",
    "tab20",
    "Set1",
    "Set2",
)
_ROW_COUNT = 256
#: No map: the three components of a vector are the colours themselves, sRGB.
RGB = "rgb"
_HEX = re.compile(r"#[0-9a-f]{6}")


def srgb_to_linear(srgb: ArrayLike) -> NDArray[np.floating]:
    """Turn sRGB values in [0, 1] into linear light (IEC 61966-2-1); float32 stays float32, the rest is float64."""
    value = _as_float(srgb)
    high = ((np.maximum(value, 0.0) + 0.055) / 1.055) ** 2.4
    return np.asarray(np.where(value <= 0.04045, value / 12.92, high), dtype=value.dtype)


def linear_to_srgb(linear: ArrayLike) -> NDArray[np.floating]:
    """Inverse of :func:`srgb_to_linear`: linear light in [0, 1] to sRGB values in [0, 1]."""
    value = _as_float(linear)
    high = 1.055 * np.maximum(value, 0.0) ** (1 / 2.4) - 0.055
    return np.asarray(np.where(value <= 0.0031308, value * 12.92, high), dtype=value.dtype)


def hex_color(color: object, what: str = "color") -> str:
    """Return any colour that matplotlib understands (``"white"``, ``"#d9d5cc"``, ``"0.2"``, a triple) as ``"#rrggbb"``.

    Raises
    ------
    InputError
        For anything else, and for colours that are transparent.
    """
    if isinstance(color, str) and _HEX.fullmatch(color):  # spares views made of defaults the import
        return color
    from matplotlib import colors

    try:
        channels = colors.to_rgba(color)
    except (ValueError, TypeError):
        near = difflib.get_close_matches(str(color).lower(), colors.get_named_colors_mapping(), n=3)
        hint = f"; did you mean {', '.join(near)}?" if near else ""
        raise InputError(
            f"{what} must be a colour such as white, #d9d5cc or 0.2; got {color!r}{hint}"
        ) from None
    if channels[3] != 1.0:
        raise InputError(f"{what} must be opaque, got {color!r}")
    return str(colors.to_hex(channels))


def rgb(color: str) -> NDArray[np.float64]:
    """Return ``"#rrggbb"`` as (3,) sRGB values in [0, 1]."""
    return np.frombuffer(bytes.fromhex(color[1:]), dtype=np.uint8) / 255.0


def colormap_names() -> list[str]:
    """List colour maps for a menu: a good shortlist first, then all of matplotlib's, reversed ones (``_r``) left out."""
    from matplotlib import colormaps

    first = [name for name in _SHORTLIST if name in colormaps]
    rest = sorted((name for name in colormaps if not name.endswith("_r")), key=str.lower)
    return first + [name for name in rest if name not in first]


@lru_cache(maxsize=32)
def colormap_table(name: str) -> NDArray[np.uint8]:
    """(n, 3) uint8 sRGB rows of a colour map, read-only: 256, or one a colour for qualitative maps (tab10, Set1 ...).

    Raises
    ------
    InputError
        For an unknown name; the message lists the nearest.
    """
    from matplotlib import colormaps

    if name not in colormaps:
        lower = {known.lower(): known for known in colormaps}
        near = [lower[match] for match in difflib.get_close_matches(str(name).lower(), lower, n=3)]
        hint = f"did you mean {', '.join(near)}?" if near else f"such as {', '.join(_SHORTLIST[:8])}"
        raise InputError(f"no colour map {name!r} — any name that matplotlib has will do; {hint}")
    chosen = colormaps[name]
    # A map with fewer colours than rows is qualitative; its colours must not be repeated or mixed.
    channels = (
        chosen(np.arange(chosen.N)) if chosen.N < _ROW_COUNT else chosen(np.linspace(0.0, 1.0, _ROW_COUNT))
    )
    table = np.ascontiguousarray(np.round(channels[:, :3] * 255.0), dtype=np.uint8)
    table.flags.writeable = False
    return table


def _as_float(values: ArrayLike) -> NDArray[np.floating]:
    array = np.asarray(values)
    return array if array.dtype == np.float32 else array.astype(np.float64)
