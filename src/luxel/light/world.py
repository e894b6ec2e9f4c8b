"""A scene made ready for light kernels: tree, packed lights, model."""

from __future__ import annotations

import numpy as np

from luxel.errors import InputError
from luxel.kernels import path
from luxel.light.lights import pack_lights
from luxel.light.periodic import make_periodic
from luxel.scene.scene import Scene
from luxel.trace.spheres import SphereSet
from luxel.trace.tree import SphereTree

__all__ = ["make_world"]

_MODELS = {
    "lambertian": path.LAMBERTIAN,
    "shadows": path.SHADOWS,
    "ao": path.AO,
    "interreflection": path.INTERREFLECTION,
}
_NO_LIMIT = np.float32(1e30)
_UNLIMITED_BOUNCES = 2**31 - 1


def make_world(
    scene: Scene,
    *,
    seed: int = 0,
    max_bounces: int | None = None,
    tree: SphereTree | None = None,
    ghost_reach: float | None = None,
) -> path.World:
    """Return what light kernels take; reuses `tree` when it was built for the same particles, none of them hidden.

    `ghost_reach` matters to periodic scenes only, see :func:`luxel.light.periodic.make_periodic`.
    """
    if not 0 <= seed < 2**63:
        raise InputError(f"seed must be a whole number in 0..2^63-1, got {seed}")
    spheres = SphereSet.of(scene.particles)
    if tree is None or tree.spheres is not spheres or scene.hidden is not None:
        tree = SphereTree.of(spheres, scene.hidden)
    reach = _NO_LIMIT
    if scene.model == "ao" and scene.ao_distance is not None:
        reach = np.float32(spheres.length_to_unit(scene.ao_distance))
    arrays, cell = tree.arrays, None
    if scene.axes:
        cell = make_periodic(scene, ghost_reach)
        # Whoever makes room for rays in the tree of pictures makes room for light's tree too.
        arrays = arrays._replace(stack_size=max(arrays.stack_size, cell.tree.stack_size))
    return path.World(
        arrays,
        pack_lights(scene, spheres),
        spheres.centers,
        spheres.radii,
        _MODELS[scene.model],
        np.float32(scene.albedo),
        reach,
        _UNLIMITED_BOUNCES if max_bounces is None else max_bounces,
        np.uint64(seed),
        np.float32(1),  # as in the paper; `light.fast` keeps more
        cell,
    )
