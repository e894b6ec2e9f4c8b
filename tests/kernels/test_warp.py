"""Warps: inverses, densities, frames."""

import numpy as np
import pytest
from numba import njit

from luxel.kernels.jit import kernel
from luxel.kernels.rng import next_state, path_key, uniform
from luxel.kernels.warp import cone_direction, cosine_direction, to_frame, turn


def exported(inner):
    """Return a function for a kernel that only kernels may call."""

    @njit
    def outer(*arguments):
        return inner(*arguments)

    return outer


def test_turn_is_cosine_and_sine():
    v = np.linspace(0, 1, 20_001, dtype=np.float32)
    outer = exported(turn)
    found = np.array([outer(x) for x in v])
    exact = 2 * np.pi * v.astype(np.float64)
    assert np.abs(found - np.stack([np.cos(exact), np.sin(exact)], 1)).max() < 1e-6


@pytest.mark.parametrize("normal", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0.6, -0.64, -0.48)])
def test_frames_are_orthonormal(normal):
    n = np.float32(normal)
    outer = exported(to_frame)
    frame = np.array([outer(*n, *np.float32(axis)) for axis in np.eye(3)])
    assert np.allclose(frame @ frame.T, np.eye(3), atol=1e-6)
    assert np.allclose(frame[2], n, atol=1e-6)
    assert np.linalg.det(frame) == pytest.approx(1, abs=1e-5)


@kernel
def draw(kind, count, out):
    state = path_key(np.uint64(3), 5, 0, 0, 9)
    nx, ny, nz = np.float32(0.6), np.float32(-0.64), np.float32(-0.48)
    for k in range(count):
        state = next_state(state)
        u, v = uniform(state)
        if kind == 0:
            d = cosine_direction(nx, ny, nz, u, v)
        else:
            d = cone_direction(nx, ny, nz, np.float32(0.7), u, v)
        out[k, 0], out[k, 1], out[k, 2] = d[0], d[1], d[2]


@pytest.mark.parametrize("kind", [0, 1])
def test_directions_have_the_density_they_promise(kind):
    directions = np.empty((100_000, 3), np.float32)
    draw(kind, len(directions), directions)
    assert np.allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-5)
    cosine = directions @ np.float32([0.6, -0.64, -0.48])
    # cosθ/π makes cos²θ uniform on [0, 1]; uniform solid angle makes cosθ uniform on [cos α, 1].
    flat = np.sort(cosine**2 if kind == 0 else (cosine - 0.7) / 0.3)
    distance = np.abs(flat - (np.arange(len(flat)) + 0.5) / len(flat)).max()
    assert distance < 1.95 / np.sqrt(len(flat))  # Kolmogorov-Smirnov at 0.1 %
    sideways = np.cross([0.6, -0.64, -0.48], [0, 0, 1])
    assert abs((directions @ sideways).mean()) < 0.01


def test_random_numbers_depend_on_every_part_of_the_key():
    outer = exported(path_key)
    base = (np.uint64(1), 2, 3, 4, 5)
    keys = {int(outer(*base))}
    for place in range(5):
        changed = list(base)
        changed[place] = changed[place] + type(changed[place])(1)
        keys.add(int(outer(*changed)))
    assert len(keys) == 6


def test_what_only_kernels_call_says_so():
    with pytest.raises(TypeError, match="next_state is called by kernels only"):
        next_state(np.uint64(1))
