"""View: everything about a picture that light does not depend on."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from luxel.arrays import as_colors
from luxel.errors import InputError
from luxel.particles import Particles
from luxel.scene.camera import Camera
from luxel.scene.colormap import RGB, colormap_table, hex_color, rgb, srgb_to_linear
from luxel.scene.hiding import Condition, as_conditions, condition_from_json, hidden
from luxel.scene.lights import Up, up_frame

__all__ = ["View"]

_ROW = 4096  # particles of one colour copied at once
_BLOCK = 1 << 18  # particles mapped at once, so that float64 temporaries stay in the processor's cache


@dataclass(frozen=True, eq=False)
class View:
    """Camera, colours and tone. Changing any of them costs no light.

    Parameters
    ----------
    camera
        None frames the data.
    color_by
        Name of a scalar (``"stress"``), a component (``"velocity.x"``) or a vector, by magnitude; None gives all
        particles the same `color`.
    colormap
        Any of matplotlib's names; or ``"rgb"``: then `color_by` names a vector whose three components are the colours
        themselves, sRGB, whole numbers 0..255 or others 0..1.
    range
        Scalar values of the map's first and last colour; None takes the finite minimum and maximum.
    log
        Logarithmic colour scale; values that are not positive get the first colour.
    exposure
        Factor on luminance before the tone curve.
    background, color, nan_color
        Any colour that matplotlib understands, kept as ``"#rrggbb"``. `color` is used when `color_by` is None,
        `nan_color` for particles whose scalar is NaN ("no data").
    up
        Axis that points up when `camera` is None: ``"x"``, ``"y"`` or ``"z"``.
    hide
        A `Cut` or `Select`, or several: particles that any of them hides are not drawn. They still cast shadows and
        bounce light, so that hiding costs nothing; see `Scene.hide` for the other rule.

    Raises
    ------
    InputError
        For unknown colours and colour maps, and values out of range.
    """

    camera: Camera | None = None
    color_by: str | None = None
    colormap: str = "viridis"
    range: tuple[float, float] | None = None
    log: bool = False
    exposure: float = 1.0
    background: str = "#17191d"
    up: Up = "z"
    color: str = "#d9d5cc"
    nan_color: str = "#7f7f86"
    hide: Condition | Sequence[Condition] = ()

    def __post_init__(self) -> None:
        if self.camera is not None and not isinstance(self.camera, Camera):
            raise InputError(f"camera must be a Camera or None, got {type(self.camera).__name__}")
        if self.color_by is not None and not (isinstance(self.color_by, str) and self.color_by):
            raise InputError(f"color_by must be the name of a scalar or None, got {self.color_by!r}")
        if not isinstance(self.colormap, str):
            raise InputError(f"colormap must be a name such as viridis, got {self.colormap!r}")
        if self.colormap not in ("viridis", RGB):  # matplotlib is slow to import
            colormap_table(self.colormap)
        if not isinstance(self.log, bool | np.bool_):
            raise InputError(f"log must be true or false, got {self.log!r}")
        if self.range is not None:
            object.__setattr__(self, "range", _checked_range(self.range, self.log))
        exposure = _number(self.exposure)
        if not (math.isfinite(exposure) and exposure > 0):
            raise InputError(f"exposure must be a positive number, got {self.exposure!r}")
        object.__setattr__(self, "exposure", exposure)
        for name in ("background", "color", "nan_color"):
            object.__setattr__(self, name, hex_color(getattr(self, name), name))
        up_frame(self.up)
        object.__setattr__(self, "hide", as_conditions(self.hide, "hide of a view"))

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """What hides particles, as a tuple."""
        return cast(tuple[Condition, ...], self.hide)

    def hidden(self, particles: Particles) -> NDArray[np.bool_] | None:
        """(N,) bool: which particles are not drawn; None if all are.

        Raises
        ------
        ScalarError
            If the particles lack a scalar that a selection names.
        """
        return hidden(particles, self.conditions)

    def with_changes(self, **changes: Any) -> View:
        """Return a view with some fields replaced."""
        return replace(self, **changes)

    def camera_for(self, particles: Particles, size: tuple[int, int] | float = 16 / 9) -> Camera:
        """Return the view's camera, or one that frames the data in a picture of `size` (pixels, or width / height)."""
        if self.camera is not None:
            return self.camera
        aspect = size[0] / size[1] if isinstance(size, tuple | list) else float(size)
        return Camera.framing(particles.bounds, up=self.up, aspect=aspect)

    def categorical(self, particles: Particles) -> bool:
        """Whether the scalar is shown as codes rather than as a scale.

        So are scalars with category labels, and whole numbers under a qualitative map (tab10 ...), unless the view has
        a range or a logarithmic scale.
        """
        if self.color_by is None or self.colormap == RGB or self.range is not None or self.log:
            return False
        if self.color_by in particles.categories:
            return True
        return len(self.lut()) < 256 and particles.scalar(self.color_by).dtype.kind in "iu"

    def scalar_range(self, particles: Particles) -> tuple[float, float]:
        """Return the scalar values (lo, hi), lo < hi, of the map's ends.

        Without a range of the view's own these are the finite minimum and maximum (the least positive value for
        logarithmic scales), moved apart when they coincide; (0, 1) or (1, 10) when there are none.

        Raises
        ------
        ScalarError
            If the particles have no such scalar.
        """
        if self.range is not None:
            return self.range
        if self.color_by is None:
            return (0.0, 1.0)
        values = particles.scalar(self.color_by)
        if values.dtype.kind == "f":
            values = values[np.isfinite(values)]
        if self.log:
            values = values[values > 0]
        if not len(values):
            return (1.0, 10.0) if self.log else (0.0, 1.0)
        return _apart(float(values.min()), float(values.max()), self.log)

    def normalised(self, particles: Particles) -> NDArray[np.float32]:
        """(N,) float32 in [0, 1], NaN where there is no data: row ``min(n - 1, floor(x n))`` of :meth:`lut` is the colour.

        Codes are ``(code modulo n + 0.5) / n`` under qualitative maps of n colours, and spread evenly under others.
        All zero when `color_by` is None.

        Raises
        ------
        ScalarError
            If the particles have no such scalar.
        """
        found = np.zeros(len(particles), dtype=np.float32)
        if self.color_by is None:
            return found
        values = particles.scalar(self.color_by)
        if self.categorical(particles):
            rows = len(self.lut())
            if rows == 256:
                rows = max(1, len(particles.categories[self.color_by]))
            codes = values if values.dtype.kind == "f" else values.astype(np.int64)
            with np.errstate(invalid="ignore"):
                found[:] = (np.floor(np.mod(codes, rows)) + 0.5) / rows
            return found
        low, high = self.scalar_range(particles)
        if self.log:
            low, high = math.log(low), math.log(high)
        # The difference of two numbers near the largest would overflow; that of their halves does not.
        half = 0.5 if math.isinf(high - low) else 1.0
        width = half * high - half * low
        for start in range(0, len(values), _BLOCK):
            block = values[start : start + _BLOCK].astype(np.float64)
            with np.errstate(divide="ignore", invalid="ignore"):
                if self.log:
                    block = np.log(np.maximum(block, 0.0))
                part = (half * np.clip(block, low, high) - half * low) / width
            found[start : start + _BLOCK] = part
        return found

    def lut(self) -> NDArray[np.uint8]:
        """(n, 3) uint8 sRGB rows of the colour map: 256, or one a colour for qualitative maps."""
        return colormap_table(self.colormap)

    def colors(self, particles: Particles) -> NDArray[np.float32]:
        """(N, 3) float32 linear-light colours of the particles.

        Raises
        ------
        ScalarError
            If the particles have no such scalar.
        InputError
            If it is to be shown as it is, but its values are no colours.
        """
        if self.color_by is None:
            return _all_alike(_linear(self.color), len(particles))
        if self.colormap == RGB:
            values = particles.scalars.get(self.color_by)
            if values is None:
                values = particles.scalar(self.color_by)  # says which there are
            given = as_colors(values, len(particles), f"scalar {self.color_by!r} as colours")
            return srgb_to_linear(given if given.dtype == np.float32 else given / np.float32(255))
        table = np.concatenate([srgb_to_linear(self.lut() / 255.0), [srgb_to_linear(rgb(self.nan_color))]])
        return table.astype(np.float32)[lut_rows(self.normalised(particles), len(table) - 1)]

    def to_json(self) -> dict[str, Any]:
        """Return a small dict of plain numbers and strings; :meth:`from_json` makes the same view again."""
        found = {field.name: getattr(self, field.name) for field in fields(self)}
        found["range"] = None if self.range is None else list(self.range)
        found["log"] = bool(self.log)
        found["hide"] = [condition.to_json() for condition in self.conditions]
        if self.camera is not None:
            camera = self.camera
            found["camera"] = {
                "eye": np.asarray(camera.eye).tolist(),
                "target": np.asarray(camera.target).tolist(),
                "up": np.asarray(camera.up).tolist(),
                "fov": float(camera.fov),
                "height": None if camera.height is None else float(camera.height),
            }
        return found

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> View:
        """Make a view of what :meth:`to_json` returned; fields left out have their defaults.

        Raises
        ------
        InputError
            For unknown fields and values that make no sense.
        """
        values = _known_fields(data, cls, "a view")
        if values.get("camera") is not None:
            values["camera"] = _camera(values["camera"])
        if "hide" in values:
            listed = values["hide"]
            if not isinstance(listed, list | tuple):
                raise InputError(f"a view's hide must be a list, got {listed!r}")
            values["hide"] = tuple(condition_from_json(each) for each in listed)
        return cls(**values)


