"""The four shading models side by side, and the truth that the last one approximates."""

from pathlib import Path

import numpy as np

import luxel

rng = np.random.default_rng(1)
plate = (
    np.stack(np.meshgrid(np.arange(36), np.arange(36), np.arange(5), indexing="ij"), -1)
    .reshape(-1, 3)
    .astype(float)
)
crack = np.abs(plate[:, 1] - 18 - 3 * np.sin(plate[:, 0] / 5)) < 1.2
particles = luxel.Particles(plate[~crack] + rng.normal(0, 0.05, (np.count_nonzero(~crack), 3)), 0.55)

Path("out").mkdir(exist_ok=True)
view = luxel.View(color="#d9d5cc")
for model in ("lambertian", "shadows", "ao", "interreflection"):
    scene = luxel.Scene(particles, model=model)
    image = luxel.render(scene, view, size=(320, 240), samples=4)
    image.save(f"out/03_{model}.png")
    print(f"out/03_{model}.png: mean grey level {image.array[image.ids >= 0].mean():.0f}")

truth = luxel.render(luxel.Scene(particles), view, size=(320, 240), light="pixel", samples=36)
truth.save("out/03_pixel.png")
seen = truth.ids >= 0
difference = image.array.astype(float)[seen] - truth.array.astype(float)[seen]
print(f"textures differ from path-traced pixels by {np.abs(difference).mean():.1f} of 255 levels on average")
