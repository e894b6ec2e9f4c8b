"""The command line: ``luxel info | render | view | demo``."""

from __future__ import annotations

import argparse
import io
import json
import os
import sys
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NoReturn

import luxel
from luxel.app.options import (
    LIGHTS,
    SunOption,
    add_file_options,
    add_scene_options,
    aim,
    build_lights,
    build_view,
    picture_size,
    positive_int,
    protect_numbers,
)
from luxel.errors import LuxelError

if TYPE_CHECKING:
    from luxel.io import Series
    from luxel.particles import Particles
    from luxel.scene.view import View
    from luxel.textures.spec import TextureSpec

__all__ = ["main"]

_QUIET_S = 15.0  # between reports where stderr is a file


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code: 0, 2 for bad input, 130 when interrupted."""
    given = sys.argv[1:] if arguments is None else arguments
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # odd file names and plain terminals
    options = _parser().parse_args(protect_numbers(given))
    try:
        options.run(options)
        sys.stdout.flush()
    except LuxelError as error:
        if options.debug:
            raise
        return _fail(str(error))
    except MemoryError:
        if options.debug:
            raise
        return _fail("not enough memory — choose fewer particles or a smaller picture")
    except KeyboardInterrupt:
        if options.debug:
            raise
        print("\nluxel: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of our output, such as `head`, has left
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    return 0


def _fail(message: str) -> int:
    print(f"luxel: error: {' '.join(message.split())}", file=sys.stderr)
    return 2


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """Say what is wrong in one line instead of repeating all options."""
        self.exit(2, f"luxel: error: {message} (see {self.prog} --help)\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="luxel", description="Global illumination on particles.", allow_abbrev=False)
    parser.add_argument("--version", action="version", version=f"luxel {luxel.__version__}")
    parser.add_argument("--debug", action="store_true", help="show tracebacks")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    info = _command(commands, "info", _info, "say what a file holds")
    add_file_options(info)
    info.add_argument("--json", action="store_true", help="print JSON")

    render = _command(commands, "render", _render, "draw a picture")
    add_file_options(render)
    _add_picture_options(render, "-o", "--output", required=True)
    render.add_argument(
        "--light",
        choices=LIGHTS,
        default="texture",
        help="light from luminance textures, or traced anew for every pixel (default: texture)",
    )
    render.add_argument("--json", action="store_true", help="print what was drawn as JSON")
    add_scene_options(render, samples=" (default: 4), or a pixel with --light pixel (default: 64)")

    view = _command(commands, "view", _view, "look at particles in the browser")
    add_file_options(view)
    _add_server_options(view)
    add_scene_options(view, samples=" (default: 4)")

    demo = _command(commands, "demo", _demo, "look at the data set that comes with luxel")
    _add_picture_options(demo, "--render")
    _add_server_options(demo)
    demo.set_defaults(light="texture", json=False)
    add_scene_options(demo, samples=" (default: 1)")
    return parser


def _command(commands: Any, name: str, run: Any, summary: str) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = commands.add_parser(
        name, help=summary, description=f"{summary[0].upper()}{summary[1:]}.", allow_abbrev=False
    )
    parser.add_argument("--debug", action="store_true", default=argparse.SUPPRESS, help="show tracebacks")
    parser.set_defaults(run=run)
    return parser


def _add_picture_options(parser: argparse.ArgumentParser, *flags: str, required: bool = False) -> None:
    parser.add_argument(
        *flags,
        dest="output",
        required=required,
        metavar="OUT.png",
        help="the picture to write: .png, .jpg, .webp, .tif or .bmp",
    )
    parser.add_argument(
        "--size",
        type=picture_size,
        default=(1280, 720),
        metavar="WxH",
        help="of the picture in pixels (default: 1280x720)",
    )
    parser.add_argument(
        "--antialias",
        type=positive_int,
        default=3,
        metavar="N",
        help="rays along each side of a pixel (default: 3)",
    )
    parser.add_argument(
        "--no-colorbar", dest="colorbar", action="store_false", help="leave out the colour bar"
    )


def _add_server_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--host", default="127.0.0.1", help="address to serve at (default: 127.0.0.1, this machine only)"
    )
    parser.add_argument("--port", type=int, default=0, help="default: any free one")
    parser.add_argument("--no-browser", dest="browser", action="store_false", help="only print the URL")


def _info(options: argparse.Namespace) -> None:
    from luxel.io import describe

    series, frame = _open(options)
    found = describe(series, frame)
    print(json.dumps(found, ensure_ascii=False, indent=2) if options.json else _table(found))


def _render(options: argparse.Namespace) -> None:
    from luxel.picture.image import check_output

    check_output(options.output)  # before minutes of work
    view = build_view(options)
    series, frame = _open(options)
    _draw(options, series[frame], view, {"file": series.path, "frame": frame})


def _view(options: argparse.Namespace) -> None:
    view = build_view(options)
    series, frame = _open(options)
    _serve(options, series, frame, view, series[frame])


def _demo(options: argparse.Namespace) -> None:
    from luxel.data import demo_particles, demo_view
    from luxel.picture.image import check_output

    view = build_view(options, demo_view())
    if options.sun is None:
        options.sun = [SunOption(155.0, 32.0)]  # to the left of the preset's camera
    if options.samples is None:
        options.samples = 1  # a good picture of this data set, and nobody wants to wait for a first one
    if options.output is None:
        particles = demo_particles()
        _serve(options, particles, None, view, particles)
    else:
        check_output(options.output)
        _draw(options, demo_particles(), view, {"file": "demo", "frame": 0})


def _open(options: argparse.Namespace) -> tuple[Series, int]:
    """Open the files and choose the frame."""
    import luxel.io

    files = options.file
    series = luxel.io.open(files[0] if len(files) == 1 else files, radius=options.radius)
    if options.frame is not None:
        series[options.frame]  # a frame that is not there is an error now
        return series, options.frame % len(series)
    frame = series.first_frame()
    if frame:
        _say(
            f"note: the first {frame} frame{'s hold' if frame > 1 else ' holds'} no particles; this is frame {frame}"
        )
    return series, frame


def _draw(options: argparse.Namespace, particles: Particles, view: View, origin: dict[str, Any]) -> None:
    from luxel.picture.raytrace import render
    from luxel.scene.scene import Scene

    started = time.perf_counter()
    if options.light == "texture":  # refuses bad values before the work
        _spec(options)
    scene = _scene(Scene, options, particles, view)
    _say_if_dark(options)
    view = aim(options, view, particles, options.size)
    if view.color_by is not None:
        view.scalar_range(particles)
    _say_if_cold()
    with _Progress() as progress:
        image = render(
            scene,
            view,
            size=options.size,
            light=options.light,
            samples=options.samples,
            mode=options.mode,
            mapping=options.mapping,
            antialias=options.antialias,
            threads=options.threads,
            seed=options.seed,
            colorbar=options.colorbar,
            progress=progress,
        )
    image.save(options.output)
    taken = time.perf_counter() - started
    if options.json:
        print(
            json.dumps(
                {
                    "output": options.output,
                    "size": list(image.size),
                    **origin,
                    "particles": len(particles),
                    "model": scene.model,
                    "light": options.light,
                    "seconds": round(taken, 3),
                    "view": view.with_changes(camera=view.camera_for(particles, options.size)).to_json(),
                },
                ensure_ascii=False,
                indent=2,
            )
        )
    else:
        print(
            f"{options.output}: {image.size[0]}x{image.size[1]}, {len(particles):,} particles, {taken:.1f} s"
        )


def _serve(
    options: argparse.Namespace,
    target: Series | Particles,
    frame: int | None,
    view: View,
    particles: Particles,
) -> None:
    from luxel.app.viewer import view as serve
    from luxel.session import Session

    spec = _spec(options)
    view = aim(options, view, particles, (16, 9))
    if view.color_by is not None:
        view.scalar_range(particles)
    _say_if_cold()
    with Session(
        target,
        frame=frame,
        lights=build_lights(options, view.up),
        model=options.model,
        albedo=options.albedo,
        ao_distance=options.ao_distance,
        periodic=options.periodic or "",
        spec=spec,
        view=view,
        threads=options.threads,
    ) as session:
        _say_if_dark(options)
        serve(
            session,
            view,
            host=options.host,
            port=options.port,
            open_browser=options.browser,
            block=True,
            announce=lambda url: print(url, flush=True),
        )


def _scene(kind: Any, options: argparse.Namespace, particles: Particles, view: View) -> Any:
    return kind(
        particles,
        lights=build_lights(options, view.up),
        model=options.model,
        albedo=options.albedo,
        ao_distance=options.ao_distance,
        periodic=options.periodic or "",
    )


def _spec(options: argparse.Namespace) -> TextureSpec:
    from luxel.textures.spec import TextureSpec

    samples = 4 if options.samples is None else options.samples
    return TextureSpec(samples=samples, mode=options.mode, seed=options.seed, mapping=options.mapping)


def _say(text: str) -> None:
    print(f"luxel: {text}", file=sys.stderr, flush=True)


def _say_if_cold() -> None:
    from luxel.kernels.jit import cold

    if cold():
        from luxel.app.warm import compile_ahead

        _say("compiling kernels for this machine (once) ...")
        compile_ahead()


def _say_if_dark(options: argparse.Namespace) -> None:
    closed = options.periodic == "xyz" and options.model != "lambertian"
    if closed and not (options.model == "ao" and options.ao_distance is not None):
        _say(
            "note: neither sky nor sun reaches into a cell that repeats along all of x, y and z"
            " — leave one out, or use --model ao with --ao-distance"
        )


class _Progress:
    """A progress bar on stderr, made at the first report; silent for short work and, longer, where nobody watches."""

    def __init__(self) -> None:
        self._bar: Any = None

    def __call__(self, done: int, total: int) -> None:
        if self._bar is None:
            from tqdm import tqdm

            watched = sys.stderr.isatty()
            self._bar = tqdm(
                total=total,
                desc="lighting",
                unit=" particles",
                unit_scale=True,
                leave=False,
                file=sys.stderr,
                delay=0.5 if watched else _QUIET_S,
                mininterval=0.1 if watched else _QUIET_S,
            )
        self._bar.total = total
        self._bar.update(done - self._bar.n)

    def __enter__(self) -> _Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()


def _table(found: dict[str, Any]) -> str:
    """Lay out what `describe` found for people."""
    lines = [
        f"{found['path']}: {found['format']}, {found['frames']} frame{'' if found['frames'] == 1 else 's'}"
    ]
    time_text = "" if found["time"] is None else f", time {found['time']:g}"
    lines.append(f"frame      {found['frame']}{time_text}")
    lines.append(f"particles  {found['particles']:,}")
    if found["bounds"] is not None:
        low, high = found["bounds"]
        lines.append(
            "bounds     "
            + "  ".join(f"{axis} {_span(a, b)}" for axis, a, b in zip("xyz", low, high, strict=True))
        )
    if found["cell"] is not None:
        periodic = (
            "".join(axis for axis, flag in zip("xyz", found["cell"]["periodic"], strict=True) if flag)
            or "no axis"
        )
        lines.append(f"cell       periodic along {periodic}")
    radii = found["radii"]
    lines.append(f"radii      {_span(radii['min'], radii['max'])}  ({radii['source']})")
    names = found["scalars"]
    lines.append(f"scalars    {'' if names else 'none'}".rstrip())
    width = max((len(name) for name in names), default=0)
    for name, scalar in names.items():
        parts = f"{scalar['dtype']}{'' if scalar['components'] == 1 else ' x ' + str(scalar['components'])}"
        missing = f"  no data: {scalar['no_data']:,}" if scalar["no_data"] else ""
        labels = f"  {', '.join(scalar['categories'][:8])}" if scalar.get("categories") else ""
        lines.append(
            f"  {name:<{width}}  {parts:<11}  {_span(scalar['min'], scalar['max'])}{missing}{labels}"
        )
    return "\n".join(lines)


def _span(low: float | None, high: float | None) -> str:
    if low is None or high is None:
        return "none"
    return f"{low:.6g}" if low == high else f"{low:.6g} … {high:.6g}"
