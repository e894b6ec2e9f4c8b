"""Embree, called from Numba, as an independent tracer: the twin of our tree in tests, the yardstick in benchmarks."""

from __future__ import annotations

import ctypes
import glob
import os

import embreex
import numba as nb
import numpy as np
from llvmlite import binding
from numba.extending import intrinsic

_SPHERE_POINT, _VERTEX, _FLOAT4 = 50, 1, 0x9004
_FLOATS = 32  # of an RTCRayHit, padded

_folder = os.path.dirname(embreex.__file__)
_libraries = glob.glob(os.path.join(_folder + ".libs", "*")) + glob.glob(
    os.path.join(_folder, ".dylibs", "*")
)
ctypes.CDLL(next(p for p in _libraries if "libtbb" in p and "malloc" not in p), ctypes.RTLD_GLOBAL)
_path = next(p for p in _libraries if "libembree4" in p)
_embree = ctypes.CDLL(_path, ctypes.RTLD_GLOBAL)
binding.load_library_permanently(_path)

_pointer = ctypes.c_void_p
for _name, _result, _arguments in (
    ("rtcNewDevice", _pointer, [ctypes.c_char_p]),
    ("rtcNewScene", _pointer, [_pointer]),
    ("rtcNewGeometry", _pointer, [_pointer, ctypes.c_int]),
    (
        "rtcSetSharedGeometryBuffer",
        None,
        [
            _pointer,
            ctypes.c_int,
            ctypes.c_uint,
            ctypes.c_int,
            _pointer,
            ctypes.c_size_t,
            ctypes.c_size_t,
            ctypes.c_size_t,
        ],
    ),
    ("rtcCommitGeometry", None, [_pointer]),
    ("rtcAttachGeometry", ctypes.c_uint, [_pointer, _pointer]),
    ("rtcCommitScene", None, [_pointer]),
):
    getattr(_embree, _name).restype = _result
    getattr(_embree, _name).argtypes = _arguments


class EmbreeScene:
    """Sphere points in Embree; `isa` (for example ``"avx2"``) limits the instruction set."""

    def __init__(self, centers: np.ndarray, radii: np.ndarray, *, threads: int = 0, isa: str = "") -> None:
        options = f"threads={threads}" + (f",isa={isa}" if isa else "")
        self._device = _embree.rtcNewDevice(options.encode())
        self.handle = _embree.rtcNewScene(self._device)
        geometry = _embree.rtcNewGeometry(self._device, _SPHERE_POINT)
        self._vertices = np.zeros((len(centers) + 1, 4), np.float32)
        self._vertices[:-1, :3] = centers
        self._vertices[:-1, 3] = radii
        _embree.rtcSetSharedGeometryBuffer(
            geometry, _VERTEX, 0, _FLOAT4, self._vertices.ctypes.data, 0, 16, len(centers)
        )
        _embree.rtcCommitGeometry(geometry)
        _embree.rtcAttachGeometry(self.handle, geometry)
        self.commit()

    def commit(self) -> None:
        """Build the hierarchy (what a construction benchmark times)."""
        _embree.rtcCommitScene(self.handle)


_voidptr = nb.types.voidptr
_intersect1 = nb.types.ExternalFunction("rtcIntersect1", nb.void(nb.uint64, _voidptr, nb.uint64))
_occluded1 = nb.types.ExternalFunction("rtcOccluded1", nb.void(nb.uint64, _voidptr, nb.uint64))
_intersect16 = nb.types.ExternalFunction("rtcIntersect16", nb.void(_voidptr, nb.uint64, _voidptr, nb.uint64))


@intrinsic
def _address(typingctx, array):
    def emit(context, builder, sig, args):
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        return builder.bitcast(data, context.get_value_type(_voidptr))

    return _voidptr(array), emit


@nb.njit
def _aligned(floats):
    raw = np.empty(floats + 16, np.float32)
    start = ((64 - raw.ctypes.data % 64) % 64) // 4
    return raw[start : start + floats]


@nb.njit(nogil=True)
def trace_rays(scene, origins, directions, any_hit, distance, ids):
    """Trace (M, 3) rays one by one; infinite and -1 for a miss."""
    ray = _aligned(_FLOATS)
    words = ray.view(np.uint32)
    pointer = _address(ray)
    none = np.uint32(0xFFFFFFFF)
    for k in range(len(origins)):
        for a in range(3):
            ray[a], ray[4 + a] = origins[k, a], directions[k, a]
        ray[3], ray[7], ray[8] = 0, 0, np.float32(np.inf)
        words[9], words[10], words[11], words[18] = none, 0, 0, none
        if any_hit:
            _occluded1(scene, pointer, 0)
            hit = ray[8] < 0
            ids[k] = 0 if hit else -1
            distance[k] = 0 if hit else np.inf
        else:
            _intersect1(scene, pointer, 0)
            hit = words[18] != none
            ids[k] = np.int32(words[17]) if hit else -1
            distance[k] = ray[8] if hit else np.inf


@nb.njit(nogil=True)
def primary_rays(scene, origin, right, up, forward, width, height, first_row, last_row, ids):
    """Trace a perspective picture in packets of 4 x 4 coherent rays."""
    valid = _aligned(16).view(np.int32)
    valid[:] = -1
    packet = _aligned(16 * 24)
    words = packet.view(np.uint32)
    pointer, mask = _address(packet), _address(valid)
    none = np.uint32(0xFFFFFFFF)
    for y in range(first_row, last_row, 4):
        for x in range(0, width, 4):
            for j in range(16):
                sx = (np.float32(x + (j & 3)) + np.float32(0.5)) / np.float32(width) * np.float32(
                    2
                ) - np.float32(1)
                sy = np.float32(1) - (np.float32(y + (j >> 2)) + np.float32(0.5)) / np.float32(
                    height
                ) * np.float32(2)
                dx = forward[0] + sx * right[0] + sy * up[0]
                dy = forward[1] + sx * right[1] + sy * up[1]
                dz = forward[2] + sx * right[2] + sy * up[2]
                s = np.float32(1) / np.sqrt(dx * dx + dy * dy + dz * dz)
                packet[j], packet[16 + j], packet[32 + j], packet[48 + j] = origin[0], origin[1], origin[2], 0
                packet[64 + j], packet[80 + j], packet[96 + j], packet[112 + j] = dx * s, dy * s, dz * s, 0
                packet[128 + j] = np.float32(np.inf)
                words[144 + j], words[160 + j], words[176 + j] = none, 0, 0
                words[272 + j], words[288 + j] = none, none
            _intersect16(mask, scene, pointer, 0)
            for j in range(16):
                ids[y + (j >> 2), x + (j & 3)] = np.int32(words[272 + j]) if words[288 + j] != none else -1
