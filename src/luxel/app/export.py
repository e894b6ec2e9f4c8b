"""`luxel.export`: particles with their light in one HTML file."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from luxel.app import protocol, state
from luxel.app.packing import PackedParticles, pack_particles
from luxel.app.page_file import check_page_path, page_overhead, write_page
from luxel.app.viewer import make_session
from luxel.errors import InputError
from luxel.particles import Particles
from luxel.picture.outside import seen_from_outside
from luxel.scene.colormap import RGB, colormap_names
from luxel.scene.from_arrays import looked_at
from luxel.scene.hiding import Select
from luxel.scene.scene import Scene
from luxel.scene.view import View
from luxel.session import Session
from luxel.textures.bake import Baker, bake_with
from luxel.textures.codecs import Codec, train
from luxel.textures.spec import TextureSpec
from luxel.textures.store.layout import CodecChoice

__all__ = ["ExportSize", "Exported", "export"]

#: Called as ``progress(stage, done, total)``.
Progress = Callable[[str, int, int], None]

_BLOCK = 1 << 18  # particles; a multiple of 2048, which is a row of the page's textures
_COLORMAPS = 16  # those that menus begin with
_EPOCH = 1


@dataclass(frozen=True)
class ExportSize:
    """What goes into a page.

    Parameters
    ----------
    count, total
        Particles in the page, and in the data.
    bytes_each
        Bytes a particle before compression, by what they are for.
    fixed_bytes
        The viewer, colour maps, and what all textures share.
    exact
        Whether the bytes of textures are known, and not only aimed at.
    """

    count: int
    total: int
    bytes_each: Mapping[str, float]
    fixed_bytes: int
    exact: bool = True

    @property
    def particle_bytes(self) -> float:
        """Bytes a particle before compression."""
        return sum(self.bytes_each.values())

    @property
    def raw_bytes(self) -> int:
        """All of it before compression and encoding."""
        return round(self.count * self.particle_bytes) + self.fixed_bytes


@dataclass(frozen=True)
class Exported:
    """A page that was written.

    Parameters
    ----------
    path
        Where.
    size
        What went into it.
    file_bytes
        Of the file.
    rms_levels
        What compression of the textures changed: root mean square, in 8-bit levels; None without textures.
    """

    path: Path
    size: ExportSize
    file_bytes: int
    rms_levels: float | None


def export(
    target: Any,
    path: str | os.PathLike[str],
    view: View | None = None,
    *,
    radii: ArrayLike | None = None,
    colors: ArrayLike | str | None = None,
    color_by: ArrayLike | str | None = None,
    scalars: Mapping[str, ArrayLike] | None = None,
    keep: Sequence[str] = (),
    codec: CodecChoice | None = None,
    visible_only: bool = False,
    title: str | None = None,
    threads: int | None = None,
    announce: Callable[[ExportSize], None] | None = None,
    progress: Progress | None = None,
    **session_options: Any,
) -> Exported:
    """Write particles with their light into one HTML file, which any browser opens from disk, without network.

    >>> luxel.export("dump.lammpstrj", "page.html", luxel.View(color_by="stress"))

    Parameters
    ----------
    target
        As of :func:`luxel.view`: a file, particles, a scene, an array of positions, baked textures ... Of a series,
        the page shows one time step.
    path
        The file to write; one that is there already is replaced once the new one is complete.
    view
        What the page shows at first.
    radii, colors, color_by, scalars
        Of an array of positions, as of :func:`luxel.view`.
    keep
        Scalars to choose from in the page, besides the one in `view`: names, or ``["all"]``.
    codec
        How textures are stored. None means PCA with eight components, or for baked textures what they have.
    visible_only
        Leave out particles that cannot be seen from outside the data, see
        :func:`luxel.picture.outside.seen_from_outside`. Views from within, and cuts, show that they are missing.
    title
        Of the page; None takes the file's name.
    threads
        None means all that the process may use.
    announce
        Called with the sizes before light is computed.
    progress
        Called as ``progress(stage, done, total)``, with stages ``"looking"``, ``"lighting"`` and ``"packing"``.
    **session_options
        Passed to :class:`luxel.Session`: ``frame``, ``model``, ``lights``, ``albedo``, ``spec`` ...

    Returns
    -------
    Exported
        With the sizes.

    Raises
    ------
    InputError
        For arrays of wrong shape, or a scene in which everything is hidden.
    ScalarError
        For a scalar that the particles do not have.
    StorageError
        If the file cannot be written.
    """
    check_page_path(path)
    target, view = looked_at(target, view, radii=radii, colors=colors, color_by=color_by, scalars=scalars)
    report = progress or (lambda stage, done, total: None)
    opened = isinstance(target, Session)
    session = target if opened else make_session(target, view, 0, session_options, TextureSpec.usual())
    try:
        view = view or session.view or View()
        content = _Content(session, view, keep, codec, visible_only, title, threads, report)
        if announce is not None:
            announce(content.size(None))
        made, payload, rms = content.light(threads, report)
        size = content.size(made)
        blocks = content.blocks(payload, report)
        file_bytes = write_page(path, content.scene_state.title, content.head(made), blocks)
    finally:
        if not opened:
            session.close()
    return Exported(Path(path), size, file_bytes, rms)


class _Content:
    """What one page holds."""

    def __init__(
        self,
        session: Session,
        view: View,
        keep: Sequence[str],
        codec: CodecChoice | None,
        visible_only: bool,
        title: str | None,
        threads: int | None,
        report: Progress,
    ) -> None:
        self.stored = session.stored
        # Scaled radii are the page's own, and it has no others to go back to.
        self.scene = session.scene if self.stored else _flat(session.scene)
        self.spec: TextureSpec = session.spec
        particles = self.scene.particles
        self.codec = codec
        names, colored = _kept_scalars(particles, view, keep)
        self.ids = None if self.scene.hidden is None else np.flatnonzero(~self.scene.hidden).astype(np.int32)
        if visible_only:
            self.ids = seen_from_outside(
                self.scene,
                view,
                threads=threads,
                progress=lambda done, total: report("looking", done, total),
            )
            view = view.with_changes(hide=())  # there is nothing left to hide
        if self.ids is not None and not len(self.ids):
            raise InputError("everything is hidden: the page would be empty — leave out a cut or a selection")
        self.view = view
        self.packed = pack_particles(_byte_colors(particles, colored), names, self.ids)
        with Session(self.scene, spec=self.spec, view=view, threads=0) as own:
            scene_state, light = state.scene_state(own, _EPOCH), state.light_state(own)
        shown = [name for name in names if name.rpartition(".")[0] != colored]
        self.scene_state = replace(
            scene_state,
            title=title or _title(session),
            count=self.packed.count,
            frame=0,
            frame_count=1,
            scalars=tuple(
                each for each in scene_state.scalars if each["name"] in shown or each["name"] == colored
            ),
            colormaps=tuple(_colormaps(view)),
            models=(self.scene.model,),
            light_fixed=True,
        )
        self.light_state = replace(light, lighting={**light.lighting, "hide": []})

    @property
    def textured(self) -> bool:
        return self.scene.model != "lambertian"

    def size(self, made: Codec | None) -> ExportSize:
        """Return the sizes, with those of a codec, or with those it will have."""
        each: dict[str, float] = dict(self.packed.bytes_each)
        shared, exact = 0, True
        if self.textured:
            made = made or (None if self.stored is None or self.codec is not None else self.stored.codec)
            if made is not None:
                each["light"], shared = made.payload_bytes, made.shared_bytes
            else:
                each["light"], shared, exact = _expected(self._choice(), self.spec.texels)
        fixed = page_overhead() + shared + sum(768 for _ in self.scene_state.colormaps)
        return ExportSize(self.packed.count, len(self.scene.particles), each, fixed, exact)

    def light(
        self, threads: int | None, report: Progress
    ) -> tuple[Codec | None, NDArray[np.uint8], float | None]:
        """Return the codec, the records of all particles in the page, and what compression changed."""
        if not self.textured:
            return None, np.zeros((self.packed.count, 0), np.uint8), None
        stored = self.stored
        if stored is not None:
            kept: Any = slice(None) if self.ids is None else self.ids
            if self.codec is None:
                return stored.codec, stored.payload[kept], float(stored.distortion["rmse"])
            codes = stored.original()[slice(0, stored.count)][kept]
        else:
            ids = np.arange(len(self.scene.particles), dtype=np.int32) if self.ids is None else self.ids
            codes = bake_with(
                Baker(self.scene, self.spec),
                ids,
                threads=threads,
                progress=lambda done, total: report("lighting", done, total),
            ).codes
        choice = self._choice()
        made = train(choice.kind, codes, **choice.options)
        payload = made.encode(codes)
        total = 0.0
        for start in range(0, len(codes), 4096):
            part = slice(start, start + 4096)
            total += float(np.square(made.decode(payload[part]).astype(np.float32) - codes[part]).sum())
        return made, payload, math.sqrt(total / codes.size)

    def head(self, made: Codec | None) -> Iterator[bytes]:
        """Yield what the page needs before its particles."""
        light = self.light_state
        about = {
            "packing": self.packed.description,
            "block": _BLOCK,
            "record": 0 if made is None else made.payload_bytes,
            "key": light.key,
            "epoch": _EPOCH,
            "view": View().to_json(),
        }
        yield json.dumps(about, allow_nan=False, separators=(",", ":")).encode()
        yield self.scene_state.encode()
        yield light.encode()
        if made is not None:
            yield protocol.CodecState(
                light.key,
                made.describe(),
                self.packed.count,
                made.payload_bytes,
                _BLOCK,
                light.decoding,
                **made.shared,
            ).encode()
        for name in self.scene_state.colormaps:
            yield state.colormap(name).encode()

    def blocks(self, payload: NDArray[np.uint8], report: Progress) -> Iterator[bytes]:
        """Yield the particles and their records in parts."""
        packed: PackedParticles = self.packed
        for start in range(0, packed.count, _BLOCK):
            part = slice(start, start + _BLOCK)
            yield packed.pack(part) + payload[part].tobytes()
            report("packing", min(start + _BLOCK, packed.count), packed.count)

    def _choice(self) -> CodecChoice:
        return CodecChoice("pca", components=8) if self.codec is None else self.codec


def _flat(scene: Scene) -> Scene:
    """Return the same scene with scaled radii as the particles' own."""
    given = scene.particles
    if given.unscaled is given:
        return scene
    flat = Particles.from_local(
        given.local,
        given.origin,
        given.radii,
        scalars=given.scalars,
        cell=given.cell,
        time=given.time,
        categories=given.categories,
        radii_source=given.radii_source,
    )
    return scene.with_changes(particles=flat)


