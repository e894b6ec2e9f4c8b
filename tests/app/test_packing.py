"""Packed particles: nothing that can be seen is lost, and nothing takes more bytes than it says."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import luxel
from luxel.app.packing import PackedParticles, pack_particles
from luxel.trace.spheres import SphereSet

RNG = np.random.default_rng(5)


def columns(packed: PackedParticles, part: slice = slice(None)) -> list[np.ndarray]:
    """What ``client/unpacking.js`` reads, in plain NumPy."""
    data, found, offset = np.frombuffer(packed.pack(part), np.uint8), [], 0
    count = len(range(*part.indices(packed.count)))
    for nbytes in packed.description["columns"]:
        planes = data[offset : offset + nbytes * count].reshape(nbytes, count).astype(np.uint64)
        steps = (planes << (8 * np.arange(nbytes, dtype=np.uint64))[:, None]).sum(axis=0)
        found.append(np.cumsum(steps) & np.uint64(2 ** (8 * nbytes) - 1))
        offset += nbytes * count
    assert offset == len(data)
    return found


def unpacked(packed: PackedParticles) -> dict[str, Any]:
    about, found = packed.description, columns(packed)
    bits = about["positions"]["bits"]
    axes = np.stack(found[:3], axis=1)
    positions = about["positions"]["low"] + about["positions"]["step"] * (axes & np.uint64(2**bits - 1))
    spare = 8 * about["columns"][0] - bits
    rest = found[3:]
    radii = about["radii"]
    codes = (
        rest.pop(0)
        if radii["column"]
        else sum(axes[:, k] >> np.uint64(bits) << np.uint64(k * spare) for k in range(3))
    )
    decoded = (
        np.array(radii["list"])[codes] if "list" in radii else radii["low"] * np.exp(codes * radii["step"])
    )
    scalars = {}
    for scalar in about["scalars"]:
        code = rest.pop(0).astype(np.float64)
        if scalar.get("log"):
            values = np.where(code == 0, 0, scalar["low"] * np.exp((code - 1) * scalar["step"]))
        else:
            values = scalar["low"] + scalar["step"] * code
        scalars[scalar["name"]] = np.where(code == scalar.get("missing"), np.nan, values)
    return {
        "positions": positions,
        "radii": decoded,
        "scalars": scalars,
        "ids": rest[0] if about["ids"] else None,
    }


def cloud(count: int, radii: Any, extent: float = 1.0, **scalars: Any) -> luxel.Particles:
    return luxel.Particles(extent * RNG.random((count, 3)), radii, scalars)


@pytest.mark.parametrize(
    ("radii", "each"),
    [
        (0.02, {"positions": 6}),
        (0.02 * (1 + 0.02 * RNG.random(500)), {"positions": 6}),  # in the bits that positions leave
        (0.02 * RNG.integers(1, 4, 500), {"positions": 6}),  # three kinds of atoms
        (0.002 * RNG.integers(1, 4, 500), {"positions": 6, "radii": 1}),
        (0.0025 * np.exp(RNG.uniform(0, 2, 500)), {"positions": 6, "radii": 1}),
        (0.0005 * np.exp(RNG.uniform(0, 2, 500)), {"positions": 9}),
        (0.02 * np.exp(RNG.uniform(0, 7, 500)), {"positions": 6, "radii": 2}),
        (1e-5 * np.exp(RNG.uniform(0, 7, 500)), {"positions": 9, "radii": 2}),
        (1e-5, {"positions": 9}),
    ],
)
def test_geometry_moves_by_less_than_a_hundredth_of_the_smallest_radius(
    radii: Any, each: dict[str, int]
) -> None:
    particles = cloud(500, radii)
    packed = pack_particles(particles, ())
    spheres, found = SphereSet.of(particles), unpacked(packed)
    least = spheres.radii.min()
    assert np.abs(found["positions"] - spheres.centers).max() <= 0.0051 * least
    assert np.abs(found["radii"] / spheres.radii - 1).max() <= 0.0051
    assert packed.bytes_each == each
    assert len(packed.pack(slice(None))) == 500 * sum(each.values())


def test_scalars_keep_what_any_scale_shows() -> None:
    count = 4000
    wide = 10 ** RNG.uniform(-6, 6, count)
    wide[:9] = 0
    scalars = {
        "kind": RNG.integers(-3, 5, count),
        "id": RNG.permutation(count) + 70_000,
        "plain": RNG.normal(size=count),
        "wide": wide,
        "gaps": np.where(RNG.random(count) < 0.1, np.nan, RNG.random(count)),
        "none": np.full(count, np.nan),
        "same": np.full(count, 7.25),
        "ends": np.array([np.inf, -np.inf, *RNG.random(count - 2)]),
    }
    particles = cloud(count, 0.01, **scalars)
    packed = pack_particles(particles, list(scalars))
    found = unpacked(packed)["scalars"]
    for name in ("kind", "id", "same"):
        np.testing.assert_array_equal(found[name], scalars[name])
    assert np.abs(found["plain"] - scalars["plain"]).max() <= np.ptp(scalars["plain"]) / 2**16
    np.testing.assert_allclose(found["wide"], wide, rtol=3e-4)
    for name in ("gaps", "none"):
        np.testing.assert_array_equal(np.isnan(found[name]), np.isnan(scalars[name]))
    np.testing.assert_allclose(found["ends"][2:], scalars["ends"][2:], rtol=3e-4, atol=2e-5)
    finite = scalars["ends"][2:]
    np.testing.assert_allclose(found["ends"][0], finite.max())
    assert found["ends"][1] <= finite.min()  # 0, on a logarithmic scale
    each = packed.bytes_each
    assert (each["kind"], each["id"], each["plain"], each["wide"]) == (1, 2, 2, 2)


def test_a_part_of_the_particles_keeps_its_ids() -> None:
    particles = cloud(300, 0.05, value=np.arange(300.0))
    ids = np.flatnonzero(RNG.random(300) < 0.3).astype(np.int32)
    packed = pack_particles(particles, ["value"], ids)
    found = unpacked(packed)
    np.testing.assert_array_equal(found["ids"], ids)
    np.testing.assert_allclose(found["positions"], SphereSet.of(particles).centers[ids], atol=3e-4)
    assert packed.description["scalars"][0]["range"] == (0.0, 299.0)  # that of all
    for start in range(0, len(ids), 40):  # blocks stand alone
        part = slice(start, start + 40)
        np.testing.assert_array_equal(columns(packed, part)[-1], ids[part])


def test_one_particle_and_coincident_ones() -> None:
    for positions in ([[3, 4, 5]], [[1, 1, 1], [1, 1, 1]]):
        particles = luxel.Particles(positions, 0.5)
        found = unpacked(pack_particles(particles, ()))
        np.testing.assert_allclose(found["positions"], SphereSet.of(particles).centers, atol=1e-6)
        np.testing.assert_allclose(found["radii"], SphereSet.of(particles).radii, rtol=1e-6)
