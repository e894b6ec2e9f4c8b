"""Textures are filtered over what a ray stands for: small particles sparkle less, large ones stay as they are."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import luxel
from luxel.light.mapping import Mapping
from luxel.light.world import make_world
from luxel.picture.drawing import Crew, draw_rays, make_eye, make_skin
from luxel.textures.textures import TextureTable, decoding_table
from luxel.trace.spheres import SphereSet
from tests.scenes import lattice

SIDE = 120


def luminance(
    edge: int, rays: int, spacing: float, *, orthographic: bool = False, mapping: Mapping = "latlong"
) -> np.ndarray:
    """(H, W) mean luminance of a lattice of edge³ particles with noise for textures, rays × rays to a pixel."""
    particles = lattice(edge)
    middle = (edge - 1) / 2
    camera = luxel.Camera(
        (middle, middle, 4.0 * edge),
        (middle, middle, middle),
        up=(0, 1, 0),
        fov=18,
        height=edge if orthographic else None,
    )
    world = make_world(luxel.Scene(particles))
    eye = make_eye(camera, SphereSet.of(particles), 1.0)
    count = len(particles)
    codes = np.random.default_rng(0).integers(0, 256, (count, 16, 16)).astype(np.uint8)
    slot, colors = np.arange(count, dtype=np.int32), np.ones((count, 3), np.float32)
    total = np.zeros((SIDE, SIDE, 5), np.float32)
    table = TextureTable(slot, codes, decoding_table(1.0, "linear"), mapping)
    for k in range(rays * rays):
        shift = (k % rays + 0.5) / rays, (k // rays + 0.5) / rays
        skin = make_skin(table, colors)
        draw_rays(world.tree, world.lights, eye, shift, skin, total, Crew(1), spacing=spacing)
    return total[:, :, 3] / np.maximum(total[:, :, 4], 1)


@pytest.mark.parametrize(
    "options",
    [{"mapping": "latlong"}, {"mapping": "octahedral"}, {"orthographic": True}],
    ids=["latlong", "octahedral", "orthographic"],
)
def test_small_particles_come_closer_to_their_mean_over_a_pixel(options):
    truth = luminance(40, 8, 0, **options)  # particles 3 pixels wide
    bare, filtered = (luminance(40, 1, spacing, **options) for spacing in (0.0, 1.0))
    assert np.square(filtered - truth).mean() < 0.6 * np.square(bare - truth).mean()
    assert abs((filtered - bare).mean()) < 0.01


def test_large_particles_stay_as_they_are():
    assert np.array_equal(luminance(8, 1, 0.0), luminance(8, 1, 1.0))  # 15 pixels wide


def test_the_filter_opens_without_a_step():
    spacings = np.linspace(0.25, 0.65, 41)
    pictures = [luminance(40, 1, spacing) for spacing in spacings]
    steps = [np.abs(a - b).mean() for a, b in itertools.pairwise(pictures)]
    assert max(steps) < 0.1 * np.abs(pictures[0] - pictures[-1]).mean()
