"""Baking: one answer whatever the batch, order or threads; errors; the filter of fast mode."""

import _thread
import threading

import numpy as np
import pytest

import luxel
from luxel.errors import InputError
from luxel.light.fast import FastLight
from luxel.light.sampling import draw_paths
from luxel.textures.bake import Baker, bake_with
from luxel.textures.spec import TextureSpec
from luxel.textures.textures import decode, encode
from tests.scenes import cloud, lattice


@pytest.fixture(scope="module")
def scene():
    return luxel.Scene(cloud(150, seed=11))


@pytest.mark.parametrize("mode", ["paper", "fast"])
def test_a_texture_depends_on_nothing_but_its_key(scene, mode):
    everything = luxel.bake(scene, samples=4, mode=mode, threads=1)
    assert np.array_equal(luxel.bake(scene, samples=4, mode=mode, threads=5).codes, everything.codes)
    some = [77, 3, 149, 40]
    assert np.array_equal(luxel.bake(scene, some, samples=4, mode=mode).codes, everything.codes[some])
    assert np.array_equal(luxel.bake(scene, [7], samples=4, mode=mode).codes[0], everything.codes[7])


def test_what_a_bake_holds(scene):
    textures = luxel.bake(scene, [5, 2], samples=4)
    assert textures.ids.tolist() == [5, 2]
    assert textures.luminance.shape == (2, 16, 16)
    assert textures.luminance.dtype == np.float32
    assert textures.nbytes == 2 * 256
    table = textures.snapshot(textures.key)
    assert table.slot[[5, 2, 0]].tolist() == [0, 1, -1]
    assert (textures.snapshot("another key").slot == -1).all()


def test_no_ids_and_bad_ids(scene):
    assert len(luxel.bake(scene, [], samples=4).ids) == 0
    for bad in ([150], [-1], [0.5], "x", [[1]]):
        with pytest.raises(InputError):
            luxel.bake(scene, bad, samples=4)


def test_progress_counts_every_particle_once(scene):
    seen = []
    luxel.bake(scene, samples=1, progress=lambda done, total: seen.append((done, total)))
    assert seen[-1] == (150, 150)
    assert seen == sorted(seen)


@pytest.mark.parametrize("encoding", ["linear", "sqrt"])
def test_codes_round_trip_within_half_a_step(encoding):
    codes = np.arange(256, dtype=np.uint8)
    assert np.array_equal(encode(decode(codes, 3.4, encoding), 3.4, encoding)[0], codes)
    values = np.linspace(0, 3.4, 5000, dtype=np.float32)
    error = np.abs(decode(encode(values, 3.4, encoding)[0], 3.4, encoding) - values)
    step = np.diff(decode(codes, 3.4, encoding)).max()
    assert error.max() <= 0.51 * step
    codes, clipped = encode(np.float32([9.0, -1.0]), 3.4, encoding)
    assert (codes.tolist(), clipped) == ([255, 0], 1)


def test_clipped_texels_are_counted():
    # Inside a white bowl lit by a strong sun, bounces exceed the bound.
    shell = np.random.default_rng(0).normal(size=(1500, 3))
    shell /= np.linalg.norm(shell, axis=1)[:, None]
    shell = shell[shell[:, 2] < 0.3]
    scene = luxel.Scene(luxel.Particles(shell, 0.06), (luxel.Sun((0, 0, 1), 1.0, 5.0),), albedo=1.0)
    assert luxel.bake(scene, range(0, 900, 9), samples=4).clipped_count > 0


def test_fast_mode_has_the_error_of_many_more_samples():
    rng = np.random.default_rng(2)
    scene = luxel.Scene(
        luxel.Particles(rng.random((900, 3)) * [1, 1, 0.3], 0.03),
        (luxel.Sky(1.0), luxel.Sun((-1, -1, 2), 2.0)),
    )
    ids = np.arange(0, 900, 15, dtype=np.int32)
    truth, _, exposed = draw_paths(Baker(scene, TextureSpec(seed=5)).world, "latlong", 16, 324, ids)
    clear = exposed > 162

    def error(luminance):
        return float(np.sqrt(((luminance - truth)[clear] ** 2).mean()))

    filtered = error(Baker(scene, TextureSpec(samples=4, mode="fast")).luminance(ids)[0])
    raw = {n: error(Baker(scene, TextureSpec(samples=n)).luminance(ids)[0]) for n in (4, 16)}
    assert filtered < 0.6 * raw[4]
    assert filtered < raw[16]


