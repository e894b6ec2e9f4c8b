"""Laws of light transport that any sampler must keep: planes, penumbras, bounces, slits, symmetry, independent errors."""

import numpy as np
import pytest

import luxel
from luxel.textures.bake import Baker
from luxel.textures.spec import TextureSpec
from tests.scenes import cloud

SKY = (luxel.Sky(1.0),)


# A speck so low above a huge sphere that the horizon dips by less than a degree, and twenty of its radii above it.
ABOVE_A_PLANE = luxel.Particles([[0, 0, 0.5], [0, 0, -5000.0]], [0.025, 5000.0])


def rows_above_a_plane(scene, mode):
    """Row means of the speck's texture, and the mean over each row of its normals' cosine with the vertical."""
    luminance = Baker(scene, TextureSpec(mode=mode, samples=256)).luminance(np.zeros(1, np.int32))[0][0]
    polar = np.linspace(0, np.pi, 17)
    return luminance.mean(axis=1), np.diff(np.sin(polar)) / np.diff(polar)


@pytest.mark.parametrize("mode", ["paper", "fast"])
@pytest.mark.parametrize("albedo", [0.0, 0.7, 1.0])
def test_above_a_plane_half_is_sky_and_half_the_plane_s_reflection(mode, albedo):
    # The plane itself sees all of the sky, luminance 1, but for the speck's own share of (r/h)² = 1/400.
    got, cosine = rows_above_a_plane(luxel.Scene(ABOVE_A_PLANE, SKY, albedo=albedo), mode)
    expected = (1 + cosine) / 2 + albedo * (1 - cosine) / 2
    # Four standard errors of a row's 4096 samples of all or nothing.
    assert np.abs(got - expected).max() < 0.031
    assert abs((got - expected).mean()) < 0.008


@pytest.mark.parametrize("mode", ["paper", "fast"])
def test_sunlight_returns_from_a_plane(mode):
    # The sun at the zenith lights the plane to its level; a texel sees albedo · level of it in its half.
    scene = luxel.Scene(ABOVE_A_PLANE, (luxel.Sun((0, 0, 1), 0.8, 2.0),), albedo=0.5)
    got, cosine = rows_above_a_plane(scene, mode)
    expected = 0.8 * np.maximum(cosine, 0) + 0.5 * 0.8 * (1 - cosine) / 2
    assert np.abs(got - expected).max() < 0.02


@pytest.mark.parametrize("mode, tolerance", [("paper", 0.02), ("fast", 0.03)])
def test_penumbra_is_as_wide_as_the_sun(mode, tolerance):
    # Specks in a row below an occluder; the sun stands at the zenith. A speck sees two discs in the sky: the sun of
    # radius beta and the occluder of radius sigma, gamma apart. Full light beyond sigma + beta, none within sigma - beta.
    height, beta = 2.0, np.radians(4.0)
    x = np.linspace(0.75, 1.65, 46)
    row = np.stack([x, 0 * x, 0 * x], axis=1)
    positions = np.concatenate([row, [[0, 0, height]]])
    particles = luxel.Particles(positions, np.r_[np.full(len(x), 1e-3), 1.0])
    scene = luxel.Scene(particles, (luxel.Sun((0, 0, 1), 1.0, np.degrees(2 * beta)),), model="shadows")
    ids = np.arange(len(x), dtype=np.int32)
    got = Baker(scene, TextureSpec(mode=mode, samples=64)).luminance(ids)[0][:, 0].mean(axis=1)
    open_light = Baker(
        luxel.Scene(luxel.Particles([[0, 0, 0]], 1.0), scene.lights, model="shadows"), TextureSpec(samples=64)
    ).luminance(np.zeros(1, np.int32))[0][0, 0]
    share = got / open_light.mean()
    gamma = np.arctan2(x, height)
    sigma = np.arcsin(1 / np.hypot(x, height))
    lit, dark = gamma - sigma > 1.01 * beta, gamma - sigma < -1.01 * beta
    assert lit.sum() > 5
    assert dark.sum() > 5
    np.testing.assert_allclose(share[lit], 1, atol=tolerance)
    np.testing.assert_allclose(share[dark], 0, atol=tolerance)
    # In between: the visible share of the sun's disc, by summing over it.
    z = 1 - (1 - np.cos(beta)) * (np.arange(100) + 0.5)[:, None] / 100
    azimuth = 2 * np.pi * (np.arange(100) + 0.5) / 100
    sun = np.stack(
        [np.sqrt(1 - z**2) * np.cos(azimuth), 0 * z + np.sqrt(1 - z**2) * np.sin(azimuth), z + 0 * azimuth]
    )
    toward = np.stack([-x, 0 * x, 0 * x + height]) / np.hypot(x, height)
    expected = (np.einsum("aij,ak->kij", sun, toward) < np.cos(sigma)[:, None, None]).mean(axis=(1, 2))
    assert np.abs(share - expected).max() < 2.5 * tolerance


