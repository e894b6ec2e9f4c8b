"""Make the data set that comes with luxel, src/luxel/data/foam.npz, from a crushed Uintah foam.

    python tools/make_demo_data.py foam_crushed.npz src/luxel/data/foam.npz

The input holds ``position`` (N, 3), ``radius`` (N,) and scalars. The lowest part is cut off, crumbs and particles deep
inside are left out (no camera and hardly any light gets there), and all numbers are rounded to 8 or 16 bits.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

FLOOR = 0.30  # what lies below is cut off
LEAST_PIECE = 3000  # smaller pieces that came off are left out
SCALARS = {
    "stress": "stress",
    "plastic_strain": "plastic_strain",
    "velocity": "velocity_magnitude",
    "pressure": "pressure",
}


def skin(points: np.ndarray, diameter: float) -> np.ndarray:
    """Return a mask (N,) of the particles at the surface and of the layer below, which closes their gaps."""
    pairs = cKDTree(points).query_pairs(2.1 * diameter, output_type="ndarray")
    step = points[pairs[:, 1]] - points[pairs[:, 0]]
    pull = np.stack(
        [np.bincount(pairs[:, 0], s, len(points)) - np.bincount(pairs[:, 1], s, len(points)) for s in step.T],
        axis=1,
    )
    count = np.bincount(pairs.ravel(), minlength=len(points))
    pieces = connected_components(
        coo_array((np.ones(len(pairs)), pairs.T), shape=(len(points),) * 2), directed=False
    )[1]
    crumb = np.bincount(pieces)[pieces] < LEAST_PIECE
    # Neighbours on all sides cancel; at a surface those inside are left over.
    surface = (np.linalg.norm(pull, axis=1) > 0.45 * diameter * count) | (count < 18)
    return ~crumb & (surface | (cKDTree(points[surface]).query(points)[0] < 0.9 * diameter))


def quantised(values: np.ndarray, dtype: type) -> tuple[np.ndarray, np.ndarray]:
    """Return values as whole numbers that span `dtype`, and (low, high) to undo it: low + (high - low) q / most."""
    low, high = values.min(axis=0).astype(np.float64), values.max(axis=0).astype(np.float64)
    unit = (values - low) / np.where(high > low, high - low, 1.0)
    return np.round(unit * np.iinfo(dtype).max).astype(dtype), np.stack([low, high])


def main() -> None:
    """Read, cut, round, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("source")
    parser.add_argument("target")
    options = parser.parse_args()
    with np.load(options.source, allow_pickle=False) as source:
        kept = np.flatnonzero(source["position"][:, 2] > FLOOR)
        points = source["position"][kept].astype(np.float64)
        kept = kept[skin(points, 2 * float(np.median(source["radius"])))]
        arrays = {}
        for name, key, dtype in [
            ("position", "position", np.uint16),
            ("radius", "radius", np.uint8),
            *((name, key, np.uint16) for name, key in SCALARS.items()),
        ]:
            arrays[name], arrays[f"{name}_ends"] = quantised(source[key][kept], dtype)
    np.savez_compressed(options.target, **arrays)
    sys.stderr.write(f"{options.target}: {len(kept)} particles\n")


if __name__ == "__main__":
    main()
