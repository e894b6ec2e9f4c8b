"""Scene: everything that light depends on, and the key that names it."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Literal, cast, get_args

import numpy as np
from numpy.typing import NDArray

from luxel.errors import InputError
from luxel.particles import Particles
from luxel.scene.hiding import Condition, as_conditions, hidden
from luxel.scene.lights import Light, QuadLight, Sky, SphereLight, Sun, default_lights
from luxel.scene.periodic import checked_cell, parse_axes

__all__ = ["MODELS", "Model", "Scene"]

Model = Literal["lambertian", "shadows", "ao", "interreflection"]
MODELS: tuple[Model, ...] = get_args(Model)


@dataclass(frozen=True, eq=False)
class Scene:
    """Particles, lights and the way light is computed.

    Parameters
    ----------
    particles
        The spheres; at least one.
    lights
        Any of `Sky` (at most one), `Sun`, `SphereLight`, `QuadLight`; None means
        :func:`luxel.scene.lights.default_lights`.
    model
        ``"lambertian"``: direct light without shadows. ``"shadows"``: direct light with soft shadows.
        ``"ao"``: ambient occlusion under a unit sky of its own, whatever the lights.
        ``"interreflection"``: direct light, soft shadows and all diffuse bounces.
    albedo
        One luminance albedo for all particles, [0, 1]. Colours do not matter here (paper 3.1).
    ao_distance
        For ``"ao"``: spheres farther than this do not occlude, in file units; None means no limit.
    periodic
        Cell vectors along which the particles repeat without end, for light only: letters of ``"xyz"`` (first,
        second, third vector) or three flags; kept as letters. Pictures show the particles as they are. Sphere and quad
        lights do not repeat. No sky or sun reaches into what repeats along all three.
    periodic_images
        A ray that has crossed more periodic faces than this without a hit ends in the dark.
    hide
        A `Cut` or `Select`, or several: particles that any of them hides do not exist, neither for light nor in
        pictures, so that light falls on what they covered. All particles keep their ids. See `View.hide` for the
        other rule, which changes no light.

    Raises
    ------
    InputError
        For no particles, an unknown model, values out of range; for `periodic` without a cell whose vectors
        span these axes.
    ScalarError
        If the particles lack a scalar that a selection in `hide` names.
    """

    particles: Particles
    lights: Sequence[Light] | None = None
    model: Model = "interreflection"
    albedo: float = 0.7
    ao_distance: float | None = None
    periodic: str | Sequence[bool] = ""
    periodic_images: int = 8
    hide: Condition | Sequence[Condition] = ()

    def __post_init__(self) -> None:
        if not isinstance(self.particles, Particles):
            raise InputError(
                f"a Scene needs Particles, got {type(self.particles).__name__} — luxel.open(...)[0] gives some"
            )
        if len(self.particles) == 0:
            raise InputError("no particles: nothing to light or draw — choose another frame")
        lights = default_lights() if self.lights is None else tuple(self.lights)
        for light in lights:
            if not isinstance(light, Sky | Sun | SphereLight | QuadLight):
                raise InputError(
                    f"a light must be Sky, Sun, SphereLight or QuadLight, got {type(light).__name__}"
                )
        if sum(isinstance(light, Sky) for light in lights) > 1:
            raise InputError("a scene has at most one Sky")
        if self.model not in MODELS:
            raise InputError(f"model must be one of {', '.join(MODELS)}; got {self.model!r}")
        if not 0.0 <= self.albedo <= 1.0:
            raise InputError(f"albedo must be in [0, 1], got {self.albedo}")
        if self.ao_distance is not None and not (math.isfinite(self.ao_distance) and self.ao_distance > 0):
            raise InputError(f"ao_distance must be positive, got {self.ao_distance}")
        if not isinstance(self.periodic_images, int) or not 0 <= self.periodic_images <= 10_000:
            raise InputError(
                f"periodic_images must be a whole number in 0..10000, got {self.periodic_images!r}"
            )
        object.__setattr__(self, "lights", lights)
        object.__setattr__(self, "periodic", parse_axes(self.periodic))
        if self.axes:
            checked_cell(self.particles, self.axes)
        object.__setattr__(self, "hide", as_conditions(self.hide, "hide of a scene"))
        self.hidden  # noqa: B018 - a scalar that is missing is an error now

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """What hides particles from light and pictures, as a tuple."""
        return cast(tuple[Condition, ...], self.hide)

    @cached_property
    def hidden(self) -> NDArray[np.bool_] | None:
        """(N,) bool: which particles do not exist for light; None if all do."""
        return hidden(self.particles, self.conditions)

    @property
    def axes(self) -> str:
        """The periodic axes in order, such as ``"xy"``; empty for a scene that does not repeat."""
        return cast(str, self.periodic)

    @property
    def sources(self) -> tuple[Light, ...]:
        """The lights, defaults filled in."""
        return cast(tuple[Light, ...], self.lights)

    @property
    def effective_lights(self) -> tuple[Light, ...]:
        """The lights that the model really uses: ambient occlusion has a unit sky of its own."""
        return (Sky(1.0),) if self.model == "ao" else self.sources

    @cached_property
    def key(self) -> str:
        """Hex digest of all that light depends on. Scalars, colours and cameras are not among it."""
        digest = hashlib.blake2b(digest_size=16)
        digest.update(_particles_digest(self.particles))
        digest.update(repr([_describe(light) for light in self.sources]).encode())
        reach = None if self.ao_distance is None else float(self.ao_distance)
        digest.update(repr((self.model, float(self.albedo), reach)).encode())
        if self.axes:
            cell = checked_cell(self.particles, self.axes)
            digest.update(repr((self.axes, self.periodic_images)).encode())
            digest.update(np.ascontiguousarray([*cell.vectors, cell.origin]).data)
        if self.hidden is not None:
            digest.update(b"hidden" + np.packbits(self.hidden).tobytes())
        return digest.hexdigest()

    def with_changes(self, **changes: Any) -> Scene:
        """Return a scene with some fields replaced."""
        return replace(self, **changes)


def _describe(light: Light) -> tuple[Any, ...]:
    # 20 and 20.0 are the same level: JSON written by a browser does not tell them apart.
    values = (np.asarray(getattr(light, f.name), dtype=object).tolist() for f in fields(light))
    return (type(light).__name__, *(float(v) if isinstance(v, int) else v for v in values))


def _particles_digest(particles: Particles) -> bytes:
    digest = hashlib.blake2b(digest_size=16)
    for array in (particles.origin, particles.local, particles.radii):
        digest.update(np.ascontiguousarray(array).data)
    return digest.digest()
