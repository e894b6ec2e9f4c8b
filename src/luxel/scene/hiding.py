"""Particles left out of the picture: beyond a cut plane, or outside a range of a scalar."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from luxel.arrays import as_vector
from luxel.errors import InputError
from luxel.particles import Particles

__all__ = ["Condition", "Cut", "Select", "as_conditions", "condition_from_json", "hidden"]

# Lattices often lie exactly in a plane that somebody types; rounding of their float32 positions must not tear a layer.
_TOLERANCE = 1e-6  # of the diagonal of the particles' bounds
_BLOCK = 1 << 18
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


@dataclass(frozen=True)
class Cut:
    """A plane: particles whose centre lies beyond it are hidden.

    Parameters
    ----------
    normal
        Towards the side that is hidden: any vector, or ``"x"``, ``"y"``, ``"z"``, ``"-x"`` ... Kept as a unit vector.
    offset
        Where the plane is: centres c with normal · c > offset are hidden, in file units. A centre in the plane stays.

    Raises
    ------
    InputError
        For a normal that is no direction or an offset that is not finite.
    """

    normal: ArrayLike
    offset: float

    def __post_init__(self) -> None:
        normal = self.normal
        if isinstance(normal, str):
            sign, axis = (-1.0, normal[1:]) if normal.startswith("-") else (1.0, normal)
            if axis not in _AXES:
                raise InputError(f"the normal of a Cut must be x, y, z, -x ... or a vector, got {normal!r}")
            normal = [sign * part for part in _AXES[axis]]
        unit = as_vector(normal, "the normal of a Cut", unit=True)
        object.__setattr__(self, "normal", tuple(part + 0.0 for part in unit.tolist()))  # no -0.0
        object.__setattr__(self, "offset", _finite(self.offset, "the offset of a Cut"))

    @classmethod
    def parse(cls, text: str) -> Cut:
        """Return what ``"x>0.5"``, ``"z<-2"`` or ``"1,1,0>3"`` says to cut away; the offset is along the unit normal.

        Raises
        ------
        InputError
            For anything else.
        """
        match = re.fullmatch(r"\s*([^<>=]+?)\s*([<>])=?\s*(\S+)\s*", text)
        try:
            if match is None:
                raise ValueError
            side, sign, offset = match[1], 1.0 if match[2] == ">" else -1.0, float(match[3])
            vector = _AXES[side] if side in _AXES else [float(part) for part in side.split(",")]
            return cls([sign * part for part in vector], sign * offset)
        except (ValueError, InputError):
            raise InputError(
                f"a cut must say which side goes, such as 'x>0.5', 'z<-2' or '1,1,0>3'; got {text!r}"
            ) from None

    def hides(self, particles: Particles) -> NDArray[np.bool_]:
        """(N,) bool: which particles lie beyond the plane, by more than a millionth of the data's diagonal."""
        normal = np.asarray(self.normal)
        low, high = particles.bounds
        limit = (
            self.offset - float(normal @ particles.origin) + _TOLERANCE * float(np.linalg.norm(high - low))
        )
        found = np.empty(len(particles), np.bool_)
        for start in range(0, len(found), _BLOCK):
            part = slice(start, start + _BLOCK)
            found[part] = particles.local[part].astype(np.float64) @ normal > limit
        return found

    def to_json(self) -> dict[str, Any]:
        """Return a small dict of plain numbers and strings."""
        return {"kind": "cut", "normal": list(self.normal), "offset": self.offset}  # type: ignore[arg-type]