def lut_rows(normalised: NDArray[np.float32], count: int) -> NDArray[np.intp]:
    """(N,) rows of a table of `count` colours; NaN is row `count`, where callers put the "no data" colour."""
    missing = np.isnan(normalised)
    rows = (np.where(missing, np.float32(0), normalised) * np.float32(count)).astype(np.intp)
    np.minimum(rows, count - 1, out=rows)
    rows[missing] = count
    return rows


def _all_alike(color: NDArray[np.float32], count: int) -> NDArray[np.float32]:
    """Return `color` (3,) so many times, in long rows: three numbers at a time take five times as long."""
    found = np.empty((count, 3), np.float32)
    row = np.tile(color, _ROW)
    whole = count // _ROW * _ROW
    found[:whole].reshape(-1, len(row))[...] = row
    found[whole:] = row.reshape(_ROW, 3)[: count - whole]
    return found


def _linear(color: str) -> NDArray[np.float32]:
    return srgb_to_linear(rgb(color)).astype(np.float32)


def _apart(low: float, high: float, log: bool) -> tuple[float, float]:
    """Widen a range that holds one value, so that scales and ticks have something to span."""
    if low < high:
        return low, high
    if log:
        return max(low / math.sqrt(10), math.ulp(0.0)), min(high * math.sqrt(10), sys.float_info.max)
    half = 0.5 * abs(low) or 0.5
    return max(low - half, -sys.float_info.max), min(high + half, sys.float_info.max)


