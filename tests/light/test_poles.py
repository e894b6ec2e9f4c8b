"""Near the poles of a latitude-longitude map, textures of fast mode are no finer and no noisier than elsewhere."""

import numpy as np
import pytest

import luxel
from luxel.light.poles import polar_rows, smooth_poles
from luxel.light.sampling import draw_paths
from luxel.textures.bake import Baker
from luxel.textures.spec import TextureSpec
from tests.scenes import lattice

AZIMUTH = 2 * np.pi * (np.arange(16) + 0.5) / 16


def rows_of(pattern) -> np.ndarray:
    return np.tile(np.asarray(pattern, np.float32), (1, 16, 1))


def smoothed(textures: np.ndarray, exposed: np.ndarray | None = None, share: float = 0.0) -> np.ndarray:
    found = textures.copy()
    seen = np.zeros(textures.shape, np.uint32) if exposed is None else exposed
    smooth_poles(found, polar_rows("latlong", textures.shape[1]), seen, share)
    return found


@pytest.mark.parametrize("pattern", [np.ones(16), 2 + np.cos(AZIMUTH), 2 + np.sin(AZIMUTH - 0.4)])
def test_what_a_lamp_from_the_side_does_to_a_pole_stays(pattern):
    textures = rows_of(pattern)
    np.testing.assert_allclose(smoothed(textures), textures, atol=1e-5)


@pytest.mark.parametrize(("harmonic", "left_at_the_pole"), [(2, 0.5), (3, 0), (5, 0), (8, 0)])
def test_what_texels_of_the_equator_could_not_show_goes(harmonic, left_at_the_pole):
    textures = rows_of(2 + np.cos(harmonic * (AZIMUTH - 0.2)))
    left = np.ptp(smoothed(textures)[0], axis=1) / np.ptp(textures[0], axis=1)
    assert left[0] == pytest.approx(left_at_the_pole, abs=1e-5)
    assert (np.diff(left[:6]) > -1e-4).all()
    np.testing.assert_array_equal(left, left[::-1])
    np.testing.assert_array_equal(smoothed(textures)[0, 4:12], textures[0, 4:12])


@pytest.mark.parametrize("power", [1, 40])
def test_means_and_ranges_of_rows_are_kept(power):
    textures = np.random.default_rng(0).random((50, 16, 16)).astype(np.float32) ** power
    textures[0], textures[1, :, 3], textures[2] = 0, 1, textures[2] > 0.5
    for rows in (textures, 1 - textures):
        found = smoothed(rows)
        assert (found.min(axis=2) >= rows.min(axis=2) - 1e-6).all()
        assert (found.max(axis=2) <= rows.max(axis=2) + 1e-6).all()
        np.testing.assert_allclose(found.mean(axis=2), rows.mean(axis=2), atol=1e-6)


@pytest.mark.parametrize("texels", [2, 4, 8, 32])
def test_maps_of_every_size(texels):
    textures = np.random.default_rng(0).random((3, texels, texels)).astype(np.float32)
    found = smoothed(textures)
    assert np.isfinite(found).all()
    assert (found != textures).any() == (texels > 2)


def test_other_maps_have_no_poles():
    assert len(polar_rows("octahedral", 16)) == 0


def test_rows_that_are_mostly_guessed_stay_as_they_are():
    textures = np.random.default_rng(0).random((1, 16, 16)).astype(np.float32)
    exposed = np.ones((1, 16, 16), np.uint32)
    exposed[0, 0, :5] = exposed[0, 1, :4] = 0
    found = smoothed(textures, exposed, 0.75)
    np.testing.assert_array_equal(found[0, 0], textures[0, 0])
    assert (found[0, 1] != textures[0, 1]).all()


def test_poles_in_penumbra_are_no_noisier_than_what_is_around():
    # Balls in a loose heap below a wide sun: nearly all of what is lit is in some penumbra.
    grid = lattice(8)
    moved = grid.positions + np.random.default_rng(3).normal(0, 0.15, grid.positions.shape)
    scene = luxel.Scene(luxel.Particles(moved, 0.32), (luxel.Sun((1, 1, 2), 1.0, 40.0),), albedo=0.0)
    ids = np.arange(len(moved), dtype=np.int32)
    found, _ = Baker(scene, TextureSpec(mode="fast", samples=1)).luminance(ids)
    truth = draw_paths(Baker(scene, TextureSpec(seed=5)).world, "latlong", 16, 256, ids)
    lit = (truth.exposed == 256) & (truth.mean > 0)
    error = np.where(lit, found - truth.mean, 0.0).astype(np.float64)

    def rmse(row: int) -> float:
        return float(np.sqrt((error[:, row] ** 2).sum() / lit[:, row].sum()))

    assert lit[:, 0].sum() > 1000
    assert max(rmse(0), rmse(1)) < rmse(4)


@pytest.mark.parametrize("model", ["lambertian", "interreflection"])
def test_poles_are_not_smoothed_where_that_costs_more_than_it_brings(model):
    # What a sun at the horizon does to a pole is a cosine cut off at 0, which has harmonics of its own; here there is next to no noise.
    particles = luxel.Particles(np.random.default_rng(1).random((80, 3)) * 40, 0.3)
    scene = luxel.Scene(particles, (luxel.Sun((1, 0, 0), 1.0, 5.0),), model=model, albedo=0.0)
    ids = np.arange(len(particles), dtype=np.int32)
    found, _ = Baker(scene, TextureSpec(mode="fast", samples=4)).luminance(ids)
    truth = draw_paths(Baker(scene, TextureSpec(seed=5)).world, "latlong", 16, 400, ids).mean
    error = np.sqrt(((found - truth) ** 2).mean(axis=(0, 2)))
    assert error[[0, 15]].max() < error[1:15].max()
    assert np.abs(found - truth)[:, 0].max() < 0.015
