"""Small scenes that tests share."""

from __future__ import annotations

import numpy as np

import luxel


def cloud(count: int = 200, *, seed: int = 0, radius: float = 0.06, spread: float = 0.0) -> luxel.Particles:
    """Random overlapping spheres in the unit cube; radii over exp(±spread)."""
    rng = np.random.default_rng(seed)
    radii = radius * np.exp(rng.uniform(-spread, spread, count))
    return luxel.Particles(
        rng.random((count, 3)), radii, {"value": rng.random(count), "vector": rng.normal(size=(count, 3))}
    )


def lattice(edge: int = 4) -> luxel.Particles:
    """Spheres on a cubic lattice that almost touch: nothing is buried."""
    grid = np.stack(np.meshgrid(*[np.arange(edge)] * 3, indexing="ij"), -1).reshape(-1, 3)
    return luxel.Particles(grid.astype(float), 0.499)


def random_rays(
    particles: luxel.Particles, count: int, *, seed: int = 1
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rays that leave random points of random spheres outwards, in normalised units: origins, directions, sphere ids."""
    from luxel.trace.spheres import SphereSet

    spheres = SphereSet.of(particles)
    rng = np.random.default_rng(seed)
    ids = rng.integers(0, len(spheres), count).astype(np.int32)
    normal = rng.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    direction = normal + 0.999 * direction
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    origins = spheres.centers[ids] + spheres.radii[ids][:, None] * normal
    return origins.astype(np.float32), direction.astype(np.float32), ids
