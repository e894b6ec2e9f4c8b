"""`bake_to`: bake into a store, interruptible at any moment; `encode_to`: the same light under another codec."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import luxel
from luxel.errors import FormatError, FrameError, InputError, StorageError
from luxel.particles import Particles
from luxel.scene.lights import Light, Up
from luxel.scene.scene import Model, Scene
from luxel.textures.bake import Baker, bake_with
from luxel.textures.spec import TextureSpec
from luxel.textures.store.arrays import write_group
from luxel.textures.store.files import LOCK_NAME, lock, remove_drafts, remove_tree
from luxel.textures.store.layout import FORMAT, VERSION, BakeSettings, CodecChoice, differences
from luxel.textures.store.reader import Baked, check_header, open_baked
from luxel.textures.store.writer import FrameWriter, Progress, read_attributes

__all__ = ["bake_to", "chosen_frames", "encode_to"]

_CHUNK = 4096  # particles: 1 MB of texels, and seconds of light


def bake_to(
    path: str | os.PathLike[str],
    target: Sequence[Particles] | Particles | Scene,
    *,
    frames: Sequence[int] | None = None,
    lights: Sequence[Light] | None = None,
    model: Model = "interreflection",
    albedo: float = 0.7,
    ao_distance: float | None = None,
    periodic: str | Sequence[bool] = "",
    up: Up = "z",
    spec: TextureSpec | None = None,
    codec: str | CodecChoice = "raw",
    keep_raw: bool = False,
    chunk: int = _CHUNK,
    overwrite: bool = False,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Baked:
    """Bake the textures of all particles into a store on disk, or go on with a bake that was interrupted.

    Whatever ends the process, chunks that were finished are kept: the same call goes on from there, and the finished
    store is the same, byte for byte, as one that was never interrupted. For a store that is finished it only checks
    that the particles are the same.

    Parameters
    ----------
    path
        Directory of the store.
    target
        A series, some particles, or a scene, which brings its own lights.
    frames
        Time steps of a series to bake; None means the first that has particles.
    lights, model, albedo, ao_distance, periodic
        See :class:`luxel.Scene`.
    up
        The axis that points up in pictures of the store.
    spec
        How textures are made; None means ``fast`` mode with 1 sample.
    codec
        How they are stored: a kind, or a :class:`CodecChoice` with its options.
    keep_raw
        Keep raw textures beside compressed ones.
    chunk
        Particles in a chunk: what an interruption loses at most.
    overwrite
        Replace a store with other settings.
    threads
        None means all that the process may use; never changes a texture.
    progress
        Called as ``progress(stage, done, total)`` in particles, from this thread.

    Raises
    ------
    InputError
        For bad options, or a store that holds another bake; the message says what differs.
    FormatError
        If there is something else at `path`, or the store is damaged.
    StorageError
        If the disk is full, or another process bakes into this store.
    """
    spec = TextureSpec.usual() if spec is None else spec
    choice = CodecChoice(codec) if isinstance(codec, str) else codec
    series: Sequence[Particles]
    chosen: tuple[int, ...]
    if isinstance(target, Scene):
        series, first, chosen = [target.particles], target, (0,)
    else:
        series = [target] if isinstance(target, Particles) else target
        chosen = chosen_frames(series, frames)
        first = Scene(series[chosen[0]], lights, model, albedo, ao_distance, periodic)
    settings = BakeSettings.of(
        first,
        spec,
        frames=chosen,
        up=up,
        codec=choice,
        chunk=chunk,
        keep_raw=keep_raw and choice.kind != "raw",
    )
    shown = str(getattr(target, "path", "particles"))  # a list of files is shown as "first … last"
    source = " … ".join(os.path.basename(part.rstrip("/\\")) for part in shown.split(" … "))
    folder = Path(path)
    with _writing(folder, settings, source, overwrite):
        for k, index in enumerate(chosen):
            scene = settings.scene(series[index])
            writer = FrameWriter(_frame_folder(folder, k), str(folder), scene, settings)
            if not writer.complete:
                _light(writer, k, len(chosen), threads, progress)
                writer.finish(writer.lit(), progress)
    return open_baked(folder)


def encode_to(
    path: str | os.PathLike[str],
    baked: Baked,
    codec: str | CodecChoice,
    *,
    keep_raw: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Baked:
    """Store the textures of `baked` under another codec, without any light being computed.

    Raw textures are used where the store kept them. What comes out of a raw store is the same, byte for byte, as a bake
    with that codec. Interrupted, it goes on where it was, as :func:`bake_to` does, and raises the same errors.
    """
    choice = CodecChoice(codec) if isinstance(codec, str) else codec
    settings = replace(baked.settings, codec=choice, keep_raw=keep_raw and choice.kind != "raw")
    folder = Path(path)
    if "://" not in baked.path and folder.resolve() == Path(baked.path).resolve():
        raise InputError(f"{folder}: a store cannot be encoded into itself — give another -o")
    with _writing(folder, settings, baked.source, overwrite):
        for k in range(len(baked)):
            frame = baked[k]
            writer = FrameWriter(_frame_folder(folder, k), str(folder), frame.scene, settings)
            if writer.complete:
                continue
            original = frame.original()
            for part in writer.missing():
                rows = writer.codes.rows(part)
                writer.put(part, original[rows], frame.errors[rows], int(frame.clipped[part]))
            writer.finish(writer.lit(), progress)
    return open_baked(folder)


def _light(
    writer: FrameWriter, frame: int, frame_count: int, threads: int | None, progress: Progress | None
) -> None:
    missing = writer.missing()
    if not missing:
        return
    baker = Baker(writer.scene, writer.settings.spec)
    baker.prepare(threads)
    # All frames are taken to be as large as this one: their sizes are not known before they are read.
    total = writer.count * frame_count
    rest = sum(_length(writer.codes.rows(k)) for k in missing)
    done = writer.count * (frame + 1) - rest
    for k in missing:
        rows = writer.codes.rows(k)
        before = done

        def report(finished: int, _: int, before: int = before) -> None:
            if progress is not None:
                progress("lighting", before + finished, total)

        report(0, 0)
        ids = np.arange(rows.start, rows.stop, dtype=np.int32)
        found = bake_with(baker, ids, progress=report, threads=threads)
        assert found.errors is not None
        writer.put(k, found.codes, found.errors, found.clipped_count)
        done += len(ids)


@contextmanager
def _writing(folder: Path, settings: BakeSettings, source: str, overwrite: bool) -> Iterator[None]:
    """Hold the store; on a good end, mark it complete."""
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: this is a file, where a store is a directory — give another -o")
    if not folder.parent.is_dir():
        raise StorageError(f"{folder}: there is no directory {folder.parent} — make it first")
    with lock(folder):
        complete = _begin(folder, settings, source, overwrite)
        yield
        if not complete:
            write_group(folder, {"luxel": _header(settings, source, complete=True)})


def _begin(folder: Path, settings: BakeSettings, source: str, overwrite: bool) -> bool:
    """Begin a store or take it up again; return whether it is complete."""
    remove_drafts(folder)
    names = {entry.name for entry in folder.iterdir()} - {LOCK_NAME}
    attributes = read_attributes(folder) if "zarr.json" in names else None
    header: dict[str, Any] = {}
    if names:
        if attributes is None:
            raise FormatError(folder, "is a directory of something else", remedy="give another -o")
        try:
            header = dict(check_header(str(folder), attributes))
        except FormatError:
            if not (overwrite and "luxel" in attributes):
                raise
    given = _header(settings, source, complete=False)
    wiped = bool(names) and header.get("settings") is None
    if names and not wiped:
        compared = ("luxel", "settings")
        found = differences({n: header.get(n) for n in compared}, {n: given[n] for n in compared})
        if not found:
            if not (folder / "frames" / "zarr.json").exists():
                write_group(folder / "frames")
            return bool(header["complete"])
        if not overwrite:
            raise InputError(
                f"{folder}: this store holds another bake: {'; '.join(found)}"
                " — add --overwrite to replace it, or give another -o"
            )
    if names:
        # First the mark, so that what is left of the old store is never taken for a part of the new one.
        write_group(folder, {"luxel": {**given, "settings": None}})
        for name in sorted(names - {"zarr.json"}):
            remove_tree(folder / name)
    write_group(folder, {"luxel": given})
    write_group(folder / "frames")
    return False


def _header(settings: BakeSettings, source: str, *, complete: bool) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "version": VERSION,
        "luxel": luxel.__version__,
        "complete": complete,
        "source": source,
        "settings": settings.to_json(),
    }


def chosen_frames(series: Sequence[Particles], frames: Sequence[int] | None) -> tuple[int, ...]:
    """Return the time steps to bake, counted from 0; None means the first that has particles."""
    if frames is None:
        finder = getattr(series, "first_frame", None)
        return (0 if finder is None else int(finder()),)
    if not len(frames):
        raise InputError(f"no frames to bake — there are {len(series)}, counted from 0")
    try:
        return tuple(range(len(series))[frame] for frame in frames)
    except IndexError:
        raise FrameError(f"no such frames {list(frames)} — there are {len(series)}, counted from 0") from None


def _frame_folder(folder: Path, k: int) -> Path:
    return folder / "frames" / f"{k:04d}"


def _length(rows: slice) -> int:
    return int(rows.stop - rows.start)
