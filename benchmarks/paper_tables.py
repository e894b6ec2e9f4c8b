"""The paper's tables with its numbers beside ours.

    python -m benchmarks.paper_tables [table2] [table3] [table4] [table5] [table6] [splits] [fill] [figure8] [--quick] [--json] [--threads N]

table2: time and memory of a bake. table3: codecs at equal bytes (d is the mean over textures of the sum of squared
differences of codes; the paper does not state its unit, so only ratios within a column compare). table4: frame rates
of textures over Lambert with one shadow ray a pixel, 1024², pairs in turn. The paper's machine: 16 cores of 2008, and data
sets that are not public; its rows are quoted, not repeated. table5 and table6: dynamic textures, see
``paper_tables_dynamic``. splits, fill and figure8: how they share a machine, see ``paper_scaling``; these need the synthetic plate only.
"""

from __future__ import annotations

import argparse
import statistics
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np

import luxel
from benchmarks.lambert import draw_lambert, draw_textured
from benchmarks.light_scenes import DataSet, data_sets
from benchmarks.measure import interleaved, ratio, report, verdict
from benchmarks.paper_scaling import figure8, fill, splits
from benchmarks.paper_tables_dynamic import table5, table6
from luxel.light.world import make_world
from luxel.picture.drawing import Crew, blank_tiles, make_eye
from luxel.textures import codecs
from luxel.textures.bake import Baker, bake_with
from luxel.textures.codecs import Distortion
from luxel.textures.compressed import CompressedTextures
from luxel.textures.spec import DEFAULT_SAMPLES, TextureSpec
from luxel.textures.store.plan import seconds_of_many
from luxel.trace.spheres import SphereSet
from luxel.trace.tree import thread_count

Rows = list[dict[str, Any]]
_SIDE = 1024
_SUBSET = 20_000  # where merging is exact


def _bake(data: DataSet, samples: int, most: int) -> luxel.LuminanceTextures:
    baker = Baker(data.scene("sky+sun"), TextureSpec(mode="fast", samples=samples))
    return bake_with(baker, data.group("all", min(most, len(data.particles)), seed=4))


def table2(sets: list[DataSet], quick: bool) -> Rows:
    """Bake everything, or a lot drawn by lottery and then extrapolated."""
    rows: Rows = []
    for data in sets:
        count = len(data.particles)
        ids = data.group("all", 8192 if quick else count)
        for mode, usual in DEFAULT_SAMPLES.items():
            samples = usual["bake"]
            lot = ids if mode == "fast" else ids[: 256 if quick else 4096]
            baker = Baker(data.scene("sky+sun"), TextureSpec(mode=mode, samples=samples))
            bake_with(baker, lot[:32])
            took = seconds_of_many(baker, lot) * count / len(lot)
            rows.append(
                {
                    "scene": data.name,
                    "particles": count,
                    "MB": count * 256 / 1e6,
                    "mode": f"{mode} {samples}",
                    "s": took,
                    "remark": "" if len(lot) == count else f"from {len(lot)}",
                }
            )
    for name, count, size, took in (
        ("Bullet-2", 569_523, 139.04, "1:27"),
        ("Fireball-12", 951_449, 232.39, "6:07"),
    ):
        rows.append(
            {
                "scene": f"paper, {name}",
                "particles": count,
                "MB": size,
                "mode": "49, 16 cores",
                "s": f"{took} h",
            }
        )
    return rows


def table3(sets: list[DataSet], quick: bool) -> Rows:
    """Codecs on the textures of the largest set; VQ also against exact merging where that is feasible."""
    data = sets[0]
    codes = _bake(data, 1, 60_000 if quick else len(data.particles)).codes
    subset = codes[np.sort(np.random.default_rng(0).permutation(len(codes))[:_SUBSET])]
    rows: Rows = []

    def row(kind: str, ratio_: float, textures: Any, note: str = "", **how: Any) -> None:
        start = perf_counter()
        codec = codecs.train(kind, textures, ratio=ratio_, **how)
        payload = codec.encode(textures)
        took = perf_counter() - start
        found = Distortion.of(codec, textures, payload)
        rows.append(
            {
                "textures": len(textures),
                "codec": kind + note,
                "ratio": found.ratio,
                "s": took,
                "d": found.d,
                "sqrt d": found.root_d,
                "RMSE": found.rmse,
                "PSNR": found.psnr,
            }
        )

    for ratio_ in (4, 16, 32):
        for kind in ("vq", "pca", "cpca"):
            if not (quick and kind == "vq" and ratio_ == 4):
                row(kind, ratio_, codes)
    for ratio_ in (4, 16):
        row("vq", ratio_, subset, " exact", exact=True)
        row("vq", ratio_, subset, " fast", exact=False)
    for ratio_, took, d in ((4, "34 h", 29.81), (16, "30 h", 59.33)):
        rows.append({"textures": 809_533, "codec": "paper VQ", "ratio": float(ratio_), "s": took, "d": d})
    for ratio_, took, d in ((4, "12 s", 109.86), (16, "10 s", 210.63)):
        rows.append({"textures": 809_533, "codec": "paper PCA", "ratio": float(ratio_), "s": took, "d": d})
    return rows


