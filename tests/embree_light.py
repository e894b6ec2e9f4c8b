"""Luminance textures traced with Embree, one ray at a time: twin of ``paper`` mode in tests, yardstick in benchmarks.

The same estimator, random numbers and compiler flags as ``kernels.path``; only the rays are Embree's. Embree cannot leave
a sphere out, so rays start a hair above their own; a ray that starts inside a neighbour meets that neighbour's far side.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np

import luxel
from luxel.kernels.jit import kernel
from luxel.kernels.light import escape_radiance
from luxel.kernels.mapping import LATLONG, texel_direction
from luxel.kernels.path import AO
from luxel.kernels.rng import PURPOSE_TEXEL, next_state, path_key, uniform
from luxel.kernels.warp import cone_direction, cosine_direction
from luxel.light.world import make_world
from luxel.trace.tree import thread_count
from tests.embree_twin import _FLOATS, EmbreeScene, _address, _aligned, _intersect1, _occluded1

_ZERO, _ONE, _TWO = np.float32(0), np.float32(1), np.float32(2)
_LIFT = np.float32(1e-4)  # of a radius
_PATIENCE, _SURVIVAL = 16, np.float32(0.95)  # of the roulette, as in kernels.path
_NONE = np.uint32(0xFFFFFFFF)


@kernel
def _aim(ray, words, px, py, pz, dx, dy, dz, limit):
    ray[0], ray[1], ray[2], ray[3] = px, py, pz, _ZERO
    ray[4], ray[5], ray[6], ray[7] = dx, dy, dz, _ZERO
    ray[8] = limit
    words[9], words[10], words[11], words[18] = _NONE, 0, 0, _NONE


@kernel
def _suns(scene, lights, ray, words, pointer, px, py, pz, nx, ny, nz, state):
    """One-sample estimate of the suns' light; returns (luminance, state, rays)."""
    total, rays = _ZERO, 0
    for k in range(lights.suns.shape[0]):
        s = lights.suns[k]
        state = next_state(state)
        u, v = uniform(state)
        dx, dy, dz = cone_direction(s[0], s[1], s[2], s[5], u, v)
        c = nx * dx + ny * dy + nz * dz
        if c > 0:
            _aim(ray, words, px, py, pz, dx, dy, dz, np.float32(np.inf))
            _occluded1(scene, pointer, 0)
            rays += 1
            if not ray[8] < 0:
                total += s[3] * c * _TWO / (_ONE + s[5])
    return total, state, rays


@kernel
def _luminance(scene, world, ray, words, pointer, px, py, pz, nx, ny, nz, state):
    """Return (luminance, rays) of one path, as ``kernels.path.luminance_at``: negative where the point is buried."""
    lights = world.lights
    total, weight = _ZERO, _ONE
    bounces = rays = 0
    while True:
        state = next_state(state)
        u, v = uniform(state)
        dx, dy, dz = cosine_direction(nx, ny, nz, u, v)
        _aim(ray, words, px, py, pz, dx, dy, dz, np.float32(np.inf))
        _intersect1(scene, pointer, 0)
        rays += 1
        missed = words[18] == _NONE
        hit, t = np.int64(words[17]), ray[8]
        gx, gy, gz = ray[12], ray[13], ray[14]
        if not missed and gx * dx + gy * dy + gz * dz > 0:
            return (-_ONE if bounces == 0 else total), rays
        direct, state, more = _suns(scene, lights, ray, words, pointer, px, py, pz, nx, ny, nz, state)
        rays += more
        total += weight * direct
        if missed:
            return total + weight * escape_radiance(lights, px, py, pz, dx, dy, dz), rays
        if bounces == world.max_bounces:
            return total, rays
        bounces += 1
        weight *= world.albedo
        survival = min(weight, _ONE if bounces <= _PATIENCE else _SURVIVAL)
        state = next_state(state)
        u, v = uniform(state)
        if u >= survival:
            return total, rays
        weight /= survival
        cx, cy, cz = world.centers[hit, 0], world.centers[hit, 1], world.centers[hit, 2]
        nx, ny, nz = px + t * dx - cx, py + t * dy - cy, pz + t * dz - cz
        scale = _ONE / np.sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz = nx * scale, ny * scale, nz * scale
        r = world.radii[hit] * (_ONE + _LIFT)
        px, py, pz = cx + r * nx, cy + r * ny, cz + r * nz


