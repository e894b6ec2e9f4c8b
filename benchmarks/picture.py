"""Pictures: how far luminance textures are from path tracing every pixel, and what each costs.

    python -m benchmarks.picture [--filter] [--quick] [--json]

Truth is the antialiased picture with every pixel path-traced; its own noise is estimated from a second one with
another seed and subtracted. Errors in 8-bit levels as displayed, over covered pixels. 22.5 degree texels, 8 bits and
noise all count.

``--filter`` instead prints what stands in docs/light.md on first light and on small particles.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import luxel
from benchmarks.measure import report
from benchmarks.small import filter_rows, first_light_rows
from luxel.data import demo_particles, demo_view
from luxel.picture.raytrace import render, visible_ids


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--quick", action="store_true", help="a smaller picture and fewer samples")
    options.add_argument("--filter", action="store_true", help="small particles and first light")
    options.add_argument("--json", action="store_true")
    chosen = options.parse_args()
    if chosen.filter:
        report("first light", first_light_rows(), chosen.json)
        report("texture filter, rms levels", filter_rows(chosen.quick), chosen.json)
        return
    size, samples = ((240, 135), 128) if chosen.quick else ((480, 270), 512)
    particles, view = demo_particles(), demo_view()
    scene = luxel.Scene(particles)
    common = {"size": size, "antialias": 2, "colorbar": False}
    truths, seconds = [], []
    for seed in (1, 2):
        start = time.perf_counter()
        truths.append(render(scene, view, light="pixel", samples=samples, seed=seed, **common))
        seconds.append(time.perf_counter() - start)
    covered = truths[0].ids >= 0
    a, b = (t.array[..., :3].astype(np.float64)[covered] for t in truths)
    truth, noise = 0.5 * (a + b), ((a - b) ** 2).mean() / 4
    rows = [
        {
            "light": f"pixel, {samples} samples",
            "s": float(np.mean(seconds)),
            "rms levels": float(np.sqrt(2 * noise)),
            "mean levels": 0.0,
        }
    ]
    seen = len(visible_ids(scene, view.camera, size, antialias=2))
    modes = (
        (("fast", 1), ("fast", 4))
        if chosen.quick
        else (("fast", 1), ("fast", 4), ("fast", 16), ("paper", 16))
    )
    for mode, spp in modes:
        start = time.perf_counter()
        image = render(scene, view, mode=mode, samples=spp, **common)
        took = time.perf_counter() - start
        difference = image.array[..., :3].astype(np.float64)[covered] - truth
        error = np.sqrt(max(0.0, (difference**2).mean() - noise))
        rows.append(
            {
                "light": f"textures, {mode}, {spp} samples",
                "s": took,
                "rms levels": float(error),
                "mean levels": float(difference.mean()),
            }
        )
    for row in rows:
        row["visible"] = seen
    report("picture", rows, chosen.json)


if __name__ == "__main__":
    main()
