"""Light: speed and error of textures against Embree path tracing the same samples, and what a view of a plate costs.

    python -m benchmarks.light [--quick] [--json] [--only TABLE ...]

Tables: paper (paper mode over Embree on the same samples), error (texels against means of thousands of samples; price
at the error of 49 raw samples), view (one view of the plate), scaling (10^4 to 10^7 particles), radii (equal against
1 : 1000). Albedo 0.7; sky of level 1, alone or with a sun of level 2 and 15 degrees. Error: over texels that are lit
(T > 0.01) and at least half in the open, weighted by solid angle, textures as stored; the truth's own noise is
subtracted from RMSE. Visible: what four views at 512², a quarter turn apart, see. Truths are kept under out/truth.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

from benchmarks.light_error import at_equal_error
from benchmarks.light_scenes import data_sets
from benchmarks.light_speed import paper_against_embree, scaling, unequal_radii
from benchmarks.light_view import one_view
from benchmarks.measure import report

_TABLES = ("paper", "error", "view", "scaling", "radii")


@dataclass(frozen=True)
class Effort:
    """How much is measured."""

    rounds: int
    ao_count: int  # particles of the paper table
    path_count: int
    truth_count: int
    truth_samples: int
    truth_lights: tuple[str, ...]
    timed_count: int
    fast_samples: tuple[int, ...]
    side: int  # of the view
    picture_side: int
    pixel_samples: int
    patience_s: float  # longer bakes are extrapolated
    sizes: tuple[int, ...]
    scaling_textures: int
    packed_count: int
    packed_textures: int


_QUICK = Effort(
    rounds=3, ao_count=128, path_count=64, truth_count=16, truth_samples=400, truth_lights=("sky+sun",), timed_count=48,
    fast_samples=(1, 2, 4), side=512, picture_side=112, pixel_samples=36, patience_s=10.0,
    sizes=(10_000, 100_000, 1_000_000), scaling_textures=256, packed_count=20_000, packed_textures=96,
)  # fmt: skip
_FULL = Effort(
    rounds=5, ao_count=512, path_count=128, truth_count=32, truth_samples=4096, truth_lights=("sky", "sky+sun"),
    timed_count=64, fast_samples=(1, 2, 4, 9), side=1024, picture_side=1024, pixel_samples=100, patience_s=600.0,
    sizes=(10_000, 100_000, 1_000_000, 10_000_000), scaling_textures=1024, packed_count=100_000, packed_textures=512,
)  # fmt: skip


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument(
        "--quick", action="store_true", help="fewer particles and samples, four to five minutes"
    )
    options.add_argument("--json", action="store_true")
    options.add_argument(
        "--only", nargs="+", choices=_TABLES, default=_TABLES, metavar="TABLE", help=", ".join(_TABLES)
    )
    chosen = options.parse_args()
    effort = _QUICK if chosen.quick else _FULL
    sets = data_sets(550_000) if {"paper", "error", "view"} & set(chosen.only) else []
    if "paper" in chosen.only:
        rows = paper_against_embree(
            sets, {"ao": effort.ao_count, "interreflection": effort.path_count}, effort.rounds
        )
        report("light: paper mode against Embree, 49 samples", rows, chosen.json)
    if "error" in chosen.only:
        table, prices = at_equal_error(
            sets,
            list(effort.truth_lights),
            effort.truth_count,
            effort.truth_samples,
            effort.timed_count,
            list(effort.fast_samples),
            effort.rounds,
        )
        report(f"light: error against {effort.truth_samples} samples", table, chosen.json)
        report("light: price at the RMSE of 49 raw samples", prices, chosen.json)
    if "view" in chosen.only:
        rows = one_view(sets[0], effort.side, effort.picture_side, effort.pixel_samples, effort.patience_s)
        report("light: one view of the plate", rows, chosen.json)
    if "scaling" in chosen.only:
        rows = scaling(list(effort.sizes), effort.scaling_textures)
        report("light: scaling at fixed density", rows, chosen.json)
    if "radii" in chosen.only:
        rows = unequal_radii(effort.packed_count, effort.packed_textures, effort.rounds)
        report("light: unequal radii", rows, chosen.json)


if __name__ == "__main__":
    main()