@kernel
def sample_texels(scene, world, ids, grid, total, exposed):
    """Sum of grid × grid samples a texel and how many were not buried, (K, T, T) each; returns the number of rays."""
    ray = _aligned(_FLOATS)
    words = ray.view(np.uint32)
    pointer = _address(ray)
    texels = total.shape[1]
    step = _ONE / np.float32(texels * grid)
    rays = 0
    for k in range(ids.shape[0]):
        sphere = ids[k]
        r = world.radii[sphere] * (_ONE + _LIFT)
        cx, cy, cz = world.centers[sphere, 0], world.centers[sphere, 1], world.centers[sphere, 2]
        for row in range(texels):
            for column in range(texels):
                light = 0.0
                seen = 0
                for s in range(grid * grid):
                    state = path_key(world.seed, sphere, row * texels + column, s, PURPOSE_TEXEL)
                    ju, jv = uniform(state)
                    u = (np.float32(column * grid + s % grid) + ju) * step
                    v = (np.float32(row * grid + s // grid) + jv) * step
                    nx, ny, nz = texel_direction(LATLONG, u, v)
                    px, py, pz = cx + r * nx, cy + r * ny, cz + r * nz
                    if world.model == AO:
                        state = next_state(state)
                        u, v = uniform(state)
                        dx, dy, dz = cosine_direction(nx, ny, nz, u, v)
                        _aim(ray, words, px, py, pz, dx, dy, dz, world.reach)
                        _occluded1(scene, pointer, 0)
                        rays += 1
                        seen += 1
                        light += 0.0 if ray[8] < 0 else 1.0
                    else:
                        value, more = _luminance(
                            scene, world, ray, words, pointer, px, py, pz, nx, ny, nz, state
                        )
                        rays += more
                        if value >= 0:
                            light += value
                            seen += 1
                total[k, row, column] = light
                exposed[k, row, column] = seen
    return rays


class EmbreeBaker:
    """Textures of a scene under a sky and suns, in model ``ao`` or ``interreflection``; nothing is rounded to 8 bits."""

    def __init__(
        self, scene: luxel.Scene, *, seed: int = 0, threads: int | None = None, isa: str = ""
    ) -> None:
        self._world = make_world(scene, seed=seed)
        lights = self._world.lights
        if scene.model not in ("ao", "interreflection") or len(lights.globes) + len(lights.quads):
            raise ValueError("the yardstick knows sky and suns, ambient occlusion and interreflection")
        self._threads = thread_count(threads)
        self._embree = EmbreeScene(self._world.centers, self._world.radii, threads=self._threads, isa=isa)

    def sample(self, ids: np.ndarray, samples: int, texels: int = 16) -> tuple[np.ndarray, np.ndarray, int]:
        """Return the sum of the samples (K, T, T), how many were not buried (K, T, T), and the number of rays.

        In model ``ao`` buried samples are black and count as exposed: one ray cannot tell.
        """
        total = np.empty((len(ids), texels, texels), np.float32)
        exposed = np.empty(total.shape, np.uint32)
        grid = round(samples**0.5)

        # Particle by particle: larger batches of a few dozen particles leave threads idle at the end.
        def part(start: int) -> int:
            stop = start + 1
            return int(
                sample_texels(
                    self._embree.handle,
                    self._world,
                    ids[start:stop],
                    grid,
                    total[start:stop],
                    exposed[start:stop],
                )
            )

        with ThreadPoolExecutor(self._threads) as pool:
            rays = sum(pool.map(part, range(len(ids))))
        return total, exposed, rays
