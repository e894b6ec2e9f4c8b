"""Compressed caches: more particles in the same budget, what frames decode is what everybody else gets, and the error is told."""

from __future__ import annotations

import numpy as np
import pytest

import luxel
from luxel.dynamic.allotment import bytes_for
from luxel.dynamic.cache import TextureCache
from luxel.dynamic.compressor import Compressor
from luxel.errors import InputError
from luxel.kernels.lookup import read_codes
from luxel.picture.frames import Frames
from luxel.session import Session
from luxel.textures.codecs import Distortion, IncrementalPCA
from luxel.textures.spec import TextureSpec
from tests.scenes import cloud

TEXELS, COMPONENTS = 8, 5


def textures(count: int, seed: int = 0, rank: int = COMPONENTS, noise: float = 1.0) -> np.ndarray:
    """Textures of so many dimensions, and some noise."""
    rng = np.random.default_rng(seed)
    basis = np.random.default_rng(99 + rank).normal(size=(rank, TEXELS**2))
    found = 128 + 12 * rng.normal(size=(count, rank)) @ basis / np.sqrt(rank)
    return np.clip(found + noise * rng.normal(size=found.shape), 0, 255).astype(np.uint8).reshape(-1, 8, 8)


def batches(codes: np.ndarray):
    """As an engine makes them: small at first."""
    start, size = 0, 16
    while start < len(codes):
        yield codes[start : start + size]
        start, size = start + size, min(256, 2 * size)


def rms(change) -> float:
    return float(np.sqrt(np.mean(np.square(np.asarray(change, float)))))


def test_what_comes_back_is_as_good_as_a_basis_learnt_from_everything():
    codes = textures(3000)
    compressor = Compressor(TEXELS, COMPONENTS)
    records = np.concatenate([compressor.pack("day", batch) for batch in batches(codes)])
    assert records.shape == (3000, 1 + COMPONENTS)
    back = compressor.unpack(records)
    error = rms(back.astype(float) - codes)
    assert compressor.error == pytest.approx(error, rel=1e-6)
    best = IncrementalPCA().partial_fit(codes).codec(COMPONENTS)
    assert error < 1.1 * Distortion.of(best, codes, best.encode(codes)).rmse
    # The first are no worse than the last: they are among those that the first basis is learnt from.
    assert rms(back[:16].astype(float) - codes[:16]) < 1.2 * error


def test_kernels_read_what_unpack_returns():
    codes = textures(1500, noise=8)
    compressor = Compressor(TEXELS, COMPONENTS)
    records = np.concatenate([compressor.pack("day", batch) for batch in batches(codes)])
    assert len(np.unique(records[:, 0])) > 2
    read = np.empty_like(codes)
    read_codes(compressor.lookup(records), read)
    assert (read == compressor.unpack(records)).all()


def test_bases_never_change_under_those_who_read_with_them():
    compressor = Compressor(TEXELS, COMPONENTS)
    first = compressor.pack("day", textures(40))
    table, before = compressor.lookup(first), compressor.unpack(first)
    for seed in range(1, 6):
        compressor.pack(f"light {seed}", textures(200, seed, rank=3 + seed))
    read = np.empty_like(before)
    read_codes(table, read)
    assert (read == before).all()
    assert (compressor.unpack(first) == before).all()


def test_another_light_gets_a_basis_of_its_own_and_two_may_take_turns():
    compressor = Compressor(TEXELS, COMPONENTS)
    sets = {"day": textures(2000, 1, rank=5), "night": textures(2000, 2, rank=4)}
    found = {key: [] for key in sets}
    for pair in zip(*(batches(codes) for codes in sets.values()), strict=True):
        for key, batch in zip(sets, pair, strict=True):
            found[key].append(compressor.pack(key, batch))
    for key, codes in sets.items():
        records = np.concatenate(found[key])
        assert rms(compressor.unpack(records).astype(float) - codes) < 2.5
    day, night = (set(np.concatenate(found[key])[:, 0].tolist()) for key in sets)
    assert not day & night
    assert max(day | night) < 20  # taking turns does not start learning anew


