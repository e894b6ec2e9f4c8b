"""What tests of the store share: small bakes, and what a store is made of."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

import luxel
from luxel.scene.lights import Sky, Sun
from luxel.textures.spec import TextureSpec

SPEC = TextureSpec(texels=4, samples=1, mode="paper")
LIGHTS = (Sky(0.7, ground=0.2, axis=(1, 2, 3)), Sun((1, 2, 3), level=1.5, angular_diameter=20))


def some(count: int = 10, seed: int = 0, offset: float = 0.0) -> luxel.Particles:
    """A few particles with every kind of thing that particles can hold."""
    rng = np.random.default_rng(seed)
    return luxel.Particles(
        rng.random((count, 3)) + offset,
        0.1 + 0.1 * rng.random(count),
        {
            "a/b c": rng.random(count),
            "Species": rng.integers(0, 2, count).astype(">i4"),
            "vector": rng.normal(size=(count, 3)).astype(np.float32),
        },
        cell=luxel.Cell(np.eye(3) * 1.1, [offset, offset, offset], (True, True, False)),
        time=0.1 + seed,
        categories={"Species": ("Ar", "Kr")},
        radii_source="column radius",
    )


def bake(path: Path, particles: object = None, **options: object) -> luxel.Baked:
    """Bake something small into a store."""
    options = {"spec": SPEC, "lights": LIGHTS, "chunk": 4, "threads": 1, **options}
    return luxel.bake_to(path, some() if particles is None else particles, **options)  # type: ignore[arg-type]


def hashes(path: Path) -> dict[str, str]:
    """Every file of a store and the hash of its content."""
    files = sorted(file for file in path.rglob("*") if file.is_file())
    return {
        file.relative_to(path).as_posix(): hashlib.sha256(file.read_bytes()).hexdigest() for file in files
    }