def test_luminance_is_a_power_series_in_the_albedo():
    # T(albedo) = sum of albedo^k T_k, and T_k knows nothing of the albedo.
    particles = cloud(150, seed=8, radius=0.07)
    ids = np.arange(24, dtype=np.int32)

    def mean(albedo, bounces, seed):
        scene = luxel.Scene(particles, (luxel.Sky(1.0), luxel.Sun((1, 1, 2), 1.0)), albedo=albedo)
        return Baker(scene, TextureSpec(samples=49, max_bounces=bounces, seed=seed)).luminance(ids)[0].mean()

    terms = {}
    for albedo in (0.5, 0.95):
        total = [mean(albedo, k, seed=1) for k in range(4)]
        terms[albedo] = np.diff([0.0, *total]) / albedo ** np.arange(4)
    # Fewer and fewer paths get so far at the lower albedo: four standard errors each.
    assert np.all(np.abs(terms[0.5] / terms[0.95] - 1) < [0.01, 0.03, 0.06, 0.11])
    series = terms[0.95]
    assert np.all(np.diff(series) < 0), "less and less of the light comes back"
    # The rest of the series at another albedo: between nothing and a geometric one of the last ratio seen.
    head = (0.6 ** np.arange(4) * series).sum()
    rest = 0.6**4 * series[3] / (1 - 0.6)
    assert head * 0.985 < mean(0.6, None, seed=2) < (head + rest) * 1.015


def test_without_albedo_interreflection_is_direct_light():
    particles = cloud(100, seed=5)
    lights = (luxel.Sky(1.0), luxel.Sun((1, 0, 1), 1.0))
    ids = np.arange(20, dtype=np.int32)
    black, shadows = (
        Baker(luxel.Scene(particles, lights, model=m, albedo=0.0), TextureSpec(samples=64, seed=s)).luminance(
            ids
        )[0]
        for s, m in enumerate(("interreflection", "shadows"))
    )
    assert abs((black - shadows).mean()) < 0.003
    assert np.sqrt(((black - shadows) ** 2).mean()) < 0.1


def slit(gap, depth, length=24):
    """Two walls of overlapping spheres that face each other across `gap`, closed below, open above."""
    y, z = np.meshgrid(np.arange(length), np.arange(-depth, 1), indexing="ij")
    wall = np.stack([0 * y.ravel(), y.ravel(), z.ravel()], axis=1).astype(float)
    offset = 0.55 + gap / 2
    walls = [wall + np.array([sign * (offset + layer), 0, 0]) for sign in (-1, 1) for layer in (0, 1)]
    floor_x = np.arange(-round(offset) - 1, round(offset) + 2)
    x, y = np.meshgrid(floor_x, np.arange(length), indexing="ij")
    floor = np.stack([x.ravel(), y.ravel(), 0 * x.ravel() - depth - 1], axis=1).astype(float)
    positions = np.concatenate([*walls, floor])
    return luxel.Particles(positions, 0.55), np.arange(len(wall)), wall


def test_a_narrow_slit_stays_lit():
    particles, left, where = slit(0.3, 9)
    scene = luxel.Scene(particles, SKY)
    for low, high in ((-4, -3), (-7, -6)):
        deep = left[(where[:, 2] >= low) & (where[:, 2] <= high) & (np.abs(where[:, 1] - 11.5) < 6)].astype(
            np.int32
        )
        # The sixteen texels that look straight across the gap, towards +x.
        across = np.s_[:, 6:10, [14, 15, 0, 1]]
        truth = Baker(scene, TextureSpec(samples=225, seed=3)).luminance(deep)[0][across]
        fast = Baker(scene, TextureSpec(samples=4, mode="fast")).luminance(deep)[0][across]
        assert 0.001 < truth.mean() < 0.05, "a slit that is barely open"
        assert fast.mean() == pytest.approx(truth.mean(), rel=0.35)
        assert (fast.mean(axis=(1, 2)) > 0).all(), "nobody in the slit is black"