def table4(sets: list[DataSet], quick: bool) -> Rows:
    """Frames of 1024² with one ray a pixel: Lambert with a shadow ray, and textures raw and compressed."""
    rows: Rows = []
    crew = Crew()
    for data in sets:
        scene = data.scene("sky+sun")
        codes = bake_with(Baker(scene, TextureSpec(mode="fast", samples=1)), data.visible)
        codec = {
            "raw": None,
            "VQ 16:1": codecs.train("vq", codes.codes, ratio=16),
            "PCA-8": codecs.train("pca", codes.codes, components=8),
            "cPCA-8": codecs.train("cpca", codes.codes, payload_bytes=8),
        }
        world = make_world(scene)
        low, high = data.particles.bounds
        camera = luxel.Camera.framing((low, high), azimuth=-60.0, elevation=35.0, aspect=1.0)
        eye = make_eye(camera, SphereSet.of(data.particles), 1.0)
        colors = np.ones((len(data.particles), 3), np.float32)
        tables = {
            name: (codes if made is None else CompressedTextures.of(codes, made)).snapshot(codes.key)
            for name, made in codec.items()
        }

        frame = (colors, np.zeros((_SIDE, _SIDE, 5), np.float32), blank_tiles(_SIDE, _SIDE), crew)
        rivals = {"Lambert": partial(draw_lambert, world, eye, *frame)}
        for name, table in tables.items():
            rivals[name] = partial(draw_textured, world, eye, table, *frame)
        seconds = interleaved(rivals, 9 if quick else 100)
        found: dict[str, Any] = {
            "scene": data.name,
            "Lambert + shadow, frames/s": 1 / statistics.median(seconds["Lambert"]),
        }
        for name in tables:
            middle, worst, best = ratio(seconds["Lambert"], seconds[name])
            found[name] = (
                f"{1 / statistics.median(seconds[name]):.1f} ({middle:.2f}x, {worst:.2f}-{best:.2f})"
            )
        for name, most in (("VQ 16:1", 1.02), ("PCA-8", 1.05), ("cPCA-8", None)):
            times = ratio(seconds[name], seconds["raw"])[0]
            bound = "" if most is None else f" (<= {most}: {verdict(times <= most)})"
            found[f"{name} / raw"] = f"{times:.3f}{bound}"
        least = min(ratio(seconds["Lambert"], seconds[name])[0] for name in ("raw", "VQ 16:1", "PCA-8"))
        found["textures >= 1.9x"] = verdict(least >= 1.9)
        rows.append(found)
    rows.append(
        {
            "scene": "paper",
            "Lambert + shadow, frames/s": "0.67-6.01",
            "raw": "1.14-1.91x",
            "VQ 16:1": "as raw",
            "PCA-8": "up to 11 % slower",
        }
    )
    return rows


TABLES = {
    "table2": table2,
    "table3": table3,
    "table4": table4,
    "table5": table5,
    "table6": table6,
}
SCALING = {"splits": splits, "fill": fill, "figure8": figure8}


def main() -> None:
    """Print the tables asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("tables", nargs="*", choices=[*TABLES, *SCALING, []], help="which (default: all)")
    parser.add_argument("--quick", action="store_true", help="smaller lots: five minutes on two cores")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--threads", type=int, help="of splits, fill and figure8 at most (default: all)")
    options = parser.parse_args()
    chosen = options.tables or [*TABLES, *SCALING]
    threads = thread_count(options.threads)
    sets = data_sets(550_000, None if set(chosen) - set(SCALING) else ["plate"])
    for name in chosen:
        rows = (
            SCALING[name](sets, options.quick, threads)
            if name in SCALING
            else TABLES[name](sets, options.quick)
        )
        report(f"paper {name}", rows, options.json)


if __name__ == "__main__":
    main()
