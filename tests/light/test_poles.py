"""Near the poles of a latitude-longitude map, textures of fast mode are no finer and no noisier than elsewhere."""

import numpy as np
import pytest

import luxel
from luxel.light.mapping import Mapping
from luxel.light.poles import smooth_poles
from luxel.light.sampling import draw_paths
from luxel.textures.bake import Baker
from luxel.textures.spec import TextureSpec
from tests.scenes import lattice

AZIMUTH = 2 * np.pi * (np.arange(16) + 0.5) / 16


def rows_of(pattern, texels: int = 16) -> np.ndarray:
    return np.tile(np.asarray(pattern, np.float32), (1, texels, 1))


def smoothed(textures: np.ndarray, mapping: Mapping = "latlong") -> np.ndarray:
    found = textures.copy()
    smooth_poles(found, mapping)
    return found


@pytest.mark.parametrize("pattern", [np.ones(16), 2 + np.cos(AZIMUTH), 2 + np.sin(AZIMUTH - 0.4)])
def test_what_a_lamp_from_the_side_does_to_a_pole_stays(pattern):
    textures = rows_of(pattern)
    np.testing.assert_allclose(smoothed(textures), textures, atol=1e-5)


@pytest.mark.parametrize("harmonic", [2, 3, 5, 8])
def test_what_texels_of_the_equator_could_not_show_goes(harmonic):
    textures = rows_of(2 + np.cos(harmonic * (AZIMUTH - 0.2)))
    left = np.ptp(smoothed(textures)[0], axis=1) / np.ptp(textures[0], axis=1)
    assert left[0] < 1e-5
    assert (np.diff(left[:6]) > -1e-4).all()
    np.testing.assert_array_equal(left, left[::-1])
    np.testing.assert_array_equal(smoothed(textures)[0, 4:12], textures[0, 4:12])


def test_means_and_ranges_of_rows_are_kept():
    textures = np.random.default_rng(0).random((50, 16, 16)).astype(np.float32) ** 4
    found = smoothed(textures)
    assert (found.min(axis=2) >= textures.min(axis=2)).all()
    assert (found.max(axis=2) <= textures.max(axis=2)).all()
    # Only what would leave a row's range is not in its mean.
    np.testing.assert_allclose(found.mean(axis=2), textures.mean(axis=2), atol=0.02)


@pytest.mark.parametrize("texels", [1, 2, 4, 8, 32])
def test_maps_of_every_size(texels):
    textures = np.random.default_rng(0).random((3, texels, texels)).astype(np.float32)
    found = smoothed(textures)
    assert np.isfinite(found).all()
    assert (found != textures).any() == (texels > 2)


def test_other_maps_have_no_poles():
    textures = np.random.default_rng(0).random((3, 16, 16)).astype(np.float32)
    np.testing.assert_array_equal(smoothed(textures, "octahedral"), textures)


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
