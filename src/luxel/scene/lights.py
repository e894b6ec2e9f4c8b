"""Light sources. Levels are in the unit of a texel: what a light adds to a surface that faces it squarely.

Lights are not drawn in pictures. Seen along a ray, a sphere or quad light replaces the sky behind it on its shining
side; on the other side it does not exist, so it never casts a shadow.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from luxel.arrays import as_vector
from luxel.errors import InputError

__all__ = [
    "Light",
    "QuadLight",
    "Sky",
    "SphereLight",
    "Sun",
    "Up",
    "default_lights",
    "light_from_json",
    "light_json",
    "sun_direction",
    "up_frame",
]

Up = Literal["x", "y", "z"]


@dataclass(frozen=True, eq=False)
class Sky:
    """Light from everywhere: uniform, or a linear gradient along an axis.

    Parameters
    ----------
    level
        Radiance from the direction of `axis`; of the whole sky when `ground` is None. A lone particle under a
        uniform sky of level 1 has luminance 1 everywhere.
    ground
        Radiance from the direction opposite to `axis`; None means the same as `level`.
    axis
        Towards the zenith; only matters with `ground`.
    """

    level: float = 1.0
    ground: float | None = None
    axis: ArrayLike = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        _check_level("Sky level", self.level)
        if self.ground is not None:
            _check_level("Sky ground", self.ground)
        object.__setattr__(self, "axis", as_vector(self.axis, "Sky axis", unit=True))


@dataclass(frozen=True, eq=False)
class Sun:
    """A distant disc.

    Parameters
    ----------
    direction
        From the particles towards the sun, any length.
    level
        Luminance added to a surface that faces it (its irradiance is π · level).
    angular_diameter
        In degrees, (0, 120]; the wider, the softer its shadows. The real sun has 0.53.
    """

    direction: ArrayLike
    level: float = 1.0
    angular_diameter: float = 15.0

    def __post_init__(self) -> None:
        _check_level("Sun level", self.level)
        if not 0.0 < self.angular_diameter <= 120.0:
            raise InputError(f"Sun angular_diameter must be in (0, 120] degrees, got {self.angular_diameter}")
        object.__setattr__(self, "direction", as_vector(self.direction, "Sun direction", unit=True))


@dataclass(frozen=True, eq=False)
class SphereLight:
    """A glowing sphere that shines outwards.

    Parameters
    ----------
    center, radius
        In file units.
    level
        Its radiance. A surface that it fills the whole view of has luminance `level`.
    """

    center: ArrayLike
    radius: float
    level: float = 1.0

    def __post_init__(self) -> None:
        _check_level("SphereLight level", self.level)
        if not (math.isfinite(self.radius) and self.radius > 0):
            raise InputError(f"SphereLight radius must be positive, got {self.radius}")
        object.__setattr__(self, "center", as_vector(self.center, "SphereLight center"))


@dataclass(frozen=True, eq=False)
class QuadLight:
    """A glowing parallelogram that shines towards ``cross(edge_u, edge_v)``.

    Parameters
    ----------
    corner, edge_u, edge_v
        One corner and the two edges that leave it, in file units.
    level
        Its radiance.
    """

    corner: ArrayLike
    edge_u: ArrayLike
    edge_v: ArrayLike
    level: float = 1.0

    def __post_init__(self) -> None:
        _check_level("QuadLight level", self.level)
        for name in ("corner", "edge_u", "edge_v"):
            object.__setattr__(self, name, as_vector(getattr(self, name), f"QuadLight {name}"))
        if not np.linalg.norm(np.cross(np.asarray(self.edge_u), np.asarray(self.edge_v))) > 0:
            raise InputError("QuadLight edges must not be parallel")


Light = Sky | Sun | SphereLight | QuadLight
_KINDS: dict[str, type[Light]] = {kind.__name__: kind for kind in (Sky, Sun, SphereLight, QuadLight)}


def light_json(light: Light) -> dict[str, Any]:
    """Return a small dict of plain numbers and strings; :func:`light_from_json` makes the same light again."""
    values = {f.name: getattr(light, f.name) for f in fields(light)}
    plain = {name: value.tolist() if hasattr(value, "tolist") else value for name, value in values.items()}
    return {"kind": type(light).__name__, **plain}


def light_from_json(data: object) -> Light:
    """Inverse of :func:`light_json`.

    Raises
    ------
    InputError
        For anything else.
    """
    if not isinstance(data, Mapping):
        raise InputError(f"a light must be a JSON object, got {type(data).__name__}")
    values = dict(data)
    kind = values.pop("kind", None)
    if not isinstance(kind, str) or kind not in _KINDS:
        raise InputError(f"a light has the kind {kind!r}; known are {', '.join(_KINDS)}")
    try:
        return _KINDS[kind](**values)
    except TypeError:
        known = ", ".join(f.name for f in fields(_KINDS[kind]))
        raise InputError(f"a {kind} has the fields {known}; got {', '.join(map(str, values))}") from None


# Every view of every frame asks.
_FRAMES = {up: np.roll(np.eye(3), -k, axis=0) for k, up in enumerate("xyz", 1)}


def up_frame(up: Up) -> NDArray[np.float64]:
    """Return (3, 3) rows: the axes that +X, +Y and +Z of a Z-up world become when `up` points up.

    Raises
    ------
    InputError
        Unless `up` is ``"x"``, ``"y"`` or ``"z"``.
    """
    if up not in ("x", "y", "z"):
        raise InputError(f"up must be x, y or z, got {up!r}")
    return _FRAMES[up].copy()


def sun_direction(azimuth: float, elevation: float, up: Up = "z") -> NDArray[np.float64]:
    """Return the unit vector towards azimuth and elevation, both in degrees.

    Azimuth turns from +X towards +Y (for ``up="z"``), elevation rises from the horizon.
    """
    a, e = math.radians(azimuth), math.radians(elevation)
    local = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    return local @ up_frame(up)


def default_lights(up: Up = "z") -> tuple[Light, ...]:
    """Return a sky of level 1 and one soft sun of level 2, above and to the left of the default camera."""
    return (Sky(1.0), Sun(sun_direction(225.0, 42.0, up), level=2.0, angular_diameter=15.0))


def _check_level(what: str, level: float) -> None:
    if not (math.isfinite(level) and level >= 0):
        raise InputError(f"{what} must be a finite number >= 0, got {level}")
