"""Pictures of real data sets lit in ``paper`` and in ``fast`` mode, side by side, to be looked at.

    python -m benchmarks.side_by_side [-o FOLDER] [--only NAME ...]

Each picture shows, from two distances at which particles are a dozen and some forty pixels wide: `paper` mode at 49 samples,
`fast` mode at its default of 4, and their difference around grey, four times as strong. What to look for: seams where the azimuth
is 0 (towards +X), swirls at the poles, blotches, light that leaks through contacts.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import luxel
from benchmarks.light_scenes import SHARED
from benchmarks.measure import report
from luxel.picture.raytrace import render, visible_ids

# File, frame, and the direction from which it is seen: azimuth and elevation in degrees.
_SCENES = {
    "foam": ("mpm_generated/foam_crushed.npz", 0, (-60.0, 30.0)),
    "fireball": ("mpm_generated/fireball_006.npz", 0, (20.0, 15.0)),
    "disc": ("solid/peri_disc.240.dump.gz", -1, (-30.0, 60.0)),
    "pour": ("dem/pour.lammpstrj.gz", -1, (0.0, 20.0)),
}
_SIZE = (480, 360)
_WIDTHS = (12.0, 40.0)  # of particles, in pixels
_FOV = 30.0
_CONTRAST = 4.0


def near_view(particles: luxel.Particles, azimuth: float, elevation: float, width: float) -> luxel.Camera:
    """A view of what stands in the middle of the picture of everything, such that it is so many pixels wide."""
    scene = luxel.Scene(particles)
    all_ = luxel.Camera.framing(
        particles.bounds, azimuth=azimuth, elevation=elevation, aspect=_SIZE[0] / _SIZE[1]
    )
    seen = visible_ids(scene, all_, _SIZE)
    eye, target = np.asarray(all_.eye, float), np.asarray(all_.target, float)
    ahead = (target - eye) / np.linalg.norm(target - eye)
    aside = particles.positions[seen] - eye
    off = np.linalg.norm(aside - (aside @ ahead)[:, None] * ahead, axis=1)
    middle = seen[np.argmin(off)]
    distance = particles.radii[middle] * _SIZE[1] / (width * np.tan(np.radians(_FOV / 2)))
    return luxel.Camera(
        particles.positions[middle] - distance * ahead, particles.positions[middle], all_.up, fov=_FOV
    )


def panels(particles: luxel.Particles, camera: luxel.Camera) -> tuple[NDArray[np.uint8], dict[str, Any]]:
    """Paper, fast and their difference beside each other (H, 3 W, 3), and figures."""
    scene, view = luxel.Scene(particles), luxel.View(camera=camera)
    pictures = {
        mode: render(scene, view, size=_SIZE, mode=mode, samples=samples, colorbar=False)
        for mode, samples in (("paper", 49), ("fast", 4))
    }
    paper, fast = (p.array[..., :3].astype(float) for p in pictures.values())
    covered = pictures["fast"].ids >= 0
    difference = (fast - paper)[covered]
    shown = np.clip(128 + _CONTRAST * (fast - paper), 0, 255)
    figures = {
        "RMS levels": float(np.sqrt((difference**2).mean())),
        "mean levels": float(difference.mean()),
        "covered": float(covered.mean()),
    }
    return np.concatenate([paper, fast, shown], axis=1).astype(np.uint8), figures


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("-o", "--output", type=Path, default=Path("out") / "side_by_side", help="a folder")
    options.add_argument("--only", nargs="+", choices=list(_SCENES), default=list(_SCENES), metavar="NAME")
    options.add_argument("--json", action="store_true")
    chosen = options.parse_args()
    chosen.output.mkdir(parents=True, exist_ok=True)
    rows = []
    for name in chosen.only:
        file, frame, (azimuth, elevation) = _SCENES[name]
        series = luxel.open(SHARED / file)
        particles = series[frame % len(series)]
        strips = []
        for width in _WIDTHS:
            strip, figures = panels(particles, near_view(particles, azimuth, elevation, width))
            strips.append(strip)
            rows.append({"scene": name, "particles": len(particles), "width": width, **figures})
        Image.fromarray(np.concatenate(strips)).save(chosen.output / f"{name}.png")
    report("fast mode beside paper mode", rows, chosen.json)


if __name__ == "__main__":
    main()
