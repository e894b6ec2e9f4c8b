"""Compile, in a process of its own while tests run, kernels that they need later: Numba's cache on disk is shared.

Run by ``conftest``; nothing depends on it but time.
"""

from __future__ import annotations

import numpy as np

import luxel
from luxel.textures import codecs
from luxel.textures.bake import Baker
from luxel.textures.compressed import CompressedTextures
from luxel.textures.spec import TextureSpec


def _periodic() -> None:
    rng = np.random.default_rng(0)
    cell = luxel.Cell(np.eye(3), np.zeros(3))
    scene = luxel.Scene(luxel.Particles(rng.random((12, 3)), 0.08, cell=cell), periodic="xyz")
    few = np.arange(2, dtype=np.int32)
    for mode in ("paper", "fast"):
        Baker(scene, TextureSpec(samples=1, mode=mode)).luminance(few)
    luxel.render(scene, size=(16, 16))
    luxel.render(scene, size=(16, 16), light="pixel", samples=1)


def _compressed() -> None:
    scene = luxel.Scene(luxel.Particles(np.random.default_rng(0).random((64, 3)), 0.08))
    textures = luxel.bake(scene, samples=1)
    for kind, how in (("cpca", {"payload_bytes": 4}), ("vq", {"codewords": 8}), ("pca", {"components": 4})):
        compressed = CompressedTextures.of(textures, codecs.train(kind, textures.codes, **how))
        for antialias in (1, 3):
            luxel.render(scene, None, compressed, (16, 16), antialias=antialias)


if __name__ == "__main__":
    _compressed()  # wanted first
    _periodic()
