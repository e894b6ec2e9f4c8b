"""What every codec promises."""

import json
from functools import lru_cache

import numpy as np
import pytest

import luxel
from luxel.errors import InputError, LuxelError
from luxel.kernels.lookup import read_codes
from luxel.textures import codecs
from luxel.textures.codecs import Distortion
from luxel.textures.compressed import CompressedTextures
from tests.scenes import cloud

COUNT = 700
RECIPES = {
    "raw": {},
    "vq": {"codewords": 60},
    "pca": {"components": 8},
    "cpca": {"payload_bytes": 8},
    "sh": {"degree": 3},
}


@lru_cache(maxsize=1)
def bake():
    particles = cloud(COUNT, radius=0.03, spread=0.3)
    scene = luxel.Scene(particles, (luxel.Sky(1.0), luxel.Sun((1, 1, 2), 2.0, 15.0)))
    return scene, luxel.bake(scene, samples=1, mode="fast")


@lru_cache(maxsize=8)
def trained(kind):
    return codecs.train(kind, bake()[1].codes, seed=3, **RECIPES[kind])


@pytest.fixture(params=list(RECIPES))
def kind(request):
    return request.param


def test_all_kinds_are_here():
    assert set(RECIPES) == set(codecs.KINDS)


def test_a_record_a_texture(kind):
    codec, codes = trained(kind), bake()[1].codes
    payload = codec.encode(codes)
    assert payload.shape == (COUNT, codec.payload_bytes)
    assert payload.dtype == np.uint8
    decoded = codec.decode(payload)
    assert decoded.shape == codes.shape
    assert decoded.dtype == np.uint8
    spread = ((codes - codes.mean(axis=0)) ** 2).mean()
    error = ((decoded.astype(float) - codes) ** 2).mean()
    assert error == 0 if kind == "raw" else 0 < error < 0.5 * spread


def test_records_do_not_depend_on_the_batch(kind):
    codec, codes = trained(kind), bake()[1].codes
    payload = codec.encode(codes)
    some = [5, 699, 5, 17]
    assert np.array_equal(codec.encode(codes[some]), payload[some])
    assert np.array_equal(codec.decode(payload[some]), codec.decode(payload)[some])
    assert codec.encode(codes[:0]).shape == (0, codec.payload_bytes)
    assert codec.decode(payload[:0]).shape == (0, 16, 16)


def test_training_is_repeatable_and_takes_blocks(kind):
    codes = bake()[1].codes
    again = codecs.train(kind, iter([codes[:300], codes[300:]]), seed=3, **RECIPES[kind])
    first = trained(kind)
    assert again.describe() == first.describe()
    for name, array in first.shared.items():
        assert np.array_equal(again.shared[name], array)


def test_restored_codecs_are_the_same(kind):
    codec, codes = trained(kind), bake()[1].codes
    description = json.loads(json.dumps(codec.describe()))
    again = codecs.restore(description, {name: array.copy() for name, array in codec.shared.items()})
    assert np.array_equal(again.encode(codes), codec.encode(codes))
    assert np.array_equal(again.decode(codec.encode(codes)), codec.decode(codec.encode(codes)))
    assert again.shared_bytes == codec.shared_bytes == sum(a.nbytes for a in codec.shared.values())
    assert again.payload_bytes == codec.payload_bytes


def test_lookups_give_what_decoding_gives(kind):
    codec, codes = trained(kind), bake()[1].codes
    payload = codec.encode(codes)
    seen = np.empty_like(codes)
    read_codes(codec.lookup(payload), seen)
    assert np.array_equal(seen, codec.decode(payload))


