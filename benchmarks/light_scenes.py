"""What the tables of ``benchmarks.light`` measure on: data sets, lights, and the particles of each."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import luxel
from benchmarks.scenes import plate, plate_camera
from luxel.picture.raytrace import visible_ids

SHARED = Path(__file__).parents[2] / "shared" / "data"
ALBEDO = 0.7
# With NUMBA_CPU_NAME=haswell both sides run AVX2 code.
ISA = "avx2" if os.environ.get("NUMBA_CPU_NAME") == "haswell" else ""
LIGHTS = {
    "sky": (luxel.Sky(1.0),),
    "sky+sun": (luxel.Sky(1.0), luxel.Sun((-1.0, -1.0, 2.0), 2.0, 15.0)),
}
# The spacing of neighbours is 0.40 h where a ball of radius h holds 64 of them; spheres of half that touch.
_SPHERE_A_SMOOTHING_LENGTH = 0.2
_VIEW_SIDE = 512


@dataclass(frozen=True)
class DataSet:
    """One set of particles and what a camera path sees of it."""

    name: str
    particles: luxel.Particles
    visible: NDArray[np.int32]

    def scene(self, lights: str, model: str = "interreflection") -> luxel.Scene:
        """The particles under one of ``LIGHTS``."""
        return luxel.Scene(self.particles, LIGHTS[lights], model=model, albedo=ALBEDO)

    def group(self, name: str, count: int, seed: int = 0) -> NDArray[np.int32]:
        """Draw `count` ids from ``"all"`` particles or the ``"visible"`` ones; all there are, if fewer."""
        pool = self.visible if name == "visible" else np.arange(len(self.particles), dtype=np.int32)
        return np.random.default_rng(seed).permutation(pool)[:count]


def orbit(particles: luxel.Particles) -> list[luxel.Camera]:
    """The camera path "orbit": four views of everything, a quarter turn apart, from 35° above the horizon."""
    return [
        luxel.Camera.framing(particles.bounds, azimuth=azimuth, elevation=35.0, aspect=1.0)
        for azimuth in (-60.0, 30.0, 120.0, 210.0)
    ]


def data_sets(count: int, names: list[str] | None = None) -> list[DataSet]:
    """The plate (of about `count` particles), the crushed foam, and gas with smoothing lengths, or those `names`.

    The latter two are real files of the shared data; without them only the plate is measured, and it is said.
    """
    makers: dict[str, Callable[[], luxel.Particles]] = {
        "plate": lambda: plate(count),
        "foam": _foam,
        "gas": _gas,
    }
    found = []
    for name, make in makers.items():
        if names is not None and name not in names:
            continue
        try:
            particles = make()
        except (FileNotFoundError, ImportError) as error:
            print(f"({name} is left out: {error})")
            continue
        views = orbit(particles)
        if name == "plate":
            views[0] = plate_camera(particles)
        scene = luxel.Scene(particles)
        seen = np.unique(
            np.concatenate([visible_ids(scene, view, (_VIEW_SIDE, _VIEW_SIDE)) for view in views])
        )
        found.append(DataSet(name, particles, seen))
    return found


def _foam() -> luxel.Particles:
    return luxel.open(SHARED / "mpm_generated" / "foam_crushed.npz")[0]


def _gas() -> luxel.Particles:
    """Gas of a cosmological volume (Gadget-4), radii proportional to the smoothing lengths."""
    import h5py

    with h5py.File(SHARED / "astro" / "gadget4_lcdm_gas_004.hdf5") as file:
        gas = file["PartType0"]
        return luxel.Particles(gas["Coordinates"][:], _SPHERE_A_SMOOTHING_LENGTH * gas["SmoothingLength"][:])


def slab(count: int, seed: int = 3) -> luxel.Particles:
    """About `count` spheres in a jittered lattice ten layers thick: the same surroundings whatever the count."""
    edge = max(2, round((count / 10) ** 0.5))
    grid = np.empty((edge, edge, 10, 3), np.float32)
    grid[..., 0], grid[..., 1], grid[..., 2] = np.meshgrid(
        *(np.arange(n, dtype=np.float32) for n in (edge, edge, 10)), indexing="ij"
    )
    positions = grid.reshape(-1, 3)
    positions += np.random.default_rng(seed).normal(0, 0.08, positions.shape).astype(np.float32)
    return luxel.Particles(positions, 0.55)


def packing(count: int, spread: float, fill: float = 0.25, seed: int = 5) -> luxel.Particles:
    """Random spheres in a cube that do not overlap; radii log-uniform over 1 : `spread`.

    The largest are placed first, by random sequential addition in classes of similar size, so that the small ones
    lie in the gaps between the large.

    Parameters
    ----------
    fill
        Volume of the spheres over volume of the cube.
    """
    rng = np.random.default_rng(seed)
    radii = np.sort(spread ** -rng.random(count) if spread > 1 else np.ones(count))[::-1]
    edge = (4 / 3 * np.pi * (radii**3).sum() / fill) ** (1 / 3)
    positions = rng.random((count, 3)) * edge
    classes = np.array_split(np.arange(count), max(1, round(4 * np.log2(spread))))
    trees: list[tuple[cKDTree, float]] = []
    for members in classes:
        largest = radii[members[0]]
        pending, settled = members, members[:0]
        bigger = list(trees)
        while len(pending):
            clash = np.zeros(len(pending), bool)
            for tree, size in trees:
                reach = size + radii[pending]
                clash |= tree.query(positions[pending], distance_upper_bound=2 * size)[0] < reach
            # Of two new ones that clash, the later gives way.
            pairs = cKDTree(positions[pending]).query_pairs(2 * largest, output_type="ndarray")
            clash[pairs[:, 1]] = True
            settled = np.append(settled, pending[~clash])
            if len(settled):
                trees = [*bigger, (cKDTree(positions[settled]), largest)]
            pending = pending[clash]
            positions[pending] = rng.random((len(pending), 3)) * edge
    return luxel.Particles(positions, radii)
