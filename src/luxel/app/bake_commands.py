"""The commands that bake: ``luxel bake | encode | plan | figure``."""

from __future__ import annotations

import argparse
import json
import time
from typing import TYPE_CHECKING, Any

from luxel.app.command import Command
from luxel.app.options import (
    add_file_options,
    add_light_options,
    add_up_option,
    build_lights,
    fill_light,
    number,
    positive_int,
)
from luxel.app.parse import frame_range
from luxel.app.report import bytes_text, distortion_texts, plan_table
from luxel.app.talk import Progress, say, say_if_cold, say_if_dark
from luxel.errors import InputError

if TYPE_CHECKING:
    from luxel.io import Series
    from luxel.textures.spec import TextureSpec
    from luxel.textures.store.layout import CodecChoice
    from luxel.textures.store.reader import Baked

__all__ = ["COMMANDS"]

# Written out so that `luxel --help` imports nothing; a test holds them to the library's own.
CODECS = ("raw", "vq", "pca", "cpca", "sh")


def _bake_options(parser: argparse.ArgumentParser) -> None:
    add_file_options(parser, stores=False)
    _add_output_options(parser)
    _add_frames_option(parser)
    parser.add_argument(
        "--chunk",
        type=positive_int,
        default=4096,
        metavar="N",
        help="particles in a chunk, which is what an interruption loses at most (default: 4096)",
    )
    _add_codec_options(parser)
    _add_light_options(parser)


def _encode_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("store", metavar="IN.zarr", help="what luxel bake made")
    _add_output_options(parser)
    _add_codec_options(parser)


def _plan_options(parser: argparse.ArgumentParser) -> None:
    add_file_options(parser, stores=False)
    _add_frames_option(parser)
    parser.add_argument("--json", action="store_true", help="print JSON")
    _add_light_options(parser)


def _figure_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("store", metavar="IN.zarr", help="compressed textures")
    parser.add_argument("-o", "--output", required=True, metavar="OUT.png", help="the picture to write")
    parser.add_argument(
        "--raw", metavar="RAW.zarr", help="the same bake uncompressed, if IN.zarr did not --keep-raw"
    )
    parser.add_argument("--frame", type=int, default=0, metavar="N", help="which of the frames (default: 0)")
    parser.add_argument("--count", type=positive_int, default=8, metavar="N", help="textures (default: 8)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of which textures (default: 0)")


def _add_output_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-o", "--output", required=True, metavar="OUT.zarr", help="the store to write")
    parser.add_argument(
        "--overwrite", action="store_true", help="replace a store that holds something else by now"
    )


def _add_frames_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--frames",
        type=frame_range,
        metavar="A:B",
        help="time steps from A up to B, which is left out; : is all (default: the first with particles)",
    )


def _add_codec_options(parser: argparse.ArgumentParser) -> None:
    codec = parser.add_argument_group("codec")
    codec.add_argument(
        "--codec", choices=CODECS, default="raw", help="how textures are stored (default: raw)"
    )
    codec.add_argument(
        "--ratio",
        type=number,
        metavar="R",
        help="raw bytes over compressed ones (default: 4, as in the paper)",
    )
    codec.add_argument(
        "--error",
        type=number,
        metavar="E",
        help="root mean squared error to stay below, in levels of 255, instead of a ratio",
    )
    codec.add_argument("--codewords", type=positive_int, metavar="N", help="size of the codebook, for vq")
    codec.add_argument("--components", type=positive_int, metavar="N", help="size of the basis, for pca")
    codec.add_argument("--keep-raw", action="store_true", help="keep raw textures beside compressed ones")


def _add_light_options(parser: argparse.ArgumentParser) -> None:
    add_light_options(parser, samples=" (default: 1, with --mode paper 49)")
    add_up_option(parser)


def _bake(options: argparse.Namespace) -> None:
    from luxel.textures.store.bake import bake_to

    spec, codec = _spec(options), _codec(options)
    series, frames = _open(options)
    say_if_dark(options)
    say_if_cold()
    _write(
        options.output,
        lambda report: bake_to(
            options.output,
            series,
            frames=frames,
            **_light(options),
            up=options.up or "z",
            spec=spec,
            codec=codec,
            keep_raw=options.keep_raw,
            chunk=options.chunk,
            overwrite=options.overwrite,
            threads=options.threads,
            progress=report,
        ),
    )


def _encode(options: argparse.Namespace) -> None:
    from luxel.textures.store.bake import encode_to
    from luxel.textures.store.reader import open_baked

    codec = _codec(options)
    baked = open_baked(options.store)
    if not all(frame.has_raw for frame in baked):
        say(
            f"note: {baked.path} kept no raw textures; what its codec {baked.settings.codec.kind} has lost stays lost"
        )
    _write(
        options.output,
        lambda report: encode_to(
            options.output,
            baked,
            codec,
            keep_raw=options.keep_raw,
            overwrite=options.overwrite,
            progress=report,
        ),
    )


def _plan(options: argparse.Namespace) -> None:
    from luxel.textures.store.plan import plan_bake

    spec = _spec(options)
    series, frames = _open(options)
    say_if_dark(options)
    say_if_cold()
    found = plan_bake(series, frames=frames, **_light(options), spec=spec, threads=options.threads).to_json()
    print(json.dumps(found, indent=2) if options.json else plan_table(series.path, found))


