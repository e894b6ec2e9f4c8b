"""Codecs against closed forms and plain implementations."""

import numpy as np
import pytest

from luxel.textures import codecs
from luxel.textures.codecs import Distortion, IncrementalPCA, VQCodec
from luxel.textures.codecs.clustered import CENTER_UNIT
from luxel.textures.codecs.linear import fraction_bits
from tests.textures.codecs.test_contract import bake


def textures(count=1500, seed=0):
    """Smooth random textures (n, 16, 16): what light looks like."""
    rng = np.random.default_rng(seed)
    v, u = np.meshgrid(np.linspace(0, np.pi, 16), np.linspace(0, 2 * np.pi, 16), indexing="ij")
    shapes = np.stack(
        [np.ones_like(u), np.cos(v), np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), np.cos(2 * v)]
    )
    weights = rng.normal(size=(count, 5)) * [25, 20, 14, 12, 6] + [120, 10, 0, 0, 0]
    noise = rng.normal(size=(count, 16, 16)) * 3
    return np.clip(np.tensordot(weights, shapes, 1) + noise, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("components", [1, 4, 12])
def test_the_error_of_pca_is_the_sum_of_dropped_eigenvalues(components):
    codes = textures()
    flat = codes.reshape(len(codes), -1).astype(float)
    values = np.linalg.eigvalsh(np.cov(flat.T, bias=True))[::-1]
    codec = codecs.train("pca", codes, components=components)
    found = ((codec.decode(codec.encode(codes)).reshape(flat.shape) - flat) ** 2).sum(axis=1).mean()
    exact = values[components:].sum()
    # What 8 bits add: coefficients to a 255th of their range, codes to whole numbers.
    assert exact * 0.98 < found < exact * 1.02 + 256 / 12 + values[:components].sum() * 2e-3


def test_a_texture_s_codeword_is_the_nearest():
    codes = textures()
    codec = codecs.train("vq", codes, codewords=97)
    book = codec.codebook.reshape(97, -1).astype(np.int64)
    flat = codes.reshape(len(codes), -1).astype(np.int64)
    distance = ((flat[:, None] - book[None]) ** 2).sum(axis=2)
    chosen = codec.indices(codes.reshape(len(codes), -1))
    assert np.array_equal(distance[np.arange(len(codes)), chosen], distance.min(axis=1))


def test_exact_merging_is_that_of_the_paper():
    """Merge the pair whose union costs least, centroids weighted by members, until so many are left (paper 3.3)."""
    codes = textures(60, seed=5)
    codec = VQCodec.train(codes, codewords=12, exact=True)
    centers = [row.astype(float) for row in codes.reshape(60, -1)]
    members = [1] * 60
    while len(centers) > 12:
        best = min(
            (
                members[a] * members[b] / (members[a] + members[b]) * ((centers[a] - centers[b]) ** 2).sum(),
                a,
                b,
            )
            for a in range(len(centers))
            for b in range(a)
        )
        _, a, b = best
        total = members[a] + members[b]
        centers[b] = (members[a] * centers[a] + members[b] * centers[b]) / total
        members[b] = total
        del centers[a], members[a]
    expected = np.array(sorted(np.rint(c).astype(int).tolist() for c in centers))
    found = np.array(sorted(codec.codebook.reshape(12, -1).astype(int).tolist()))
    assert np.abs(expected - found).max() <= 1


@pytest.mark.parametrize("codewords", [40, 300])
def test_fast_merging_is_as_good_as_exact_merging(codewords):
    codes = textures(3000, seed=2)
    exact, fast = (
        Distortion.of(VQCodec.train(codes, codewords=codewords, exact=how), codes).d for how in (True, False)
    )
    assert fast < 1.05 * exact


@pytest.mark.parametrize("ratio", [16, 32])
def test_clustered_pca_beats_both_at_equal_bytes(ratio):
    codes = np.concatenate([bake()[1].codes, textures(3000)])
    d = {
        kind: Distortion.of(codecs.train(kind, codes, ratio=ratio), codes).d for kind in ("vq", "pca", "cpca")
    }
    assert d["cpca"] < min(d["vq"], d["pca"])


@pytest.mark.parametrize("payload_bytes, clusters", [(8, 6), (3, 1), (40, 4)])
def test_clustered_records_mean_what_their_description_says(payload_bytes, clusters):
    codes = bake()[1].codes
    codec = codecs.train("cpca", codes, payload_bytes=payload_bytes, clusters=clusters)
    payload = codec.encode(codes[:40])
    first = np.concatenate([[0], np.cumsum(codec.count, dtype=int)])
    steps = 2.0 ** -fraction_bits(codec.texels)
    for record, found in zip(payload, codec.decode(payload), strict=True):
        cluster = int(record[0]) if clusters > 1 else 0
        bits = np.unpackbits(record, bitorder="little")
        at = 8 * (clusters > 1)
        value = codec.center[cluster] * CENTER_UNIT
        for k in range(first[cluster], first[cluster + 1]):
            width = int(codec.width[k])
            symbol = int(bits[at : at + width] @ (1 << np.arange(width)))
            step = np.rint(codec.scale[k] * codec.levels[2**width - 2 + symbol])
            value = value + float(step) * codec.basis[k] * steps
            at += width
        assert np.array_equal(found.ravel(), np.clip(np.floor(value + 0.5), 0, 255))


def test_pca_of_textures_that_arrive_bit_by_bit():
    codes = textures()
    bitwise = IncrementalPCA()
    for k in range(0, len(codes), 130):
        bitwise.partial_fit(codes[k : k + 130])
    assert bitwise.count == len(codes)
    first, second = bitwise.codec(6), codecs.train("pca", codes, components=6)
    assert np.array_equal(first.offset, second.offset)
    assert np.array_equal(first.basis, second.basis)


def test_harmonics_give_low_orders_back():
    codec = codecs.train("sh", textures(), degree=2)
    v, u = np.meshgrid(
        np.pi * (np.arange(16) + 0.5) / 16, 2 * np.pi * (np.arange(16) + 0.5) / 16, indexing="ij"
    )
    light = 120 + 60 * np.cos(v) + 30 * np.sin(v) * np.cos(u)
    codes = light.round().astype(np.uint8)[None]
    assert np.abs(codec.decode(codec.encode(codes)).astype(int) - codes).max() <= 8


def test_distortion_is_the_paper_s():
    a = np.zeros((2, 4, 4), np.uint8)
    b = a.copy()
    b[0, 1, 2] = 3
    b[1, :, :] = 1
    found = Distortion.between(a, b)
    assert found.d == (9 + 16) / 2
    assert found.root_d == pytest.approx(((9 + 16) / 2) ** 0.5)
    assert found.rmse == pytest.approx(((9 + 16) / 32) ** 0.5)
    assert Distortion.between(a, a).psnr == np.inf
