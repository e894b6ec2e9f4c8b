"""One contract for every tracer, and the tree against its twins: plain NumPy and Embree."""

import numpy as np
import pytest

import luxel
from luxel.kernels.blockers import KINDS
from luxel.kernels.bundle import ROOM, bundle_scratch, first_met, meets, put, trace_bundle, whose
from luxel.kernels.jit import kernel
from luxel.kernels.tree import IDS, LEAF
from luxel.kernels.tree_trace import scratch, trace
from luxel.trace.reference import ReferenceTracer
from luxel.trace.spheres import SphereSet
from luxel.trace.tree import SphereTree
from tests.scenes import cloud, lattice, random_rays


class TracerContract:
    make = None

    def tracer(self, particles):
        return type(self).make(SphereSet.of(particles))

    def test_hits_the_nearest_of_two(self):
        tracer = self.tracer(luxel.Particles([[0, 0, 0], [4, 0, 0]], 1.0))
        unit = tracer.spheres.unit
        origin = tracer.spheres.to_unit([[-3.0, 0, 0], [7.0, 0, 0], [-3.0, 1.5, 0]]).astype(np.float32)
        direction = np.array([[1, 0, 0], [-1, 0, 0], [1, 0, 0]], np.float32)
        distance, ids = tracer.closest(origin, direction)
        assert ids.tolist() == [0, 1, -1]
        np.testing.assert_allclose(distance[:2] * unit, 2.0, rtol=1e-6)
        assert np.isinf(distance[2])

    def test_limit_and_skip(self):
        tracer = self.tracer(luxel.Particles([[0, 0, 0], [4, 0, 0]], 1.0))
        origin = tracer.spheres.to_unit([[-3.0, 0, 0]]).astype(np.float32)
        direction = np.array([[1, 0, 0]], np.float32)
        near = tracer.spheres.length_to_unit(1.9)
        assert not tracer.occluded(origin, direction, near)[0]
        assert tracer.closest(origin, direction, skip=np.array([0], np.int32))[1][0] == 1

    def test_ray_that_starts_inside_is_blocked_at_once(self):
        tracer = self.tracer(luxel.Particles([[0, 0, 0], [9, 0, 0]], [1.0, 0.1]))
        origin = tracer.spheres.to_unit([[0.5, 0, 0]]).astype(np.float32)
        distance, ids = tracer.closest(origin, np.array([[1, 0, 0]], np.float32))
        assert (distance[0], ids[0]) == (0.0, 0)

    @pytest.mark.parametrize("scale", [1e-20, 1.0, 3e21])
    @pytest.mark.parametrize("spread", [0.0, 3.0])
    def test_leaving_a_sphere_never_meets_it_again(self, scale, spread):
        base = cloud(60, spread=spread)
        alone = luxel.Particles(base.local[:1] * scale, base.radii[:1] * scale)
        tracer = self.tracer(alone)
        origins, directions, ids = random_rays(alone, 500)
        assert not tracer.occluded(origins, directions, skip=ids).any()

    def test_no_rays(self):
        none = np.zeros((0, 3), np.float32)
        distance, ids = self.tracer(lattice(2)).closest(none, none)
        assert len(distance) == len(ids) == 0


class TestTree(TracerContract):
    make = SphereTree


class TestReference(TracerContract):
    make = ReferenceTracer


