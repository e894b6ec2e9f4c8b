"""Whole textures against Embree: the same estimator with another tracer, an independent error bar on all of paper mode."""

import numpy as np
import pytest

import luxel
from luxel.textures.bake import Baker
from luxel.textures.spec import TextureSpec
from tests.embree_light import EmbreeBaker
from tests.scenes import cloud, lattice

SUNNY = (luxel.Sky(1.0), luxel.Sun((-1, -1, 2), 2.0, 15.0))


@pytest.mark.parametrize("model", ["ao", "interreflection"])
@pytest.mark.parametrize(
    "particles", [lattice(5), cloud(150, radius=0.07, spread=1.2)], ids=["lattice", "cloud"]
)
def test_paper_mode_equals_embree(model, particles):
    scene = luxel.Scene(particles, SUNNY, model=model)
    ids = np.arange(0, len(particles), 4, dtype=np.int32)
    samples = 100
    total, _, _ = EmbreeBaker(scene, seed=3).sample(ids, samples)
    ours = Baker(scene, TextureSpec(samples=samples, seed=4)).luminance(ids)[0]
    again, _, _ = EmbreeBaker(scene, seed=5).sample(ids, samples)
    theirs, other = total / samples, again / samples
    # Three independent estimates: ours may differ from Embree's by no more than Embree's from each other's.
    noise = np.sqrt(((theirs - other) ** 2).mean())
    assert 0.01 < noise < 0.15
    assert np.sqrt(((ours - theirs) ** 2).mean()) < 1.1 * noise
    assert abs((ours - 0.5 * (theirs + other)).mean()) < 5 * noise / np.sqrt(theirs.size) + 0.001
