"""Scenes that nobody means to make: every texel stays a number within the scale, and every bake ends."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import luxel
from luxel.textures.bake import Baker, bake_with
from luxel.textures.spec import TextureSpec
from tests.scenes import cloud

MODES = st.sampled_from(["paper", "fast"])
MODELS = st.sampled_from(["shadows", "ao", "interreflection"])
LEVELS = st.sampled_from([0.0, 1.0, 3.0])
DEFAULT = (luxel.Sky(1.0), luxel.Sun((-1, -1, 2), 2.0))


def bake_sanely(particles, lights=DEFAULT, mode="fast", model="interreflection", ids=None):
    """Bake some particles; return their luminance after checking what must hold in any scene."""
    scene = luxel.Scene(particles, lights, model=model)
    baker = Baker(scene, TextureSpec(mode=mode, samples=1))
    ids = np.arange(min(6, len(particles)), dtype=np.int32) if ids is None else np.asarray(ids, np.int32)
    luminance = baker.luminance(ids)[0]
    assert luminance.shape == (len(ids), 16, 16)
    assert np.isfinite(luminance).all()
    assert luminance.min() >= 0
    stored = bake_with(baker, ids)
    assert stored.luminance.max() <= stored.scale * (1 + 1e-6)
    assert stored.clipped_count == (luminance > stored.scale).sum()
    return luminance


@settings(max_examples=10)
@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.integers(2, 40), MODES, MODELS)
def test_coincident_particles(seed, places, count, mode, model):
    rng = np.random.default_rng(seed)
    points = rng.random((places, 3))[rng.integers(0, places, count)]
    luminance = bake_sanely(luxel.Particles(points, 0.1), mode=mode, model=model)
    if places == 1:
        # Twins share every point of their surfaces: none lies inside the other by more than rounding.
        assert luminance.max() <= 3.2


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.integers(2, 60), MODES, MODELS)
def test_radii_from_a_thousandth_to_a_thousand_spacings(seed, count, mode, model):
    rng = np.random.default_rng(seed)
    radii = 10.0 ** rng.uniform(-3, 3, count)
    bake_sanely(luxel.Particles(rng.random((count, 3)) * count ** (1 / 3), radii), mode=mode, model=model)


def test_radii_beyond_single_precision_are_lit_and_told(caplog):
    radii = np.array([1e-5, 1e-4, 1.0, 2e3])
    points = [[0, 0, 2000.0], [0.001, 0, 2000], [3, 0, 2001], [0, 0, 0]]
    bake_sanely(luxel.Particles(points, radii))
    (told,) = [r.getMessage() for r in caplog.records if r.levelname == "WARNING"]
    assert "2 of 4 particles" in told
    assert "particle 0: 1e-05" in told
    caplog.clear()
    bake_sanely(luxel.Particles(points[2:], radii[2:]))
    assert not caplog.records


@settings(max_examples=4)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1e9, -1e9, 1e12]), MODES)
def test_far_from_zero_light_is_the_same(seed, offset, mode):
    # Positions on a grid that float64 keeps exactly at this offset: the same scene, bit for bit.
    rng = np.random.default_rng(seed)
    points = rng.integers(0, 1024, (12, 3)) / 64.0
    near, far = (luxel.Particles(p, 1.5) for p in (points, points + np.array([offset, offset / 2, -offset])))
    assert np.array_equal(bake_sanely(near, mode=mode), bake_sanely(far, mode=mode))


@pytest.mark.parametrize("mode, spread", [("paper", 0.0), ("paper", 1e-7), ("fast", 1e-7)])
def test_a_thousand_particles_at_one_point(mode, spread):
    rng = np.random.default_rng(1)
    points = 0.5 + spread * rng.normal(size=(1000, 3))
    bake_sanely(luxel.Particles(np.concatenate([points, [[3.0, 0, 0]]]), 0.5), mode=mode, ids=[0, 500, 1000])


def test_a_million_particles_in_one_cell():
    # All overlap all: neighbour lists of a million, which must neither be cut short nor take the day.
    rng = np.random.default_rng(2)
    points = np.concatenate([rng.random((1_000_000, 3)), [[3.0, 0.5, 0.5]]])
    particles = luxel.Particles(points, np.r_[np.full(1_000_000, 0.9), 1.0])
    luminance = bake_sanely(particles, (luxel.Sky(1.0),), mode="paper", ids=[0, 500_000, 1_000_000])
    assert luminance[:2].max() == 0, "buried under the others"
    # The one outside sees them as one dark bulk towards -x and open sky towards +x.
    assert luminance[2, 4:12, 7:9].mean() < 0.9 * luminance[2, 4:12, [15, 0]].mean()


@pytest.mark.parametrize("mode", ["paper", "fast"])
@pytest.mark.parametrize("radius", [1e-30, 1.0, 1e30])
def test_one_particle_alone_under_any_unit(mode, radius):
    luminance = bake_sanely(luxel.Particles([[0, 0, 0]], radius), (luxel.Sky(1.0),), mode=mode)
    assert np.array_equal(luminance, np.ones((1, 16, 16), np.float32))


@st.composite
def contradictory_lights(draw):
    """Lights that are dark, wider than half the sky, or stand within particles."""
    lights = []
    if draw(st.booleans()):
        lights.append(luxel.Sky(draw(LEVELS), draw(st.sampled_from([None, 0.0, 2.0])), (0, 0, 1)))
    place = st.tuples(*[st.sampled_from([-1.0, 0.0, 0.25, 0.5, 4.0])] * 3)
    axis = st.sampled_from([(0, 0, 1), (0, 0, -1), (1, 1, 0)])
    size = st.sampled_from([1e-6, 0.05, 50.0])
    kinds = (
        st.builds(luxel.Sun, axis, LEVELS, st.just(120.0)),
        st.builds(luxel.SphereLight, place, size, LEVELS),
        st.builds(lambda p, e, level: luxel.QuadLight(p, (e, 0, 0), (0, e, 0), level), place, size, LEVELS),
    )
    return (*lights, *draw(st.lists(st.one_of(kinds), max_size=4)))


@settings(max_examples=10)
@given(contradictory_lights(), MODES, st.sampled_from(["shadows", "interreflection"]))
def test_contradictory_lights(lights, mode, model):
    # A particle stands at the very centre of some of these lights and encloses others.
    points = np.concatenate([[[0, 0, 0], [0.25, 0.25, 0.25], [0.5, 0.5, 0.5]], cloud(20).positions])
    luminance = bake_sanely(luxel.Particles(points, 0.1), lights, mode=mode, model=model)
    if all(light.level == 0 and getattr(light, "ground", None) in (None, 0) for light in lights):
        assert luminance.max() == 0


@pytest.mark.parametrize("mode", ["paper", "fast"])
def test_one_texture_whatever_the_company(mode):
    # Unequal radii and all kinds of light; fresh bakers, any order, batches that cut anywhere, any number of threads.
    lights = (
        *DEFAULT,
        luxel.SphereLight((0.5, 0.5, 3), 0.4, 3.0),
        luxel.QuadLight((0, 0, 2), (0, 1, 0), (1, 0, 0), 1.0),
    )
    scene = luxel.Scene(cloud(200, seed=6, radius=0.03, spread=2.0), lights)
    rng = np.random.default_rng(0)
    reference = luxel.bake(scene, samples=4, mode=mode, threads=1).codes
    for threads, count in ((3, 33), (2, 97), (1, 1)):
        ids = rng.permutation(200)[:count]
        assert np.array_equal(
            luxel.bake(scene, ids, samples=4, mode=mode, threads=threads).codes, reference[ids]
        )
