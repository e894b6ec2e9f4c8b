"""Image: a picture, and how it gets into a file."""

from __future__ import annotations

import io
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from luxel.errors import InputError, MissingFileError

__all__ = ["Image", "check_output"]

_FORMATS = {
    ".png": "PNG",
    ".jpg": "JPEG",
    ".jpeg": "JPEG",
    ".webp": "WEBP",
    ".tif": "TIFF",
    ".tiff": "TIFF",
    ".bmp": "BMP",
}
_OPAQUE = {"JPEG", "BMP"}  # formats without transparency


@dataclass(frozen=True, eq=False)
class Image:
    """A rendered picture.

    Parameters
    ----------
    pixels
        (H, W, 3) or (H, W, 4) uint8 sRGB, the first row on top; alpha is not premultiplied.
    ids
        (H, W) int32: the particle in each pixel's centre, -1 where there is none; None if not kept.
    depth
        (H, W) float32: distance along the ray in file units, inf where there is nothing; None if not kept.

    Raises
    ------
    InputError
        For other shapes or dtypes.
    """

    pixels: NDArray[np.uint8]
    ids: NDArray[np.int32] | None = None
    depth: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        pixels = self.pixels
        if (
            not isinstance(pixels, np.ndarray)
            or pixels.dtype != np.uint8
            or pixels.ndim != 3
            or pixels.shape[2] not in (3, 4)
        ):
            given = f"{getattr(pixels, 'dtype', type(pixels).__name__)} {getattr(pixels, 'shape', '')}"
            raise InputError(f"pixels must be uint8 of shape (H, W, 3) or (H, W, 4), got {given}")
        for name in ("ids", "depth"):
            plane = getattr(self, name)
            if plane is not None and plane.shape != pixels.shape[:2]:
                raise InputError(
                    f"{name} must have the picture's shape {pixels.shape[:2]}, got {plane.shape}"
                )

    @property
    def array(self) -> NDArray[np.uint8]:
        """The pixels, (H, W, 3) or (H, W, 4) uint8."""
        return self.pixels

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        height, width = self.pixels.shape[:2]
        return width, height

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the picture; the suffix says how: .png, .jpg, .webp, .tif or .bmp.

        A file that is there already is replaced only once the new one is complete.

        Raises
        ------
        InputError
            For an unknown suffix, or a place that cannot be written.
        MissingFileError
            If there is no such directory.
        """
        target, kind = check_output(path)
        encoded = self._encoded(kind)
        draft = target.with_name(f".{target.name}.{os.getpid()}.part")
        try:
            draft.write_bytes(encoded)
            os.replace(draft, target)
        except OSError as error:
            draft.unlink(missing_ok=True)
            raise InputError(f"{target}: cannot write it ({error.strerror or error})") from error

    def _repr_png_(self) -> bytes:
        return self._encoded("PNG")

    def _encoded(self, kind: str) -> bytes:
        from PIL import Image as Pillow

        picture = Pillow.fromarray(self.pixels)
        if kind in _OPAQUE and picture.mode == "RGBA":
            picture = Pillow.alpha_composite(Pillow.new("RGBA", picture.size, "white"), picture).convert(
                "RGB"
            )
        buffer = io.BytesIO()
        if kind == "JPEG":
            # Colour at full resolution: half of it would smear colour maps over single particles.
            picture.save(buffer, kind, quality=95, subsampling=0)
        else:
            picture.save(buffer, kind)
        return buffer.getvalue()


def check_output(path: str | os.PathLike[str]) -> tuple[Path, str]:
    """Return the path and Pillow's name of its format, or say why a picture cannot be written there.

    Writes nothing; callers ask before they spend minutes on a picture.

    Raises
    ------
    InputError
        For an unknown suffix, or a place that cannot be written.
    MissingFileError
        If there is no such directory.
    """
    target = Path(path)
    kind = _FORMATS.get(target.suffix.lower())
    if kind is None:
        given = (
            f"the suffix {target.suffix!r} is no picture format"
            if target.suffix
            else "the name has no suffix"
        )
        raise InputError(f"{target}: {given} — use one of {', '.join(_FORMATS)}")
    try:
        _check_place(target)
    except OSError as error:  # a name too long, a folder that may not be entered
        if isinstance(error, MissingFileError):
            raise
        raise InputError(f"{target}: cannot write there ({error.strerror or error})") from error
    return target, kind


def _check_place(target: Path) -> None:
    folder = target.parent
    if target.is_dir():
        raise InputError(f"{target}: this is a directory — give the name of a file")
    if not folder.exists():
        raise MissingFileError(f"{target}: there is no directory {folder} — make it first")
    if not folder.is_dir():
        raise InputError(f"{target}: {folder} is not a directory")
    if not os.access(folder, os.W_OK) or (target.exists() and not os.access(target, os.W_OK)):
        raise InputError(f"{target}: no permission to write there")