def test_fast_mode_fills_buried_texels_instead_of_bleeding_black():
    # Two overlapping spheres under an open sky: the seam is bright, so nothing near it may be dark.
    scene = luxel.Scene(luxel.Particles([[0, 0, 0], [0.8, 0, 0]], 0.5), (luxel.Sky(1.0),))
    paper = luxel.bake(scene, samples=400).luminance[0]
    fast = luxel.bake(scene, samples=400, mode="fast").luminance[0]
    assert (paper == 0).sum() > 4
    assert fast.min() > 0.3


def test_bilinear_lookup_wraps_and_crosses_the_poles():
    from luxel.kernels.mapping import LATLONG
    from luxel.kernels.shade import bilinear

    rng = np.random.default_rng(3)
    codes = rng.integers(0, 256, (1, 16, 16)).astype(np.uint8)
    decoding = np.linspace(0, 1, 256, dtype=np.float32)

    def at(u, v):
        s = np.sin(np.pi * v)
        n = np.float32([s * np.cos(2 * np.pi * u), s * np.sin(2 * np.pi * u), np.cos(np.pi * v)])
        return float(bilinear(LATLONG, codes, decoding, 0, *n))

    t = decoding[codes[0]]
    assert at(2.5 / 16, 3.5 / 16) == pytest.approx(t[3, 2], abs=1e-4)
    assert at(3.0 / 16, 3.5 / 16) == pytest.approx((t[3, 2] + t[3, 3]) / 2, abs=1e-4)
    assert at(0.0, 3.5 / 16) == pytest.approx((t[3, 15] + t[3, 0]) / 2, abs=1e-3)
    # A quarter texel from the pole: three quarters of row 0, one quarter of the opposite side of row 0.
    assert at(2.5 / 16, 0.25 / 16) == pytest.approx(0.75 * t[0, 2] + 0.25 * t[0, 10], abs=1e-3)
    assert at(2.5 / 16, 15.75 / 16) == pytest.approx(0.75 * t[15, 2] + 0.25 * t[15, 10], abs=1e-3)
    # It is continuous everywhere: close points have close values.
    for u, v in rng.random((200, 2)):
        assert abs(at(u, v) - at((u + 1e-4) % 1, v)) < 0.02


def test_the_mean_over_a_sphere_does_not_depend_on_the_mapping(scene):
    means = []
    for mapping in ("latlong", "octahedral"):
        luminance = luxel.bake(scene, [3, 30, 60], samples=100, mapping=mapping).luminance
        means.append(np.einsum("kij,ij->k", luminance, luxel.texel_solid_angles(mapping, 16)) / (4 * np.pi))
    assert np.abs(means[0] - means[1]).max() < 0.02


def test_touching_lattice_has_nothing_buried():
    scene = luxel.Scene(lattice(3), (luxel.Sky(1.0),))
    assert (draw_paths(Baker(scene).world, "latlong", 16, 4, np.arange(27, dtype=np.int32))[2] == 4).all()


def test_more_samples_than_16_bits_count():
    scene = luxel.Scene(luxel.Particles([[0, 0, 0]], 1.0), (luxel.Sky(1.0),), model="lambertian")
    assert luxel.bake(scene, samples=65536, texels=4).luminance.min() == 1


@pytest.mark.parametrize("mode", ["paper", "fast"])
def test_an_interrupted_bake_leaves_nothing_behind(scene, mode):
    before = threading.active_count()

    def interrupt(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        luxel.bake(scene, samples=4, mode=mode, progress=interrupt, threads=2)
    assert threading.active_count() == before
    again = luxel.bake(scene, samples=4, mode=mode, threads=2)
    assert np.array_equal(again.codes, luxel.bake(scene, samples=4, mode=mode, threads=1).codes)


def test_ctrl_c_while_the_filter_learns(scene, monkeypatch):
    baker = Baker(scene, TextureSpec(samples=4, mode="fast"))
    ids = np.arange(8, dtype=np.int32)
    before = set(threading.enumerate())
    draw = FastLight._draw

    pressed = threading.Lock()

    def interrupted(self, *args, **options):
        if pressed.acquire(blocking=False):
            _thread.interrupt_main()
        return draw(self, *args, **options)

    with monkeypatch.context() as patch:
        patch.setattr(FastLight, "_draw", interrupted)
        with pytest.raises(KeyboardInterrupt):
            bake_with(baker, ids, threads=2)
    for thread in set(threading.enumerate()) - before:
        thread.join(30)  # one that was just starting when the key was pressed ends by itself
        assert not thread.is_alive()
    found = bake_with(baker, ids, threads=2)
    assert np.array_equal(found.codes, luxel.bake(scene, ids, samples=4, mode="fast").codes)
