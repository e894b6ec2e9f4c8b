"""luxel: global illumination on particles.

>>> import luxel
>>> series = luxel.open("dump.lammpstrj")
>>> scene = luxel.Scene(series[0])
>>> luxel.render(scene, luxel.View(color_by="stress")).save("picture.png")
"""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.1.0"

# Loaded on first use, so that `import luxel` stays fast: name -> module that defines it.
_HOMES = {
    "Baked": "luxel.textures.store.reader",
    "Camera": "luxel.scene.camera",
    "Cell": "luxel.particles",
    "CodecChoice": "luxel.textures.store.layout",
    "Cut": "luxel.scene.hiding",
    "Lighting": "luxel.scene.saved",
    "Frames": "luxel.picture.frames",
    "LuminanceTextures": "luxel.textures.textures",
    "LuxelError": "luxel.errors",
    "Particles": "luxel.particles",
    "QuadLight": "luxel.scene.lights",
    "SavedView": "luxel.scene.saved",
    "Scene": "luxel.scene.scene",
    "Select": "luxel.scene.hiding",
    "Series": "luxel.io",
    "Session": "luxel.session",
    "Sky": "luxel.scene.lights",
    "SphereLight": "luxel.scene.lights",
    "Sun": "luxel.scene.lights",
    "TextureSpec": "luxel.textures.spec",
    "View": "luxel.scene.view",
    "bake": "luxel.textures.bake",
    "bake_to": "luxel.textures.store.bake",
    "export": "luxel.app.export",
    "encode_to": "luxel.textures.store.bake",
    "open": "luxel.io",
    "open_baked": "luxel.textures.store.reader",
    "render": "luxel.picture.raytrace",
    "texel_directions": "luxel.light.mapping",
    "texel_solid_angles": "luxel.light.mapping",
    "view": "luxel.app.viewer",
}

__all__ = sorted([*_HOMES, "__version__"])


def __getattr__(name: str) -> Any:
    try:
        module = _HOMES[name]
    except KeyError:
        raise AttributeError(f"module 'luxel' has no attribute {name!r}") from None
    value = getattr(importlib.import_module(module), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