@pytest.mark.parametrize(
    "particles",
    [
        cloud(1, seed=1),
        cloud(17, seed=2),
        cloud(800, seed=3),
        cloud(800, seed=4, spread=3.4),
        lattice(9),
        luxel.Particles(np.zeros((300, 3)), 0.5),
        luxel.Particles(np.geomspace(1e-2, 1e2, 400)[:, None] * [1.0, 0, 0], np.geomspace(1e-4, 1, 400)),
        luxel.Particles(np.random.default_rng(5).random((500, 3)) + 1e9, 0.05),
    ],
    ids=["one", "two leaves", "cloud", "polydisperse", "lattice", "coincident", "exponential", "far away"],
)
def test_tree_agrees_with_reference(particles):
    spheres = SphereSet.of(particles)
    tree, plain = SphereTree(spheres), ReferenceTracer(spheres)
    origins, directions, ids = random_rays(particles, 400)
    expected, _ = plain.closest(origins, directions, skip=ids)
    distance, found = tree.closest(origins, directions, skip=ids)
    hit = np.isfinite(expected)
    # Grazing rays may fall either way: allow one in two hundred to differ.
    different = (hit != np.isfinite(distance)) | (hit & ~np.isclose(distance, expected, rtol=1e-4, atol=2e-6))
    assert different.mean() <= 0.005
    assert (tree.occluded(origins, directions, skip=ids) == (found >= 0)).all()


def test_tree_agrees_with_embree():
    embree = pytest.importorskip("tests.embree_twin")
    particles = cloud(3000, seed=6, radius=0.02, spread=1.0)
    spheres = SphereSet.of(particles)
    rng = np.random.default_rng(7)
    origins = rng.normal(size=(4000, 3)).astype(np.float32)
    origins *= (3.0 / np.linalg.norm(origins, axis=1))[:, None]
    directions = rng.uniform(-0.5, 0.5, (4000, 3)).astype(np.float32) - origins
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    distance, ids = SphereTree(spheres).closest(origins, directions)
    scene = embree.EmbreeScene(spheres.centers, spheres.radii)
    twin_distance, twin_ids = np.empty_like(distance), np.empty_like(ids)
    embree.trace_rays(scene.handle, origins, directions, False, twin_distance, twin_ids)
    assert (ids == twin_ids).mean() >= 0.998
    same = (ids == twin_ids) & (ids >= 0)
    assert same.sum() > 1000
    np.testing.assert_allclose(distance[same], twin_distance[same], rtol=2e-4)


def test_tree_does_not_depend_on_threads():
    spheres = SphereSet.of(cloud(5000, seed=8, radius=0.01))
    one, many = SphereTree(spheres, threads=1), SphereTree(spheres, threads=5)
    for a, b in zip(one.arrays[1:4:2], many.arrays[1:4:2], strict=True):
        assert np.array_equal(a, b)


def test_trees_end_with_their_particles():
    import gc
    import weakref

    particles = cloud(50, seed=12)
    tree = SphereTree.of(SphereSet.of(particles))
    assert SphereTree.of(SphereSet.of(particles)) is tree
    gone = weakref.ref(tree), weakref.ref(tree.spheres)
    del particles, tree
    gc.collect()
    assert [ref() for ref in gone] == [None, None]


def test_memory_a_particle():
    # The issue of memory at 10^8 particles: at most 40 bytes each beyond the data.
    spheres = SphereSet.of(lattice(30))
    assert SphereTree(spheres).nbytes / len(spheres) <= 40


def test_every_sphere_is_in_exactly_one_leaf():
    tree = SphereTree(SphereSet.of(cloud(2345, seed=9, spread=2.0)))
    ids = tree.arrays.ids.reshape(-1, LEAF)[:, IDS:]
    ids = ids[ids >= 0]
    assert sorted(ids.tolist()) == list(range(2345))


@kernel
def trace_in_bundles(tree, origins, directions, limit, skip, kinds, any_hit, size, distance, ids):
    """Bundles of `size` rays; where any hit will do, ids are 1 for one and -1 for none."""
    work, bundle = scratch(tree.stack_size), bundle_scratch(tree)
    for first in range(0, origins.shape[0], size):
        count = min(size, origins.shape[0] - first)
        for j in range(count):
            o, d = origins[first + j], directions[first + j]
            put(
                bundle, j, first + j, limit[first + j], o[0], o[1], o[2], d[0], d[1], d[2], limit[first + j],
                skip[first + j], kinds[first + j],
            )  # fmt: skip
        trace_bundle(tree, work, bundle, count, any_hit)
        for j in range(count):
            k, worth = whose(bundle, j)
            t, hit = first_met(bundle, tree, j)
            if any_hit:
                hit = 1 if meets(bundle, j) else -1
            distance[k] = t if hit >= 0 else worth
            ids[k] = hit