def test_a_quarter_turn_permutes_the_columns_of_fast_textures():
    base = cloud(120, seed=3, radius=0.09)
    lights = (luxel.Sky(1.0), luxel.Sun((2, 1, 2), 1.0))
    turned = luxel.Particles(
        np.stack([-base.positions[:, 1], base.positions[:, 0], base.positions[:, 2]], 1), base.radii
    )
    spec = TextureSpec(samples=9, mode="fast")
    ids = np.arange(24, dtype=np.int32)
    plain = Baker(luxel.Scene(base, lights), spec).luminance(ids)[0]
    other = Baker(luxel.Scene(turned, (luxel.Sky(1.0), luxel.Sun((-1, 2, 2), 1.0))), spec).luminance(ids)[0]
    right, wrong = np.roll(other, -4, axis=2) - plain, np.roll(other, 4, axis=2) - plain
    assert abs(right.mean()) < 0.01
    assert np.sqrt((right**2).mean()) < 0.2
    assert np.sqrt((right**2).mean()) < 0.5 * np.sqrt((wrong**2).mean())


def test_scaling_changes_no_bit_of_a_fast_texture():
    base = cloud(120, spread=1.0)
    lights = (luxel.Sky(1.0), luxel.Sun((1, 1, 2), 1.0))
    codes = [
        luxel.bake(
            luxel.Scene(luxel.Particles(base.local * np.float32(s), base.radii * np.float32(s)), lights),
            range(12),
            samples=4,
            mode="fast",
        ).codes
        for s in (1.0, 2.0**-60, 2.0**50)
    ]
    assert np.array_equal(codes[1], codes[0])
    assert np.array_equal(codes[2], codes[0])


def clusters(edge):
    """Copies of one small cluster, far apart on a square lattice: identical neighbourhoods. Ids of the first of each."""
    cluster = np.array([[0, 0, 0], [0.9, 0.2, 0.3], [-0.3, 0.8, -0.4]])
    y, x = np.meshgrid(np.arange(edge), np.arange(edge), indexing="ij")
    corner = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1) * 64.0
    positions = (corner[:, None] + cluster).reshape(-1, 3)
    return luxel.Particles(positions, 0.5), np.arange(0, len(positions), 3, dtype=np.int32)


def layer(edge):
    """Touching spheres in one layer; the rim is wide enough that with a reach of 3 all inner ones see the same."""
    y, x = np.meshgrid(np.arange(edge + 8), np.arange(edge + 8), indexing="ij")
    positions = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1).astype(float)
    inner = ((x >= 4) & (x < edge + 4) & (y >= 4) & (y < edge + 4)).ravel()
    return luxel.Particles(positions, 0.499), np.flatnonzero(inner).astype(np.int32)


@pytest.mark.parametrize("mode", ["paper", "fast"])
@pytest.mark.parametrize("kind", ["layer", "clusters"])
def test_errors_of_identical_neighbours_are_independent(mode, kind):
    # Identical surroundings and a shared set of rays would give every particle the same error: a pattern, not noise.
    edge = 10
    if kind == "layer":
        particles, ids = layer(edge)
        scene = luxel.Scene(particles, SKY, model="ao", ao_distance=3.0)
    else:
        particles, ids = clusters(edge)
        scene = luxel.Scene(particles, (luxel.Sky(1.0), luxel.Sun((1, 1, 2), 2.0)))
    truth = Baker(scene, TextureSpec(mode="paper", samples=1024, seed=5)).luminance(ids[:4])[0].mean(axis=0)
    found = []  # a hundred textures alone give each of these a standard deviation of 0.045
    for seed in range(4):
        luminance = Baker(scene, TextureSpec(mode=mode, samples=4, seed=seed)).luminance(ids)[0]
        error = (luminance - luminance.mean(axis=0)).reshape(edge, edge, -1)
        pairs = (error[1:], error[:-1]), (error[:, 1:], error[:, :-1])
        found.append([(a * b).sum() / np.sqrt((a**2).sum() * (b**2).sum()) for a, b in pairs])
    assert (np.abs(np.mean(found, axis=0)) < 0.08).all()
    if mode == "paper":
        # Independent errors average out: the mean of a hundred textures is ten times closer to the truth.
        single = np.sqrt(((luminance - truth) ** 2).mean())
        assert np.sqrt(((luminance.mean(axis=0) - truth) ** 2).mean()) < 0.25 * single
