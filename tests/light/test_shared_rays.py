"""What the shared rays of fast mode find, against the plain tree on the same rays and `path_tail` on the same paths."""

import numpy as np
import pytest
from numba import njit

import luxel
from luxel.kernels.near import RAY, near_scratch
from luxel.kernels.path import path_tail
from luxel.kernels.periodic import HERE
from luxel.kernels.rays import Site, neighbours
from luxel.kernels.rng import PURPOSE_TEXEL, path_key
from luxel.kernels.simd import FAR, LANES
from luxel.kernels.tree_trace import scratch, trace
from luxel.kernels.waves import add_path, follow_paths, wave_scratch
from luxel.light.mapping import texel_solid_angles
from luxel.light.ray_sets import make_ray_table, make_sun_table
from luxel.light.sampling import RaySets, draw_rays
from luxel.light.world import make_world
from luxel.trace.spheres import SphereSet
from luxel.trace.tree import SphereTree
from tests.scenes import cloud, lattice

RNG = np.random.default_rng(3)


def polydisperse(count):
    radii = 10 ** RNG.uniform(-2.5, -0.8, count)
    return luxel.Particles(RNG.uniform(-1, 1, (count, 3)), radii)


SCENES = {
    "overlapping": cloud(400, radius=0.05, spread=0.3),
    "on a giant": luxel.Particles(
        np.concatenate([RNG.uniform(-1, 1, (200, 3)), [[0, 0, -501.0]]]), np.append(np.full(200, 0.1), 500.0)
    ),
    "touching": lattice(6),
    "polydisperse": polydisperse(1500),
    "beyond any beam": cloud(6000, radius=0.02, spread=0.5),
    "far apart": luxel.Particles([[0, 0, 0], [0, 0, 40], [3, 0, 25.0]], [1.0, 2.0, 4.0]),
}


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("samples", [9, 16])
def test_sunlight_is_that_of_single_rays(name, samples):
    particles = SCENES[name]
    sun = luxel.Sun((0.3, 0.2, 1.0), 2.0, 15.0)
    scene = luxel.Scene(particles, (sun,), model="shadows")
    world = make_world(scene)
    ids = np.arange(0, len(particles), max(1, len(particles) // 40), dtype=np.int32)
    table = make_sun_table("latlong", (16, 16), samples, world.lights.suns)
    rays = table.rays[:, :1]
    around = make_ray_table("latlong", (16, 16), 1)
    found = draw_rays(world, RaySets(around, table._replace(rays=rays), (16, 16)), ids).sun

    words = rays[0, 0].reshape(-1, RAY // LANES, LANES).swapaxes(1, 2).reshape(-1, RAY // LANES)
    keep = table.texel >= 0
    starts, directions, texel = words[keep, :3], words[keep, 3:6], table.texel[keep]
    spheres = SphereSet.of(particles)
    tree = SphereTree.of(spheres)
    level = world.lights.suns[0, 3] * 2 / (1 + world.lights.suns[0, 5])
    wrong = total = 0
    for k, i in enumerate(ids):
        origins = spheres.centers[i] + spheres.radii[i] * starts
        skip = np.full(len(origins), i, np.int32)
        t, hit = tree.closest(origins, directions, skip=skip)
        buried = (hit >= 0) & (t <= 0)
        value = np.where(hit < 0, level * np.maximum(words[keep, 6], 0), 0.0)
        seen = np.bincount(texel, ~buried, 256)
        mean = np.bincount(texel, value, 256) / np.maximum(seen, 1)
        wrong += np.count_nonzero(np.abs(mean - found.mean[k].ravel()) > 1e-4)
        wrong += np.count_nonzero(seen != found.exposed[k].ravel())
        total += 512
    # Grazing rays that rounding decides: many where single precision ends at a thousandth of the small radii.
    assert wrong < (5e-3 if name == "on a giant" else 2e-3) * total


@njit(error_model="numpy")
def follow_both(world, particle, starts, directions, together, alone):
    """Paths that go on from where rays of a particle meet a neighbour, both ways; returns their number."""
    work = scratch(world.tree.stack_size)
    near, waves = near_scratch(LANES), wave_scratch(world.tree, len(starts))
    x, y, z = world.centers[particle, 0], world.centers[particle, 1], world.centers[particle, 2]
    r = world.radii[particle]
    known, reach = neighbours(world, work, near, particle)
    paths = 0
    for k in range(len(starts)):
        px, py, pz = x + r * starts[k, 0], y + r * starts[k, 1], z + r * starts[k, 2]
        dx, dy, dz = directions[k, 0], directions[k, 1], directions[k, 2]
        t, hit = trace(world.tree, work, px, py, pz, dx, dy, dz, FAR, particle, False)
        if hit < 0 or t <= 0:
            continue
        hx, hy, hz = px + t * dx, py + t * dy, pz + t * dz
        state = path_key(world.seed, particle, 0, k, PURPOSE_TEXEL)
        alone[paths] = path_tail(world, work, hit, hx, hy, hz, HERE, state)
        together[paths] = 0
        add_path(world.cell, waves, paths, paths, hit, hx, hy, hz, HERE, state)
        paths += 1
    site = Site(particle, x, y, z, r, reach)
    follow_paths(world, work, near, known, site, waves, paths, together)
    return paths


LAMPS = (
    luxel.Sun((1, 1, 2), 2.0, 15.0),
    luxel.SphereLight((0.2, 0.1, 1.5), 0.1, 30.0),
    luxel.QuadLight((-1, -1, 2), (2, 0, 0), (0, -2, 0), 2.0),
)


@pytest.mark.parametrize("name", ["overlapping", "touching", "polydisperse", "on a giant"])
@pytest.mark.parametrize("lights", [(), LAMPS], ids=["sky", "all lights"])
@pytest.mark.parametrize("bounces, keep", [(None, 1), (2, 1), (None, 0.45)])
def test_paths_that_bounce_together_are_those_that_bounce_alone(name, lights, bounces, keep):
    particles = SCENES[name]
    world = make_world(luxel.Scene(particles, (luxel.Sky(1.0), *lights), albedo=0.8), max_bounces=bounces)
    world = world._replace(keep=np.float32(keep))
    starts = RNG.normal(size=(200, 3))
    starts /= np.linalg.norm(starts, axis=1, keepdims=True)
    directions = starts + 0.9 * RNG.permutation(starts)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    arrays = starts.astype(np.float32), directions.astype(np.float32)
    different, count, difference, total = 0, 0, 0.0, 0.0
    for i in range(0, len(particles), max(1, len(particles) // 20)):
        together, alone = np.zeros(200, np.float32), np.zeros(200, np.float32)
        n = follow_both(world, np.int32(i), *arrays, together, alone)
        different += np.count_nonzero(np.abs(together[:n] - alone[:n]) > 1e-3 * (1 + alone[:n]))
        difference += float((together - alone).sum())
        count, total = count + n, total + float(alone.sum())
    assert count > 20
    # Where rounding sends a path elsewhere: the longer paths are, the more often.
    assert different < (0.02 if keep == 1 else 0.04) * count + 1
    assert abs(difference) < 0.02 * total + 1e-3


@pytest.mark.parametrize("samples", [1, 2, 3, 6, 9])
@pytest.mark.parametrize("mapping", ["latlong", "octahedral"])
def test_every_texel_has_as_many_rays_as_asked_for(mapping, samples):
    table = make_ray_table(mapping, (8, 8), samples, sets=2, every_cell=True)
    assert np.bincount(table.texel[table.texel >= 0], minlength=64).tolist() == [samples] * 64
    if mapping == "octahedral":  # all of one size
        assert np.array_equal(make_ray_table(mapping, (8, 8), samples, sets=2).texel, table.texel)


@pytest.mark.parametrize("samples", [1, 2, 6, 9])
@pytest.mark.parametrize("texels", [8, 16])
def test_small_texels_near_poles_have_fewer_rays_but_no_part_of_the_sphere_fewer_than_the_equator(
    texels, samples
):
    table = make_ray_table("latlong", (texels, texels), samples, sets=2)
    counts = np.bincount(table.texel[table.texel >= 0], minlength=texels**2).reshape(texels, texels)
    middle = counts[texels // 2 - 1 : texels // 2 + 1]
    assert (middle == samples).all()
    assert counts.max() == samples
    density = counts.sum(axis=1) / texel_solid_angles("latlong", texels)[:, 0]
    density /= density[texels // 2]
    rows = next(rows for rows in range(int(samples**0.5), 0, -1) if samples % rows == 0)  # of a texel's cells
    rounding = rows / (texels * samples * np.sin((np.arange(texels) + 0.5) * np.pi / texels))
    assert (density >= 0.97 - rounding).all()
    assert (density <= 1.53 + rounding).all()
    assert counts.sum() < 0.88 * samples * texels**2


def test_roulette_that_spares_paths_changes_no_mean():
    world = make_world(
        luxel.Scene(SCENES["touching"], (luxel.Sky(1.0), luxel.Sun((1, 1, 2), 2.0, 15.0)), albedo=0.8)
    )
    ids = np.arange(216, dtype=np.int32)
    means, spreads = [], []
    for keep in (1.0, 0.45):
        sets = RaySets.make("latlong", (8, 8), 16, world.lights.suns, sun_samples=16)
        found = draw_rays(world._replace(keep=np.float32(keep)), sets, ids).rest
        means.append(found.mean.astype(float).mean())
        spreads.append(found.variance.astype(float).mean())
    # 216 x 64 x 16 paths of a standard deviation below 1: a standard error of 0.002 each.
    assert abs(means[0] - means[1]) < 4 * np.sqrt(2) * np.sqrt(max(spreads) / (216 * 64 * 16))
    assert spreads[1] < 0.8 * spreads[0]  # what it is for