def test_bases_that_no_record_names_give_way():
    kept = [0, 3]
    compressor = Compressor(TEXELS, COMPONENTS, lambda: kept)
    first = [compressor.pack(f"light {turn}", textures(16, turn, rank=5)) for turn in range(4)]
    assert [records[0, 0] for records in first] == [0, 1, 2, 3]
    before = [compressor.unpack(records) for records in first]
    for turn in range(4, 400):
        codes = textures(16, turn, rank=2 + turn % 4)
        assert rms(compressor.unpack(compressor.pack(f"light {turn}", codes)).astype(float) - codes) < 2
    for k in kept:
        assert (compressor.unpack(first[k]) == before[k]).all()
    assert (compressor.unpack(first[1]) != before[1]).any()


def test_when_all_bases_are_used_up_the_last_stays_and_the_error_tells():
    compressor = Compressor(TEXELS, 1)
    for turn in range(140):
        compressor.pack(f"light {turn}", textures(16, turn, rank=2 + turn % 5))
    records = compressor.pack("one more", textures(16, 500, rank=5))
    assert records[0, 0] == 127
    assert compressor.error > 5


@pytest.mark.parametrize("components", [-1, 65])
def test_a_number_of_components_out_of_range_is_refused(components):
    with pytest.raises(InputError, match="components"):
        TextureCache(TEXELS, 1 << 20, components=components)


def test_a_compressed_cache_holds_many_more_and_keeps_its_budget():
    budget, count = 16 << 20, 400_000
    held = []
    for components in (0, 8):
        cache = TextureCache(16, budget, components=components)
        light = cache.begin("day", count, 1.0, "linear")
        ids = np.arange(0, 2000, dtype=np.int32)
        codes = np.repeat((ids % 251).astype(np.uint8), 256).reshape(-1, 16, 16)
        assert cache.publish(light, ids, codes).all()
        there, back, _ = cache.lookup("day", ids)
        assert there.all()
        assert np.abs(back.astype(int) - codes).max() <= (1 if components else 0)
        assert cache.stats().nbytes <= budget
        assert (cache.stats().error > 0) == bool(components)
        held.append(cache.capacity)
    assert held[1] > 3 * held[0]
    assert bytes_for(held[1], 16, count, 8) <= budget


def test_too_small_a_budget_names_one_that_is_enough():
    with pytest.raises(InputError, match="set max_bytes to") as told:
        TextureCache(16, 1 << 20, components=8).begin("day", 100, 1.0, "linear")
    needed = int(str(told.value).split("set max_bytes to ")[1].split()[0])
    assert TextureCache(16, needed, components=8).begin("day", 100, 1.0, "linear")
    with pytest.raises(InputError, match="set max_bytes to"):
        TextureCache(16, needed - 1, components=8).begin("day", 100, 1.0, "linear")


def test_frames_show_what_the_page_gets():
    """The picture from compressed textures is that of the textures that a page is sent."""
    scene = luxel.Scene(cloud(120))
    spec = TextureSpec(mode="paper", samples=4, texels=8)
    with (
        Session(scene, spec=spec, threads=0, components=6) as session,
        Frames(session, size=(60, 44), antialias=1, threads=1, bake_budget_s=0.05) as frames,
    ):
        *_, last = frames
        assert last.ready == last.visible > 10
        batch = session.tiles(np.arange(120))
        sent = luxel.LuminanceTextures(
            batch.ids, batch.codes, session.scale, session.encoding, 120, session.key
        )
        raw = luxel.bake(scene, samples=4, mode="paper", texels=8)
        change = batch.codes.astype(float) - raw.codes[batch.ids]
        assert 0 < rms(change) < 25
        assert session._cache.stats().error == pytest.approx(rms(change), rel=0.2)
        with Frames(scene, size=(60, 44), textures=sent, antialias=1, threads=1) as still:
            *_, expected = still
        assert (last.pixels == expected.pixels).all()
