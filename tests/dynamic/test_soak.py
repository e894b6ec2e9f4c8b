"""A short soak: the core of ``benchmarks.soak`` with real light on few particles."""

from __future__ import annotations

import threading

import pytest

from benchmarks.soak import soak
from luxel.dynamic.allotment import bytes_for
from luxel.textures.spec import TextureSpec
from tests.scenes import cloud

from .fakes import GUARD_S

SPEC = TextureSpec(mode="paper", samples=1, texels=8)


@pytest.mark.parametrize("driver", ["threads", "budget"])
def test_a_short_soak_leaves_nothing_behind(driver):
    before = set(threading.enumerate())
    series = [cloud(300, seed=seed) for seed in (1, 2)]
    found = soak(
        series,
        driver,
        seconds=GUARD_S,
        frames=80,
        textures=300,
        changes=5,
        served=1,
        size=(48, 48),
        spec=SPEC,
        max_bytes=bytes_for(200, 8, 300),
        rest=8,
    )
    assert found.frames >= 80
    assert found.textures >= 300
    assert found.evicted > 0
    assert found.witness.served > 0
    assert found.lights + found.steps >= 5
    assert found.errors == []
    assert found.bytes_over_budget == 0
    assert found.witness.worst <= 1
    assert set(threading.enumerate()) == before
