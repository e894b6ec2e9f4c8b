"""Draw your own arrays: positions, radii and a scalar in, a picture with global illumination out."""

from pathlib import Path

import numpy as np

import luxel

rng = np.random.default_rng(0)
turns = rng.random(6_000)
angle = 14 * np.pi * turns
spiral = np.stack([np.cos(angle), np.sin(angle), 2.4 * turns], axis=1) * (0.4 + 0.6 * turns[:, None])
positions = spiral + rng.normal(0, 0.04, spiral.shape)

particles = luxel.Particles(
    positions, radii=rng.uniform(0.015, 0.035, len(positions)), scalars={"height": positions[:, 2]}
)
scene = luxel.Scene(
    particles, lights=[luxel.Sky(1.0), luxel.Sun(direction=(-1, -2, 3), level=2.0, angular_diameter=15)]
)
view = luxel.View(color_by="height", colormap="viridis")

image = luxel.render(scene, view, size=(480, 320), samples=4)
Path("out").mkdir(exist_ok=True)
image.save("out/01_render.png")
print(f"out/01_render.png: {len(particles)} particles, {len(np.unique(image.ids)) - 1} of them visible")
