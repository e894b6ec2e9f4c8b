"""Light whose value is known in closed form, and laws that it must obey."""

import numpy as np
import pytest

import luxel
from luxel.light.sampling import draw_paths
from luxel.scene.lights import sun_direction
from luxel.textures.bake import Baker
from luxel.textures.spec import TextureSpec
from tests.scenes import cloud, lattice

SKY = (luxel.Sky(1.0),)


def texel_normals(texels=16, fine=8):
    """(T, T, fine², 3) normals spread over every texel, uniform in (u, v)."""
    k = (np.arange(texels * fine) + 0.5) / (texels * fine)
    azimuth, polar = np.meshgrid(2 * np.pi * k, np.pi * k)
    n = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], -1)
    return n.reshape(texels, fine, texels, fine, 3).swapaxes(1, 2).reshape(texels, texels, -1, 3)


@pytest.mark.parametrize("model", ["shadows", "ao", "interreflection", "lambertian"])
@pytest.mark.parametrize("mode", ["paper", "fast"])
@pytest.mark.parametrize("mapping", ["latlong", "octahedral"])
def test_lone_sphere_under_a_unit_sky_is_1_everywhere(model, mode, mapping):
    scene = luxel.Scene(luxel.Particles([[7.0, 8, 9]], 3.0), SKY, model=model)
    textures = luxel.bake(scene, samples=4, mode=mode, mapping=mapping)
    assert np.array_equal(textures.luminance, np.ones((1, 16, 16), np.float32))
    assert textures.clipped_count == 0


def test_furnace():
    # Albedo 1, unlimited depth, nothing buried: every point reflects exactly what the sky sends.
    scene = luxel.Scene(lattice(3), SKY, albedo=1.0)
    exact = Baker(scene, TextureSpec(samples=49)).luminance(np.arange(27, dtype=np.int32))[0]
    # Roulette beyond sixteen bounces is the only noise.
    assert abs(float(exact.mean()) - 1) < 2e-3
    assert np.abs(exact.mean(axis=(1, 2)) - 1).max() < 0.03


def test_two_spheres_occlude_by_the_closed_form():
    # A sphere of radius R at distance d that is wholly above the horizon takes (R/d)² cosθ of the sky (Howell, B-39).
    radius, distance = 1.0, 3.0
    particles = luxel.Particles([[0, 0, 0], [distance, 0, 0]], radius)
    textures = luxel.bake(luxel.Scene(particles, SKY, model="ao"), [0], samples=1024)
    normals = texel_normals()
    offset = np.array([distance, 0, 0]) - radius * normals
    d = np.linalg.norm(offset, axis=-1)
    cosine = np.einsum("...k,...k->...", offset, normals) / d
    sine = radius / d
    whole, hidden = (cosine >= sine).all(axis=-1), (cosine <= -sine).all(axis=-1)
    expected = 1 - (sine**2 * np.maximum(cosine, 0)).mean(axis=-1)
    got = textures.luminance[0]
    assert whole.sum() > 20
    assert hidden.sum() > 50
    assert np.abs(got - expected)[whole].max() < 0.05
    assert abs((got - expected)[whole].mean()) < 0.003
    assert np.array_equal(got[hidden], np.ones(hidden.sum(), np.float32))


def test_huge_sphere_as_plane_hides_half_the_sky():
    # A small sphere resting on a huge one: the horizontal texels at its equator see half the sky.
    particles = luxel.Particles([[0, 0, 1.0], [0, 0, -5000.0]], [1.0, 5000.0])
    got = luxel.bake(luxel.Scene(particles, SKY, model="ao"), [0], samples=400).luminance[0]
    v = (np.arange(16) + 0.5) / 16 * np.pi
    rows = got.mean(axis=1)
    expected = (1 + np.cos(v)) / 2  # the tilted-plane view factor
    assert np.abs(rows - expected)[:12].max() < 0.02


