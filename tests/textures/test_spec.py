"""The light key names exactly what light depends on."""

import numpy as np
import pytest

import luxel
from luxel.errors import InputError
from luxel.textures.spec import TextureSpec, light_key
from tests.scenes import cloud


def test_sample_counts_that_are_no_square_name_the_nearest_two():
    with pytest.raises(InputError, match="the nearest squares are 25 and 36"):
        TextureSpec(samples=30)


@pytest.mark.parametrize(
    "bad",
    [
        {"texels": 15},
        {"texels": 2},
        {"samples": 0},
        {"mode": "quick"},
        {"seed": -1},
        {"max_bounces": -1},
        {"mapping": "cube"},
    ],
)
def test_bad_specs(bad):
    with pytest.raises(InputError):
        TextureSpec(**bad)


def test_key_changes_with_light_and_never_with_colours():
    base = cloud(20)
    scene = luxel.Scene(base)
    key = light_key(scene, TextureSpec())
    recoloured = luxel.Particles(base.local, base.radii, {"other": np.zeros(20)}, time=3.0)
    assert light_key(luxel.Scene(recoloured), TextureSpec()) == key
    different = [
        light_key(luxel.Scene(luxel.Particles(base.local + np.float32(1), base.radii)), TextureSpec()),
        light_key(luxel.Scene(luxel.Particles(base.local, base.radii * 1.01)), TextureSpec()),
        light_key(scene.with_changes(model="ao"), TextureSpec()),
        light_key(scene.with_changes(albedo=0.5), TextureSpec()),
        light_key(scene.with_changes(lights=(luxel.Sky(1.0),)), TextureSpec()),
        light_key(scene.with_changes(lights=(luxel.Sky(1.0), luxel.Sun((0, 0, 1)))), TextureSpec()),
        light_key(scene, TextureSpec(seed=1)),
        light_key(scene, TextureSpec(samples=25)),
        light_key(scene, TextureSpec(mode="fast")),
        light_key(scene, TextureSpec(mapping="octahedral")),
    ]
    assert len({key, *different}) == len(different) + 1
