"""Sums of light become pixels: sixteen at a time as by the formulas, one by one."""

import numpy as np
import pytest

import luxel
from luxel.kernels.tone import develop, develop_rows
from luxel.picture.drawing import NONE_BLANK, make_tone
from luxel.scene.colormap import linear_to_srgb

RAYS = 9


def sums(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """Sums of pixels with none to nine hits, dark to far too bright, some black."""
    hits = rng.integers(0, RAYS + 1, (height, width)).astype(np.float32)
    light = np.exp(rng.uniform(-9, 4, (height, width))) * (rng.random((height, width)) > 0.1) * hits
    total = np.empty((height, width, 5), np.float32)
    total[..., :3] = rng.random((height, width, 3)) * light[..., None]
    total[..., 3], total[..., 4] = light, hits
    return total


@pytest.mark.parametrize(
    "lights", [(luxel.Sky(1.0),), (luxel.Sky(1.0), luxel.Sun((0, 0, 1), 3.0))], ids=["sky", "sun"]
)
@pytest.mark.parametrize("size", [(1, 1), (5, 7), (16, 32), (9, 41)])
def test_pixels_follow_the_formulas(size: tuple[int, int], lights: tuple[luxel.Sky | luxel.Sun, ...]) -> None:
    rng = np.random.default_rng(size[0])
    scene = luxel.Scene(luxel.Particles([[0, 0, 0]], 1.0), lights)
    tone = make_tone(scene, luxel.View(background="#204060"), grading=None)
    total = sums(rng, *size)
    linear = np.empty((*size, 3), np.float32)
    develop(total, RAYS, tone.exposure, tone.white, tone.top, linear)
    expected = linear_to_srgb(np.clip(linear, 0, 1)) * 255
    found = np.empty((*size, 3), np.uint8)
    develop_rows(total, NONE_BLANK, RAYS, tone, 0, size[0], found)
    # Rounded to the nearest level, but for what rounding of sums turns.
    assert np.abs(found - expected).max() <= 0.51


def test_what_is_blank_is_not_read() -> None:
    height, width = 24, 44
    rng = np.random.default_rng(0)
    tone = make_tone(luxel.Scene(luxel.Particles([[0, 0, 0]], 1.0)), luxel.View(), (1.2, 0.5))
    blank = (rng.random((3, 6)) < 0.5).astype(np.uint8)
    total = sums(rng, height, width)
    hidden = np.repeat(np.repeat(blank, 8, 0), 8, 1)[:height, :width] != 0
    empty = total.copy()
    empty[hidden] = 0
    expected, found = (np.empty((height, width, 3), np.uint8) for _ in range(2))
    develop_rows(empty, NONE_BLANK, RAYS, tone, 0, height, expected)
    total[hidden] = np.nan
    develop_rows(total, blank, RAYS, tone, 0, height, found)
    np.testing.assert_array_equal(found, expected)
    assert hidden.any()
    assert not hidden.all()
    # Rows by themselves are those of the whole.
    develop_rows(total, blank, RAYS, tone, 3, 13, alone := np.zeros_like(found))
    np.testing.assert_array_equal(alone[3:13], expected[3:13])