def _figure(options: argparse.Namespace) -> None:
    import numpy as np

    from luxel.picture.textures_figure import codec_figure
    from luxel.textures.store.reader import open_baked

    baked = open_baked(options.store)
    source = baked if options.raw is None else open_baked(options.raw)
    for each in (baked, source):
        if not 0 <= options.frame < len(each):
            raise InputError(f"--frame: {each.path} has frames 0..{len(each) - 1}, got {options.frame}")
    frame, plain = baked[options.frame], source[options.frame]
    if not plain.has_raw:
        raise InputError(
            f"{source.path} kept no raw textures to compare with — bake with --keep-raw, or give the raw store with --raw"
        )
    if plain.key != frame.key:
        raise InputError(
            f"{source.path} holds other textures than {baked.path}: particles, light or sampling differ"
        )
    # Textures that see something: black ones say nothing about a codec.
    codes, stored = plain.original(), frame.textures.codes
    lit = np.flatnonzero(stored.mean(axis=(1, 2)) > 8)
    pool = lit if len(lit) else np.arange(frame.count)
    chosen = np.sort(np.random.default_rng(options.seed).permutation(pool)[: options.count])
    original = np.concatenate([codes[slice(k, k + 1)] for k in chosen.tolist()])
    codec_figure(original, stored[chosen]).save(options.output)
    print(f"{options.output}: {len(chosen)} textures of {frame.count:,}, {baked.settings.codec.kind}")


def _write(output: str, work: Any) -> None:
    """Run `work` with progress bars, and say what has come of it."""
    started = time.perf_counter()
    bars: dict[str, Progress] = {}

    def report(stage: str, done: int, total: int) -> None:
        if stage not in bars:
            for bar in bars.values():
                bar.close()
            bars[stage] = Progress(stage)
        bars[stage](done, total)
        if done == total:
            bars.pop(stage).close()
            worked.append(stage)

    worked: list[str] = []
    try:
        baked: Baked = work(report)
    except KeyboardInterrupt:
        lit = bars.get("lighting")
        for bar in bars.values():
            bar.close()
        far = f" after {lit.done:,} of {lit.total:,} particles" if lit is not None and lit.total else ""
        say(f"stopped{far}; finished chunks are kept in {output} — run the same command again to go on")
        raise
    finally:
        for bar in bars.values():
            bar.close()
    count = sum(frame.count for frame in baked)
    stored = sum(frame.count * frame.payload_bytes + frame.shared_bytes for frame in baked)
    took = f"{time.perf_counter() - started:.1f} s" if worked else "complete already, nothing to do"
    print(f"{output}: {count:,} textures, {baked.settings.codec.kind}, {bytes_text(stored)}; {took}")
    worst = max(baked, key=lambda frame: frame.distortion["rmse"])
    if worst.distortion["d"]:
        frame = "" if len(baked) == 1 else f" of frame {worst.source_frame}, the largest"
        for name, text in distortion_texts(worst.distortion):
            print(f"  {name}{frame}: {text}")


def _open(options: argparse.Namespace) -> tuple[Series, list[int] | None]:
    import luxel.io
    from luxel.textures.store.reader import is_store

    files = options.file
    if len(files) == 1 and is_store(files[0]):
        raise InputError(
            f"{files[0]}: is baked already — luxel encode gives it another codec; bake the particle file for other light"
        )
    series = luxel.io.open(files[0] if len(files) == 1 else files, radius=options.radius)
    if options.frames is None:
        frame = series.first_frame()
        if frame:
            say(f"note: frames before {frame} hold no particles; this bakes frame {frame}")
        return series, None
    frames = list(range(len(series))[options.frames])
    if not frames:
        raise InputError(
            f"--frames: {series.path} has frames 0..{len(series) - 1}, none of them is in that range"
        )
    return series, frames


def _light(options: argparse.Namespace) -> dict[str, Any]:
    return {
        "lights": build_lights(options, options.up or "z"),
        "model": options.model,
        "albedo": options.albedo,
        "ao_distance": options.ao_distance,
        "periodic": options.periodic or "",
    }


def _spec(options: argparse.Namespace) -> TextureSpec:
    from luxel.textures.spec import TextureSpec

    fill_light(options)
    return TextureSpec.usual(options.mode, options.samples, seed=options.seed, mapping=options.mapping)


def _codec(options: argparse.Namespace) -> CodecChoice:
    from luxel.textures.store.layout import CodecChoice

    return CodecChoice(options.codec, options.ratio, options.error, options.codewords, options.components)


COMMANDS = (
    Command(
        "bake",
        "bake the textures of all particles into a store; interrupted, it goes on later",
        _bake_options,
        _bake,
    ),
    Command(
        "encode",
        "store baked textures under another codec, without computing light",
        _encode_options,
        _encode,
    ),
    Command("figure", "draw textures beside what a codec made of them", _figure_options, _figure),
    Command("plan", "say what a bake will cost in bytes and time, before it is begun", _plan_options, _plan),
)
