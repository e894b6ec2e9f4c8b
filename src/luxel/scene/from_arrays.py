"""Plain arrays in place of particles: what `luxel.view`, `luxel.render` and `luxel.export` take directly."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from luxel.arrays import as_colors, as_points
from luxel.errors import InputError
from luxel.particles import Particles
from luxel.scene.colormap import RGB, hex_color
from luxel.scene.view import View

__all__ = ["from_arrays", "is_array", "looked_at"]


def is_array(target: object) -> bool:
    """Whether `target` is an array of positions, or something that becomes one: a list of points, a data frame."""
    if isinstance(target, list | tuple):
        return not len(target) or not isinstance(target[0], str | Particles)
    return hasattr(target, "__array__")


def from_arrays(
    positions: ArrayLike,
    view: View | None = None,
    *,
    radii: ArrayLike | None = None,
    colors: ArrayLike | str | None = None,
    color_by: ArrayLike | str | None = None,
    scalars: Mapping[str, ArrayLike] | None = None,
) -> tuple[Particles, View]:
    """Make particles, and a view that shows their colours.

    Parameters
    ----------
    positions
        (N, 3).
    view
        Everything else about the picture; `colors` and `color_by` override its colours.
    radii
        One number or (N,); None estimates one from the spacing.
    colors
        sRGB colours, which light makes brighter or darker without changing their hue: (N, 3) whole numbers 0..255 or
        others 0..1. Or one colour for all: ``"tomato"``, ``(1, 0.4, 0.3)``.
    color_by
        (N,) values to be shown in the view's colour map, (N, k) to be shown by magnitude, or the name of one of `scalars`.
    scalars
        Further named values to colour by.

    Raises
    ------
    InputError
        For wrong shapes or dtypes, or both `colors` and `color_by`.
    """
    view = view or View()
    count = len(as_points(positions))
    named = dict(scalars or {})
    if colors is not None and color_by is not None:
        raise InputError("colors are shown as they are, color_by in a colour map — give one of them")
    if isinstance(color_by, str):
        known = ", ".join(named) or "none were given"
        if color_by.partition(".")[0] not in named:
            raise InputError(
                f"no scalar {color_by!r} to colour by; scalars: {known} — or pass the values themselves"
            )
        view = view.with_changes(color_by=color_by)
    elif color_by is not None:
        values = np.asarray(color_by)
        if values.ndim == 0 or values.shape[0] != count:
            raise InputError(
                f"color_by must have shape ({count},), as there are {count} positions; got {values.shape}"
            )
        name = getattr(color_by, "name", None)  # of a column of a data frame
        name = name if isinstance(name, str) and name else "value"
        named[name] = values
        view = view.with_changes(color_by=name)
    elif colors is not None:
        if isinstance(colors, str) or np.shape(colors) == (3,):
            view = view.with_changes(color=_one_color(colors), color_by=None)
        else:
            named["color"] = as_colors(colors, count)
            view = view.with_changes(color_by="color", colormap=RGB, range=None, log=False)
    return Particles(positions, radii, named), view


def looked_at(
    target: Any,
    view: View | None,
    *,
    radii: ArrayLike | None = None,
    colors: ArrayLike | str | None = None,
    color_by: ArrayLike | str | None = None,
    scalars: Mapping[str, ArrayLike] | None = None,
) -> tuple[Any, View | None]:
    """Return `target` with particles in place of arrays, and the view with `color_by`; the rest stays as it is.

    Raises
    ------
    InputError
        As :func:`from_arrays`; and for `radii`, `colors` or `scalars` of what brings its own.
    """
    if is_array(target):
        return from_arrays(target, view, radii=radii, colors=colors, color_by=color_by, scalars=scalars)
    given = {"radii": radii, "colors": None if isinstance(colors, str) else colors, "scalars": scalars}
    if names := [name for name, value in given.items() if value is not None]:
        raise InputError(
            f"{', '.join(names)}: for arrays of positions only; a {type(target).__name__} brings its own"
            " — build Particles(positions, radii, scalars) instead"
        )
    if isinstance(colors, str):
        view = (view or View()).with_changes(color=_one_color(colors), color_by=None)
    if color_by is not None:
        if not isinstance(color_by, str):
            raise InputError(
                f"color_by must be the name of a scalar of the {type(target).__name__}, or go with positions"
            )
        view = (view or View()).with_changes(color_by=color_by)
    return target, view


def _one_color(color: Any) -> str:
    if not isinstance(color, str):
        values = np.asarray(color)
        color = tuple((values / 255 if values.dtype.kind in "iu" and values.max() > 1 else values).tolist())
    return hex_color(color, "colors")
