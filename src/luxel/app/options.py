"""Command line options that `render`, `view` and `demo` share, and what they mean."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from luxel.app.parse import (
    SunOption,
    axes,
    frame_budget,
    number,
    picture_size,
    positive_int,
    radius,
    sky_levels,
    sun,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from luxel.scene.camera import Camera
    from luxel.scene.hiding import Condition
    from luxel.scene.lights import Light
    from luxel.scene.saved import SavedView
    from luxel.scene.view import View

__all__ = [
    "SunOption",
    "add_bake_options",
    "add_file_options",
    "add_light_options",
    "add_scene_options",
    "bake_share",
    "build_lights",
    "build_look",
    "build_view",
    "fill_light",
    "frame_budget",
    "given_light",
    "number",
    "picture_size",
    "positive_int",
    "protect_numbers",
]

# Written out so that `luxel --help` imports nothing; a test holds them to the library's own.
MODELS = ("lambertian", "shadows", "ao", "interreflection")
LIGHTS = ("texture", "pixel")
RENDERERS = ("browser", "raytrace")
MODES = ("fast", "paper")
MAPPINGS = ("latlong", "octahedral")
# Options of light are None unless they are given, so that they can be refused where the light is baked in.
_LIGHT_DEFAULTS = {"model": "interreflection", "mode": "fast", "mapping": "latlong", "albedo": 0.7, "seed": 0}
_LIGHT_OPTIONS = (*_LIGHT_DEFAULTS, "samples", "sun", "sky", "ao_distance", "periodic", "radius_scale")
# Whether what is hidden still casts shadows and bounces light.
HIDDEN_LIGHT = ("keeps", "opens")
_NUMBER = re.compile(r"-\.?\d")


def protect_numbers(arguments: Sequence[str]) -> list[str]:
    """Put a blank before arguments such as -1e5 and -30,40, which argparse would take for options."""
    return [f" {argument}" if _NUMBER.match(argument) else argument for argument in arguments]


def add_bake_options(parser: argparse.ArgumentParser) -> None:
    """Add what says how a viewer shares the machine between light and everything else."""
    group = parser.add_argument_group("share of the machine")
    group.add_argument(
        "--bake-threads",
        type=positive_int,
        metavar="N",
        help="threads that compute light (default: as many as --threads)",
    )
    group.add_argument(
        "--bake-budget",
        type=frame_budget,
        metavar="TIME",
        help="let them work for so long of every frame, a thirtieth of a second or longer, such as 10ms (default: all the time)",
    )


def bake_share(options: argparse.Namespace) -> dict[str, Any]:
    """Return what :func:`add_bake_options` says, as a session takes it."""
    threads = options.threads if options.bake_threads is None else options.bake_threads
    return {"threads": threads, "bake_budget_s": options.bake_budget or 0.0}


def add_file_options(parser: argparse.ArgumentParser, *, stores: bool = True) -> None:
    """Add what says which particles: the file, the frame (where `stores` are files too), the radius."""
    parser.add_argument(
        "file",
        nargs="+",
        metavar="FILE",
        help="a particle file, a Uintah directory, a pattern, or several files"
        + ("; or what luxel bake made" if stores else ""),
    )
    if stores:
        parser.add_argument(
            "--frame",
            type=int,
            metavar="K",
            help="time step, counted from 0; -1 is the last (default: the first with particles)",
        )
    parser.add_argument(
        "--radius",
        type=radius,
        metavar="R",
        help="radius of all particles in file units, or auto to estimate it (default: the file's, else auto)",
    )


def add_scene_options(parser: argparse.ArgumentParser, *, samples: str, keyframes: bool = False) -> None:
    """Add what says how particles are lit and looked at; None means "not given".

    With `keyframes`, ``--view`` may be repeated: then it is for the caller to set ``view_file`` to each of ``view_files``.
    """
    add_light_options(parser, samples=samples)
    _add_view_options(parser, keyframes=keyframes)


def add_light_options(parser: argparse.ArgumentParser, *, samples: str) -> None:
    """Add what says how particles are lit; None means "not given", see :func:`fill_light`."""
    light = parser.add_argument_group("light")
    light.add_argument("--model", choices=MODELS, help="shading model (default: interreflection)")
    light.add_argument(
        "--samples",
        type=positive_int,
        metavar="N",
        help=f"light samples a texel; in paper mode a square number{samples}",
    )
    light.add_argument(
        "--mode",
        choices=MODES,
        help="fast filters the textures; paper follows the paper to the letter (default: fast)",
    )
    light.add_argument(
        "--mapping",
        choices=MAPPINGS,
        help="from texels to directions: latitude-longitude as in the paper, or equal-area octahedral (default: latlong)",
    )
    light.add_argument(
        "--albedo",
        type=number,
        metavar="A",
        help="share of light that particles reflect, 0 to 1 (default: 0.7)",
    )
    light.add_argument(
        "--sun",
        type=sun,
        action="append",
        metavar="AZ,EL[,LEVEL[,DIAMETER]]",
        help="a sun instead of the default one, angles in degrees (default: 225,42,2,15); may be repeated; none for no sun",
    )
    light.add_argument(
        "--sky",
        type=sky_levels,
        metavar="LEVEL[,GROUND]",
        help="the sky's level instead of 1, and its level from below; 0 for no sky",
    )
    light.add_argument(
        "--ao-distance",
        type=number,
        metavar="D",
        help="for --model ao: what is farther does not occlude, in file units (default: no limit)",
    )
    light.add_argument(
        "--periodic",
        type=axes,
        metavar="AXES",
        help="repeat the simulation cell for light along these of its vectors, such as xy; pictures show one cell (default: none)",
    )
    light.add_argument("--seed", type=int, metavar="N", help="of the random numbers (default: 0)")
    light.add_argument("--threads", type=positive_int, metavar="N", help="default: all processors")


def _add_view_options(parser: argparse.ArgumentParser, *, keyframes: bool) -> None:
    look = parser.add_argument_group("view")
    what = "a saved view; other options override it"
    if keyframes:
        what += "; repeated, the camera moves smoothly from one to the next"
        look.add_argument("--view", dest="view_files", action="append", metavar="VIEW.json", help=what)
    else:
        look.add_argument("--view", dest="view_file", metavar="VIEW.json", help=what)
    look.add_argument(
        "--color-by", metavar="NAME", help="scalar, component (velocity.x) or vector (its magnitude)"
    )
    look.add_argument("--colormap", metavar="NAME", help="any of matplotlib's (default: viridis)")
    look.add_argument(
        "--range",
        nargs=2,
        type=number,
        metavar=("LO", "HI"),
        help="scalar values of the first and last colour (default: those of the data)",
    )
    look.add_argument("--log", action="store_true", default=None, help="logarithmic colour scale")
    look.add_argument("--background", metavar="C", help="colour: white, #17191d, 0.2 ...")
    look.add_argument("--exposure", type=number, metavar="E", help="brightness factor (default: 1)")
    add_up_option(look)
    look.add_argument(
        "--azimuth", type=number, metavar="DEG", help="camera's direction around the up axis (default: -60)"
    )
    look.add_argument(
        "--elevation", type=number, metavar="DEG", help="camera's height above the horizon (default: 25)"
    )
    look.add_argument("--orthographic", action="store_true", help="parallel projection")
    _add_hiding_options(parser)


def _add_hiding_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("which particles, and how large")
    group.add_argument(
        "--cut",
        action="append",
        metavar="PLANE",
        help="hide particles beyond a plane, such as 'x>0.5', 'z<-2' or '1,1,0>3'; may be repeated",
    )
    group.add_argument(
        "--cut-light",
        choices=HIDDEN_LIGHT,
        help="opens: light falls into the cut; keeps: what is cut away still casts shadows, light stays as it is"
        " (default: opens, keeps where the light is baked in)",
    )
    group.add_argument(
        "--select",
        action="append",
        metavar="RANGE",
        help="show only particles with these values, such as 'stress>1e6', 'type=2' or '0.1<density<0.9'; may be repeated",
    )
    group.add_argument("--select-light", choices=HIDDEN_LIGHT, help="the same for what is not selected")
    group.add_argument("--radius-scale", type=number, metavar="F", help="factor on all radii (default: 1)")


def add_up_option(group: argparse._ActionsContainer) -> None:
    """Add ``--up``, which turns the default lights and cameras."""
    group.add_argument("--up", choices=("x", "y", "z"), help="axis that points up (default: z)")


def given_light(options: argparse.Namespace) -> list[str]:
    """Return the options of light that were given, as they are typed."""
    return [
        f"--{name.replace('_', '-')}" for name in _LIGHT_OPTIONS if getattr(options, name, None) is not None
    ]


def fill_light(options: argparse.Namespace) -> None:
    """Set the options of light that were not given to their defaults, where these are not for others to choose."""
    for name, value in _LIGHT_DEFAULTS.items():
        if getattr(options, name) is None:
            setattr(options, name, value)


def build_lights(
    options: argparse.Namespace, up: str, base: Sequence[Light] | None = None
) -> tuple[Light, ...]:
    """Return the lights: a given sky or sun replaces that light of `base`, or of the default lights, only."""
    from luxel.scene.lights import Sky, Sun, default_lights, sun_direction, up_frame

    lights = list(default_lights(up) if base is None else base)  # type: ignore[arg-type]
    if options.sky is not None:
        lights = [light for light in lights if not isinstance(light, Sky)]
        if any(options.sky):  # a negative level is refused by Sky
            level, *ground = options.sky
            axis = up_frame(up)[2]  # type: ignore[arg-type]
            lights.insert(0, Sky(level, ground[0] if ground else None, axis=axis))
    if options.sun is not None:
        lights = [light for light in lights if not isinstance(light, Sun)]
        for given in options.sun:
            if given is not None:
                direction = sun_direction(given.azimuth, given.elevation, up)  # type: ignore[arg-type]
                lights.append(Sun(direction, given.level, given.diameter))
    return tuple(lights)


def build_look(options: argparse.Namespace, base: View | None = None, *, rule: str = "opens") -> SavedView:
    """Return view and light that options ask for, on top of ``--view``'s; the frame is that of ``--view``.

    Parameters
    ----------
    options
        Parsed by :func:`add_scene_options`.
    base
        As of :func:`build_view`.
    rule
        What ``--cut-light`` and ``--select-light`` say where they are not given.
    """
    from luxel.scene.saved import Lighting, SavedView

    loaded = None if options.view_file is None else SavedView.load(options.view_file)
    saved = loaded or SavedView(base or _default_view())
    view = build_view(options, saved.view)
    before = saved.light or Lighting()
    names = ("model", "albedo", "ao_distance", "periodic", "radius_scale")
    changes = {name: value for name in names if (value := getattr(options, name, None)) is not None}
    kept, opened = _conditions(options, rule)
    light = before.with_changes(
        lights=build_lights(options, view.up, before.lights),
        hide=(*before.conditions, *opened),
        **changes,
    )
    return SavedView(view.with_changes(hide=(*view.conditions, *kept)), light, saved.frame)


def _default_view() -> View:
    from luxel.scene.view import View

    return View()


def _conditions(options: argparse.Namespace, rule: str) -> tuple[list[Condition], list[Condition]]:
    """Return what ``--cut`` and ``--select`` hide: without change of light, and from light too."""
    from luxel.scene.hiding import Cut, Select

    kept: list[Condition] = []
    opened: list[Condition] = []
    for kind, texts, given in (
        (Cut, options.cut, options.cut_light),
        (Select, options.select, options.select_light),
    ):
        found = opened if (given or rule) == "opens" else kept
        found += [kind.parse(text) for text in texts or ()]
    return kept, opened


def build_view(options: argparse.Namespace, base: View | None = None) -> View:
    """Return the view that options ask for, without a camera from angles: that takes the data's bounds.

    Parameters
    ----------
    options
        Parsed by :func:`add_scene_options`.
    base
        What applies where no option says otherwise; None means the defaults.
    """
    view = base or _default_view()
    changes: dict[str, Any] = {}
    for name in ("color_by", "colormap", "log", "background", "exposure", "up"):
        if getattr(options, name) is not None:
            changes[name] = getattr(options, name)
    if options.range is not None:
        changes["range"] = tuple(options.range)
    elif "color_by" in changes and changes["color_by"] != view.color_by:
        changes["range"] = None  # a saved range belongs to the saved scalar
    if options.up is not None and options.up != view.up:
        changes["camera"] = None
    return view.with_changes(**changes) if changes else view


def aim(options: argparse.Namespace, view: View, bounds: NDArray[np.float64], size: tuple[int, int]) -> View:
    """Return the view with the camera that ``--azimuth``, ``--elevation`` and ``--orthographic`` ask for, to see all of `bounds` (2, 3)."""
    from luxel.scene.camera import Camera

    if options.azimuth is None and options.elevation is None and not options.orthographic:
        return view
    angles = {
        name: getattr(options, name)
        for name in ("azimuth", "elevation")
        if getattr(options, name) is not None
    }
    camera: Camera = Camera.framing(
        bounds, up=view.up, aspect=size[0] / size[1], orthographic=options.orthographic, **angles
    )
    return view.with_changes(camera=camera)
