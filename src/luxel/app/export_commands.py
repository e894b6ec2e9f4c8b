"""The command that makes pages: ``luxel export``."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from luxel.app.command import Command
from luxel.app.look_commands import open_if_baked, open_series, stored_look, texture_spec
from luxel.app.options import (
    add_file_options,
    add_scene_options,
    aim,
    build_look,
    fill_light,
    number,
    positive_int,
)
from luxel.app.report import bytes_text
from luxel.app.talk import Progress, say, say_if_cold, say_if_dark

if TYPE_CHECKING:
    from luxel.app.export import ExportSize
    from luxel.textures.store.layout import CodecChoice

__all__ = ["COMMANDS"]

# Written out so that `luxel --help` imports nothing; a test holds them to the library's own.
CODECS = ("raw", "vq", "pca", "cpca", "sh")


def _export_options(parser: argparse.ArgumentParser) -> None:
    add_file_options(parser)
    parser.add_argument("-o", "--output", required=True, metavar="PAGE.html", help="the page to write")
    parser.add_argument(
        "--scalars",
        type=_names,
        default=[],
        metavar="NAME,...",
        help="scalars to choose from in the page, or all (default: the one of --color-by)",
    )
    parser.add_argument(
        "--visible-only",
        action="store_true",
        help="leave out particles that cannot be seen from outside the data; views from within and cuts show their absence",
    )
    parser.add_argument("--title", metavar="TEXT", help="of the page (default: the file's name)")
    codec = parser.add_argument_group("codec")
    codec.add_argument(
        "--codec", choices=CODECS, help="how textures are stored (default: pca; of baked textures, theirs)"
    )
    codec.add_argument(
        "--components", type=positive_int, metavar="N", help="bytes a texture, for pca (default: 8)"
    )
    codec.add_argument("--ratio", type=number, metavar="R", help="raw bytes over compressed ones, instead")
    add_scene_options(parser, samples=" (default: 1, with --mode paper 49)")


def _export(options: argparse.Namespace) -> None:
    from luxel.app.export import export
    from luxel.app.page_file import check_page_path
    from luxel.session import Session

    check_page_path(options.output)  # before minutes of work
    codec = _codec(options)
    baked = open_if_baked(options)
    if baked is not None:
        look = stored_look(options, baked)
        frame = baked[look.frame or 0]
        view = aim(options, look.view, frame.particles.bounds, (16, 9))
        session = Session(baked, frame=frame.index, view=view, threads=0)
    else:
        look = build_look(options)
        fill_light(options)
        series, k = open_series(options, look.frame)
        view = aim(options, look.view, series[k].bounds, (16, 9))
        session = Session(
            series, frame=k, lighting=look.light, spec=texture_spec(options), view=view, threads=0
        )
        say_if_dark(session.scene)
        say_if_cold()
    bars: dict[str, Progress] = {}

    def report(stage: str, done: int, total: int) -> None:
        if stage not in bars:
            for bar in bars.values():
                bar.close()
            bars[stage] = Progress(stage)
        bars[stage](done, total)

    with session:
        try:
            made = export(
                session,
                options.output,
                view,
                keep=options.scalars,
                codec=codec,
                visible_only=options.visible_only,
                title=options.title,
                threads=options.threads,
                announce=lambda size: say(_size_text(size)),
                progress=report,
            )
        finally:
            for bar in bars.values():
                bar.close()
    loss = "" if made.rms_levels is None else f"; textures within {made.rms_levels:.2g} of 255 levels (rms)"
    print(f"{options.output}: {made.size.count:,} particles, {bytes_text(made.file_bytes)}{loss}")


def _size_text(size: ExportSize) -> str:
    about = "" if size.exact else "about "
    parts = ", ".join(f"{name} {nbytes:.3g}" for name, nbytes in size.bytes_each.items())
    left = "" if size.count == size.total else f" of {size.total:,}"
    return (
        f"{size.count:,}{left} particles of {about}{size.particle_bytes:.3g} bytes ({parts}) and "
        f"{bytes_text(size.fixed_bytes)} of viewer: {about}{bytes_text(size.raw_bytes)} before compression"
    )


def _codec(options: argparse.Namespace) -> CodecChoice | None:
    from luxel.textures.store.layout import CodecChoice

    if options.codec is None and (options.components or options.ratio) is None:
        return None
    components = options.components
    if components is None and options.ratio is None and options.codec == "pca":
        components = 8
    return CodecChoice(options.codec or "pca", ratio=options.ratio, components=components)


def _names(text: str) -> list[str]:
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise argparse.ArgumentTypeError(f"expected names such as stress,damage, got {text.strip()!r}")
    return names


COMMANDS = (
    Command(
        "export",
        "write particles with their light into one HTML file that opens from disk",
        _export_options,
        _export,
    ),
)
