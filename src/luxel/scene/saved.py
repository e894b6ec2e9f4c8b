"""A saved view: all that a picture of a file depends on but the file itself, as a small JSON file."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, cast

from luxel.errors import FormatError, InputError, MissingFileError, StorageError
from luxel.particles import Particles
from luxel.scene.hiding import Condition, as_conditions, condition_from_json
from luxel.scene.lights import Light, light_from_json, light_json
from luxel.scene.scene import Model, Scene
from luxel.scene.view import View

__all__ = ["Lighting", "SavedView"]

#: Of the file; readers take this one and all before it.
VERSION = 1
_BYTES_MAX = 1 << 20


@dataclass(frozen=True, eq=False)
class Lighting:
    """What light depends on besides the particles.

    Parameters
    ----------
    model, lights, albedo, ao_distance, periodic, periodic_images, hide
        See :class:`luxel.Scene`.
    radius_scale
        Factor on all radii.
    """

    model: Model = "interreflection"
    lights: Sequence[Light] | None = None
    albedo: float = 0.7
    ao_distance: float | None = None
    periodic: str = ""
    periodic_images: int = 8
    hide: Condition | Sequence[Condition] = ()
    radius_scale: float = 1.0

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """What hides particles from light and pictures, as a tuple."""
        return as_conditions(self.hide)

    @classmethod
    def of(cls, scene: Scene) -> Lighting:
        """Return what lights a scene, particles with scaled radii included."""
        return cls(
            scene.model,
            scene.sources,
            float(scene.albedo),
            None if scene.ao_distance is None else float(scene.ao_distance),
            scene.axes,
            scene.periodic_images,
            scene.conditions,
            scene.particles.radius_scale,
        )

    def scene(self, particles: Particles) -> Scene:
        """Return these particles under this light.

        Raises
        ------
        InputError
            For anything that a scene does not take.
        """
        return Scene(
            particles.scaled(self.radius_scale),
            self.lights,
            self.model,
            self.albedo,
            self.ao_distance,
            self.periodic,
            self.periodic_images,
            self.hide,
        )

    def with_changes(self, **changes: Any) -> Lighting:
        """Return a lighting with some fields replaced."""
        return replace(self, **changes)

    def to_json(self) -> dict[str, Any]:
        """Return a small dict of plain numbers and strings; :meth:`from_json` makes the same lighting again."""
        found = {field.name: getattr(self, field.name) for field in fields(self)}
        found["lights"] = None if self.lights is None else [light_json(light) for light in self.lights]
        found["hide"] = [condition.to_json() for condition in self.conditions]
        return found

    @classmethod
    def from_json(cls, data: object) -> Lighting:
        """Make a lighting of what :meth:`to_json` returned; fields left out have their defaults.

        Raises
        ------
        InputError
            For unknown fields, and lights and conditions that make no sense. What only a scene can judge, it does.
        """
        values = _fields(data, "the light of a saved view", [field.name for field in fields(cls)])
        what = "the light of a saved view"
        for name in ("lights", "hide"):
            if values.get(name) is not None and not isinstance(values[name], list):
                raise InputError(f"{what}: {name} must be a list, got {values[name]!r}")
        for name in ("albedo", "ao_distance", "radius_scale"):
            value = values.get(name)
            if isinstance(value, bool) or not (value is None or isinstance(value, int | float)):
                raise InputError(f"{what}: {name} must be a number, got {value!r}")
        if not isinstance(values.get("periodic", ""), str):
            raise InputError(f"{what}: periodic must be letters such as xy, got {values['periodic']!r}")
        if values.get("lights") is not None:
            values["lights"] = tuple(light_from_json(each) for each in values["lights"])
        if "hide" in values:
            values["hide"] = tuple(
                condition_from_json(each, f"{what}: hide") for each in values["hide"] or ()
            )
        return cls(**values)


@dataclass(frozen=True, eq=False)
class SavedView:
    """A view with its light and time step.

    >>> saved = luxel.SavedView.load("view.json")
    >>> luxel.render(saved.scene(series[saved.frame or 0]), saved.view)

    Parameters
    ----------
    view
        Camera, colours, tone, and what is hidden without change of light.
    light
        None where the light is not part of it, such as in views of baked textures.
    frame
        Time step; None means the reader's choice.
    """

    view: View
    light: Lighting | None = None
    frame: int | None = None

    def scene(self, particles: Particles) -> Scene:
        """Return these particles under the saved light, or the default one."""
        return (self.light or Lighting()).scene(particles)

    def to_json(self) -> dict[str, Any]:
        """Return a dict of plain values; :meth:`from_json` makes the same saved view again."""
        return {
            "luxel_view": VERSION,
            "frame": self.frame,
            "view": self.view.to_json(),
            "light": None if self.light is None else self.light.to_json(),
        }

    @classmethod
    def from_json(cls, data: object) -> SavedView:
        """Make a saved view of what :meth:`to_json` returned, or of a bare view's JSON.

        Raises
        ------
        InputError
            For another version, unknown fields, and values that make no sense.
        """
        if not isinstance(data, Mapping):
            raise InputError(f"a saved view must be a JSON object, got {type(data).__name__}")
        if "luxel_view" not in data:
            return cls(View.from_json(data))
        version = data["luxel_view"]
        if type(version) is not int or not 1 <= version <= VERSION:
            raise InputError(
                f"this saved view has version {version!r}; this luxel reads 1..{VERSION} — update luxel, or save it again"
            )
        values = _fields(data, "a saved view", ["luxel_view", "frame", "view", "light"])
        frame = values.get("frame")
        if frame is not None and (type(frame) is not int or frame < 0):
            raise InputError(f"the frame of a saved view must be a whole number >= 0, got {frame!r}")
        light = values.get("light")
        return cls(
            View.from_json(values.get("view", {})),
            None if light is None else Lighting.from_json(light),
            frame,
        )

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> SavedView:
        """Read a file that :meth:`save` or the viewer wrote.

        Raises
        ------
        MissingFileError
            If there is no such file.
        FormatError
            If it holds no view; the message says where it goes wrong.
        """
        path = os.fspath(path)
        try:
            if os.path.getsize(path) > _BYTES_MAX:
                raise FormatError(path, f"this is no view: longer than {_BYTES_MAX} bytes")
            with open(path, encoding="utf-8") as file:
                return cls.from_json(json.load(file))
        except FileNotFoundError:
            raise MissingFileError(f"{path}: no such view file") from None
        except json.JSONDecodeError as error:
            raise FormatError(
                path,
                f"this is no view: {error.msg}",
                place=f"line {error.lineno}, column {error.colno}",
                remedy="save one in the viewer",
            ) from None
        except InputError as error:
            raise FormatError(path, str(error)) from None
        except (ValueError, RecursionError) as error:  # bytes that are no text, brackets without end
            if isinstance(error, FormatError):
                raise
            raise FormatError(path, f"this is no view: {error}", remedy="save one in the viewer") from None
        except OSError as error:
            raise InputError(f"{path}: cannot read it ({error.strerror})") from None

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a file that :meth:`load`, ``luxel render --view`` and the viewer read.

        Raises
        ------
        StorageError
            If it cannot be written.
        """
        path = os.fspath(path)
        try:
            with open(path, "w", encoding="utf-8") as file:
                json.dump(self.to_json(), file, ensure_ascii=False, indent=2)
                file.write("\n")
        except OSError as error:
            raise StorageError(f"{path}: cannot write it ({error.strerror})") from None


def _fields(data: object, what: str, known: list[str]) -> dict[str, Any]:
    if not isinstance(data, Mapping):
        raise InputError(f"{what} must be a JSON object, got {type(data).__name__}")
    if unknown := [str(name) for name in data if name not in known]:
        raise InputError(f"{what} has no field {', '.join(unknown)}; known are {', '.join(known)}")
    return cast(dict[str, Any], dict(data))
