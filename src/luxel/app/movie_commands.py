"""The command that makes movies: ``luxel movie``."""

from __future__ import annotations

import argparse
import glob
import hashlib
import json
import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import luxel
from luxel.app.command import Command
from luxel.app.look_commands import (
    add_picture_options,
    open_if_baked,
    open_series,
    stored_look,
    texture_spec,
)
from luxel.app.options import (
    LIGHTS,
    add_file_options,
    add_scene_options,
    aim,
    build_look,
    fill_light,
    number,
)
from luxel.app.parse import frame_range
from luxel.app.talk import Progress, say, say_if_cold, say_if_dark
from luxel.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from luxel.app.movie import Shot
    from luxel.particles import Particles
    from luxel.scene.saved import SavedView
    from luxel.scene.view import View
    from luxel.textures.spec import TextureSpec
    from luxel.textures.store.reader import Baked

__all__ = ["COMMANDS"]

_SECONDS = 8.0
_MOST_PICTURES = 100_000


def _movie_options(parser: argparse.ArgumentParser) -> None:
    add_file_options(parser)
    parser.add_argument(
        "-o",
        "--output",
        required=True,
        metavar="OUT",
        help="the movie to write: .mp4 (needs the program ffmpeg), .gif, .webp, or a folder for PNG files, which is resumable",
    )
    parser.add_argument(
        "--orbit",
        type=number,
        metavar="DEG",
        help="turn the camera around the data by so many degrees; 360 makes a loop",
    )
    parser.add_argument(
        "--frames", type=frame_range, metavar="A:B", help="show time steps from A up to B, which is left out"
    )
    parser.add_argument(
        "--fps", type=_rate, default=25.0, metavar="N", help="pictures a second (default: 25)"
    )
    parser.add_argument(
        "--seconds",
        type=_duration,
        metavar="S",
        help=f"length (default: one picture a time step; {_SECONDS:g} where there is one step only)",
    )
    add_picture_options(parser)
    parser.add_argument(
        "--light",
        choices=LIGHTS,
        default="texture",
        help="light from luminance textures, which are computed once a time step, or traced anew for every pixel (default: texture)",
    )
    add_scene_options(
        parser,
        samples=" (default: 1, with --mode paper 49), or a pixel with --light pixel (default: 64)",
        keyframes=True,
    )


def _movie(options: argparse.Namespace) -> None:
    from luxel.app.movie import pictures
    from luxel.app.movie_files import PngSequence, movie_file

    started = time.perf_counter()
    data = _open(options)
    steps = _steps(options, data)
    if len(steps) == 1 and len(data.looks) == 1 and not options.orbit:
        raise InputError(
            "nothing moves — give --orbit 360, several --view files, or time steps with --frames"
        )
    shots = _shots(options, data, steps, _keys(options, data, steps))
    target = movie_file(options.output, options.size, len(shots), options.fps, _about(options, data, shots))
    missing = target.missing(len(shots))
    if missing:
        say_if_cold()
        data.warn()
    with Progress("drawing", "pictures") as bar, _Bars("lighting") as light:
        bar(len(shots) - len(missing), len(shots))

        def counted() -> Iterator[tuple[int, Any]]:
            for k, pixels in pictures(shots, missing, data.step, light):
                yield k, pixels
                bar(bar.done + 1, len(shots))

        try:
            target.write(counted())
        except KeyboardInterrupt:
            if isinstance(target, PngSequence):
                say(
                    f"stopped after {bar.done} of {len(shots)} pictures, which are kept in {options.output}"
                    " — run the same command again to go on"
                )
            else:
                say("stopped; nothing was written — a folder of PNGs can be gone on with later")
            raise
    width, height = options.size
    done = f"{time.perf_counter() - started:.1f} s" if missing else "complete already, nothing to do"
    print(f"{options.output}: {len(shots)} pictures, {width}x{height}; {done}")


@dataclass(frozen=True)
class _Data:
    """What a movie is made of: a series under some light, or baked light."""

    path: str
    count: int
    looks: Sequence[SavedView]
    first: int
    spec: TextureSpec | None
    particles: Callable[[int], Particles]
    step: Callable[[int], Any]
    warn: Callable[[], None]


def _open(options: argparse.Namespace) -> _Data:
    from luxel.app.movie import Brush

    traced = {"samples": options.samples, "seed": options.seed or 0}
    baked = open_if_baked(options)
    looks = _looks(options, baked)
    if baked is not None:
        brush = Brush(options.size, options.antialias, options.colorbar, options.threads)
        frame = baked[looks[0].frame or 0]
        return _Data(
            baked.path, len(baked), looks, frame.index, None,
            lambda k: baked[k].particles, lambda k: brush.baked(baked[k]), lambda: None,
        )  # fmt: skip
    fill_light(options)
    spec = texture_spec(options) if options.light == "texture" else None
    brush = Brush(options.size, options.antialias, options.colorbar, options.threads, spec, traced)
    series, first = open_series(options, looks[0].frame)
    return _Data(
        series.path, len(series), looks, first, spec,
        lambda k: looks[0].scene(series[k]).particles,
        lambda k: brush.lit(looks[0].scene(series[k])),
        lambda: say_if_dark(looks[0].scene(series[first])),
    )  # fmt: skip


def _looks(options: argparse.Namespace, baked: Baked | None) -> list[SavedView]:
    """Return the keyframes; all have the light of the first."""
    looks: list[SavedView] = []
    for file in options.view_files or [None]:
        options.view_file = file
        look = build_look(options) if baked is None else stored_look(options, baked)
        if looks and look.light is not None and look.light.to_json() != looks[0].light.to_json():  # type: ignore[union-attr]
            raise InputError(
                f"{file}: its light differs from that of {options.view_files[0]} — a movie has one light: its camera, colours,"
                " cuts that keep light, and time steps may change"
            )
        looks.append(look)
    return looks


