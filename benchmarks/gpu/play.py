"""Plays what the page's renderer asked WebGL for on a real graphics processor, checks the pictures, and takes the time.

Imports nothing but NumPy and the standard library, so that it runs where luxel is not installed.
"""

from __future__ import annotations

import ctypes
import json
import statistics
import struct
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.gpu.gles import GLES

Row = dict[str, Any]
Step = Callable[[], object]

_COMPILE_STATUS, _LINK_STATUS, _FRAMEBUFFER, _FRAMEBUFFER_COMPLETE = 0x8B81, 0x8B82, 0x8D40, 0x8CD5
_RGBA, _RGBA_INTEGER, _UNSIGNED_BYTE, _UNSIGNED_INT = 0x1908, 0x8D99, 0x1401, 0x1405
_POINT_SIZE_RANGE, _MAP_READ = 0x846D, 1
_SAME_MIN, _LEVELS_MAX = 0.99, 2.0  # as tests hold the page to the ray tracer
# What has not been trained, and the pictures that it must equal.
_SAME = {"raw": "vq", "tiles": "vq"}


class Player:
    """Turns calls of WebGL into calls of OpenGL ES.

    Parameters
    ----------
    gl
        Where to draw.
    data
        By name, the bytes that calls hand over.
    objects
        How many objects the calls make.
    """

    def __init__(self, gl: GLES, data: dict[str, NDArray[np.uint8]], objects: int) -> None:
        self._gl = gl
        self._data = data
        self._made: list[Any] = [0] * objects
        self._kept: list[Any] = []  # arrays that prepared calls point into

    def name(self, number: int) -> int:
        """Return what OpenGL calls an object."""
        return int(self._made[number])

    def play(self, calls: list[list[Any]]) -> None:
        """Play calls one by one: some make objects that the next ones need."""
        for call in calls:
            self.prepared(call)()

    def prepared(self, call: list[Any]) -> Step:
        """Return a call with its arguments in place, so that playing it costs next to nothing."""
        name, arguments, *made = call
        special = getattr(self, f"_{name}", None)
        if special is not None:
            return special(*arguments, *made)  # type: ignore[no-any-return]
        if name.startswith("create") and name not in ("createShader", "createProgram"):
            return self._generated(name.removeprefix("create"), made[0])
        if name.startswith("delete"):
            return self._deleted(name.removeprefix("delete"), arguments[0])
        function = getattr(self._gl, name[0].upper() + name[1:])
        values = [self._plain(argument) for argument in arguments]
        if not made:
            return lambda: function(*values)
        return lambda: self._set(made[0], function(*values))

    def _set(self, number: int, value: Any) -> None:
        self._made[number] = value

    def _plain(self, value: Any) -> Any:
        if value is None:
            return 0
        if isinstance(value, dict):
            return self._made[value["object"]] if "object" in value else self._pointer(value["data"])
        return self._numbers(value) if isinstance(value, list) else value

    def _pointer(self, place: list[Any]) -> int:
        name, offset, length = place
        data = self._data[name]
        if offset + length > data.nbytes:
            raise ValueError(f"{name} has {data.nbytes} bytes where a call reads up to {offset + length}")
        return int(data.ctypes.data) + int(offset)

    def _numbers(self, values: list[float], dtype: Any = np.uint32) -> int:
        array = np.array(values, dtype)
        self._kept.append(array)
        return int(array.ctypes.data)

    def _generated(self, kind: str, number: int) -> Step:
        made = ctypes.c_uint()
        generate = getattr(self._gl, "GenVertexArrays" if kind == "VertexArray" else f"Gen{kind}s")

        def step() -> None:
            generate(1, ctypes.addressof(made))
            self._made[number] = made.value

        return step

    def _deleted(self, kind: str, what: dict[str, int] | None) -> Step:
        if what is None:
            return lambda: None
        if kind == "Sync":
            return lambda: self._gl.DeleteSync(self._made[what["object"]])
        delete = getattr(self._gl, f"Delete{kind}s")
        return lambda: delete(1, self._numbers([self._made[what["object"]]]))

    def _shaderSource(self, shader: dict[str, int], text: str) -> Step:  # noqa: N802
        source = ctypes.c_char_p(text.encode())
        self._kept.append(source)
        return lambda: self._gl.ShaderSource(self._made[shader["object"]], 1, ctypes.addressof(source), None)

    def _compileShader(self, shader: dict[str, int]) -> Step:  # noqa: N802
        def step() -> None:
            name = self._made[shader["object"]]
            self._gl.CompileShader(name)
            self._check(self._gl.GetShaderiv, _COMPILE_STATUS, self._gl.GetShaderInfoLog, name)

        return step

    def _linkProgram(self, program: dict[str, int]) -> Step:  # noqa: N802
        def step() -> None:
            name = self._made[program["object"]]
            self._gl.LinkProgram(name)
            self._check(self._gl.GetProgramiv, _LINK_STATUS, self._gl.GetProgramInfoLog, name)

        return step

    def _check(self, ask: Any, what: int, log: Any, name: int) -> None:
        good = ctypes.c_int()
        ask(name, what, ctypes.addressof(good))
        if not good.value:
            text = ctypes.create_string_buffer(8192)
            log(name, len(text), None, ctypes.addressof(text))
            raise RuntimeError(f"a shader is not accepted: {text.value.decode(errors='replace')}")

    def _getUniformLocation(self, program: dict[str, int], name: str, number: int) -> Step:  # noqa: N802
        return lambda: self._set(
            number, self._gl.GetUniformLocation(self._made[program["object"]], ctypes.c_char_p(name.encode()))
        )

    def _uniform4fv(self, place: dict[str, int], values: dict[str, list[Any]]) -> Step:
        pointer, count = self._pointer(values["data"]), values["data"][2] // 16
        return lambda: self._gl.Uniform4fv(self._made[place["object"]], count, pointer)

    def _uniformMatrix3fv(self, place: dict[str, int], flipped: int, values: dict[str, list[Any]]) -> Step:  # noqa: N802
        pointer = self._pointer(values["data"])
        return lambda: self._gl.UniformMatrix3fv(self._made[place["object"]], 1, flipped, pointer)

    def _clearBufferfv(self, buffer: int, index: int, values: list[float]) -> Step:  # noqa: N802
        pointer = self._numbers(values, np.float32)
        return lambda: self._gl.ClearBufferfv(buffer, index, pointer)

    def _drawBuffers(self, buffers: list[int]) -> Step:  # noqa: N802
        pointer = self._numbers(buffers)
        return lambda: self._gl.DrawBuffers(len(buffers), pointer)

    def _bufferData(self, target: int, data: Any, use: int) -> Step:  # noqa: N802
        size = data["data"][2] if isinstance(data, dict) else data
        pointer = self._pointer(data["data"]) if isinstance(data, dict) else None
        return lambda: self._gl.BufferData(target, size, pointer, use)

    def _getBufferSubData(self, target: int, offset: int, into: dict[str, list[Any]]) -> Step:  # noqa: N802
        size = into["data"][2]
        copy = (ctypes.c_uint8 * size)()

        def step() -> None:
            mapped = self._gl.MapBufferRange(target, offset, size, _MAP_READ)
            ctypes.memmove(copy, mapped, size)
            self._gl.UnmapBuffer(target)

        return step


