"""What a session looks like as messages: the wire form of its scene, light, scalars and status."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from luxel.app import protocol
from luxel.app.order import Order
from luxel.arrays import as_colors
from luxel.errors import InputError
from luxel.light.lights import luminance_scale, pack_lights, scene_white
from luxel.particles import Particles
from luxel.scene.colormap import colormap_names
from luxel.scene.hiding import condition_from_json
from luxel.scene.lights import Light, Sky, Sun, Up, sun_direction, up_frame
from luxel.scene.saved import Lighting, SavedView
from luxel.scene.scene import MODELS, Scene
from luxel.scene.view import View
from luxel.session import Session
from luxel.textures.spec import light_key
from luxel.textures.textures import decoding_table
from luxel.trace.spheres import SphereSet

__all__ = [
    "beside_state",
    "colormap",
    "geometry",
    "geometry_part",
    "light_changes",
    "light_state",
    "lights_with",
    "particle",
    "restore",
    "scalar",
    "scene_state",
    "status",
    "view_of",
]

_PART = 1 << 20  # particles in one geometry message: 16 MB


def view_of(session: Session) -> View:
    """Return the session's view, or the default one."""
    return session.view or View()


def restore(session: Session, saved: SavedView) -> tuple[View, str]:
    """Show the light and frame of a saved view; return what pages should show, and what they should know about it.

    Raises
    ------
    LuxelError
        If the particles lack a scalar that it names, or for a light that no scene takes; then nothing has changed.
    """
    view, frame, note = saved.view, saved.frame, ""
    if frame is not None and frame >= len(session.series):
        note = (
            f"The saved view is of frame {frame}, and there are {len(session.series)} here: the frame stays."
        )
        frame = None
    if session.light_fixed and saved.light is not None:
        note = note or "The light of the saved view is left out: the light here is baked in."
        view = view.with_changes(hide=(*view.conditions, *saved.light.conditions))
    particles = session.particles if frame is None else session.series[frame]
    if view.color_by is not None:
        particles.scalar(view.color_by)
    view.hidden(particles)
    session.restore(saved.light, frame)
    return view, note


def scene_state(
    session: Session, epoch: int, notice: str = "", *, streamed: bool = False, first: int = 0
) -> protocol.SceneState:
    """Describe the data set, without its arrays; `streamed` and `first` say whether these follow, see the message."""
    particles = session.particles.unscaled
    spheres = SphereSet.of(particles)
    names = [name for name in particles.names() if _drawable(particles, name)]
    return protocol.SceneState(
        epoch=epoch,
        title=_title(session.series),
        count=len(particles),
        center=tuple(spheres.center.tolist()),
        unit=float(spheres.unit),
        bounds=tuple(tuple(float(x) for x in corner) for corner in spheres.bounds()),
        texels=session.spec.texels,
        mapping=session.spec.mapping,
        frame=session.frame,
        frame_count=max(1, len(session.series)) if isinstance(session.series, Sequence) else 1,
        time=particles.time if particles.time is not None and math.isfinite(particles.time) else None,
        scalars=tuple(
            {
                "name": name,
                "labels": list(particles.categories[name]) if name in particles.categories else None,
                "colors": _are_colors(particles, name),
            }
            for name in names
        ),
        colormaps=tuple(colormap_names()),
        models=MODELS,
        view=view_of(session).to_json(),
        light_fixed=session.light_fixed,
        notice=notice,
        streamed=streamed,
        first=first,
    )


def light_state(session: Session) -> protocol.LightState:
    """Describe the light, in normalised units."""
    # One read of the scene, so that key and lights belong together even if another thread relights now.
    return _light_of(session.scene, session)


def beside_state(session: Session) -> protocol.BesideState | None:
    """Describe the light that is compared with; None while there is none."""
    scene = session.scene_beside
    return None if scene is None else protocol.BesideState(**vars(_light_of(scene, session)))


def _light_of(scene: Scene, session: Session) -> protocol.LightState:
    lights = pack_lights(scene, SphereSet.of(scene.particles))
    return protocol.LightState(
        key=light_key(scene, session.spec),
        model=scene.model,
        albedo=float(scene.albedo),
        white=scene_white(scene),
        decoding=decoding_table(luminance_scale(scene), session.spec.encoding),
        sky=lights.sky,
        suns=lights.suns,
        globes=lights.globes,
        quads=lights.quads,
        lighting=Lighting.of(scene).to_json(),
    )


def geometry(particles: Particles, epoch: int) -> Iterator[protocol.Geometry]:
    """Yield the particles in parts of bounded size, radii as they are in the file."""
    spheres = SphereSet.of(particles.unscaled)
    for start in range(0, len(particles), _PART):
        part = slice(start, start + _PART)
        yield protocol.Geometry(epoch, start, spheres.centers[part], spheres.radii[part])


def geometry_part(
    particles: Particles, epoch: int, start: int, count: int, order: Order | None
) -> protocol.Geometry:
    """Return some particles in the order that pages have them in; fewer at the end."""
    spheres = SphereSet.of(particles.unscaled)
    part = _part(start, count, order)
    return protocol.Geometry(epoch, start, spheres.centers[part], spheres.radii[part])


def _part(start: int, count: int | None, order: Order | None) -> Any:
    """Indices of some particles in the order that pages have them in."""
    part = slice(start, None if count is None else start + count)
    return part if order is None else order.to_file[part]


