import itertools
import math

import numpy as np
import pytest

from luxel import Camera
from luxel.errors import InputError

BOUNDS = np.array([[-1.0, -2.0, 10.0], [3.0, 5.0, 11.0]])
CORNERS = np.array(list(itertools.product(*BOUNDS.T)))


def screen(camera, points, aspect):
    """Project to [-1, 1] on both axes."""
    right, up, forward = camera.basis()
    offset = points - camera.eye
    if camera.orthographic:
        half = camera.height / 2
        return np.stack([offset @ right / (half * aspect), offset @ up / half], axis=1)
    slope = math.tan(math.radians(camera.fov) / 2)
    depth = offset @ forward
    assert (depth > 0).all()
    return np.stack([offset @ right / (depth * slope * aspect), offset @ up / (depth * slope)], axis=1)


def test_basis_is_right_handed_and_orthonormal():
    basis = Camera((3, 1, 2), (0, 0, 0)).basis()
    np.testing.assert_allclose(basis @ basis.T, np.eye(3), atol=1e-12)
    right, up, forward = basis
    np.testing.assert_allclose(np.cross(right, forward), up, atol=1e-12)


def test_basis_known():
    np.testing.assert_allclose(
        Camera((0, -5, 0), (0, 0, 0)).basis(), [[1, 0, 0], [0, 0, 1], [0, 1, 0]], atol=1e-12
    )


def test_looking_straight_up_still_has_a_basis():
    basis = Camera((0, 0, 0), (0, 0, 1)).basis()
    np.testing.assert_allclose(basis @ basis.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize("up", ["x", "y", "z"])
@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("aspect", [0.4, 1.0, 2.5])
def test_framing_shows_all_and_touches_the_border(up, orthographic, aspect):
    camera = Camera.framing(BOUNDS, up=up, aspect=aspect, orthographic=orthographic, azimuth=20, elevation=40)
    reach = np.abs(screen(camera, CORNERS, aspect)).max()
    assert 0.9 < reach <= 1.0
    assert np.argmax(np.asarray(camera.up)) == "xyz".index(up)


def test_framing_angles():
    camera = Camera.framing(BOUNDS, azimuth=90, elevation=0)
    towards = np.subtract(camera.eye, camera.target)
    np.testing.assert_allclose(towards / np.linalg.norm(towards), [0, 1, 0], atol=1e-12)


def test_framing_a_point():
    camera = Camera.framing(np.zeros((2, 3)))
    assert np.linalg.norm(np.subtract(camera.eye, camera.target)) > 0


@pytest.mark.parametrize(
    "fields",
    [
        {"eye": (0, 0, 0), "target": (0, 0, 0)},
        {"eye": (0, 0), "target": (1, 0, 0)},
        {"eye": (0, 0, np.nan), "target": (1, 0, 0)},
        {"eye": (0, 0, 0), "target": (1, 0, 0), "fov": 0},
        {"eye": (0, 0, 0), "target": (1, 0, 0), "fov": 180},
        {"eye": (0, 0, 0), "target": (1, 0, 0), "height": 0},
        {"eye": (0, 0, 0), "target": (1, 0, 0), "up": (0, 0, 0)},
    ],
)
def test_bad_cameras_are_refused(fields):
    with pytest.raises(InputError, match="camera"):
        Camera(**fields)


@pytest.mark.parametrize("up", [(1, 1, 1), (0, 0, 1), (0, -1, 0), (1, -1, 1)])
def test_looking_along_up_still_has_a_picture(up):
    basis = Camera((0, 0, 0), up, up=up).basis()
    assert np.allclose(basis @ basis.T, np.eye(3))