def _number(value: object) -> float:
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return math.nan


def _checked_range(given: ArrayLike, log: bool) -> tuple[float, float]:
    ends = [_number(end) for end in given] if isinstance(given, Sequence | np.ndarray) else []
    if len(ends) != 2 or not all(math.isfinite(end) for end in ends):
        raise InputError(f"range must be two finite numbers (lo, hi) or None, got {given!r}")
    low, high = ends
    if low >= high:
        raise InputError(
            f"range must have lo < hi, got {low:g} {high:g} — a colour map named …_r runs the other way"
        )
    if log and low <= 0:
        raise InputError(f"range of a logarithmic scale must be positive, got {low:g} {high:g}")
    return low, high


def _camera(data: object) -> Camera:
    values = _known_fields(data, Camera, "a view's camera", ("eye", "target"))
    for name in ("fov", "height"):
        if values.get(name) is not None and not isinstance(values[name], int | float):
            raise InputError(f"a view's camera {name} must be a number, got {values[name]!r}")
    return Camera(**values)


def _known_fields(data: object, cls: type[Any], what: str, required: tuple[str, ...] = ()) -> dict[str, Any]:
    if not isinstance(data, Mapping):
        raise InputError(f"{what} must be a JSON object, got {type(data).__name__}")
    known = [field.name for field in fields(cls)]
    if unknown := [str(name) for name in data if name not in known]:
        raise InputError(f"{what} has no field {', '.join(unknown)}; known are {', '.join(known)}")
    if missing := [name for name in required if name not in data]:
        raise InputError(f"{what} needs the field {', '.join(missing)}")
    return dict(data)
