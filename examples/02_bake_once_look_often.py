"""Light is kept on the particles: bake once, then change camera, scalar and colours without tracing another path."""

from pathlib import Path

import numpy as np

import luxel

grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 16)] * 3, indexing="ij"), -1).reshape(-1, 3)
keep = (np.linalg.norm(grid, axis=1) > 0.8) & (
    np.abs(grid[:, 0] + grid[:, 1]) > 0.25
)  # a hollow, cracked block
positions = grid[keep]
particles = luxel.Particles(
    positions, scalars={"x": positions[:, 0], "distance": np.linalg.norm(positions, axis=1)}
)

scene = luxel.Scene(particles)
textures = luxel.bake(scene, samples=4, mode="fast")
print(
    f"{len(textures.ids)} textures, {textures.nbytes / 2**20:.1f} MiB, {textures.clipped_count} clipped texels"
)

Path("out").mkdir(exist_ok=True)
for name, color_by, colormap, azimuth in (("a", "x", "viridis", -60), ("b", "distance", "magma", 20)):
    camera = luxel.Camera.framing(particles.bounds, azimuth=azimuth, aspect=4 / 3)
    view = luxel.View(camera=camera, color_by=color_by, colormap=colormap)
    luxel.render(scene, view, textures=textures, size=(320, 240)).save(f"out/02_{name}.png")
print("out/02_a.png, out/02_b.png")
