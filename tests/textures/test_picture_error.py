"""What compression does to a picture is less than what is recorded of it."""

from __future__ import annotations

import numpy as np
import pytest

import luxel
from luxel.textures import codecs
from luxel.textures.codecs import Distortion
from luxel.textures.compressed import CompressedTextures
from tests.scenes import cloud


@pytest.fixture(scope="module")
def scene():
    return luxel.Scene(
        cloud(1500, radius=0.05), [luxel.Sky(1.0), luxel.Sun((1, 1, 2), level=2.0, angular_diameter=15)]
    )


@pytest.fixture(scope="module")
def baked(scene):
    return luxel.bake(scene, samples=2, mode="fast")


@pytest.mark.parametrize("kind", ["vq", "pca", "cpca"])
def test_a_picture_errs_by_less_than_its_textures(scene, baked, kind):
    codec = codecs.train(kind, baked.codes, ratio=16)
    recorded = Distortion.of(codec, baked.codes, codec.encode(baked.codes))
    assert recorded.rmse > 1  # there is something to see
    view = luxel.View(color="white")
    raw, small = (
        luxel.render(scene, view, textures=textures, size=(300, 240), antialias=1)
        for textures in (baked, CompressedTextures.of(baked, codec))
    )
    np.testing.assert_array_equal(raw.ids, small.ids)
    covered = raw.ids >= 0
    difference = raw.pixels[covered].astype(float) - small.pixels[covered].astype(float)
    assert 0 < np.sqrt((difference**2).mean()) < recorded.rmse