def scalar(
    particles: Particles,
    request: protocol.ScalarRequest,
    epoch: int,
    order: Order | None = None,
    with_values: bool = True,
) -> protocol.Scalar:
    """Return values of one scalar and the ranges of all, or the ranges alone.

    Raises
    ------
    ScalarError
        If there is no such scalar.
    """
    name = request.name
    values = particles.scalar(name)
    with np.errstate(over="ignore"):
        part = np.ascontiguousarray(values[_part(request.start, request.count, order)], dtype=np.float32)
    linear, logarithmic, missing = _ranges(particles, name)
    return protocol.Scalar(
        epoch,
        name,
        part if with_values else part[:0],
        linear,
        logarithmic,
        values.dtype.kind in "iu",
        missing,
        request.start,
    )


def _ranges(particles: Particles, name: str) -> tuple[tuple[float, float], tuple[float, float], bool]:
    """Return ranges for linear and logarithmic scales, and whether there is NaN; pages ask for it part by part."""
    derived = SphereSet.of(particles.unscaled).derived
    key = f"ranges of {name}"
    if key not in derived:
        view = View(color_by=name)
        derived[key] = (
            view.scalar_range(particles),
            view.with_changes(log=True).scalar_range(particles),
            bool(np.isnan(particles.scalar(name)).any()),
        )
    found: tuple[tuple[float, float], tuple[float, float], bool] = derived[key]
    return found


def particle(
    particles: Particles, number: int, epoch: int, order: Order | None = None
) -> protocol.ParticleState:
    """Describe the particle that has a number on pages.

    Raises
    ------
    InputError
        If there is no such particle.
    """
    if not 0 <= number < len(particles):
        raise InputError(f"no particle {number} — there are {len(particles)}, counted from 0")
    k = number if order is None else int(order.to_file[number])
    values = []
    for name, column in particles.scalars.items():
        labels = particles.categories.get(name, ())
        cells = np.atleast_1d(column[k])
        code = int(cells[0]) if column.ndim == 1 and column.dtype.kind in "iu" else -1
        text = labels[code] if 0 <= code < len(labels) else ", ".join(_number_text(cell) for cell in cells)
        values.append((name, text))
    position = particles.origin + particles.local[k]
    return protocol.ParticleState(
        epoch,
        number,
        k,
        ", ".join(f"{x:.7g}" for x in position),
        _number_text(particles.radii[k]),
        values,
    )


def _number_text(value: Any) -> str:
    if isinstance(value, np.integer):
        return str(value)
    return "no data" if np.isnan(value) else f"{value:.6g}"


def colormap(name: str) -> protocol.Colormap:
    """Return the colours of a map.

    Raises
    ------
    InputError
        If there is no such map.
    """
    return protocol.Colormap(name, View(colormap=name).lut())


def status(session: Session) -> protocol.Status:
    """Return how far the light is."""
    now = session.status()
    return protocol.Status(
        key=now.key,
        ready=int(now.ready),
        queued=int(now.queued),
        baking=int(now.baking),
        evicted=int(now.evicted),
        textures_per_s=round(float(now.textures_per_s), 1),
        error=None if now.error is None else str(now.error),
    )


def light_changes(session: Session, message: protocol.SetLight) -> dict[str, Any]:
    """Return what :meth:`luxel.Session.relight` is to be given.

    Raises
    ------
    InputError
        For values that make no sense, and if there are none.
    """
    changes: dict[str, Any] = {}
    for name in ("model", "albedo", "radius_scale"):
        if getattr(message, name) is not None:
            changes[name] = getattr(message, name)
    if message.sky is not None or message.sun is not None:
        up = message.up or view_of(session).up
        changes["lights"] = lights_with(session.scene.sources, message.sky, message.sun, up)  # type: ignore[arg-type]
    if message.hide is not None:
        changes["hide"] = tuple(condition_from_json(each) for each in message.hide)
    if not changes:
        raise InputError("a change of light that changes nothing")
    return changes


def lights_with(
    lights: Sequence[Light], sky: float | None, sun: tuple[float, float, float, float] | None, up: Up
) -> tuple[Light, ...]:
    """Return `lights` with a new sky level, and azimuth, elevation, level and diameter of the first sun.

    Other lights stay. A sky with a gradient keeps the ratio of its two levels, and turns with `up`.

    Raises
    ------
    InputError
        For values out of range.
    """
    changed = list(lights)
    upwards = up_frame(up)[2]
    if sky is not None:
        old = next((light for light in lights if isinstance(light, Sky)), None)
        if old is None:
            changed.insert(0, Sky(sky))
        else:
            ground = None if old.ground is None else old.ground * sky / old.level if old.level > 0 else sky
            axis = old.axis if ground is None else upwards
            changed[changed.index(old)] = replace(old, level=sky, ground=ground, axis=axis)
    if sun is not None:
        azimuth, elevation, level, diameter = sun
        if not -90.0 <= elevation <= 90.0:
            raise InputError(f"the sun's elevation must be in -90..90 degrees, got {elevation:g}")
        new = Sun(sun_direction(azimuth, elevation, up), level=level, angular_diameter=diameter)
        before = next((light for light in lights if isinstance(light, Sun)), None)
        if before is not None:
            changed[changed.index(before)] = new
        elif level > 0:
            changed.append(new)
    return tuple(changed)


def _drawable(particles: Particles, name: str) -> bool:
    return particles.scalar(name).dtype.kind in "fiu"


def _are_colors(particles: Particles, name: str) -> bool:
    """Whether a scalar can be shown as it is, see ``View.colormap``."""
    try:
        as_colors(particles.scalars.get(name, ()), len(particles))
    except InputError:
        return False
    return True


def _title(series: object) -> str:
    path = getattr(series, "path", None)
    return (
        os.path.basename(os.fspath(path).rstrip("/\\"))
        if isinstance(path, str | os.PathLike)
        else "particles"
    )
