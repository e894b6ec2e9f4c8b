"""Scenes that benchmarks share."""

from __future__ import annotations

import numpy as np

import luxel


def plate(count: int = 550_000, seed: int = 1) -> luxel.Particles:
    """A plate of touching spheres with a ragged hole, radial cracks and a plume of debris; about `count` particles."""
    rng = np.random.default_rng(seed)
    scale = (count / 550_000) ** (1 / 3)
    nx = ny = round(160 * scale)
    nz = round(22 * scale)
    grid = (
        np.stack(np.meshgrid(np.arange(nx), np.arange(ny), np.arange(nz), indexing="ij"), -1)
        .reshape(-1, 3)
        .astype(float)
    )
    x, y = grid[:, 0] - nx / 2, grid[:, 1] - ny / 2
    r, angle = np.hypot(x, y), np.arctan2(y, x)
    hole = 18 * scale
    crack = (np.abs(np.sin(3.5 * angle) * r) < 1.2 + 0.02 * (60 * scale - r)) & (r < 70 * scale)
    keep = (r > hole + 2 * scale * np.sin(5 * angle)) & ~crack
    grid, r = grid[keep], r[keep]
    grid[:, 2] += 8 * scale * np.exp(-(((r - hole) / (15 * scale)) ** 2))
    grid += rng.normal(0, 0.08, grid.shape)
    debris = rng.normal(0, 1, (round(20_000 * scale**3), 3)) * np.array([12, 12, 25]) * scale
    debris += np.array([nx / 2, ny / 2, 45 * scale])
    positions = np.concatenate([grid, debris[debris[:, 2] > 20 * scale]])
    return luxel.Particles(positions, 0.55, {"height": positions[:, 2]})


def plate_camera(particles: luxel.Particles) -> luxel.Camera:
    """The view of the plate that the tables use."""
    low, high = particles.bounds
    middle, size = 0.5 * (low + high), high - low
    return luxel.Camera(
        middle + size * [0.0, -1.25, 1.1], [middle[0], middle[1], low[2] + 0.1 * size[2]], fov=53.13
    )
