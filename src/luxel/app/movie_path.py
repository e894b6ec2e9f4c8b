"""What each picture of a movie shows: views interpolated between keyframes, turned around the data, and time steps."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxel.errors import InputError
from luxel.scene.camera import Camera
from luxel.scene.hiding import Condition, Cut, Select
from luxel.scene.view import View

__all__ = ["interpolated", "orbit_angles", "orbited", "steps_between", "steps_shown"]

_Curve = Callable[[float], NDArray[np.float64]]


def interpolated(keys: Sequence[View], count: int) -> list[View]:
    """Return `count` views along a smooth path through `keys`, which have cameras; the first and the last are keys.

    Keys are evenly spaced in time. Curves are cubic, and monotone between keys: nothing overshoots. Distance, height and
    exposure change by equal factors. Directions follow azimuth and elevation where all cameras have the same `up`, so that
    the horizon stays level. What is no number changes at the keys.

    Raises
    ------
    InputError
        If perspective and orthographic cameras are mixed.
    """
    if len(keys) == 1:
        return [keys[0]] * count
    cameras = [_camera(key) for key in keys]
    camera_at = _camera_curve(cameras)
    exposure = _curve([[math.log(key.exposure)] for key in keys])
    ranges = _range_curve(keys)
    hide = _hide_curve([key.conditions for key in keys])
    found = []
    for k in range(count):
        u = k * (len(keys) - 1) / max(1, count - 1)
        before = min(int(u), len(keys) - 1)
        if u == before:
            found.append(keys[before])
            continue
        changes: dict[str, Any] = {
            "camera": camera_at(u),
            "exposure": math.exp(exposure(u)[0]),
            "hide": hide(u) if hide is not None else keys[before].conditions,
        }
        if ranges is not None:
            changes["range"] = tuple(ranges(u).tolist())
        found.append(keys[before].with_changes(**changes))
    return found


def orbit_angles(degrees: float, count: int) -> list[float]:
    """Angles in degrees of `count` pictures. Whole turns leave out the last, which would be the first again."""
    steps = count if degrees % 360 == 0 else count - 1
    return [degrees * k / max(1, steps) for k in range(count)]


def orbited(view: View, degrees: float) -> View:
    """Return the view from a camera that is turned around its target, about its own `up`."""
    camera = _camera(view)
    axis = np.asarray(camera.up, np.float64)
    away = np.asarray(camera.eye, np.float64) - np.asarray(camera.target, np.float64)
    angle = math.radians(degrees)
    turned = (
        away * math.cos(angle)
        + np.cross(axis, away) * math.sin(angle)
        + axis * (axis @ away) * (1 - math.cos(angle))
    )
    eye = np.asarray(camera.target) + turned
    return view.with_changes(camera=Camera(eye, camera.target, camera.up, camera.fov, camera.height))


def steps_shown(steps: Sequence[int], count: int) -> list[int]:
    """Return the time step of each of `count` pictures: all of `steps` in turn, evenly."""
    return [steps[k * len(steps) // count] for k in range(count)]


def steps_between(keys: Sequence[int], count: int) -> list[int]:
    """Return the time step of each of `count` pictures, which go from key to key as the views of :func:`interpolated` do."""
    times = np.arange(count) * (len(keys) - 1) / max(1, count - 1)
    return [round(step) for step in np.interp(times, range(len(keys)), keys).tolist()]


def _camera(view: View) -> Camera:
    assert view.camera is not None
    return view.camera


def _curve(values: Sequence[Sequence[float]]) -> _Curve:
    from scipy.interpolate import PchipInterpolator

    curve = PchipInterpolator(range(len(values)), np.asarray(values, np.float64))
    return lambda u: np.asarray(curve(u))


def _camera_curve(cameras: Sequence[Camera]) -> Callable[[float], Camera]:
    if len({camera.orthographic for camera in cameras}) > 1:
        raise InputError("a movie cannot go from perspective to orthographic views — save all of one kind")
    eyes, targets, ups = (
        np.array([getattr(c, name) for c in cameras], np.float64) for name in ("eye", "target", "up")
    )
    away = eyes - targets
    distance = np.linalg.norm(away, axis=1)
    flat = cameras[0].orthographic
    heights = [math.log(camera.height) if camera.height is not None else 0.0 for camera in cameras]
    numbers = _curve(
        [[*t, math.log(d), c.fov, h] for t, d, c, h in zip(targets, distance, cameras, heights, strict=True)]
    )
    level = bool(np.allclose(ups, ups[0], atol=1e-9))
    directions = _level_directions(away / distance[:, None], ups[0]) if level else None
    turns = None if level else _turns(cameras)

    def at(u: float) -> Camera:
        *target, log_distance, fov, log_height = numbers(u).tolist()
        if directions is not None:
            towards, up = directions(u), ups[0]
        else:
            assert turns is not None
            towards, up = turns(u)
        eye = np.asarray(target) + math.exp(log_distance) * towards
        return Camera(eye, target, up, fov, math.exp(log_height) if flat else None)

    return at


def _level_directions(towards: NDArray[np.float64], up: NDArray[np.float64]) -> _Curve:
    """Return unit vectors that follow azimuth, the short way round, and elevation about `up`."""
    first = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    first /= np.linalg.norm(first)
    second = np.cross(up, first)
    azimuth = np.arctan2(towards @ second, towards @ first)
    upright = np.hypot(towards @ first, towards @ second) < 1e-9
    for k in np.flatnonzero(upright):  # there, any azimuth will do
        azimuth[k] = azimuth[k - 1] if k else azimuth[np.argmin(upright)]
    elevation = np.arcsin(np.clip(towards @ up, -1, 1))
    angles = _curve(np.stack([np.unwrap(azimuth), elevation], axis=1).tolist())

    def at(u: float) -> NDArray[np.float64]:
        a, e = angles(u)
        return np.asarray(
            math.cos(e) * (math.cos(a) * first + math.sin(a) * second) + math.sin(e) * up, np.float64
        )

    return at


def _turns(
    cameras: Sequence[Camera],
) -> Callable[[float], tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Return directions and ups of cameras that turn freely."""
    from scipy.spatial.transform import Rotation, RotationSpline

    # Columns: right, up, and from the target to the eye.
    frames = np.stack([(camera.basis() * [[1], [1], [-1]]).T for camera in cameras])
    spline = RotationSpline(range(len(cameras)), Rotation.from_matrix(frames))

    def at(u: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        frame = spline(u).as_matrix()
        return frame[:, 2], frame[:, 1]

    return at


def _range_curve(keys: Sequence[View]) -> _Curve | None:
    """Return the ends of the colour scale; None where they are not given, or are of different scalars."""
    if len({(key.color_by, key.log) for key in keys}) > 1 or any(key.range is None for key in keys):
        return None
    ends = [list(key.range or ()) for key in keys]
    if not keys[0].log:
        return _curve(ends)
    logs = _curve(np.log(ends).tolist())
    return lambda u: np.exp(logs(u))


def _hide_curve(hides: Sequence[tuple[Condition, ...]]) -> Callable[[float], tuple[Condition, ...]] | None:
    """Return what is hidden, with planes and limits that move; None where keys hide different kinds of things."""
    kinds = [[_kind(condition) for condition in each] for each in hides]
    if any(each != kinds[0] for each in kinds):
        return None
    curves = [
        _curve([_limits(each[k]) for each in hides]) if _limits(hides[0][k]) else None
        for k in range(len(hides[0]))
    ]

    def at(u: float) -> tuple[Condition, ...]:
        return tuple(
            condition if curve is None else _moved(condition, curve(u).tolist())
            for condition, curve in zip(hides[0], curves, strict=True)
        )

    return at


def _kind(condition: Condition) -> tuple[object, ...]:
    if isinstance(condition, Cut):
        return "cut", condition.normal
    return "select", condition.scalar, condition.low is None, condition.high is None


def _limits(condition: Condition) -> list[float]:
    if isinstance(condition, Cut):
        return [condition.offset]
    return [limit for limit in (condition.low, condition.high) if limit is not None]


def _moved(condition: Condition, limits: list[float]) -> Condition:
    if isinstance(condition, Cut):
        return Cut(condition.normal, limits[0])
    low = None if condition.low is None else limits[0]
    return Select(condition.scalar, low, None if condition.high is None else limits[-1])