def test_ambient_occlusion_has_a_unit_sky_and_a_reach():
    particles = luxel.Particles([[0, 0, 0], [3.0, 0, 0]], 1.0)
    far = luxel.Scene(particles, (luxel.Sky(9.0), luxel.Sun((1, 0, 0), 5)), model="ao", ao_distance=0.9)
    assert np.array_equal(luxel.bake(far, samples=16).luminance, np.ones((2, 16, 16), np.float32))
    near = far.with_changes(ao_distance=2.5)
    assert luxel.bake(near, samples=16).luminance.min() < 0.95


def test_direct_light_follows_the_cosine_for_every_kind_of_light():
    particles = luxel.Particles([[0, 0, 0]], 1e-3)
    toward = np.array([2.0, 1.0, 2.0]) / 3
    normals = texel_normals()
    lights = {
        "sun": (luxel.Sun(toward, 0.8, 10.0), 0.8),
        # (R/d)² L, and area·L/(π d²) for a small quad that faces the particle
        "sphere": (luxel.SphereLight(toward * 10, 0.5, 300.0), 300 * 0.05**2),
        "quad": (_facing_quad(toward, 10.0, 0.6, 300.0), 300 * 0.36 / (np.pi * 100)),
    }
    for name, (light, level) in lights.items():
        for model in ("lambertian", "shadows", "interreflection"):
            got = luxel.bake(luxel.Scene(particles, (light,), model=model), samples=64).luminance[0]
            cosine = np.einsum("...k,k->...", normals, toward)
            lit = (cosine > 0.15).all(axis=-1)
            expected = level * cosine.mean(axis=-1)
            assert np.abs(got - expected)[lit].max() < 0.02 * level + 0.02, (name, model)
            assert got[(cosine < -0.15).all(axis=-1)].max() == 0, (name, model)


@pytest.mark.parametrize("q", [1e-2, 1e-3, 1.5e-4])
def test_small_far_lights_do_not_stand_before_themselves(q):
    # (R/d)² L is kept: the mean over the sphere of the clamped cosine is 1/4 of the level, whatever the distance.
    light = luxel.SphereLight((0, 0, 1000.0), 1000 * q, 1.0 / q**2)
    scene = luxel.Scene(luxel.Particles([[0, 0, 0]], 1.0), (light,), model="shadows")
    polar = (np.arange(16) + 0.5) / 16 * np.pi
    luminance = Baker(scene, TextureSpec(samples=16)).luminance(np.zeros(1, np.int32))[0]
    mean = (luminance * np.sin(polar)[:, None]).sum() / (16 * np.sin(polar).sum())
    assert mean == pytest.approx(0.25, abs=0.004)


def _facing_quad(toward, distance, edge, level):
    u = np.cross(toward, [0, 0, 1.0])
    u /= np.linalg.norm(u)
    v = np.cross(u, toward)  # cross(u, v) = -toward: it shines back at the origin
    corner = toward * distance - 0.5 * edge * (u + v)
    return (
        luxel.QuadLight(corner, edge * v, edge * u, level)
        if np.dot(np.cross(v, u), toward) < 0
        else luxel.QuadLight(corner, edge * u, edge * v, level)
    )


def test_the_back_of_a_quad_does_not_exist():
    particles = luxel.Particles([[0, 0, 0]], 0.1)
    back = luxel.QuadLight((-5, -5, 2), (10, 0, 0), (0, 10, 0), 1.0)  # shines up, away from the particle
    scene = luxel.Scene(particles, (luxel.Sky(1.0), back))
    lit = luxel.bake(scene, samples=4)
    assert np.abs(lit.luminance - 1).max() <= 0.5 * lit.scale / 255 + 1e-6
    front = luxel.QuadLight(
        (-5, -5, 2), (0, 10, 0), (10, 0, 0), 0.0
    )  # faces it and is dark: it hides the sky
    dark = luxel.bake(scene.with_changes(lights=(luxel.Sky(1.0), front)), samples=100).luminance[0]
    assert dark[0].mean() < 0.25
    assert abs(dark[-1].mean() - 1) < 0.01