@dataclass(frozen=True)
class Select:
    """A range of a scalar: particles outside it, or without data, are hidden.

    Parameters
    ----------
    scalar
        Name of a scalar, component (``"velocity.x"``) or vector, by its magnitude.
    low, high
        Lowest and highest value that stays visible; None means no limit. Scalars that are not whole numbers are
        compared in single precision, as viewers hold them.

    Raises
    ------
    InputError
        For limits that are not finite or in the wrong order.
    """

    scalar: str
    low: float | None = None
    high: float | None = None

    def __post_init__(self) -> None:
        if not (isinstance(self.scalar, str) and self.scalar):
            raise InputError(f"a Select needs the name of a scalar, got {self.scalar!r}")
        for name in ("low", "high"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _finite(getattr(self, name), f"{name} of a Select"))
        if self.low is not None and self.high is not None and self.low > self.high:
            raise InputError(f"a Select needs low <= high, got {self.low:g} and {self.high:g}")

    @classmethod
    def parse(cls, text: str) -> Select:
        """Return what ``"stress>1e6"``, ``"type=2"`` or ``"0.1<=density<0.9"`` says to keep.

        Raises
        ------
        InputError
            For anything else.
        """
        parts = [part.strip() for part in re.split(r"(<=|>=|==|<|>|=)", text)]
        try:
            if len(parts) == 3:
                name, sign, value = parts
            elif len(parts) == 5 and parts[1][0] == parts[3][0] == "<":
                low, high = _limit(parts[0], parts[1], up=True), _limit(parts[4], parts[3], up=False)
                return cls(parts[2], low, high)
            else:
                raise ValueError
            if sign.startswith("="):
                return cls(name, float(value), float(value))
            limit = _limit(value, sign, up=sign.startswith(">"))
            return cls(name, limit, None) if sign.startswith(">") else cls(name, None, limit)
        except (ValueError, InputError):
            raise InputError(
                "a selection must say which values stay, such as 'stress>1e6', 'type=2' or '0.1<density<0.9';"
                f" got {text!r}"
            ) from None

    def hides(self, particles: Particles) -> NDArray[np.bool_]:
        """(N,) bool: which particles lie outside the range.

        Raises
        ------
        ScalarError
            If the particles have no such scalar.
        """
        values = particles.scalar(self.scalar)
        if values.dtype.kind == "f":
            with np.errstate(over="ignore"):
                values = values.astype(np.float32, copy=False)
        single = values.dtype == np.float32
        found = np.isnan(values) if single else np.zeros(len(values), np.bool_)
        if self.low is not None:
            found |= values < (np.float32(self.low) if single else self.low)
        if self.high is not None:
            found |= values > (np.float32(self.high) if single else self.high)
        return found

    def to_json(self) -> dict[str, Any]:
        """Return a small dict of plain numbers and strings."""
        return {"kind": "select", "scalar": self.scalar, "low": self.low, "high": self.high}


Condition = Cut | Select


def as_conditions(given: Condition | Iterable[Condition], what: str = "hide") -> tuple[Condition, ...]:
    """Return one condition or several as a tuple.

    Raises
    ------
    InputError
        For anything else.
    """
    several: list[Any] = (
        [given] if isinstance(given, Cut | Select) or not isinstance(given, Iterable) else [*given]
    )
    for each in several:
        if not isinstance(each, Cut | Select):
            raise InputError(f"{what} takes Cut and Select, got {type(each).__name__}")
    return tuple(several)


def hidden(particles: Particles, conditions: Sequence[Condition]) -> NDArray[np.bool_] | None:
    """(N,) bool: which particles some condition hides; None if they all stay.

    Raises
    ------
    ScalarError
        If the particles lack a scalar that a condition names.
    """
    found: NDArray[np.bool_] | None = None
    for condition in conditions:
        each = condition.hides(particles)
        found = each if found is None else found | each
    return None if found is None or not found.any() else found


def condition_from_json(data: object, what: str = "a view's hide") -> Condition:
    """Make a condition of what its ``to_json`` returned.

    Raises
    ------
    InputError
        For anything else.
    """
    if not isinstance(data, Mapping):
        raise InputError(f"{what} must list JSON objects, got {type(data).__name__}")
    values = dict(data)
    kind = values.pop("kind", None)
    known = {"cut": ("normal", "offset"), "select": ("scalar", "low", "high")}
    if not isinstance(kind, str) or kind not in known:
        raise InputError(f"{what} has the kind {kind!r}; known are {', '.join(known)}")
    if wrong := [str(name) for name in values if name not in known[kind]]:
        raise InputError(
            f"{what}: a {kind} has no field {', '.join(wrong)}; known are {', '.join(known[kind])}"
        )
    try:
        return Cut(**values) if kind == "cut" else Select(**values)
    except TypeError:
        raise InputError(f"{what}: a {kind} needs the fields {', '.join(known[kind])}") from None


def _limit(text: str, sign: str, *, up: bool) -> float:
    """Return the outermost value that ``> text`` or ``< text`` lets through, in the precision of the comparison."""
    value = float(text)
    if sign.endswith("=") or not math.isfinite(value):
        return value
    towards = math.inf if up else -math.inf
    if abs(value) >= 2**24:  # whole numbers are compared exactly, and single precision holds no more of them
        return math.nextafter(value, towards)
    return float(np.nextafter(np.float32(value), np.float32(towards)))


def _finite(value: object, what: str) -> float:
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number) or isinstance(value, bool):
        raise InputError(f"{what} must be a finite number, got {value!r}")
    return number
