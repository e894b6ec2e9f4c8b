"""The error that comes with every fast texture is honest: where it says more, there is more, and about as much."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import luxel
from benchmarks.scenes import plate
from luxel.light import fast
from luxel.light.mapping import texel_solid_angles
from luxel.light.sampling import draw_paths
from luxel.textures.bake import Baker
from luxel.textures.spec import TextureSpec


@pytest.fixture(scope="module")
def truth():
    """Two independent path-traced samplings of lit particles of a cracked plate."""
    scene = luxel.Scene(plate(12_000))
    ids = np.random.default_rng(8).permutation(len(scene.particles))[:1600].astype(np.int32)
    first = Baker(scene, TextureSpec(mode="fast")).first_light(ids)
    ids = ids[first[:, 0] > 0.05][:420]
    parts = [(seed, ids[k : k + 30]) for seed in (11, 12) for k in range(0, len(ids), 30)]
    worlds = {seed: Baker(scene, TextureSpec(seed=seed)).world for seed in (11, 12)}
    with ThreadPoolExecutor(2) as pool:
        drawn = list(pool.map(lambda p: draw_paths(worlds[p[0]], "latlong", 16, 9, p[1]), parts))
    half = len(parts) // 2
    first, second = (
        [np.concatenate([d[q] for d in half_of]) for q in (0, 2)] for half_of in (drawn[:half], drawn[half:])
    )
    return scene, ids, first, second


@pytest.mark.parametrize("samples", [1, 4])
def test_expected_errors_are_those_found(truth, samples):
    scene, ids, (a, seen_a), (b, seen_b) = truth
    assert len(ids) == 420
    luminance, expected = Baker(scene, TextureSpec(samples=samples, mode="fast")).luminance(ids)
    weights = texel_solid_angles("latlong", 16) * ((seen_a > 4) & (seen_b > 4))
    # The product of two differences: the truths' own noise is independent and cancels.
    found = ((luminance - a) * (luminance - b) * weights).sum(axis=(1, 2)) / weights.sum(axis=(1, 2))
    order = np.argsort(expected)
    ratios = []
    for part in np.array_split(order, 2):
        assert len(part) >= 200
        ratios.append(np.sqrt(found[part].mean() / (expected[part].astype(np.float64) ** 2).mean()))
    assert np.all(np.abs(np.array(ratios) - 1) < 0.25), ratios
    assert found[order[210:]].mean() > found[order[:210]].mean()


def test_filters_of_large_scenes_learn_from_more_and_err_less(truth, monkeypatch):
    scene, ids, (a, seen_a), (b, seen_b) = truth
    weights = texel_solid_angles("latlong", 16) * ((seen_a > 4) & (seen_b > 4))
    errors = []
    for each in (256, 12):  # of 12,000 particles, 512 and 1,000 textures to learn from
        monkeypatch.setattr(fast, "_PARTICLES_A_TRAINING_TEXTURE", each)
        luminance, _ = Baker(scene, TextureSpec(samples=4, mode="fast")).luminance(ids)
        errors.append(((luminance - a) * (luminance - b) * weights).sum() / weights.sum())
    assert errors[1] < 0.97 * errors[0]


def test_paper_errors_fall_as_samples_grow():
    scene = luxel.Scene(plate(4000))
    few, many = (luxel.bake(scene, range(0, 3600, 200), samples=n).errors for n in (4, 64))
    lit = few > 0.02
    assert lit.sum() > 5
    assert np.abs(few[lit] / many[lit] / 4 - 1).mean() < 0.25
