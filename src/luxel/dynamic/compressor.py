"""Compressor: packs the textures of a cache by principal components that it learns from them as they come (paper section 5)."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Collection
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from luxel.errors import InputError
from luxel.kernels.lookup import LearntTexels, linear_rows, readable
from luxel.textures.codecs.linear import PCACodec
from luxel.textures.codecs.moments import Moments

__all__ = ["Compressor"]

_MOST_BASES = 128
# A basis is learnt anew from so many times more textures, or sooner if it suits what comes so much worse than what it was learnt from.
_GROWTH, _SOON_GROWTH = 4, 1.5
_WORSE = 1.25
_SAMPLE_BYTES = 8192  # a texel, of the sample that moments keep
_KEPT_BASES = 8  # the latest are never given up: some record may be on its way to the cache
_KEYS = 2  # light keys that are learnt from at a time: there may be two in one picture


@dataclass(eq=False)
class _Lessons:
    """What has been learnt under one light key."""

    moments: Moments = field(default_factory=Moments)
    basis: int = -1  # the latest
    fitted: int = 0  # textures that it was learnt from
    error: float = math.inf  # RMS of its fit, in codes


class Compressor:
    """Textures in, records of 1 + `components` bytes out, and back.

    A record names the basis that it was packed with. A new basis comes when there is much more to learn from than before, or the light changes; there are
    up to 128, of which the oldest that no record names gives way. Those who read with a basis keep it. The textures that make a basis necessary are among those that it is learnt from, so the first ones are not packed badly.

    Safe to use from several threads; owns a lock.

    Parameters
    ----------
    texels
        Rows and columns of a texture.
    components
        Of each texture, a byte each.
    in_use
        Returns the bases that some kept record names.

    Raises
    ------
    InputError
        If there are not 1 to `texels`² components.
    """

    def __init__(
        self, texels: int, components: int, in_use: Callable[[], Collection[int]] = lambda: range(_MOST_BASES)
    ) -> None:
        if not 1 <= components <= texels * texels:
            raise InputError(
                f"compressed textures must have 1..{texels * texels} components, got {components}"
            )
        self.texels, self.components = texels, components
        self._lock = threading.Lock()
        self._lessons: dict[str, _Lessons] = {}  # the latest last
        self._in_use = in_use
        self._codecs: list[PCACodec] = []
        self._recent: deque[int] = deque(maxlen=_KEPT_BASES)
        self.bases = self._table()
        self._squares, self._count = 0.0, 0

    @property
    def record_bytes(self) -> int:
        """Bytes a texture."""
        return 1 + self.components

    @property
    def most_bytes(self) -> int:
        """Bytes of all bases and of what they are learnt from, at most."""
        size = self.texels * self.texels
        return _MOST_BASES * size * (6 * self.components + 8) + _KEYS * size * (8 * size + _SAMPLE_BYTES)

    @property
    def error(self) -> float:
        """Root mean square of what packing changed, in codes, over all textures packed so far; 0 before the first."""
        with self._lock:
            return math.sqrt(self._squares / self._count) if self._count else 0.0

    def pack(self, key: str, codes: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Turn textures (K, T, T) under a light key into records (K, `record_bytes`)."""
        if not len(codes):
            return np.empty((0, self.record_bytes), np.uint8)
        with self._lock:
            lessons = self._lessons.pop(key, None) or _Lessons()
            self._lessons = dict(list(self._lessons.items())[1 - _KEYS :]) | {key: lessons}
            lessons.moments.add(codes)
            records, error = self._packed(lessons.basis, codes)
            grown = lessons.moments.count / max(1, lessons.fitted)
            worse = error > _WORSE * lessons.error and grown >= _SOON_GROWTH
            due = lessons.basis < 0 or grown >= _GROWTH or worse
            if due and (place := self._place()) is not None:
                codec = PCACodec.from_moments(lessons.moments, "components", self.components)
                self._codecs = [*self._codecs[:place], codec, *self._codecs[place + 1 :]]
                self._recent.append(place)
                self.bases = self._table()
                lessons.basis = place
                records, error = self._packed(lessons.basis, codes)
                lessons.fitted, lessons.error = lessons.moments.count, error
            self._squares += error * error * len(codes)
            self._count += len(codes)
            version = self._recent[-1] if lessons.basis < 0 else lessons.basis
        return np.concatenate([np.full((len(codes), 1), version, np.uint8), records], axis=1)

    def unpack(self, records: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Turn records (K, `record_bytes`) into codes (K, T, T)."""
        codes = np.empty((len(records), self.texels, self.texels), np.uint8)
        codecs = self._codecs
        for version in np.unique(records[:, 0]):
            chosen = records[:, 0] == version
            codes[chosen] = codecs[version].decode(records[chosen, 1:])
        return codes

    def lookup(self, records: NDArray[np.uint8]) -> LearntTexels:
        """Return what kernels read texels of these records from. Records that come later may need newer `bases`."""
        return self.bases._replace(records=readable(records))

    def _place(self) -> int | None:
        """Where a new basis goes; None if records name all of them."""
        if len(self._codecs) < _MOST_BASES:
            return len(self._codecs)
        kept = {*self._in_use(), *self._recent, *(each.basis for each in self._lessons.values())}
        return next((place for place in range(_MOST_BASES) if place not in kept), None)

    def _packed(self, basis: int, codes: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], float]:
        """Return coefficients by a basis, the latest of all if it is negative, and the RMS error in codes."""
        if not self._codecs:
            return np.empty((0, self.components), np.uint8), math.inf
        codec = self._codecs[self._recent[-1] if basis < 0 else basis]
        records = codec.encode(codes)
        change = codec.decode(records).astype(np.float32) - codes
        return records, float(np.sqrt(np.mean(change * change)))

    def _table(self) -> LearntTexels:
        """All bases side by side; made anew with every one, so that frames keep what they have."""
        none = np.empty((0, self.components), np.uint8)
        found = [codec.lookup(none) for codec in self._codecs]
        size = self.texels * self.texels
        rows = [each.rows for each in found] or [
            linear_rows(np.zeros((size, self.components)), np.zeros(size))
        ]
        return LearntTexels(
            np.empty((0, self.record_bytes), np.uint8),
            np.stack(rows),
            np.array([int(each.shift) for each in found] or [0], np.int32),
            self.texels,
        )
