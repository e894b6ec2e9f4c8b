"""What named columns mean: positions, radii, vectors, codes."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxel.io.frame import axes_to_radius, encode_labels

__all__ = ["Columns", "find_positions", "find_radii", "group_columns", "tidy"]

Columns = dict[str, NDArray[Any]]

# Exact names only: a column that merely looks like a component stays what it is.
_VECTORS = {
    "velocity": ("vx", "vy", "vz"),
    "force": ("fx", "fy", "fz"),
    "omega": ("omegax", "omegay", "omegaz"),
    "mu": ("mux", "muy", "muz"),
    "angmom": ("angmomx", "angmomy", "angmomz"),
    "torque": ("tqx", "tqy", "tqz"),
}
_ELEMENT = re.compile(
    r"(?P<base>.+?)(?:\[(?P<one>\d+)\]|:(?P<zero>\d+))$"
)  # LAMMPS c_S[1], ParaView stress:0

_POSITIONS = (
    ("x", "y", "z"),
    ("points:0", "points:1", "points:2"),
    ("points_0", "points_1", "points_2"),
    ("position_x", "position_y", "position_z"),
    ("position:0", "position:1", "position:2"),
    ("pos_x", "pos_y", "pos_z"),
    ("posx", "posy", "posz"),
    ("px", "py", "pz"),
    ("coord_x", "coord_y", "coord_z"),
    ("x_coord", "y_coord", "z_coord"),
)
_RADII = ("radius", "radii", "rad")
_DIAMETERS = ("diameter", "diameters", "diam")
_WHOLE = {
    "id",
    "ids",
    "type",
    "mol",
    "molecule",
    "material",
    "proc",
    "procp1",
    "ix",
    "iy",
    "iz",
    "typeid",
    "frame",
}


def find_positions(names: Sequence[str]) -> tuple[str, str, str] | None:
    """Return the three columns that hold positions, whatever their case, or None."""
    by_lower = {name.lower(): name for name in reversed(names)}
    for x, y, z in _POSITIONS:
        if x in by_lower and y in by_lower and z in by_lower:
            return by_lower[x], by_lower[y], by_lower[z]
    return None


def find_radii(columns: Mapping[str, NDArray[Any]]) -> tuple[NDArray[Any], str] | None:
    """Return (N,) radii and their source from a column called radius or diameter, or None.

    A column ``r`` counts too, unless ``g`` and ``b`` stand beside it: then it is a colour.
    """
    by_lower = {name.lower(): name for name in reversed(list(columns))}
    radii = _RADII if {"g", "b"} <= by_lower.keys() else (*_RADII, "r")
    for lower in (*radii, *_DIAMETERS):
        name = by_lower.get(lower)
        if name is not None and columns[name].dtype.kind in "fiu":
            return axes_to_radius(name, columns[name], diameter=lower in _DIAMETERS)
    return None


def group_columns(columns: Mapping[str, NDArray[Any]]) -> Columns:
    """Join the components of a vector into one (N, k) array: vx vy vz to velocity, ``c_S[1] … c_S[n]`` to c_S."""
    groups: dict[str, tuple[str, ...]] = {
        vector: parts
        for vector, parts in _VECTORS.items()
        if vector not in columns and all(part in columns for part in parts)
    }
    indexed: dict[tuple[str, bool], dict[int, str]] = {}
    for name in columns:
        match = _ELEMENT.fullmatch(name)
        if match:
            one = match["one"] is not None
            indexed.setdefault((match["base"], one), {})[int(match["one"] if one else match["zero"])] = name
    for (base, one), members in indexed.items():
        if (
            base not in columns
            and len(members) > 1
            and sorted(members) == list(range(one, len(members) + one))
        ):
            groups[base] = tuple(members[k] for k in sorted(members))
    home = {part: vector for vector, parts in groups.items() for part in parts}
    grouped: Columns = {}
    for name, values in columns.items():
        vector = home.get(name)
        if vector is None:
            grouped[name] = values
        elif vector not in grouped and all(columns[part].dtype.kind != "U" for part in groups[vector]):
            grouped[vector] = np.stack([columns[part] for part in groups[vector]], axis=1)
    return grouped


def tidy(columns: Mapping[str, NDArray[Any]]) -> tuple[Columns, dict[str, tuple[str, ...]]]:
    """Return scalars and categories: text becomes codes, whole numbers by name become integers, vectors join."""
    plain: Columns = {}
    categories: dict[str, tuple[str, ...]] = {}
    for name, values in columns.items():
        if values.dtype.kind in "US":
            plain[name], categories[name] = encode_labels(values)
        elif name.lower() in _WHOLE and values.dtype.kind == "f":
            plain[name] = _whole(values)
        else:
            plain[name] = values
    return group_columns(plain), categories


def _whole(values: NDArray[Any]) -> NDArray[Any]:
    """Turn floats into integers where that loses nothing (a float64 is exact up to 2^53)."""
    if not (
        np.isfinite(values).all() and (np.abs(values) < 2.0**53).all() and (values == np.rint(values)).all()
    ):
        return values
    small = values.size == 0 or (np.abs(values) < 2**31).all()
    return values.astype(np.int32 if small else np.int64)
