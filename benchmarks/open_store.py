"""From the start of a process to a picture of a baked store: `python -m benchmarks.open_store [--quick] [--store PATH]`.

A slab of 10^6 particles with ambient occlusion (what light it is does not matter here) as PCA of 8 components. Each round is a new process that imports
luxel, opens the store and draws 1024 × 1024 pixels with a ray each; files and compiled kernels are warm after a round that does not
count. With --store the bake is kept there and used again.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path
from time import perf_counter

import luxel
from benchmarks.light_scenes import slab
from benchmarks.measure import report, verdict
from luxel.textures.spec import TextureSpec
from luxel.textures.store.bake import bake_to
from luxel.textures.store.layout import CodecChoice

_COUNT = 1_000_000
_MOST_S = 2.0
_PARTS = ("process", "store", "scene", "records", "drawing")
_CHILD = """
import sys, time, json
at = [time.perf_counter()]
import luxel
def note(value):
    at.append(time.perf_counter())
    return value
frame = note(luxel.open_baked(sys.argv[1])[0])
scene = note(frame.scene)
textures = note(frame.compressed)
note(luxel.render(scene, textures=textures, size=(1024, 1024), antialias=1))
print(json.dumps([b - a for a, b in zip(at, at[1:])]))
"""


def _round(store: Path) -> list[float]:
    """Seconds of a process: all of it, before its first line and after its last, then part by part."""
    start = perf_counter()
    said = subprocess.run(
        [sys.executable, "-c", _CHILD, str(store)], stdout=subprocess.PIPE, check=True, text=True, timeout=600
    ).stdout
    took = perf_counter() - start
    parts = json.loads(said)
    return [took, took - sum(parts), *parts]


def main() -> None:
    """Print the median of some rounds and their range."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="fewer rounds")
    parser.add_argument("--store", type=Path, help="where to keep the bake for other runs")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    with ExitStack() as stack:
        store = options.store or Path(stack.enter_context(tempfile.TemporaryDirectory())) / "slab.zarr"
        scene = luxel.Scene(slab(_COUNT), model="ao")
        bake_to(
            store, scene, spec=TextureSpec(mode="fast", samples=1), codec=CodecChoice("pca", components=8)
        )
        _round(store)
        rounds = [_round(store) for _ in range(5 if options.quick else 15)]
    total, *parts = zip(*rounds, strict=True)
    row = {
        "particles": len(scene.particles),
        "s to a picture": statistics.median(total),
        "range": f"{min(total):.2f}-{max(total):.2f}",
        **{name: statistics.median(some) for name, some in zip(_PARTS, parts, strict=True)},
        f"< {_MOST_S:g} s": verdict(statistics.median(total) < _MOST_S),
    }
    report("open a baked store", [row], options.json)


if __name__ == "__main__":
    main()
