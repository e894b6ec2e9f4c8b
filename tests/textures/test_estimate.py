"""Estimates: of the right shape and scale, alike in every batch, as far from the real textures as their errors say."""

import numpy as np
import pytest

import luxel
from luxel.light.mapping import texel_directions, texel_solid_angles, texel_weights
from luxel.session import Session
from luxel.textures.bake import Baker
from luxel.textures.estimate import EstimateBaker
from luxel.textures.spec import TextureSpec


def heap(count: int = 400) -> luxel.Particles:
    rng = np.random.default_rng(3)
    return luxel.Particles(rng.random((count, 3)) * [8, 8, 3], 0.45)


@pytest.mark.parametrize("mapping", ["latlong", "octahedral"])
def test_interpolation_keeps_what_is_linear_on_the_sphere(mapping):
    places, weights = texel_weights(mapping, 8, 16)
    np.testing.assert_allclose(weights.sum(axis=0), 1, atol=1e-6)
    assert (weights >= 0).all()
    coarse, fine = (texel_directions(mapping, n).reshape(-1, 3) for n in (8, 16))
    found = (coarse[places] * weights[..., None]).sum(axis=0)
    assert np.abs(found - fine).max() < 0.25
    assert np.abs(found - fine).mean() < 0.06


def test_interpolation_to_as_many_texels_changes_nothing():
    places, weights = texel_weights("latlong", 8, 8)
    assert (places[0] == np.arange(64)).all()
    assert (weights == np.array([1, 0, 0, 0])[:, None]).all()


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("mode", ["fast", "paper"])
def test_an_estimate_does_not_depend_on_its_batch(mode, whole):
    baker = Baker(luxel.Scene(heap()), TextureSpec(texels=16, samples=4, mode=mode))
    estimates = EstimateBaker(baker, whole=whole)
    for _ in estimates.preparation(1):
        pass
    ids = np.arange(0, 90, 3, dtype=np.int32)
    together = np.empty((len(ids), 16, 16), np.uint8)
    estimates.bake_into(ids, together)
    for k in (0, 7, 29):
        one = np.empty((1, 16, 16), np.uint8)
        estimates.bake_into(ids[k : k + 1], one)
        assert (one[0] == together[k]).all()


@pytest.mark.parametrize(
    ("estimates", "mode", "samples"), [(True, "fast", 4), (None, "fast", 4), (None, "paper", 9)]
)
def test_what_comes_after_an_estimate_is_the_texture_of_a_bake(estimates, mode, samples):
    """With level of detail off nothing of estimates is left in the end."""
    particles = heap(60)
    spec = TextureSpec(texels=8, samples=samples, mode=mode)
    expected = luxel.bake(luxel.Scene(particles), texels=8, samples=samples, mode=mode, threads=1)
    with Session(particles, spec=spec, threads=0, estimates=estimates) as session:
        heard: list[tuple[int, bool]] = []
        session.subscribe(lambda batch: heard.extend(zip(batch.ids.tolist(), batch.estimate, strict=True)))
        session.sighted(range(60), (9, 9, 9))
        assert session.wait()
        batch = session.tiles(range(60))
    assert [each for each, estimate in heard if estimate] != []
    assert sorted(each for each, estimate in heard if not estimate) == list(range(60))
    assert not batch.estimate.any()
    assert (batch.codes == expected.codes[batch.ids]).all()


@pytest.mark.parametrize(("estimates", "samples"), [(None, 1), (False, 4)])
def test_textures_that_come_soon_have_no_estimates(estimates, samples):
    spec = TextureSpec(texels=8, samples=samples, mode="fast")
    with Session(heap(60), spec=spec, threads=0, estimates=estimates) as session:
        heard: list[bool] = []
        session.subscribe(lambda batch: heard.extend(batch.estimate.tolist()))
        session.sighted(range(60), (9, 9, 9))
        assert session.wait()
    assert heard == [False] * 60


def test_a_first_sample_of_all_texels_is_as_good_as_a_bake_of_one_sample():
    scene = luxel.Scene(heap(300))
    ids = np.arange(300, dtype=np.int32)
    baker = Baker(scene, TextureSpec(mode="fast", samples=9))
    truth = Baker(scene, TextureSpec(mode="fast", samples=64)).luminance(ids)[0]
    first = EstimateBaker(baker, whole=True).luminance(ids)[0]
    baked = Baker(scene, TextureSpec(mode="fast", samples=1)).luminance(ids)[0]
    errors = [np.sqrt(((found - truth) ** 2).mean()) for found in (first, baked)]
    assert errors[0] < 1.05 * errors[1]
    assert abs(first - baked).max() > 0  # its filter has learnt from less


def test_small_particles_are_content_with_estimates_until_they_grow():
    with Session(
        heap(60),
        spec=TextureSpec(texels=8, samples=4, mode="fast"),
        threads=0,
        estimates=True,
        small_pixels=6,
    ) as session:
        session.sighted(range(60), (9, 9, 9), pixels=np.where(np.arange(60) < 40, 4.0, 20.0))
        session.wait()
        assert session.tiles(range(60)).estimate.tolist() == [True] * 40 + [False] * 20
        assert session.status().refining == 0
        session.sighted(range(60), (2, 2, 2), pixels=np.full(60, 8.0))
        session.wait()
        assert not session.tiles(range(60)).estimate.any()


def test_the_step_from_an_estimate_to_its_texture_is_within_the_errors_of_both():
    lights = [luxel.Sky(1.0), luxel.Sun((1, 1, 2), level=2.0, angular_diameter=15)]
    baker = Baker(luxel.Scene(heap(900), lights=lights), TextureSpec(mode="fast", samples=4))
    estimates = EstimateBaker(baker)
    for each in (baker, estimates):
        for _ in each.preparation(2):
            pass
    ids = np.arange(600, dtype=np.int32)
    (later, later_error), (first, first_error) = baker.luminance(ids), estimates.luminance(ids)
    weights = texel_solid_angles("latlong", 16) / (4 * np.pi)
    step = np.sqrt(((later - first) ** 2 * weights).sum(axis=(1, 2)))
    # What 8 x 8 texels cannot show is no error of the samples: the later texture without its finer half has the same.
    coarse = later.reshape(-1, 8, 2, 8, 2).mean(axis=(2, 4)).repeat(2, axis=1).repeat(2, axis=2)
    blur = ((later - coarse) ** 2 * weights).sum(axis=(1, 2))
    expected = np.sqrt(later_error**2 + first_error**2 + blur)
    assert np.sqrt((step**2).mean()) < 1.25 * np.sqrt((expected**2).mean())
    assert (step < 3 * expected).mean() > 0.985
    # Those told to be uncertain take the larger steps.
    sure, doubtful = np.array_split(np.argsort(expected), 2)
    assert (step[doubtful] ** 2).mean() > (step[sure] ** 2).mean()
