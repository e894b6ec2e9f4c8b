"""The commands that look: ``luxel info | render | view | demo``."""

from __future__ import annotations

import argparse
import json
import time
from typing import TYPE_CHECKING, Any

from luxel.app.command import Command
from luxel.app.options import (
    LIGHTS,
    RENDERERS,
    SunOption,
    add_bake_options,
    add_file_options,
    add_scene_options,
    aim,
    bake_share,
    build_look,
    fill_light,
    given_light,
    picture_size,
    positive_int,
)
from luxel.app.talk import Progress, say, say_if_cold, say_if_dark
from luxel.errors import InputError

if TYPE_CHECKING:
    from luxel.io import Series
    from luxel.particles import Particles
    from luxel.scene.saved import SavedView
    from luxel.scene.scene import Scene
    from luxel.scene.view import View
    from luxel.session import Session
    from luxel.textures.spec import Purpose, TextureSpec
    from luxel.textures.store.reader import Baked
    from luxel.textures.textures import TextureSource

__all__ = ["COMMANDS", "add_picture_options", "open_if_baked", "open_series", "stored_look", "texture_spec"]


def _info_options(parser: argparse.ArgumentParser) -> None:
    add_file_options(parser)
    parser.add_argument("--json", action="store_true", help="print JSON")


def _render_options(parser: argparse.ArgumentParser) -> None:
    add_file_options(parser)
    _add_output_option(parser, "-o", "--output", required=True)
    add_picture_options(parser)
    parser.add_argument(
        "--light",
        choices=LIGHTS,
        default="texture",
        help="light from luminance textures, or traced anew for every pixel (default: texture)",
    )
    parser.add_argument("--json", action="store_true", help="print what was drawn as JSON")
    add_scene_options(
        parser, samples=" (default: 6, with --mode paper 49), or a pixel with --light pixel (default: 64)"
    )


def _view_options(parser: argparse.ArgumentParser) -> None:
    add_file_options(parser)
    _add_server_options(parser)
    add_bake_options(parser)
    add_scene_options(parser, samples=" (default: 9 after a first one, with --mode paper 49)")


def _demo_options(parser: argparse.ArgumentParser) -> None:
    _add_output_option(parser, "--render")
    add_picture_options(parser)
    _add_server_options(parser)
    add_bake_options(parser)
    parser.set_defaults(light="texture", json=False)
    add_scene_options(parser, samples=" (default: 9 after a first one, with --render 2)")


def _add_output_option(parser: argparse.ArgumentParser, *flags: str, required: bool = False) -> None:
    parser.add_argument(
        *flags,
        dest="output",
        required=required,
        metavar="OUT.png",
        help="the picture to write: .png, .jpg, .webp, .tif or .bmp",
    )


def add_picture_options(parser: argparse.ArgumentParser) -> None:
    """Add what says how a picture is drawn: its size, antialiasing, and whether it has a colour bar."""
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
    parser.add_argument(
        "--renderer",
        choices=RENDERERS,
        default="browser",
        help="what draws at first: the browser, or this machine, which then sends pictures instead of particles (default: browser)",
    )
    parser.add_argument("--no-browser", dest="browser", action="store_false", help="only print the URL")


def _info(options: argparse.Namespace) -> None:
    baked = open_if_baked(options)
    if baked is not None:
        from luxel.app.report import store_table
        from luxel.textures.store.info import describe_baked

        found = describe_baked(baked)
        table = store_table
    else:
        from luxel.app.report import file_table as table
        from luxel.io import describe

        series, frame = open_series(options)
        found = describe(series, frame)
    print(json.dumps(found, ensure_ascii=False, indent=2) if options.json else table(found))


def _render(options: argparse.Namespace) -> None:
    from luxel.picture.image import check_output

    check_output(options.output)  # before minutes of work
    baked = open_if_baked(options)
    if baked is not None:
        look = stored_look(options, baked)
        frame = baked[look.frame or 0]
        origin = {"file": baked.path, "frame": frame.index}
        _draw(options, frame.scene, look.view, origin, frame.compressed)
    else:
        look = build_look(options)
        series, k = open_series(options, look.frame)
        _draw(options, look.scene(series[k]), look.view, {"file": series.path, "frame": k})


def _view(options: argparse.Namespace) -> None:
    baked = open_if_baked(options)
    if baked is not None:
        from luxel.session import Session

        look = stored_look(options, baked)
        frame = baked[look.frame or 0]
        view = _ready(options, look.view, frame.particles)
        _serve(options, Session(baked, frame=frame.index, view=view, **bake_share(options)), view)
    else:
        look = build_look(options)
        series, k = open_series(options, look.frame)
        _serve_light(options, series, k, look, series[k])


def _demo(options: argparse.Namespace) -> None:
    from luxel.data import demo_particles, demo_view
    from luxel.picture.image import check_output

    if options.sun is None and options.view_file is None:
        options.sun = [SunOption(155.0, 32.0)]  # to the left of the preset's camera
    if options.samples is None and options.output is not None and options.mode != "paper":
        options.samples = 2  # a good picture of this data set, and nobody wants to wait for a first one
    look = build_look(options, demo_view())
    particles = demo_particles()
    if options.output is None:
        _serve_light(options, particles, None, look, particles)
    else:
        check_output(options.output)
        _draw(options, look.scene(particles), look.view, {"file": "demo", "frame": 0})


