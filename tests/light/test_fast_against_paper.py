"""Fast mode against many samples of paper mode on real data sets."""

import numpy as np
import pytest

import luxel
from benchmarks.scenes import plate
from luxel.light.sampling import draw_paths
from luxel.textures.bake import Baker
from luxel.textures.spec import TextureSpec
from tests.conftest import shared_data
from tests.light.exposure import open_fraction

LIGHTS = (luxel.Sky(1.0), luxel.Sun((-1, -1, 2), 2.0, 15.0))
SAMPLES = 100
# Root mean square error that fast mode may have at its default of 4 samples, under a unit sky and a sun of level 2:
# a third more than that of 49 raw samples, which is 0.09 on what is visible of such data: eight particles are few.
BOUND = 0.12
# Fill levels, filters and adaptive stopping must not lighten or darken a data set.
BIAS = 0.03


@pytest.mark.shared_data
@pytest.mark.parametrize(
    "file",
    [
        "mpm_generated/foam_crushed.npz",
        "mpm_generated/fireball_006.npz",
        "solid/peri_disc.240.dump.gz",
        "dem/pour.lammpstrj.gz",
    ],
)
def test_fast_mode_is_paper_mode_with_less_noise(file):
    series = luxel.open(shared_data(file))
    particles = series[len(series) - 1]
    scene = luxel.Scene(particles, LIGHTS)
    # The outer ones of a random lot, which see light.
    lot = np.random.default_rng(4).choice(len(particles), 400, replace=False).astype(np.int32)
    outward = np.linalg.norm(particles.positions[lot] - particles.positions.mean(axis=0), axis=1)
    ids = lot[np.argsort(outward)[-8:]]
    exposed = open_fraction(particles, ids, 16)
    first, second = (
        Baker(scene, TextureSpec(samples=SAMPLES, seed=seed)).luminance(ids)[0] / np.maximum(exposed, 0.5)
        for seed in (7, 8)
    )
    counts = exposed > 0.95
    assert counts.sum() > 300
    truth, noise = 0.5 * (first + second)[counts], (((first - second)[counts]) ** 2).mean() / 4
    difference = Baker(scene, TextureSpec(mode="fast", samples=4)).luminance(ids)[0][counts] - truth
    error = np.sqrt((difference**2).mean() - noise)
    assert error < BOUND
    assert abs(difference.mean()) < BIAS
    raw = Baker(scene, TextureSpec(samples=4)).luminance(ids)[0][counts] - truth
    assert error < 0.8 * np.sqrt((raw**2).mean() - noise)


def test_what_is_not_sampled_is_dim():
    scene = luxel.Scene(plate(60_000), LIGHTS)
    ids = np.random.default_rng(2).choice(len(scene.particles), 400, replace=False).astype(np.int32)
    baker = Baker(scene, TextureSpec(mode="fast", samples=4))
    fast, told = baker.luminance(ids)
    flat = np.ptp(fast, axis=(1, 2)) == 0
    assert flat.sum() > 120
    sampled = draw_paths(Baker(scene, TextureSpec(seed=5)).world, "latlong", 16, 16, ids[flat])
    truth, exposed = sampled.mean, sampled.exposed > 0
    assert truth.mean(axis=(1, 2)).max() < 0.03
    # Nor do they hide a bright spot: a crack that opens on a few texels.
    assert truth.reshape(-1, 4, 4, 4, 4).mean(axis=(2, 4)).max() < 0.25
    difference = np.where(exposed, fast[flat] - truth, 0.0)
    assert abs(difference.sum() / exposed.sum()) < 0.001 * baker.scale
    noise = (sampled.variance[exposed] / sampled.exposed[exposed]).sum()
    found = np.sqrt(((difference**2).sum() - noise) / exposed.sum())
    assert 0.5 < np.sqrt((told[flat] ** 2).mean()) / found < 2


def test_no_texture_is_flat_where_light_comes_straight_in():
    # a ball in a box of balls that is open by one narrow shaft to the sky
    grid = np.arange(-4, 5) * 1.0
    x, y, z = (a.ravel() for a in np.meshgrid(grid, grid, grid, indexing="ij"))
    shaft = (x == 0) & (y == 0) & (z > 0)
    centers = np.stack([x, y, z], axis=1)[~shaft]
    middle = np.flatnonzero((np.abs(centers) < 0.1).all(axis=1)).astype(np.int32)
    deep = np.flatnonzero((centers == [2.0, 2.0, -1.0]).all(axis=1)).astype(np.int32)
    scene = luxel.Scene(luxel.Particles(centers, np.full(len(centers), 0.62)), LIGHTS)
    baker = Baker(scene, TextureSpec(mode="fast", samples=2))
    assert np.ptp(baker.luminance(middle)[0]) > 0.05
    assert not baker.luminance(deep)[0].any()
