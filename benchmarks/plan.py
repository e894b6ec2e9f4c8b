"""What `luxel plan` foretells beside what the bake then takes: `python -m benchmarks.plan [--json]`.

Two scenes of the shared data in both modes, baked whole into stores: seconds of a raw bake, and bytes of its textures raw and as PCA at 4:1.
The bake comes right after its plan, in the same process.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from time import perf_counter
from typing import Any

import luxel
from benchmarks.light_scenes import ALBEDO, LIGHTS, SHARED
from benchmarks.measure import report, verdict
from luxel.textures.spec import TextureSpec
from luxel.textures.store.bake import bake_to, encode_to
from luxel.textures.store.layout import CodecChoice
from luxel.textures.store.plan import plan_bake

_SCENES = ("converted/bullet_008.vtp", "md/pyscal_cluster.dump")
_WITHIN = 0.25
_RATIO = 4


def _row(name: str, mode: Any, folder: Path) -> dict[str, Any]:
    scene = luxel.Scene(luxel.open(SHARED / name)[0], LIGHTS["sky+sun"], albedo=ALBEDO)
    spec = TextureSpec.usual(mode)
    plan = plan_bake(scene, spec=spec)
    start = perf_counter()
    baked = bake_to(folder / "raw.zarr", scene, spec=spec)
    took = perf_counter() - start
    packed = encode_to(folder / "pca.zarr", baked, CodecChoice("pca", ratio=_RATIO))
    planned = [size for _, size in plan.sizes.values()]
    stored = [each.count * each.payload_bytes + each.shared_bytes for each in (baked[0], packed[0])]
    pairs = [(plan.seconds, took), *zip(planned, stored, strict=True)]
    off = max(abs(foretold / true - 1) for foretold, true in pairs)
    return {
        "scene": name,
        "particles": len(scene.particles),
        "mode": f"{mode} {spec.samples}",
        "planned s": plan.seconds,
        "s": took,
        "planned / s": plan.seconds / took,
        "raw MB": stored[0] / 1e6,
        "planned / raw": planned[0] / stored[0],
        f"{_RATIO}:1 MB": stored[1] / 1e6,
        f"planned / {_RATIO}:1": planned[1] / stored[1],
        f"within {_WITHIN:.0%}": verdict(off <= _WITHIN),
    }


def main() -> None:
    """Print a row for each scene and mode."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rows = []
    for name in _SCENES:
        for mode in ("fast", "paper"):
            with tempfile.TemporaryDirectory() as folder:
                rows.append(_row(name, mode, Path(folder)))
    report("plan", rows, options.json)


if __name__ == "__main__":
    main()