def play(path: Path, frames: int, device: int | None = None, picture: Path | None = None) -> Iterator[Row]:
    """Play a file of `prepare`; yield a row for each way to draw spheres and each representation of light.

    A row says under "trouble" what is wrong, if anything is: errors of OpenGL, or pictures that are not the ray tracer's.

    Parameters
    ----------
    frames
        How many are timed, of the orbit's sixty.
    picture
        Where to save what is seen first, one PNG a row: its stem is the prefix of their names. None saves nothing.
    """
    file = np.load(path)
    calls = json.loads(file["calls"].tobytes())
    data = {"blobs": file["blobs"], **_unpacked(file, calls["points"]["sizes"])}
    gl = GLES(device)
    sizes = (ctypes.c_float * 2)()
    gl.GetFloatv(_POINT_SIZE_RANGE, ctypes.addressof(sizes))
    width, height = (int(side) for side in file["size"])
    used = "points" if max(width, height) < sizes[1] else "quads"
    for way, recorded in calls.items():
        player = Player(gl, data, recorded["objects"])
        player.play(recorded["setup"])
        for part in recorded["parts"]:
            player.play(part["first"])
            pixels, ids = _seen(
                gl, player.name(recorded["capture"]), player.name(recorded["ids"]), width, height
            )
            if picture is not None:
                _save(picture.with_name(f"{picture.stem}-{way}-{part['name']}.png"), pixels)
            truth = file[f"picture {_SAME.get(part['name'], part['name'])}"]
            same, levels = _compare(pixels, ids, truth, file["ids"])
            seconds = _timed(
                gl, [[player.prepared(call) for call in frame] for frame in part["frames"][:frames]]
            )
            middle = statistics.median(seconds)
            yield {
                "drawn by": gl.renderer,
                "spheres as": f"{way}{' (as a page here)' if way == used else ''}",
                "light": part["name"],
                "frames/s": 1 / middle,
                "ms": 1e3 * middle,
                "slowest": 1e3 * max(seconds),
                "ids %": 100 * same,
                "levels": levels,
                "trouble": _trouble(gl, same, levels),
            }


