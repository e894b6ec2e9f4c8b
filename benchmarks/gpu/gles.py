"""OpenGL ES 3 without a window, by ctypes: EGL hands out a context, and functions by name.

No package is needed for it, only the driver's libEGL.
"""

from __future__ import annotations

import ctypes
import ctypes.util
from collections.abc import Callable
from typing import Any

_DEVICES_MAX = 16
_PLATFORM_DEVICE = 0x313F
_ES_API = 0x30A0
_CONFIG = (0x3040, 0x40, 0x3033, 0, 0x3038)  # renderable type: ES 3; surface type: any, even none
_CONTEXT = (0x3098, 3, 0x3038)  # client version
_RENDERER = 0x1F01
_SOFTWARE = ("llvmpipe", "softpipe", "swiftshader", "swrast")

# Arguments: i an int or enum, f a float, p a pointer or an offset, s a sync; a result before the colon.
_SIGNATURES = {
    "ActiveTexture": "i", "AttachShader": "ii", "BindBuffer": "ii", "BindFramebuffer": "ii", "BindRenderbuffer": "ii",
    "BindTexture": "ii", "BindVertexArray": "i", "BlendFunc": "ii", "BufferData": "ippi", "CheckFramebufferStatus": "i:i",
    "ClearBufferfv": "iip", "ClearBufferuiv": "iip", "CompileShader": "i", "CreateProgram": "i:", "CreateShader": "i:i",
    "DeleteBuffers": "ip", "DeleteFramebuffers": "ip", "DeleteRenderbuffers": "ip", "DeleteSync": "s", "DeleteTextures": "ip",
    "DepthFunc": "i", "DepthMask": "i", "Disable": "i", "DrawArrays": "iii", "DrawBuffers": "ip", "DrawElements": "iiip",
    "Enable": "i", "FenceSync": "s:ii", "Finish": "", "Flush": "", "FramebufferRenderbuffer": "iiii",
    "FramebufferTexture2D": "iiiii", "GenBuffers": "ip", "GenFramebuffers": "ip", "GenRenderbuffers": "ip", "GenTextures": "ip",
    "GenVertexArrays": "ip", "GetError": "i:", "GetFloatv": "ip", "GetProgramInfoLog": "iipp", "GetProgramiv": "iip",
    "GetShaderInfoLog": "iipp", "GetShaderiv": "iip", "GetString": "p:i", "GetUniformLocation": "i:ip", "LinkProgram": "i",
    "MapBufferRange": "p:ippi", "PixelStorei": "ii", "ReadPixels": "iiiiiip", "RenderbufferStorage": "iiii", "Scissor": "iiii",
    "ShaderSource": "iipp", "TexParameteri": "iii", "TexStorage2D": "iiiii", "TexStorage3D": "iiiiii",
    "TexSubImage2D": "iiiiiiiip", "TexSubImage3D": "iiiiiiiiiip", "Uniform1f": "if", "Uniform1i": "ii", "Uniform2f": "iff",
    "Uniform3f": "ifff", "Uniform4f": "iffff", "Uniform4fv": "iip", "UniformMatrix3fv": "iiip", "UnmapBuffer": "i:i",
    "UseProgram": "i", "Viewport": "iiii",
}  # fmt: skip
_TYPES: dict[str, Any] = {
    "i": ctypes.c_int,
    "f": ctypes.c_float,
    "p": ctypes.c_void_p,
    "s": ctypes.c_void_p,
    "": None,
}


class GLES:
    """A current context of OpenGL ES 3, and its functions without their prefix: ``gl.DrawArrays(...)``.

    Parameters
    ----------
    device
        Which of the machine's EGL devices; None takes the first that is no software, or else the first.

    Raises
    ------
    OSError
        If there is no libEGL, or no device has OpenGL ES 3.
    """

    def __init__(self, device: int | None = None) -> None:
        self._egl = ctypes.CDLL(ctypes.util.find_library("EGL") or "libEGL.so.1")
        self._egl.eglGetProcAddress.restype = ctypes.c_void_p
        for name, signature in _SIGNATURES.items():
            result, _, arguments = signature.rpartition(":")
            function = self._function(f"gl{name}", _TYPES[result], *(_TYPES[c] for c in arguments))
            setattr(self, name, function)
        displays = self._displays()
        if device is not None:
            displays = displays[device : device + 1]
        found = [made for display in displays if (made := self._make_current(display)) is not None]
        if not found:
            raise OSError(
                f"no EGL device with OpenGL ES 3 among {len(displays)} — install a driver, or Mesa's libegl1 and libgl1-mesa-dri"
            )
        hardware = [each for each in found if not any(word in each[1].lower() for word in _SOFTWARE)]
        display, self.renderer = (hardware or found)[0]
        self._make_current(display)

    def __getattr__(self, name: str) -> Callable[..., Any]:
        raise AttributeError(f"OpenGL function gl{name} is not in the table of {__name__}")

    def _function(self, name: str, result: Any, *arguments: Any) -> Any:
        address = self._egl.eglGetProcAddress(name.encode())
        if not address:
            raise OSError(f"this libEGL has no {name}")
        return ctypes.CFUNCTYPE(result, *arguments)(address)

    def _displays(self) -> list[int]:
        pointer = ctypes.c_void_p
        try:
            query = self._function("eglQueryDevicesEXT", ctypes.c_uint, ctypes.c_int, pointer, pointer)
            display_of = self._function("eglGetPlatformDisplayEXT", pointer, ctypes.c_uint, pointer, pointer)
        except OSError:
            self._egl.eglGetDisplay.restype = pointer
            self._egl.eglGetDisplay.argtypes = [pointer]
            return [self._egl.eglGetDisplay(None)]
        devices, count = (pointer * _DEVICES_MAX)(), ctypes.c_int()
        if not query(_DEVICES_MAX, devices, ctypes.byref(count)):
            return []
        found = (display_of(_PLATFORM_DEVICE, device, None) for device in devices[: count.value])
        return [display for display in found if display]

    def _make_current(self, display: int) -> tuple[int, str] | None:
        """Make a context of a display the current one; return the display and its renderer's name."""
        egl, pointer = self._egl, ctypes.c_void_p
        egl.eglInitialize.argtypes = [pointer, pointer, pointer]
        egl.eglChooseConfig.argtypes = [pointer, pointer, pointer, ctypes.c_int, pointer]
        egl.eglCreateContext.argtypes = [pointer, pointer, pointer, pointer]
        egl.eglCreateContext.restype = pointer
        egl.eglMakeCurrent.argtypes = [pointer, pointer, pointer, pointer]
        config, count = pointer(), ctypes.c_int()
        if not (egl.eglInitialize(display, None, None) and egl.eglBindAPI(_ES_API)):
            return None
        wanted = (ctypes.c_int * len(_CONFIG))(*_CONFIG)
        if (
            not egl.eglChooseConfig(display, wanted, ctypes.byref(config), 1, ctypes.byref(count))
            or not count.value
        ):
            return None
        context = egl.eglCreateContext(display, config, None, (ctypes.c_int * len(_CONTEXT))(*_CONTEXT))
        if not context or not egl.eglMakeCurrent(display, None, None, context):
            return None
        return display, ctypes.string_at(self.GetString(_RENDERER)).decode()
