"""Mappings: inverses, solid angles, what lies beyond the edges, and lookups that no seam shows in."""

import numpy as np
import pytest

import luxel
from luxel.errors import InputError
from luxel.kernels.jit import kernel
from luxel.kernels.mapping import texel_direction, texel_uv
from luxel.kernels.shade import bilinear
from luxel.light.denoise import dilate
from luxel.light.mapping import mapping_code, texel_directions, texel_neighbours, texel_solid_angles

MAPPINGS = ("latlong", "octahedral")
pytestmark = pytest.mark.parametrize("mapping", MAPPINGS)


@kernel
def uv_of(code, n, out):
    for k in range(len(n)):
        out[k, 0], out[k, 1] = texel_uv(code, n[k, 0], n[k, 1], n[k, 2])


@kernel
def direction_of(code, uv, out):
    for k in range(len(uv)):
        out[k, 0], out[k, 1], out[k, 2] = texel_direction(code, uv[k, 0], uv[k, 1])


@kernel
def look_up_all(code, codes, decoding, n, out):
    for k in range(len(n)):
        out[k] = bilinear(code, codes, decoding, 0, n[k, 0], n[k, 1], n[k, 2])


def to_uv(mapping, n):
    out = np.empty((len(n), 2), np.float32)
    uv_of(mapping_code(mapping), np.ascontiguousarray(n, np.float32), out)
    return out


def to_direction(mapping, uv):
    out = np.empty((len(uv), 3), np.float32)
    direction_of(mapping_code(mapping), np.ascontiguousarray(uv, np.float32), out)
    return out


def look_up(mapping, texture, n):
    """Bilinear lookup in a (T, T) texture of floats: every texel has a code of its own."""
    out = np.empty(len(n), np.float32)
    codes = np.arange(texture.size, dtype=np.int32).reshape(1, *texture.shape)
    decoding = texture.astype(np.float32).ravel()
    look_up_all(mapping_code(mapping), codes, decoding, np.ascontiguousarray(n, np.float32), out)
    return out


def random_directions(count, seed=0):
    n = np.random.default_rng(seed).normal(size=(count, 3))
    return n / np.linalg.norm(n, axis=1)[:, None]


def awkward_directions():
    """Axes, and directions at and beside poles, seams and the planes where the maps have kinks."""
    signs = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1], [-1, 0, 1]), -1).reshape(-1, 3)
    signs = signs[np.abs(signs).sum(axis=1) > 0].astype(float)
    squeezed = [
        random_directions(2000, seed) * scale
        for seed, scale in enumerate(([1, 1, 1e4], [1, 1, 1e7], [1e-6, 1, 1], [1, 1e-6, 1], [1, 1, 1e-6]))
    ]
    n = np.concatenate([signs, *squeezed])
    return n / np.linalg.norm(n, axis=1)[:, None]


def harmonics(n):
    """Real spherical harmonics up to degree 2 with fixed coefficients; (...,) in about [-1, 1]."""
    x, y, z = np.moveaxis(n, -1, 0)
    return (
        0.1 + 0.3 * x - 0.2 * y + 0.4 * z + 0.25 * x * y - 0.3 * y * z + 0.2 * x * z
        + 0.1 * (3 * z * z - 1) + 0.15 * (x * x - y * y)
    )  # fmt: skip


def great_circle(a, b, count):
    t = np.linspace(0, 2 * np.pi, count)[:, None]
    return np.cos(t) * np.asarray(a) + np.sin(t) * np.asarray(b)


def test_inverse_of_every_direction(mapping):
    n = np.concatenate([random_directions(20_000), awkward_directions()])
    uv = to_uv(mapping, n)
    assert uv.min() > -1e-6
    assert uv.max() < 1 + 1e-6
    back = to_direction(mapping, uv)
    assert np.abs(back - n).max() < 1e-5
    assert np.abs(np.linalg.norm(back, axis=1) - 1).max() < 1e-6


def test_inverse_of_every_place(mapping):
    uv = np.random.default_rng(1).uniform(0.001, 0.999, (20_000, 2))
    assert np.abs(to_uv(mapping, to_direction(mapping, uv)) - uv).max() < 3e-5


def test_axes_lie_where_the_conventions_say(mapping):
    places = {
        "latlong": {(0, 0.5): (1, 0, 0), (0.25, 0.5): (0, 1, 0), (0.3, 0): (0, 0, 1), (0.3, 1): (0, 0, -1)},
        "octahedral": {(1, 0.5): (1, 0, 0), (0.5, 1): (0, 1, 0), (0.5, 0.5): (0, 0, 1), (0, 1): (0, 0, -1)},
    }[mapping]
    found = to_direction(mapping, np.array(list(places)))
    assert np.abs(found - np.array(list(places.values()))).max() < 1e-6