def _steps(options: argparse.Namespace, data: _Data) -> list[int]:
    """Return the time steps to show, in turn: those of ``--frames``, or those of the keyframes if these differ."""
    if options.frames is not None:
        steps = list(range(data.count)[options.frames])
        if not steps:
            raise InputError(
                f"--frames: {data.path} has frames 0..{data.count - 1}, none of them is in that range"
            )
        return steps
    named = [look.frame for look in data.looks if look.frame is not None]
    if options.frame is not None or len(named) < len(data.looks) or len(set(named)) < 2:
        return [data.first]
    if max(named) >= data.count:
        raise InputError(f"a view is of frame {max(named)}, and {data.path} has frames 0..{data.count - 1}")
    return named


def _keys(options: argparse.Namespace, data: _Data, steps: list[int]) -> list[View]:
    """Return the views of the keyframes, checked, with cameras and colour scales that hold for all time steps."""
    import numpy as np

    from luxel.scene.camera import Camera
    from luxel.scene.colormap import RGB

    listed = options.frames is not None
    shown = sorted(set(steps)) if listed else list(range(min(steps), max(steps) + 1))
    views = [look.view for look in data.looks]
    bounds: NDArray[np.float64] | None = None
    ranges: list[tuple[float, float] | None] = [view.range for view in views]
    with Progress("reading", "time steps") as bar:
        for done, step in enumerate(shown):
            bar(done, len(shown))
            particles = data.particles(step)
            low, high = particles.bounds
            bounds = (
                np.stack([low, high])
                if bounds is None
                else np.stack([np.minimum(bounds[0], low), np.maximum(bounds[1], high)])
            )
            for k, view in enumerate(views):
                view.hidden(particles)
                if view.color_by is not None:
                    particles.scalar(view.color_by)  # one that is not there is told now
                # A single step has the scale that a picture of it has.
                if view.color_by is None or view.range is not None or view.colormap == RGB:
                    continue
                first, last = view.scalar_range(particles)
                if len(shown) > 1 and not view.categorical(particles):
                    before = ranges[k] or (first, last)
                    ranges[k] = min(first, before[0]), max(last, before[1])
    assert bounds is not None
    keys = []
    for view, ends in zip(views, ranges, strict=True):
        aimed = aim(options, view.with_changes(range=ends), bounds, options.size)
        if aimed.camera is None:
            width, height = options.size
            aimed = aimed.with_changes(camera=Camera.framing(bounds, up=aimed.up, aspect=width / height))
        keys.append(aimed)
    return keys


def _shots(options: argparse.Namespace, data: _Data, steps: list[int], keys: list[View]) -> list[Shot]:
    from luxel.app.movie import Shot
    from luxel.app.movie_path import interpolated, orbit_angles, orbited, steps_between, steps_shown

    if len(steps) == 1 and len(keys) == 1 and not options.orbit:
        raise InputError(
            "nothing moves — give --orbit 360, several --view files, or time steps with --frames"
        )
    listed = options.frames is not None
    if options.seconds is not None:
        count = max(1, round(options.seconds * options.fps))
    else:
        count = len(steps) if listed and len(steps) > 1 else round(_SECONDS * options.fps)
    if count > _MOST_PICTURES:
        raise InputError(f"{count} pictures are more than {_MOST_PICTURES} — lower --seconds or --fps")
    views = interpolated(keys, count)
    if options.orbit:
        views = [orbited(view, a) for view, a in zip(views, orbit_angles(options.orbit, count), strict=True)]
    shown = steps_shown(steps, count) if listed else steps_between(steps, count)
    return [Shot(step, view) for step, view in zip(shown, views, strict=True)]


def _about(options: argparse.Namespace, data: _Data, shots: list[Shot]) -> dict[str, Any]:
    """Return what the pictures depend on, in a few plain values."""
    light = data.looks[0].light
    what = {
        "shots": [[shot.step, shot.view.to_json()] for shot in shots],
        "light": None if light is None else light.to_json(),
        "spec": None if data.spec is None else str(data.spec),
        "drawn": [options.light, options.samples, options.seed, options.antialias, options.colorbar],
        "radius": options.radius,
        "files": [_stamp(path) for path in sorted(options.file)],
    }
    digest = hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()
    return {
        "luxel": luxel.__version__,
        "data": data.path,
        "digest": digest,
        "pictures": len(shots),
        "size": list(options.size),
    }


def _stamp(path: str) -> list[Any]:
    """Return what tells whether a file has changed; patterns are told by what they match."""
    names = sorted(glob.glob(path)) or [path]
    return [[os.path.abspath(name), os.path.getsize(name), os.stat(name).st_mtime_ns] for name in names]


class _Bars:
    """A progress bar for each piece of work, one after the other."""

    def __init__(self, label: str) -> None:
        self._label = label
        self._bar: Progress | None = None

    def __call__(self, done: int, total: int) -> None:
        if self._bar is None:
            self._bar = Progress(self._label)
        self._bar(done, total)
        if done == total:
            self.__exit__()

    def __enter__(self) -> _Bars:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()
            self._bar = None


def _rate(text: str) -> float:
    rate = number(text)
    if not 0.1 <= rate <= 240:
        raise argparse.ArgumentTypeError(f"expected 0.1 to 240 pictures a second, got {text.strip()!r}")
    return rate


def _duration(text: str) -> float:
    seconds = number(text)
    if not 0 < seconds <= 36_000:
        raise argparse.ArgumentTypeError(f"expected seconds above 0, got {text.strip()!r}")
    return seconds


COMMANDS = (
    Command("movie", "make a movie: an orbit, a path of saved views, time steps", _movie_options, _movie),
)
