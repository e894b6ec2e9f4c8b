"""Parts of a picture are what the whole has there."""

from __future__ import annotations

import numpy as np
import pytest

import luxel
from luxel.errors import InputError
from luxel.kernels import frustum, tiles
from luxel.picture import bands
from luxel.picture.bands import draw_bands
from luxel.picture.drawing import id_at, make_eye, part_of, seen_tree
from luxel.scene.camera import Camera
from luxel.trace.spheres import SphereSet
from tests.scenes import cloud

SIZE = (120, 90)
SCENE = luxel.Scene(cloud(300, spread=0.5), model="shadows")


def looks() -> list[luxel.View]:
    bounds = SCENE.particles.bounds
    return [
        luxel.View(camera=Camera.framing(bounds, orthographic=flat), color_by="value")
        for flat in (False, True)
    ]


def ids(tree: object, eye: frustum.Eye, size: tuple[int, int], shift: tuple[float, float]) -> np.ndarray:
    found = np.empty(size[::-1], np.int32)
    distance = np.empty(size[::-1], np.float32)
    x, y = (np.float32(each + 0.5) for each in shift)
    tiles.primary_tiles(tree, eye, *size, x, y, 0, size[1], distance, found)
    return found


@pytest.mark.parametrize("look", looks(), ids=["perspective", "orthographic"])
def test_parts_show_what_the_whole_shows_there(look: luxel.View) -> None:
    tree = seen_tree(SCENE, look).arrays
    eye = make_eye(look.camera, SphereSet.of(SCENE.particles), SIZE[0] / SIZE[1])
    whole = ids(tree, eye, SIZE, (0.0, 0.0))
    assert (whole >= 0).mean() > 0.1
    for corner, part in [((0, 0), (120, 24)), ((0, 31), (120, 59)), ((17, 0), (40, 90)), ((50, 40), (9, 7))]:
        own, shift = part_of(eye, SIZE, corner, part)
        there = whole[corner[1] : corner[1] + part[1], corner[0] : corner[0] + part[0]]
        # Rounding may move a ray that grazes a sphere.
        assert (ids(tree, own, part, shift) == there).mean() > 0.998
    picked = [
        [id_at(tree, eye, SIZE, ((x + 0.5) / 120, (y + 0.5) / 90)) for x in range(120)] for y in range(90)
    ]
    assert (np.array(picked) == whole).mean() > 0.998
    assert id_at(tree, eye, SIZE, (1.0, 1.0)) == whole[-1, -1]


@pytest.mark.parametrize("look", looks(), ids=["perspective", "orthographic"])
@pytest.mark.parametrize("antialias", [1, 2, 3])
def test_bands_make_the_same_picture(
    look: luxel.View, antialias: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    textures = luxel.bake(SCENE, samples=1, texels=8)
    table = textures.snapshot(textures.key)
    options = {"size": SIZE, "antialias": antialias}
    whole = luxel.render(SCENE, look, textures, colorbar=False, **options).pixels
    np.testing.assert_array_equal(draw_bands(SCENE, look, table, **options), whole)
    monkeypatch.setattr(bands, "_BAND_BYTES", 20 * SIZE[0] * 40)  # two bands of 40 rows, one of 10
    told = []
    banded = draw_bands(SCENE, look, table, progress=lambda *now: told.append(now), **options)
    assert len({total for _, total in told}) == 1
    assert [done for done, _ in told] == sorted(done for done, _ in told)
    assert told[-1] == (told[-1][1], told[-1][1])
    assert len(told) == 3
    different = (banded != whole).any(-1)
    assert different.mean() < 0.002


def test_progress_can_end_it() -> None:
    class StopError(Exception):
        pass

    def stop(done: int, total: int) -> None:
        raise StopError

    textures = luxel.bake(SCENE, ids=[0], samples=1, texels=8)
    with pytest.raises(StopError):
        draw_bands(SCENE, luxel.View(), textures.snapshot(textures.key), SIZE, progress=stop)
    with pytest.raises(InputError, match="size"):
        draw_bands(SCENE, luxel.View(), textures.snapshot(textures.key), (0, 5))
