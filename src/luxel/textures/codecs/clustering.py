"""Training of clustered principal components."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from luxel.errors import InputError
from luxel.textures.codecs.clustered import CENTER_UNIT, ClusteredPCACodec
from luxel.textures.codecs.linear import fraction_bits
from luxel.textures.codecs.protocol import Codes, Progress, gathered, one_target, parts
from luxel.textures.codecs.quantisers import gains_by_count, lloyd_max, normal_sample, water_fill

__all__ = ["train"]

_CLUSTERS = (1, 2, 4, 8, 16, 32, 64, 128, 256)
_SAMPLE, _MEMBERS = 32_768, 512  # textures that are learned from, at least: in all, and a cluster
_JUDGED = 4096
_ROUNDS = 4
_AXES = 48  # clusters begin from k-means along so many principal axes


def train(
    codes: Codes,
    *,
    ratio: float | None,
    payload_bytes: int | None,
    error: float | None,
    clusters: int | None,
    seed: int,
    progress: Progress | None,
) -> ClusteredPCACodec:
    """See :meth:`ClusteredPCACodec.train`."""
    codes = gathered(codes)
    target, value = one_target(ratio=ratio, payload_bytes=payload_bytes, error=error)
    if clusters is not None and not 1 <= clusters <= 256:
        raise InputError(f"clusters must be 1..256, got {clusters}")
    tries = [clusters] if clusters else [k for k in _CLUSTERS if k * 8 <= len(codes)] or [1]
    rng = np.random.default_rng(seed)
    learner = _Learner(codes, tries[-1], rng)
    plan: _Plan
    if target == "ratio":
        plan = _Ratio(len(codes), codes.shape[1] ** 2, float(value))
    elif target == "error":
        plan = _Error(len(codes), codes.shape[1] ** 2, float(value))
    else:
        plan = _Record(int(value))
    best, least, worse = None, math.inf, 0
    for step, k in enumerate(tries):
        if (codec := learner.fit(k, plan, rounds=1)) is not None:
            price = plan.price(codec, learner)
            worse = 0 if price < least else worse + 1
            if price < least:
                best, least = codec, price
        if progress is not None:
            progress(step + 1, len(tries) + 1)
        if worse == 2:  # more clusters only cost more from here on
            break
    if best is not None:
        finished = learner.fit(best.clusters, plan, rounds=_ROUNDS)
        if finished is not None and plan.price(finished, learner) < least:
            best = finished
    if best is None:
        raise InputError(f"{target} {value:g} cannot be reached with {len(codes)} textures; {plan.remedy}")
    if progress is not None:
        progress(len(tries) + 1, len(tries) + 1)
    return best


@dataclass(frozen=True, eq=False)
class _Spectra:
    """Clusters and their principal components.

    Parameters
    ----------
    members
        (K,) textures in each.
    center
        (K, D) float32 means.
    values, vectors
        For each cluster (n,) falling variances and (D, n) axes.
    """

    members: NDArray[np.int64]
    center: NDArray[np.float32]
    values: list[NDArray[np.float32]]
    vectors: list[NDArray[np.float32]]

    def counts(
        self, errors: NDArray[np.float64], record: int, most: float = math.inf
    ) -> tuple[NDArray[np.int64], float]:
        """Vectors that each cluster gets, `most` in all, and the squared error of a texture that is expected then."""
        gains = [gains_by_count(values, errors, self.bits(record)) for values in self.values]
        count = np.array([len(own) for own in gains])
        if count.sum() > most:
            # A further vector is worth less than the one before: so the best are simply taken.
            worth = [
                share * np.minimum.accumulate(np.diff(own, prepend=0))
                for share, own in zip(self.members, gains, strict=True)
            ]
            owner = np.repeat(np.arange(len(gains)), count)
            best = np.argsort(-np.concatenate(worth), kind="stable")[: int(most)]
            count = np.bincount(owner[best], minlength=len(gains))
        gained = [own[n - 1] if n else 0.0 for own, n in zip(gains, count, strict=True)]
        spread = [float(values.sum(dtype=np.float64)) for values in self.values]
        left = np.subtract(spread, gained) @ self.members
        return count, float(left) / int(self.members.sum())

    def bits(self, record: int) -> int:
        """Bits for coefficients in a record of so many bytes."""
        return 8 * (record - int(len(self.members) > 1))

    def codec(
        self, count: NDArray[np.int64], record: int, levels: NDArray[np.float32], errors: NDArray[np.float64]
    ) -> ClusteredPCACodec:
        """Return the codec of the first `count` (K,) vectors."""
        size = self.center.shape[1]
        texels = math.isqrt(size)
        digits = 2 ** fraction_bits(texels)
        bases, scales, widths = [], [], []
        for n, values, vectors in zip(count, self.values, self.vectors, strict=True):
            largest = np.abs(vectors[:, :n]).max(axis=0)
            bases.append(np.rint(vectors[:, :n] / largest * 127).astype(np.int8).T)
            scales.append((np.sqrt(values[:n]) * largest / 127 * digits).astype(np.float32))
            widths.append(water_fill(values[:n], errors, self.bits(record)).astype(np.uint8))
        if not count.any():  # all textures alike: one vector that adds nothing
            count = np.eye(1, len(count), dtype=np.int64)[0]
            bases, scales = [np.zeros((1, size), np.int8)], [np.zeros(1, np.float32)]
            widths = [np.ones(1, np.uint8)]
        return ClusteredPCACodec(
            record,
            np.rint(self.center / CENTER_UNIT).astype(np.int16),
            count.astype(np.uint16),
            np.concatenate(bases),
            np.concatenate(scales),
            np.concatenate(widths),
            levels,
            texels,
        )


class _Choice(NamedTuple):
    """Bytes of a record, how many vectors (K,) each cluster has, and the squared error of a texture that is expected."""

    record: int
    vectors: NDArray[np.int64]
    error: float


@dataclass(frozen=True)
class _Record:
    """Records of a given size, with as many vectors as they can use."""

    size: int
    remedy = "records need at least 2 bytes"

    def guess(self, clusters: int) -> int:
        """Bytes of a record, before anything is known of the textures; 0 if there is no room for any."""
        return self.size if self.size > int(clusters > 1) else 0

    def choose(
        self, spectra: _Spectra, errors: NDArray[np.float64], record: int, optimism: float
    ) -> _Choice | None:
        """Choose a record, near `record`; None if the target cannot be reached.

        Parameters
        ----------
        optimism
            How much larger errors were than expected, so far.
        """
        return _Choice(record, *spectra.counts(errors, record))

    def price(self, codec: ClusteredPCACodec, learner: _Learner) -> float:
        """What is to be as small as possible; infinite where the target is missed."""
        return learner.error(codec)


@dataclass(frozen=True)
class _Ratio:
    """All stored bytes within a ratio of the raw ones: longer records leave less room for vectors."""

    count: int
    size: int
    ratio: float
    remedy = "try a lower ratio"

    def guess(self, clusters: int) -> int:
        """See :class:`_Record`."""
        lead = int(clusters > 1)
        # Coefficients take about three bits.
        a_byte = clusters * 8 / 3 * (self.size + 5)
        record = int((self._room(clusters) + lead * a_byte) // (self.count + a_byte))
        return record if record > lead else 0

    def choose(
        self, spectra: _Spectra, errors: NDArray[np.float64], record: int, optimism: float
    ) -> _Choice | None:
        """See :class:`_Record`."""
        clusters = len(spectra.members)
        choices = []
        for size in range(max(1 + int(clusters > 1), record - 2), record + 4):
            most = (self._room(clusters) - self.count * size) // (self.size + 5)
            if most >= 1:
                choices.append(_Choice(size, *spectra.counts(errors, size, most)))
        return min(choices, key=lambda choice: choice.error, default=None)

    def price(self, codec: ClusteredPCACodec, learner: _Learner) -> float:
        """See :class:`_Record`."""
        return learner.error(codec)

    def _room(self, clusters: int) -> float:
        """Bytes for records and vectors."""
        return self.count * self.size / self.ratio - clusters * (2 * self.size + 2) - 4 * 510


@dataclass(frozen=True)
class _Error:
    """As few bytes as an error allows."""

    count: int
    size: int
    error: float
    remedy = "try a larger error, or raw textures"

    def guess(self, clusters: int) -> int:
        """See :class:`_Record`."""
        return self.size

    def choose(
        self, spectra: _Spectra, errors: NDArray[np.float64], record: int, optimism: float
    ) -> _Choice | None:
        """See :class:`_Record`."""
        enough = 0.99 * self.allowed / max(optimism, 1.0)
        low, high = 1 + int(len(spectra.members) > 1), self.size
        while low < high:
            middle = (low + high) // 2
            if spectra.counts(errors, middle)[1] <= enough:
                high = middle
            else:
                low = middle + 1
        choice = _Choice(low, *spectra.counts(errors, low))
        return choice if choice.error <= enough else None

    @property
    def allowed(self) -> float:
        """Squared error of a texture, less the twelfth of a texel that rounding adds."""
        return (self.error**2 - 1 / 12) * self.size

    def price(self, codec: ClusteredPCACodec, learner: _Learner) -> float:
        """See :class:`_Record`."""
        if learner.error(codec) > self.allowed:
            return math.inf
        return float(self.count * codec.payload_bytes + codec.shared_bytes)


_Plan = _Record | _Ratio | _Error


class _Learner:
    """Fits codecs of any number of clusters to samples of the textures.

    Parameters
    ----------
    codes
        (N, T, T) uint8.
    clusters
        Most that will be asked for.
    rng
        Draws the samples.
    """

    def __init__(self, codes: Codes, clusters: int, rng: np.random.Generator) -> None:
        self._rng = rng
        self._judged = _drawn(codes, _JUDGED, rng)
        sample = _drawn(codes, max(_SAMPLE, _MEMBERS * clusters), rng)
        self._sample = sample[rng.permutation(len(sample))]
        some = self._flat(min(len(sample), 4 * _JUDGED)).astype(np.float32)
        mean = some.mean(axis=0)
        axes = _principal(some - mean)[1][:, :_AXES]
        self._points = np.empty((len(sample), axes.shape[1]), np.float32)
        for part in parts(len(sample)):
            self._points[part] = (self._flat(part.stop)[part] - mean) @ axes

    def error(self, codec: ClusteredPCACodec) -> float:
        """Mean squared error of a texture, before texels are rounded, of textures that need not be in the samples."""
        return float(codec.quantized(self._judged)[1].mean())

    def fit(self, clusters: int, plan: _Plan, rounds: int) -> ClusteredPCACodec | None:
        """Alternate between bases of the clusters and the choice of the best cluster for every texture."""
        record, optimism, codec = plan.guess(clusters), 1.0, None
        if record == 0:
            return None
        count = min(len(self._sample), max(_SAMPLE, _MEMBERS * clusters))
        sample = self._sample[:count]
        label = self._first_clusters(clusters, count)
        levels, errors = lloyd_max(normal_sample())
        for _ in range(rounds):
            if codec is not None:
                records, _, values = codec.quantized(sample)
                label = records[:, 0].astype(np.int64) if codec.lead else label
                used = np.arange(values.shape[1]) < codec.count[label][:, None]
                if used.any():
                    levels, errors = lloyd_max(values[used])
            spectra = self._spectra(label, clusters)
            for _ in range(3):
                choice = plan.choose(spectra, errors, record, optimism)
                if choice is None:
                    return None
                record = choice.record
                codec = spectra.codec(choice.vectors, record, levels, errors)
                optimism *= max(1.0, self.error(codec) / max(choice.error * optimism, 1e-6))
                if plan.price(codec, self) < math.inf:
                    break
        return codec

    def _flat(self, count: int) -> NDArray[np.uint8]:
        return self._sample[:count].reshape(count, -1)

    def _first_clusters(self, clusters: int, count: int) -> NDArray[np.int64]:
        """k-means along the leading axes."""
        label = np.zeros(count, np.int64)
        if clusters == 1:
            return label
        points = self._points[:count]
        distinct = np.unique(points, axis=0)
        center = distinct[self._rng.choice(len(distinct), clusters, replace=len(distinct) < clusters)]
        for _ in range(12):
            for part in parts(count):
                away = (center * center).sum(axis=1) - 2 * points[part] @ center.T
                label[part] = np.argmin(away, axis=1)
            order = np.argsort(label, kind="stable")
            used, starts, members = np.unique(label[order], return_index=True, return_counts=True)
            center = points[self._rng.choice(count, clusters)]  # for those that are empty
            center[used] = np.add.reduceat(points[order], starts, axis=0) / members[:, None]
        return label

    def _spectra(self, label: NDArray[np.int64], clusters: int) -> _Spectra:
        """Principal components of textures that share a label."""
        flat = self._flat(len(label))
        order = np.argsort(label, kind="stable")
        members = np.bincount(label, minlength=clusters)
        ends = np.cumsum(members)
        center = np.zeros((clusters, flat.shape[1]), np.float32)
        values: list[NDArray[np.float32]] = []
        vectors: list[NDArray[np.float32]] = []
        for k in range(clusters):
            own = flat[order[ends[k] - members[k] : ends[k]]].astype(np.float32)
            if len(own):
                center[k] = own.mean(axis=0)
                own -= center[k]
            found = _principal(own)
            values.append(found[0])
            vectors.append(found[1])
        return _Spectra(members, center, values, vectors)


def _drawn(codes: Codes, count: int, rng: np.random.Generator) -> NDArray[np.uint8]:
    """At most `count` textures drawn at random, in their own order; read in blocks."""
    if count >= len(codes):
        return np.asarray(codes[:])
    rows = np.sort(rng.choice(len(codes), count, replace=False))
    drawn = np.empty((count, *codes.shape[1:]), np.uint8)
    for part in parts(len(codes)):
        first, last = np.searchsorted(rows, (part.start, part.stop))
        drawn[first:last] = np.asarray(codes[part])[rows[first:last] - part.start]
    return drawn


def _principal(centred: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Variances (n,), falling, and axes (D, n) of rows of mean 0 (m, D); n is the smaller of m and D."""
    count, size = centred.shape
    if count >= size:
        values, vectors = np.linalg.eigh(centred.T @ centred / np.float32(count))
    else:  # the products of fewer rows than columns have the same variances, and rows for axes
        values, mixtures = np.linalg.eigh(centred @ centred.T / np.float32(max(count, 1)))
        vectors = centred.T @ (mixtures / np.sqrt(np.maximum(values * count, 1e-6)))
    return np.maximum(values[::-1], 0), vectors[:, ::-1]