def _kept_scalars(particles: Particles, view: View, keep: Sequence[str]) -> tuple[list[str], str | None]:
    """Return the scalars that the page holds, and which vector among them holds colours."""
    names = list(particles.names()) if "all" in keep and "all" not in particles.names() else list(keep)
    colored = None
    if view.color_by is not None:
        if view.colormap == RGB:
            view.colors(particles)  # says what is wrong with it
            colored = view.color_by
            names = [f"{colored}.{axis}" for axis in "xyz"] + names
        else:
            names = [view.color_by, *names]
    names += [each.scalar for each in view.conditions if isinstance(each, Select)]
    found = list(dict.fromkeys(names))
    for name in found:
        if particles.scalar(name).dtype.kind not in "fiu":
            raise InputError(f"scalar {name!r} is not made of numbers that a page can show")
    return found, colored


def _byte_colors(particles: Particles, name: str | None) -> Particles:
    """Return the particles with one of their vectors as colours of 8 bits, which is what screens show."""
    if name is None or particles.scalars[name].dtype.kind in "iu":
        return particles
    bytes_ = np.rint(255 * particles.scalars[name]).astype(np.uint8)
    return Particles.from_local(
        particles.local,
        particles.origin,
        particles.radii,
        scalars={**particles.scalars, name: bytes_},
        categories=particles.categories,
    )


def _colormaps(view: View) -> list[str]:
    names = colormap_names()[:_COLORMAPS]
    return names if view.colormap in (*names, RGB) else [view.colormap, *names]


def _expected(choice: CodecChoice, texels: int) -> tuple[float, int, bool]:
    """Return bytes a texture, bytes that all share, and whether that is certain."""
    size = texels * texels
    if choice.kind == "raw":
        return size, 0, True
    if choice.kind == "pca" and choice.components is not None:
        count = min(choice.components, size)
        return count, size * (4 + 2 * count), True
    return size / (choice.ratio or 16.0), 0, False


def _title(session: Session) -> str:
    path = getattr(session.series, "path", None)
    return os.path.basename(os.fspath(path).rstrip("/\\")) if path else "particles"