@kernel
def trace_alone(tree, origins, directions, limit, skip, distance, ids):
    work = scratch(tree.stack_size)
    for k in range(origins.shape[0]):
        o, d = origins[k], directions[k]
        distance[k], ids[k] = trace(tree, work, o[0], o[1], o[2], d[0], d[1], d[2], limit[k], skip[k], False)


def in_bundles(tree, origins, directions, limit, skip, kinds, any_hit, size):
    distance, found = np.empty(len(skip), np.float32), np.empty(len(skip), np.int32)
    trace_in_bundles(
        tree.arrays, origins, directions, limit, skip, kinds.astype(np.int32), any_hit, size, distance, found
    )
    return distance, found


@pytest.mark.parametrize("size", [1, 3, 11, 12, 17, ROOM])
@pytest.mark.parametrize("count", [0, 1, 5, 700, 30_000])
def test_bundles_meet_what_rays_alone_meet(count, size):
    spheres = SphereSet.of(cloud(max(count, 1), seed=4, radius=0.02))
    tree = SphereTree(spheres, hidden=np.ones(1, np.bool_) if count == 0 else None)
    origins, directions, skip = random_rays(cloud(700, seed=4), 4000)
    skip = np.where(skip < count, skip, -1).astype(np.int32)
    limit = np.random.default_rng(3).choice(np.float32([0.05, 0.4, 1e30]), len(skip))
    distance, ids = np.empty(len(skip), np.float32), np.empty(len(skip), np.int32)
    trace_alone(tree.arrays, origins, directions, limit, skip, distance, ids)
    nobody = np.full(len(skip), -1)
    t, found = in_bundles(tree, origins, directions, limit, skip, nobody, False, size)
    np.testing.assert_allclose(t, distance, rtol=1e-5)
    # A ray may start inside of several spheres, and meet two within rounding.
    assert (found != ids)[distance > 0].mean() <= 1e-3
    kinds = np.random.default_rng(5).integers(-1, 8, len(skip))
    for kind in (nobody, kinds):
        blocked = in_bundles(tree, origins, directions, limit, skip, kind, True, size)[1]
        assert ((blocked >= 0) != (ids >= 0)).mean() <= 1e-3
    assert count < 700 or 0.02 < (ids >= 0).mean() < 1


def test_coincident_spheres_are_met_by_bundles():
    particles = luxel.Particles(np.repeat([[0.0, 0, 0], [3, 0, 0]], 40, axis=0), 1.0)
    tree = SphereTree(SphereSet.of(particles))
    origins, directions, _ = random_rays(particles, 2000)
    distance, ids = tree.closest(origins - 5 * directions, directions)
    one = SphereTree(SphereSet.of(luxel.Particles(particles.positions[::40], 1.0)))
    expected, first = one.closest(origins - 5 * directions, directions)
    np.testing.assert_array_equal(ids < 0, first < 0)
    np.testing.assert_array_equal(ids[ids >= 0] // 40, first[ids >= 0])
    np.testing.assert_allclose(distance[ids >= 0], expected[ids >= 0], atol=1e-5)


@pytest.mark.parametrize("kinds", [1, 8, KINDS])
def test_what_blocked_others_changes_nothing(kinds):
    particles = cloud(800, seed=9, radius=0.01, spread=1.0)
    tree = SphereTree(SphereSet.of(particles))
    origins, directions, ids = random_rays(particles, 20_000)
    expected = tree.occluded(origins, directions, skip=ids)
    assert 0.1 < expected.mean() < 0.9
    kind = np.random.default_rng(1).integers(0, kinds, len(ids))
    limit = np.full(len(ids), 1e30, np.float32)
    found = in_bundles(tree, origins, directions, limit, ids, kind, True, ROOM)[1] >= 0
    # Where boxes and spheres round differently: one in ten thousand.
    assert (found != expected).mean() <= 1e-4