def _unpacked(file: Any, sizes: dict[str, int]) -> dict[str, NDArray[np.uint8]]:
    """Textures that would be too large to carry: those of VQ, as a page has them raw, or as tiles of what it sees."""
    raw = file["codebook"][file["index"]]
    tiles = np.zeros(sizes["tiles"], np.uint8)
    seen = raw[file["visible"]].reshape(-1)[: len(tiles)]
    tiles[: len(seen)] = seen
    return {"raw": raw.reshape(-1), "tiles": tiles}


def _seen(
    gl: GLES, capture: int, ids: int, width: int, height: int
) -> tuple[NDArray[np.uint8], NDArray[np.int32]]:
    """Read the picture and the ids of the frame drawn last, first row on top."""
    pixels = np.empty((height, width, 4), np.uint8)
    gl.BindFramebuffer(_FRAMEBUFFER, capture)
    if gl.CheckFramebufferStatus(_FRAMEBUFFER) != _FRAMEBUFFER_COMPLETE:
        raise RuntimeError("this driver cannot draw to the page's targets")
    gl.ReadPixels(0, 0, width, height, _RGBA, _UNSIGNED_BYTE, pixels.ctypes.data)
    wide = np.empty((height, width, 4), np.uint32)
    gl.BindFramebuffer(_FRAMEBUFFER, ids)
    gl.ReadPixels(0, 0, width, height, _RGBA_INTEGER, _UNSIGNED_INT, wide.ctypes.data)
    return pixels[::-1, :, :3], wide[::-1, :, 0].astype(np.int32) - 1


def _compare(
    pixels: NDArray[np.uint8],
    ids: NDArray[np.int32],
    truth: NDArray[np.uint8],
    true_ids: NDArray[np.int32],
) -> tuple[float, float]:
    """Share of what is covered that shows the right particle, and how far it is from the ray tracer's, in levels of 255."""
    covered = (ids >= 0) | (true_ids >= 0)
    same = (ids == true_ids) & covered
    if not same.any():
        return 0.0, 255.0
    levels = np.abs(pixels.astype(np.int16) - truth)[same]
    return float(same.sum() / covered.sum()), float(levels.mean())


def _trouble(gl: GLES, same: float, levels: float) -> str:
    found = []
    while error := gl.GetError():
        found.append(f"OpenGL error {error:#x}")
    if same < _SAME_MIN or levels > _LEVELS_MAX:
        found.append("not the ray tracer's picture")
    return ", ".join(found)


def _timed(gl: GLES, frames: list[list[Step]]) -> list[float]:
    """Seconds of every frame, from its first call until the graphics processor has finished."""
    seconds = []
    gl.Finish()
    for frame in frames:
        start = time.perf_counter()
        for step in frame:
            step()
        gl.Finish()
        seconds.append(time.perf_counter() - start)
    return seconds


def _save(path: Path, pixels: NDArray[np.uint8]) -> None:
    """Write a PNG."""
    height, width, _ = pixels.shape
    rows = np.concatenate([np.zeros((height, 1), np.uint8), pixels.reshape(height, -1)], 1)

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows.tobytes(), 6)) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + body)