@pytest.mark.parametrize("texels", [4, 16])
def test_solid_angles_by_monte_carlo(mapping, texels):
    angles = texel_solid_angles(mapping, texels)
    assert angles.sum() == pytest.approx(4 * np.pi, rel=1e-12)
    count = 400_000
    column, row = np.clip((to_uv(mapping, random_directions(count)) * texels).astype(int), 0, texels - 1).T
    found = np.bincount(row * texels + column, minlength=texels**2)
    expected = angles.ravel() / (4 * np.pi) * count
    chi2, freedom = ((found - expected) ** 2 / expected).sum(), texels**2 - 1
    assert chi2 < freedom + 4 * np.sqrt(2 * freedom)


def test_directions_are_those_of_texel_centres(mapping):
    middle = (np.arange(6) + 0.5) / 6
    expected = np.stack(np.meshgrid(middle, middle), -1).reshape(-1, 2)
    assert np.abs(to_uv(mapping, texel_directions(mapping, 6).reshape(-1, 3)) - expected).max() < 1e-5


def test_what_is_no_mapping_and_no_texel_count(mapping):
    for texels in (0, 7, 2.0):
        with pytest.raises(InputError):
            texel_solid_angles(mapping, texels)
    with pytest.raises(InputError, match="latlong or octahedral"):
        texel_directions(mapping + "s", 4)


def test_neighbours_are_mutual_and_near(mapping):
    texels = 16
    beside = texel_neighbours(mapping, texels)
    for k in range(texels**2):
        assert all(k in beside[:, other] for other in beside[:, k])
    n = texel_directions(mapping, texels).reshape(-1, 3)
    cosine = np.einsum("ik,jik->ji", n, n[beside])
    assert np.degrees(np.arccos(cosine.min())) < 24  # 22.5 at latitude-longitude's equator


def test_holes_are_filled_from_around_them(mapping):
    # In a field that is linear in n, whoever looks in the wrong place finds values from afar.
    n = texel_directions(mapping, 16)
    for axis in np.concatenate([random_directions(20), awkward_directions()[:26]]):
        slope = np.cross(axis, [0.36, 0.48, 0.8])
        field = (n @ slope)[None].astype(np.float32)
        hole = (n @ axis > np.cos(np.radians(25)))[None]
        filled = dilate(field, np.uint32(~hole), mapping)
        assert np.array_equal(filled[~hole], field[~hole])
        assert np.abs(filled - field)[hole].max(initial=0) < 0.5


def test_lookup_of_a_smooth_function(mapping):
    n = np.concatenate([random_directions(50_000), awkward_directions()])
    worst = {}
    for texels in (16, 32):
        texture = harmonics(texel_directions(mapping, texels))
        worst[texels] = np.abs(look_up(mapping, texture, n) - harmonics(n)).max()
    # Texels shrink by half: errors go with their square, or with their size at the octahedral map's kinks.
    assert worst[16] < {"latlong": 0.03, "octahedral": 0.1}[mapping]
    assert worst[32] < {"latlong": 0.26, "octahedral": 0.52}[mapping] * worst[16]


def test_lookup_has_no_seams(mapping):
    # In a texture of noise a wrong neighbour would show as a jump of some tenths.
    texture = np.random.default_rng(5).random((16, 16))
    x, y, z = np.eye(3)
    tilted = (x + y + z) / np.sqrt(3)
    circles = [(x, y), (x, z), (y, z), ((x + y) / np.sqrt(2), z), (tilted, (x - y) / np.sqrt(2))]
    for a, b in circles:
        values = look_up(mapping, texture, great_circle(a, b, 20_001))
        assert np.abs(np.diff(values)).max() < 0.01
        assert values[0] == pytest.approx(values[-1], abs=0.01)


def test_a_small_sphere_on_a_plane_sees_part_of_the_sky(mapping):
    # The view factor of a plane that is tilted against another: (1 + cos v) / 2.
    particles = luxel.Particles([[0, 0, 1.0], [0, 0, -5000.0]], [1.0, 5000.0])
    scene = luxel.Scene(particles, (luxel.Sky(1.0),), model="ao")
    got = luxel.bake(scene, [0], samples=400, mapping=mapping)
    assert got.mapping == mapping
    assert got.snapshot(got.key).mapping == mapping
    z = texel_directions(mapping, 16)[..., 2]
    away = (got.luminance[0] - (1 + z) / 2)[z > -0.7]  # around the contact the plane is not a plane
    assert np.abs(away).max() < 0.09
    assert abs(away.mean() - 0.01) < 0.004  # the horizon dips by sqrt(2 / 5000) radians
