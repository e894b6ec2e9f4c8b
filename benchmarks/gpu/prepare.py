"""Makes the scene and has the page's renderer draw it on paper; what comes of it is one file that `play` plays."""

from __future__ import annotations

import json
import math
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import luxel
from benchmarks.scenes import plate
from luxel.light.lights import pack_lights, scene_white
from luxel.picture.raytrace import render, visible_ids
from luxel.textures import codecs
from luxel.textures.bake import bake
from luxel.textures.compressed import CompressedTextures
from luxel.textures.textures import decoding_table
from luxel.trace.spheres import SphereSet

_ROW = 2048  # particles: whole rows of the page's textures, so that none of its uploads is padded
_CODEWORDS = 2048
_TRAINED = 50_000  # textures that codecs are trained on
_COLOR_BY = "height"
_FRAMES = 60  # of one turn around the scene


class _Arrays:
    """Arrays one after the other in a file, described for JSON."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self._offset = 0

    def add(self, array: Any) -> dict[str, Any]:
        """Append an array; return where it is."""
        data = np.ascontiguousarray(array)
        self.parts.append(data.tobytes())
        place = {"offset": self._offset, "length": data.size, "type": data.dtype.name}
        self._offset += data.nbytes
        return place


def prepare(path: Path, count: int, size: tuple[int, int]) -> None:
    """Write all that `play` needs to `path`, an .npz file; needs Node.js."""
    particles = _plate(-(-count // _ROW) * _ROW)
    scene = luxel.Scene(particles, model="ao")
    textures = bake(scene, samples=2, mode="fast")
    cameras = _orbit(particles)
    seen = np.zeros(len(particles), np.bool_)
    for camera in cameras:
        seen[visible_ids(scene, camera, size)] = True
    arrays, spheres = _Arrays(), SphereSet.of(particles)
    view = luxel.View(camera=cameras[0], color_by=_COLOR_BY)
    lights = pack_lights(scene, spheres)
    decoding = decoding_table(textures.scale, textures.encoding)
    trained = {
        "raw": codecs.train("raw", textures.codes),
        "vq": codecs.train("vq", textures.codes[:: _step(len(particles))], codewords=_CODEWORDS),
        "pca-8": codecs.train("pca", textures.codes[:: _step(len(particles))], components=8),
        "cpca": codecs.train("cpca", textures.codes[:: _step(len(particles))], payload_bytes=8),
    }
    coded = {name: CompressedTextures.of(textures, codec) for name, codec in trained.items() if name != "raw"}
    index = coded["vq"].payload.view(np.uint16).ravel()
    described = [
        {
            "name": name,
            **codec.describe(),
            "payload_bytes": codec.payload_bytes,
            "mapping": textures.mapping,
            # Raw textures would be 256 bytes each: there they are those of VQ, unpacked.
            "payload": None if name == "raw" else arrays.add(coded[name].payload),
            "arrays": {key: arrays.add(each) for key, each in codec.shared.items()}
            | {"decoding": arrays.add(decoding)},
        }
        for name, codec in trained.items()
    ]
    low, high = spheres.bounds()
    told = {
        "count": len(particles),
        "width": size[0],
        "height": size[1],
        "reach": float(np.linalg.norm(np.maximum(-low, high))),
        "cameras": [_normalised(camera, spheres) for camera in cameras],
        "spheres": arrays.add(
            np.concatenate([spheres.centers, spheres.radii[:, None]], 1).astype(np.float32)
        ),
        "values": arrays.add(view.normalised(particles)),
        "lut": arrays.add(view.lut()),
        "lights": {name: arrays.add(getattr(lights, name)) for name in ("sky", "suns", "globes", "quads")},
        "white": scene_white(scene),
        "codecs": described,
        "visible": arrays.add(np.flatnonzero(seen).astype(np.int32)),
        "decoding": arrays.add(decoding),
        "texels": textures.codes.shape[1],
        "mapping": textures.mapping,
    }
    calls, blobs = _recorded(told, arrays)
    none = CompressedTextures.of(
        replace(textures, ids=textures.ids[:0], codes=textures.codes[:0]), trained["vq"]
    )
    truths = {
        name: render(scene, view, source, size, antialias=1, colorbar=False)
        for name, source in {"lambert": none, **coded}.items()
    }
    np.savez_compressed(
        path,
        calls=np.frombuffer(calls, np.uint8),
        blobs=np.frombuffer(blobs, np.uint8),
        index=index,
        codebook=trained["vq"].shared["codebook"],
        visible=np.flatnonzero(seen).astype(np.int32),
        size=size,
        ids=truths["vq"].ids,
        **{f"picture {name}": truth.pixels[..., :3] for name, truth in truths.items()},
    )


def _plate(count: int) -> luxel.Particles:
    """The plate with so many particles, at positions with few digits, which pack well."""
    wanted = count
    while len(found := plate(wanted)) < count:
        wanted += count // 100
    positions = np.round(found.positions[:count] * 64) / 64  # what is left out is debris
    return luxel.Particles(positions, 0.55, {_COLOR_BY: positions[:, 2]})


def _step(count: int) -> int:
    return max(1, count // _TRAINED)


def _orbit(particles: luxel.Particles) -> list[luxel.Camera]:
    """Cameras on a circle, so close that the plate fills the picture."""
    low, high = particles.bounds
    middle, size = 0.5 * (low + high), float(high[0] - low[0])
    target = np.array([middle[0], middle[1], low[2]])
    turns = [2 * math.pi * k / _FRAMES - 1.2 for k in range(_FRAMES)]
    offsets = [size * np.array([0.8 * math.cos(turn), 0.8 * math.sin(turn), 0.55]) for turn in turns]
    return [luxel.Camera(target + offset, target, fov=53.13) for offset in offsets]


def _normalised(camera: luxel.Camera, spheres: SphereSet) -> dict[str, Any]:
    """Return a camera as the page has it."""
    eye, target = spheres.to_unit(camera.eye), spheres.to_unit(camera.target)
    return {
        "eye": eye.tolist(),
        "target": target.tolist(),
        "up": np.asarray(camera.up).tolist(),
        "fov": camera.fov,
        "height": None,
    }


def _recorded(told: dict[str, Any], arrays: _Arrays) -> tuple[bytes, bytes]:
    """What the page's renderer asks WebGL for, and the data that goes with it."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "input.json").write_text(json.dumps(told))
        with (folder / "input.bin").open("wb") as file:
            file.writelines(arrays.parts)
        subprocess.run(["node", str(Path(__file__).with_name("record.js")), str(folder)], check=True)
        return (folder / "calls.json").read_bytes(), (folder / "blobs.bin").read_bytes()
