"""Compile kernels ahead, on two cores: Numba compiles one function at a time in a process, but processes share its cache."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import TYPE_CHECKING

from luxel.kernels.jit import warmed

if TYPE_CHECKING:
    from luxel.scene.scene import Scene

__all__ = ["compile_ahead"]


def compile_ahead() -> None:
    """Compile what bakes and pictures need, in two processes at once; what they leave out is compiled when it is called."""
    if (os.cpu_count() or 1) < 2:
        return
    command = [sys.executable, "-m", "luxel.app.warm"]
    null = subprocess.DEVNULL
    parts = [subprocess.Popen([*command, part], stdout=null, stderr=null) for part in ("light", "picture")]
    try:
        for part in parts:
            part.wait()
        warmed()
    finally:
        for part in parts:
            part.terminate()


def _light() -> None:
    import numpy as np

    from luxel.textures.bake import Baker
    from luxel.textures.spec import TextureSpec

    baker = Baker(_scene(10), TextureSpec(samples=1, mode="fast"))
    baker.luminance(np.arange(4, dtype=np.int32))


def _picture() -> None:
    import numpy as np

    from luxel.kernels.path import path_tail
    from luxel.kernels.tree_trace import scratch
    from luxel.light.denoise import TextureFilter
    from luxel.light.in_view import Gaze, texels_looked_at
    from luxel.light.sampling import Drawn, Samples
    from luxel.light.world import make_world
    from luxel.picture.raytrace import render

    scene = _scene(2)
    world = make_world(scene)
    # First what the other process will want in a while, and then finds in the cache.
    zero = np.float32(0)
    work = scratch(world.tree.stack_size)
    path_tail(world, work, np.int32(0), zero, zero, zero, (zero, zero, zero), np.uint64(0))
    shape = (64, 16, 16)
    noise = np.random.default_rng(0).random(shape).astype(np.float32)
    drawn = Drawn(Samples(noise, noise, np.ones(shape, np.uint32)), None)
    TextureFilter.learn(drawn, drawn, drawn, "latlong")
    render(scene.with_changes(model="lambertian"), size=(16, 16), threads=1)
    shown = np.ones(len(scene.particles), np.uint8)
    texels_looked_at(
        world, "latlong", 4, np.arange(2, dtype=np.int32), Gaze(np.zeros((1, 3), np.float32), shown)
    )


def _scene(side: int) -> Scene:
    import numpy as np

    from luxel.particles import Particles
    from luxel.scene.scene import Scene

    at = np.stack(np.meshgrid(range(side), range(side), [0], indexing="ij"), -1).reshape(-1, 3)
    return Scene(Particles(at.astype(float), 0.4))


if __name__ == "__main__":
    {"light": _light, "picture": _picture}[sys.argv[1]]()
