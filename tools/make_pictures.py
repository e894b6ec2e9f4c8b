"""Draw the pictures of docs/ that no browser is needed for.

    python tools/make_pictures.py [NAME ...]

About a minute on two cores. The pages that show the viewer come from ``tools/make_screenshots.py``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

import luxel
from luxel.data import demo_particles, demo_view
from luxel.picture.image import Image
from luxel.picture.textures_figure import codec_figure
from luxel.textures.codecs import train

IMAGES = Path(__file__).resolve().parent.parent / "docs" / "images"
SIZE = (640, 480)
STONE = "#ead8bc"


def cracked_block() -> luxel.Particles:
    """A block with a winding crack that narrows with depth, and a cavity in one of its walls; 97,000 particles."""
    rng = np.random.default_rng(4)
    axes = np.meshgrid(np.arange(64), np.arange(64), np.arange(26), indexing="ij")
    grid = np.stack(axes, -1).reshape(-1, 3).astype(float)
    x, y, z = grid.T
    middle = 32 + 5 * np.sin(x / 9) + 2.5 * np.sin(x / 3.7 + 1)
    width = (1.2 + 5.2 * np.exp(-(((x - 26) / 17) ** 2))) * (0.45 + 0.55 * z / 25)
    cavity = (np.abs(y - middle - 9) < 5.5) & (np.abs(z - 7) < 4) & (np.abs(x - 27) < 9)
    kept = grid[((np.abs(y - middle) > width) | (z < 3)) & ~cavity]
    return luxel.Particles(kept + rng.normal(0, 0.07, kept.shape), 0.55, {"depth": kept[:, 2]})


def crack() -> None:
    """The paper's figure 4: a crack under direct light with soft shadows, and with all bounces."""
    particles = cracked_block()
    lights = [luxel.Sky(0.12), luxel.Sun(direction=(0.25, -0.8, 1.0), level=2.6, angular_diameter=6)]
    view = luxel.View(camera=luxel.Camera((-16, 6, 58), (27, 36, 14), fov=30), color=STONE)
    for model in ("shadows", "interreflection"):
        scene = luxel.Scene(particles, lights, model=model)
        _save(luxel.render(scene, view, size=SIZE, samples=16), f"crack-{model}")


def models() -> None:
    """The demo, close, under each of the four models."""
    view = demo_view()
    camera = luxel.Camera(eye=(-0.623, -0.912, 1.239), target=(0.56, 0.50, 0.50), fov=8.0)
    for model in ("lambertian", "shadows", "ao", "interreflection"):
        scene = luxel.Scene(demo_particles(), model=model)
        image = luxel.render(scene, view.with_changes(camera=camera), size=SIZE, samples=9, colorbar=False)
        _save(image, f"model-{model}")


def cuts() -> None:
    """A cut that keeps the light of what it removes, and one that lets light fall in."""
    particles = cracked_block()
    camera = luxel.Camera((14, -52, 52), (36, 40, 11), fov=36)
    cut = luxel.Cut.parse("y<28")
    kept = luxel.View(camera=camera, color_by="depth", colormap="viridis", hide=cut)
    _save(luxel.render(luxel.Scene(particles), kept, size=SIZE, samples=9), "cut-keeps")
    opened = luxel.Scene(particles, hide=cut)
    _save(luxel.render(opened, kept.with_changes(hide=()), size=SIZE, samples=9), "cut-opens")


def codecs() -> None:
    """The paper's figure 3: textures, what a codec at 32:1 makes of them, and four times the difference."""
    scene = luxel.Scene(demo_particles())
    codes = luxel.bake(scene, samples=4, mode="fast").codes
    lively = np.argsort(codes.reshape(len(codes), -1).std(axis=1))[-len(codes) // 4 :]
    shown = codes[np.sort(np.random.default_rng(0).choice(lively, 6, replace=False))]
    for kind in ("vq", "pca", "cpca"):
        codec = train(kind, codes, ratio=32)
        _save(codec_figure(shown, codec.decode(codec.encode(shown))), f"codec-{kind}")


PICTURES: dict[str, Callable[[], None]] = {"crack": crack, "models": models, "cuts": cuts, "codecs": codecs}


def _save(image: Image, name: str) -> None:
    image.save(IMAGES / f"{name}.webp")


if __name__ == "__main__":
    for chosen in sys.argv[1:] or PICTURES:
        PICTURES[chosen]()