def open_series(options: argparse.Namespace, wanted: int | None = None) -> tuple[Series, int]:
    """Open the files and choose the frame: the one asked for, else that of a saved view, else the first with particles."""
    import luxel.io

    files = options.file
    series = luxel.io.open(files[0] if len(files) == 1 else files, radius=options.radius)
    if options.frame is not None:
        series[options.frame]  # a frame that is not there is an error now
        return series, options.frame % len(series)
    if wanted is not None:
        if wanted < len(series):
            return series, wanted
        say(f"note: the saved view is of frame {wanted}, and there are {len(series)} frames here")
    frame = series.first_frame()
    if frame:
        say(f"note: frames before {frame} hold no particles; this is frame {frame}")
    return series, frame


def open_if_baked(options: argparse.Namespace) -> Baked | None:
    """Open a store of baked textures, and refuse what would change its light; None for particle files."""
    from luxel.textures.store.reader import is_store, open_baked

    stores = [file for file in options.file if is_store(file)]
    if not stores:
        return None
    if len(options.file) > 1:
        raise InputError(
            f"{stores[0]}: baked textures are looked at alone — give one store, or particle files"
        )
    baked = open_baked(stores[0])
    refused = given_light(options)
    if getattr(options, "light", "texture") != "texture":
        refused.append("--light")
    for name in ("cut", "select"):
        if getattr(options, f"{name}_light", None) == "opens":
            refused.append(f"--{name}-light opens")
    if options.radius is not None:
        refused.append("--radius")
    if refused:
        raise InputError(
            f"{', '.join(refused)}: the light of {baked.path} is baked in"
            " — leave these out, or bake the particle file again with them"
        )
    return baked


def stored_look(options: argparse.Namespace, baked: Baked) -> SavedView:
    """Return the view that options ask for, under the light of the store."""
    from luxel.scene.saved import SavedView
    from luxel.scene.view import View

    look = build_look(options, View(up=baked.settings.up), rule="keeps")
    view, frame = look.view, look.frame if options.frame is None else options.frame
    if look.light is not None and look.light.conditions:
        say(
            "note: what the saved view hides from light too is only left out of the picture: this light is baked in"
        )
        view = view.with_changes(hide=(*view.conditions, *look.light.conditions))
    return SavedView(view, None, frame)


def _draw(
    options: argparse.Namespace,
    scene: Scene,
    view: View,
    origin: dict[str, Any],
    textures: TextureSource | None = None,
) -> None:
    from luxel.picture.raytrace import render

    started = time.perf_counter()
    particles = scene.particles
    lit: dict[str, Any] = {"textures": textures}
    if textures is None:
        fill_light(options)
        if options.light == "texture":  # refuses bad values before the work
            texture_spec(options, "picture")
        say_if_dark(scene)
        names = ("light", "samples", "mode", "mapping", "seed")
        lit = {name: getattr(options, name) for name in names}
    view = _ready(options, view, particles, options.size)
    with Progress() as progress:
        image = render(
            scene,
            view,
            size=options.size,
            antialias=options.antialias,
            threads=options.threads,
            colorbar=options.colorbar,
            progress=progress,
            **lit,
        )
    image.save(options.output)
    if image.ids is not None and (image.ids < 0).all():
        say("note: no particle is in the picture — look at the camera, --cut, --select and --radius")
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
                    "view": _saved(options, scene, view, origin).to_json(),
                },
                ensure_ascii=False,
                indent=2,
            )
        )
    else:
        print(
            f"{options.output}: {image.size[0]}x{image.size[1]}, {len(particles):,} particles, {taken:.1f} s"
        )


def _saved(options: argparse.Namespace, scene: Scene, view: View, origin: dict[str, Any]) -> SavedView:
    """Return what draws the same picture again."""
    from luxel.scene.saved import Lighting, SavedView

    view = view.with_changes(camera=view.camera_for(scene.particles, options.size))
    return SavedView(view, Lighting.of(scene), origin["frame"])


def _serve_light(
    options: argparse.Namespace,
    target: Series | Particles,
    frame: int | None,
    look: SavedView,
    particles: Particles,
) -> None:
    from luxel.session import Session

    fill_light(options)
    spec = texture_spec(options, "view")
    view = _ready(options, look.view, particles)
    session = Session(target, frame=frame, lighting=look.light, spec=spec, view=view, **bake_share(options))
    say_if_dark(session.scene)
    _serve(options, session, view)


def _serve(options: argparse.Namespace, session: Session, view: View) -> None:
    from luxel.app.viewer import view as serve

    with session:
        serve(
            session,
            view,
            host=options.host,
            port=options.port,
            open_browser=options.browser,
            renderer=options.renderer,
            block=True,
            announce=lambda url: print(url, flush=True),
        )


def _ready(
    options: argparse.Namespace, view: View, particles: Particles, size: tuple[int, int] = (16, 9)
) -> View:
    """Return the view with its camera, checked; kernels are compiled before anybody waits for light."""
    view = aim(options, view, particles.bounds, size)
    if view.color_by is not None:
        view.scalar_range(particles)
    view.hidden(particles)
    say_if_cold()
    return view


def texture_spec(options: argparse.Namespace, purpose: Purpose = "bake") -> TextureSpec:
    """Return how textures are to be made."""
    from luxel.textures.spec import TextureSpec

    return TextureSpec.usual(
        options.mode, options.samples, purpose=purpose, seed=options.seed, mapping=options.mapping
    )


COMMANDS = (
    Command("info", "say what a file holds", _info_options, _info),
    Command("render", "draw a picture", _render_options, _render),
    Command("view", "look at particles in the browser", _view_options, _view),
    Command("demo", "look at the data set that comes with luxel", _demo_options, _demo),
)
