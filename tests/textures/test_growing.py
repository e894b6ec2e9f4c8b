"""Textures that are baked as they are needed are those of a bake."""

from __future__ import annotations

import numpy as np
import pytest

import luxel
from luxel.textures import growing
from luxel.textures.bake import Baker
from luxel.textures.growing import GrowingTextures
from luxel.textures.spec import TextureSpec
from tests.scenes import cloud

COUNT = 120


@pytest.mark.parametrize("mode", ["paper", "fast"])
def test_they_are_those_of_a_bake_and_made_once(mode: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = luxel.Scene(cloud(COUNT), model="shadows")
    spec = TextureSpec(8, 1, mode)  # type: ignore[arg-type]
    whole = luxel.bake(scene, texels=8, samples=1, mode=mode)  # type: ignore[arg-type]
    baked: list[int] = []
    plain = growing.bake_with

    def noting(baker: Baker, ids: np.ndarray, **options: object) -> object:
        baked.extend(ids.tolist())
        return plain(baker, ids, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(growing, "bake_with", noting)
    textures = GrowingTextures(Baker(scene, spec), threads=2)
    rng = np.random.default_rng(3)
    asked: set[int] = set()
    for size in (3, 40, 1, 90):
        before = textures.snapshot(textures.key)
        ids = rng.permutation(COUNT)[:size].astype(np.int32)
        textures.grow(ids)
        asked |= set(ids.tolist())
        table = textures.snapshot(textures.key)
        known = np.flatnonzero(table.slot >= 0)
        assert set(known.tolist()) == asked
        assert len(textures) == len(asked)
        np.testing.assert_array_equal(table.codes[table.slot[known]], whole.codes[known])
        kept = np.flatnonzero(before.slot >= 0)  # an older table is as it was
        np.testing.assert_array_equal(before.codes[before.slot[kept]], whole.codes[kept])
    assert sorted(baked) == sorted(asked)
    assert (textures.snapshot("another light").slot == -1).all()
