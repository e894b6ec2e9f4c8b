"""How the pictures of a movie get into files: a folder of PNGs, an animated GIF or WebP, or MP4 by ffmpeg."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from luxel.errors import InputError, MissingFileError, StorageError
from luxel.picture.image import Image

__all__ = ["MovieFile", "PngSequence", "movie_file"]

Pixels = NDArray[np.uint8]

_MANIFEST = "movie.json"
_ANIMATION_BYTES_MAX = 2 << 30  # Pillow keeps all pictures of an animation until it is written
# Encoders of ffmpeg that may be there, the best first, and how to ask them for good quality.
_ENCODERS = {
    "libx264": ("-crf", "18"),
    "libopenh264": ("-b:v", "12M"),
    "h264_videotoolbox": ("-q:v", "70"),
    "mpeg4": ("-q:v", "2"),
}
_COLORS = (
    "scale=out_color_matrix=bt709:out_range=tv,"
    "setparams=range=tv:colorspace=bt709:color_primaries=bt709:color_trc=bt709"
)


class MovieFile(Protocol):
    """Where pictures go."""

    def missing(self, count: int) -> list[int]:
        """Which of `count` pictures still have to be drawn."""
        ...

    def write(self, pictures: Iterable[tuple[int, Pixels]]) -> None:
        """Write pictures (H, W, 3) uint8 with their numbers, ascending; nothing half-written is left behind."""
        ...


def movie_file(
    path: str | os.PathLike[str], size: tuple[int, int], count: int, fps: float, about: Mapping[str, Any]
) -> MovieFile:
    """Return what writes a movie, or say why it cannot be written there, before anything is drawn.

    Parameters
    ----------
    path
        ``.mp4``, ``.gif`` or ``.webp``; anything without a suffix is a folder for PNG files.
    size, count, fps
        Of the movie.
    about
        What its pictures depend on, in plain values: pictures in a folder are kept if it is the same.

    Raises
    ------
    InputError
        For other suffixes, a place that cannot be written, a folder that holds something else, and too many pixels.
    MissingFileError
        If there is no such directory, or no ffmpeg.
    """
    target = Path(path)
    if target.is_dir() or not target.suffix:
        return PngSequence(target, about)
    kind = target.suffix.lower()
    if kind not in (".mp4", ".gif", ".webp"):
        raise InputError(
            f"{target}: the suffix {target.suffix!r} is no movie format — use .mp4, .gif, .webp, or a folder for PNGs"
        )
    if not target.parent.is_dir():
        raise MissingFileError(f"{target}: there is no directory {target.parent} — make it first")
    if not os.access(target.parent, os.W_OK):
        raise InputError(f"{target}: no permission to write there")
    if kind == ".mp4":
        return _Mp4(target, size, fps)
    nbytes = size[0] * size[1] * count * (1 if kind == ".gif" else 3)
    if nbytes > _ANIMATION_BYTES_MAX:
        raise InputError(
            f"{target}: {count} pictures of {size[0]}x{size[1]} are too much for {kind} — choose a smaller --size, fewer"
            " pictures, .mp4 or a folder"
        )
    return _Animation(target, fps)


class PngSequence:
    """A folder of numbered PNG files. Those that are complete stay when the work is interrupted, and are not drawn again."""

    def __init__(self, folder: Path, about: Mapping[str, Any]) -> None:
        self._folder = folder
        manifest = folder / _MANIFEST
        text = json.dumps(about, indent=1, sort_keys=True) + "\n"
        if not folder.parent.is_dir():
            raise MissingFileError(f"{folder}: there is no directory {folder.parent} — make it first")
        try:
            before = manifest.read_text(encoding="utf-8")
        except FileNotFoundError:
            if folder.exists() and any(folder.iterdir()):
                raise InputError(
                    f"{folder}: holds other files — give a new folder for the pictures"
                ) from None
            before = None
        except (OSError, ValueError) as error:
            raise InputError(f"{manifest}: cannot read it ({error})") from None
        if before is not None and before != text:
            raise InputError(
                f"{folder}: holds pictures of another movie (data, views, light or size differ) — delete it, or give another"
                " folder"
            )
        if before is None:
            try:
                folder.mkdir(exist_ok=True)
                manifest.write_text(text, encoding="utf-8")
            except OSError as error:
                raise InputError(f"{folder}: cannot write there ({error.strerror})") from None

    def _path(self, number: int) -> Path:
        return self._folder / f"{number:06d}.png"

    def missing(self, count: int) -> list[int]:
        """Which of `count` pictures are not there yet."""
        return [number for number in range(count) if not self._path(number).exists()]

    def write(self, pictures: Iterable[tuple[int, Pixels]]) -> None:
        """Write each picture as it comes."""
        for number, pixels in pictures:
            Image(pixels).save(self._path(number))


class _Animation:
    """An animated GIF or WebP, by Pillow."""

    def __init__(self, target: Path, fps: float) -> None:
        self._target, self._fps = target, fps

    def missing(self, count: int) -> list[int]:
        """All of them."""
        return list(range(count))

    def write(self, pictures: Iterable[tuple[int, Pixels]]) -> None:
        """Write all pictures at the end."""
        from PIL import Image as Pillow

        gif = self._target.suffix.lower() == ".gif"
        frames = [
            Pillow.fromarray(pixels).quantize(256) if gif else Pillow.fromarray(pixels)
            for _, pixels in pictures
        ]
        # In hundredths of a second in GIFs; what rounding leaves goes to the next picture.
        unit = 10 if gif else 1
        ends = [round((k + 1) * 1000 / self._fps / unit) * unit for k in range(len(frames))]
        durations = [max(unit, end - begin) for begin, end in itertools.pairwise([0, *ends])]
        options: dict[str, Any] = {
            "save_all": True,
            "append_images": frames[1:],
            "duration": durations,
            "loop": 0,
        }
        options |= {"optimize": False} if gif else {"quality": 90}
        with _draft(self._target) as draft:
            frames[0].save(draft, "GIF" if gif else "WEBP", **options)


class _Mp4:
    """An MP4, by the program ffmpeg."""

    def __init__(self, target: Path, size: tuple[int, int], fps: float) -> None:
        self._target, self._size, self._fps = target, size, fps
        program = os.environ.get("LUXEL_FFMPEG") or shutil.which("ffmpeg")
        if program is None:
            raise MissingFileError(
                f"{target}: MP4 is written by the program ffmpeg, which is not here — install it (apt, brew or conda install"
                " ffmpeg), or write .webp, .gif or a folder of PNGs"
            )
        if size[0] % 2 or size[1] % 2:
            raise InputError(f"{target}: MP4 needs an even width and height, got {size[0]}x{size[1]}")
        self._program = program
        self._encoder = self._choose()

    def _choose(self) -> str:
        try:
            listed = subprocess.run(
                [self._program, "-hide_banner", "-encoders"],
                capture_output=True,
                text=True,
                timeout=30,
                check=True,
            ).stdout.split()
        except (OSError, subprocess.SubprocessError) as error:
            raise InputError(f"{self._target}: {self._program} does not work ({error})") from None
        found = next((each for each in _ENCODERS if each in listed), None)
        if found is None:
            raise InputError(
                f"{self._target}: {self._program} knows none of the encoders {', '.join(_ENCODERS)} — install a fuller ffmpeg,"
                " or write .webp, .gif or a folder of PNGs"
            )
        return found

    def missing(self, count: int) -> list[int]:
        """All of them."""
        return list(range(count))

    def write(self, pictures: Iterable[tuple[int, Pixels]]) -> None:
        """Write each picture as it comes."""
        width, height = self._size
        with _draft(self._target) as draft, tempfile.TemporaryFile() as complaints:
            command = [
                self._program, "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}",
                "-framerate", f"{self._fps:g}", "-i", "-", "-vf", _COLORS, "-an",
                "-c:v", self._encoder, *_ENCODERS[self._encoder], "-pix_fmt", "yuv420p", "-colorspace", "bt709",
                "-color_primaries", "bt709", "-color_trc", "bt709", "-movflags", "+faststart", "-f", "mp4", str(draft),
            ]  # fmt: skip
            # In a session of its own, so that Ctrl-C reaches it through us.
            process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=complaints,
                start_new_session=True,
            )
            assert process.stdin is not None
            try:
                try:
                    for _, pixels in pictures:
                        process.stdin.write(pixels.tobytes())
                    process.stdin.close()
                except BrokenPipeError:
                    pass  # it has ended, and says why
                code = process.wait()
            finally:
                process.kill()
                process.wait()
                with contextlib.suppress(OSError):
                    process.stdin.close()
            if code != 0:
                complaints.seek(0)
                said = complaints.read().decode(errors="replace").strip().splitlines() or [f"code {code}"]
                raise StorageError(f"{self._target}: ffmpeg could not write it ({said[-1]})")


@contextlib.contextmanager
def _draft(target: Path) -> Iterator[Path]:
    """Yield a file beside the target that takes its place if all goes well."""
    draft = target.with_name(f".{target.stem}.{os.getpid()}.part{target.suffix}")
    try:
        yield draft
        os.replace(draft, target)
    except OSError as error:
        if isinstance(error, StorageError | MissingFileError):
            raise
        raise StorageError(f"{target}: cannot write it ({error.strerror or error})") from error
    finally:
        draft.unlink(missing_ok=True)
