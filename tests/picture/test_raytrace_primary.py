"""Tile frusta against single rays and the reference, perspective and orthographic."""

import numpy as np
import pytest

import luxel
from luxel.light.world import make_world
from luxel.picture.raytrace import make_eye, trace_primary, visible_ids
from luxel.trace.reference import ReferenceTracer
from luxel.trace.spheres import SphereSet
from tests.scenes import cloud, lattice


def rays_of(eye, width, height):
    x, y = np.meshgrid((np.arange(width) + 0.5) / width * 2 - 1, 1 - (np.arange(height) + 0.5) / height * 2)
    plane = x[..., None] * eye.right + y[..., None] * eye.up
    if eye.orthographic:
        origin, direction = eye.origin + plane, np.broadcast_to(eye.forward, plane.shape)
    else:
        origin, direction = np.broadcast_to(eye.origin, plane.shape), eye.forward + plane
    direction = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    return origin.reshape(-1, 3).astype(np.float32), direction.reshape(-1, 3).astype(np.float32)


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_tiles_agree_with_reference(orthographic, up):
    particles = cloud(300, spread=1.0)
    camera = luxel.Camera.framing(particles.bounds, up=up, aspect=1.3, orthographic=orthographic)
    check(particles, camera, 65, 50)


@pytest.mark.parametrize("height", [None, 0.7])
def test_eye_in_the_middle_of_the_data(height):
    particles = cloud(300, spread=0.5)
    check(particles, luxel.Camera([0.5, 0.5, 0.5], [1.0, 0.8, 0.6], fov=70, height=height), 48, 33)


def test_eye_far_away():
    particles = lattice(5)
    check(particles, luxel.Camera([900.0, 700, 500], [2.0, 2, 2], fov=0.4), 64, 64)


def check(particles, camera, width, height):
    spheres = SphereSet.of(particles)
    world = make_world(luxel.Scene(particles))
    eye = make_eye(camera, spheres, width / height)
    distance, ids = trace_primary(world, eye, width, height, (0.5, 0.5), 2)
    origins, directions = rays_of(eye, width, height)
    plain = ReferenceTracer(spheres)
    # A camera ray passes through the sphere that holds its origin: back faces are not drawn.
    t = plain._distances(origins, directions, np.full(len(origins), -1))
    t[t <= 0] = np.inf
    expected = np.where(np.isfinite(t.min(axis=1)), t.argmin(axis=1), -1).reshape(height, width)
    assert (expected >= 0).mean() > 0.05
    assert (ids == expected).mean() >= 0.995
    same = (ids == expected) & (ids >= 0)
    np.testing.assert_allclose(
        distance[same], t.min(axis=1).reshape(height, width)[same], rtol=1e-3, atol=2e-5
    )


def test_visible_ids_are_those_of_the_picture():
    particles = cloud(300)
    scene = luxel.Scene(particles, model="lambertian")
    camera = luxel.Camera.framing(particles.bounds, aspect=1.0)
    image = luxel.render(scene, luxel.View(camera=camera), size=(80, 80), antialias=1)
    expected = np.unique(image.ids)
    assert visible_ids(scene, camera, (80, 80)).tolist() == expected[expected >= 0].tolist()