def test_gradient_sky():
    scene = luxel.Scene(luxel.Particles([[0, 0, 0]], 1.0), (luxel.Sky(1.0, 0.2, (0, 0, 1)),), model="shadows")
    got = luxel.bake(scene, samples=400).luminance[0].mean(axis=1)
    v = (np.arange(16) + 0.5) / 16 * np.pi
    assert np.abs(got - (0.2 + 0.8 * (1 + 2 / 3 * np.cos(v)) / 2)).max() < 0.012


def test_scaling_and_moving_the_scene_changes_nothing():
    base = cloud(60)
    lights = (luxel.Sky(1.0), luxel.SphereLight((0.5, 0.5, 3.0), 0.5, 4.0))
    expected = luxel.bake(luxel.Scene(base, lights), range(12), samples=9).codes
    for scale in (2.0**-60, 2.0**70):
        moved = luxel.Particles(base.local * np.float32(scale), base.radii * np.float32(scale))
        scaled = (luxel.Sky(1.0), luxel.SphereLight(np.array([0.5, 0.5, 3.0]) * scale, 0.5 * scale, 4.0))
        assert np.array_equal(luxel.bake(luxel.Scene(moved, scaled), range(12), samples=9).codes, expected)


def test_rotating_the_scene_rotates_the_light():
    # A turn by one texel column about z, lights included: textures shift by one column, within noise.
    base = cloud(40, seed=3)
    turn = 2 * np.pi / 16
    matrix = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    sun = sun_direction(20, 30)
    plain = luxel.bake(
        luxel.Scene(base, (luxel.Sky(1), luxel.Sun(sun, 1.0))), range(10), samples=400
    ).luminance
    turned = luxel.Particles((base.positions - 0.5) @ matrix.T, base.radii)
    other = luxel.bake(
        luxel.Scene(turned, (luxel.Sky(1), luxel.Sun(matrix @ sun, 1.0))), range(10), samples=400
    ).luminance
    difference = np.roll(other, -1, axis=2) - plain
    assert abs(difference.mean()) < 0.005
    assert np.sqrt((difference**2).mean()) < 0.05


def test_more_samples_shrink_the_error():
    scene = luxel.Scene(cloud(100), SKY)
    ids = range(20)
    truth = luxel.bake(scene, ids, samples=2500, seed=9).luminance
    error = [
        np.sqrt(((luxel.bake(scene, ids, samples=n).luminance - truth) ** 2).mean()) for n in (4, 16, 64)
    ]
    assert error[1] < 0.58 * error[0]
    assert error[2] < 0.58 * error[1]


def test_roulette_is_unbiased():
    # A finite number of bounces approaches the unlimited result from below, as 0.7^k.
    scene = luxel.Scene(cloud(150, radius=0.08), SKY, albedo=0.7)
    ids = range(25)
    full = luxel.bake(scene, ids, samples=256).luminance.mean()
    series = [luxel.bake(scene, ids, samples=256, max_bounces=k).luminance.mean() for k in (0, 1, 2, 8)]
    assert series == sorted(series)
    assert abs(series[-1] - full) < 0.01 * full
    assert series[0] < 0.9 * full


def test_texel_means_equal_independent_means():
    # Another seed is an independent estimate; standardised differences must look like noise.
    scene = luxel.Scene(cloud(100), (luxel.Sky(1.0), luxel.Sun((1, 1, 1), 1.0)))
    ids = np.arange(20, dtype=np.int32)
    a, b = (draw_paths(Baker(scene, TextureSpec(seed=k)).world, "latlong", 16, 100, ids) for k in (1, 2))
    clear = (a[2] == 100) & (b[2] == 100) & (a[1] > 1e-4) & (b[1] > 1e-4)
    z = (a[0] - b[0])[clear] / np.sqrt((a[1] + b[1])[clear] / 100)
    assert clear.sum() > 1000
    assert abs(z.mean()) < 4 / np.sqrt(clear.sum())
    assert 0.9 < z.std() < 1.1