@pytest.mark.parametrize("kind, targets", [
    *(("pca", {"components": n}) for n in (1, 3, 7, 9, 16, 21)),
    *(("cpca", {"payload_bytes": n, "clusters": k}) for n, k in ((2, 5), (3, 1), (11, 2), (60, 3))),
])  # fmt: skip
@pytest.mark.parametrize("count", [1, 3, COUNT])
def test_lookups_read_records_of_any_size_to_the_last(kind, targets, count):
    codes = bake()[1].codes
    codec = codecs.train(kind, codes, **targets)
    payload = codec.encode(codes)[-count:].copy()
    seen = np.empty_like(codes[:count])
    read_codes(codec.lookup(payload), seen)
    assert np.array_equal(seen, codec.decode(payload))
    assert np.array_equal(seen, codec.decode(codec.encode(codes))[-count:])


def test_pictures_from_records_are_pictures_from_decoded_textures(kind):
    scene, textures = bake()
    compressed = CompressedTextures.of(textures, trained(kind))
    decoded = luxel.LuminanceTextures(
        textures.ids,
        trained(kind).decode(compressed.payload),
        textures.scale,
        textures.encoding,
        textures.count,
        textures.key,
    )
    pictures = [luxel.render(scene, textures=t, size=(64, 48), antialias=1) for t in (compressed, decoded)]
    assert np.array_equal(pictures[0].pixels, pictures[1].pixels)
    assert compressed.nbytes == COUNT * trained(kind).payload_bytes + trained(kind).shared_bytes
    assert (compressed.snapshot("another key").slot == -1).all()


@pytest.mark.parametrize("ratio", [4, 16])
@pytest.mark.parametrize("kind", ["vq", "pca", "cpca", "sh"])
def test_a_ratio_is_kept(kind, ratio):
    codes = np.tile(bake()[1].codes, (8, 1, 1))
    codes[COUNT:] ^= np.random.default_rng(1).integers(0, 4, codes[COUNT:].shape, dtype=np.uint8)
    codec = codecs.train(kind, codes, ratio=ratio)
    found = Distortion.of(codec, codes)
    assert ratio <= found.ratio < 1.6 * ratio
    assert found.ratio == codes.nbytes / (len(codes) * codec.payload_bytes + codec.shared_bytes)


@pytest.mark.parametrize("kind", ["vq", "pca", "cpca"])
def test_an_error_is_kept(kind):
    codes = bake()[1].codes
    codec = codecs.train(kind, codes, error=12.0)
    rmse = Distortion.of(codec, codes).rmse
    assert 3.0 < rmse <= 12.0 * 1.02


def test_lies_are_refused(kind):
    codec = trained(kind)
    description, shared = codec.describe(), codec.shared
    for bad in ({}, {"kind": "zip"}, {"kind": 3}, [], {**description, "texels": -1}):
        with pytest.raises(LuxelError):
            codecs.restore(bad, shared)
    for name, array in shared.items():
        missing = {k: v for k, v in shared.items() if k != name}
        with pytest.raises(InputError, match=name):
            codecs.restore(description, missing)
        for wrong in (array[..., :-1], array.astype(np.complex64), array.reshape(-1)[:0], array[None]):
            with pytest.raises(LuxelError):
                codecs.restore(description, {**shared, name: wrong})


def test_bad_textures_and_records(kind):
    codec, codes = trained(kind), bake()[1].codes
    for bad in (codes[0], codes[:, :8], codes.astype(np.float32)):
        with pytest.raises(InputError):
            codec.encode(bad)
    payload = codec.encode(codes)
    for bad in (payload[0], payload[:, :-1], payload.astype(np.int16)):
        with pytest.raises(InputError):
            codec.decode(bad)


@pytest.mark.parametrize(
    "kind, targets",
    [
        ("zip", {}),
        ("vq", {}),
        ("vq", {"ratio": 4, "error": 3}),
        ("vq", {"ratio": -1}),
        ("pca", {"ratio": 1e6}),
        ("pca", {"codewords": 3}),
        ("cpca", {"ratio": 1e6}),
        ("sh", {"error": 1.0}),
    ],
)
def test_what_cannot_be_trained(kind, targets):
    with pytest.raises(LuxelError):
        codecs.train(kind, bake()[1].codes, **targets)
