"""Training of clustered principal components."""

from __future__ import annotations

import math
from functools import lru_cache
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from luxel.errors import InputError
from luxel.textures.codecs.clustered import _CENTER_UNIT, WIDEST, ClusteredPCACodec
from luxel.textures.codecs.linear import fraction_bits
from luxel.textures.codecs.protocol import Codes, Progress, gathered, one_target, parts

__all__ = ["lloyd_max", "train", "water_fill"]

_CLUSTERS = (1, 2, 4, 8, 16, 32, 64, 128, 256)
_SAMPLE, _MEMBERS = 32_768, 512  # textures that are learned from, at least: in all, and a cluster
_JUDGED = 4096
_ROUNDS = 4
_AXES = 48  # clusters begin from k-means along so many principal axes
_ROUGH = 96  # axes of all textures that bases are looked for in while the number of clusters is open


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
    judged = _drawn(codes, _JUDGED, rng)
    learner = _Learner(_drawn(codes, max(_SAMPLE, _MEMBERS * tries[-1]), rng), rng)
    if target == "error":
        return _to_error(len(codes), float(value), clusters, learner, judged, progress)
    size = codes.shape[1] ** 2
    room = len(codes) * size / float(value) if target == "ratio" else None
    best, least, worse = None, math.inf, 0

    def tried(k: int, record: int, rounds: int, *, rough: bool = False) -> bool:
        """Fit a codec, keep it if it is the best so far, and return whether it was."""
        nonlocal best, least
        most = None if room is None else _vectors_within(room, len(codes), size, k, record)
        if record <= int(k > 1) or (most is not None and most < 1):
            return False
        codec = learner.fit(k, record, rounds, most=most, rough=rough)
        found = float(codec.quantized(judged)[1].mean())
        if found >= least:
            return False
        best, least = codec, found
        return True

    for step, k in enumerate(tries):
        record = int(value) if room is None else _record_within(room, len(codes), size, k)
        worse = 0 if tried(k, record, rounds=1, rough=True) else worse + 1
        if progress is not None:
            progress(step + 1, len(tries) + 1)
        if best is not None and worse == 2:  # more clusters only cost more from here on
            break
    if best is None:
        raise InputError(
            f"{target} {value:g} cannot be reached with {len(codes)} textures; try a lower ratio, or records of at least 2 bytes"
        )
    k, record = best.clusters, best.payload_bytes
    for further in (0,) if room is None else (0, 1, -1):  # longer records leave less room for bases
        tried(k, record + further, rounds=_ROUNDS)
    if progress is not None:
        progress(len(tries) + 1, len(tries) + 1)
    return best


def _to_error(
    count: int,
    error: float,
    clusters: int | None,
    learner: _Learner,
    judged: NDArray[np.uint8],
    progress: Progress | None,
) -> ClusteredPCACodec:
    """Bisect the size of a record."""
    k = clusters or max(k for k in _CLUSTERS if k * 64 <= max(count, 64))
    low, high, best = 1, judged.shape[1] ** 2, None
    steps = 0
    while low < high:
        middle = (low + high) // 2
        codec = learner.fit(k, middle + 1, rounds=2)
        decoded = codec.decode(codec.encode(judged)).astype(np.float64)
        if ((decoded - judged) ** 2).mean() <= error**2:
            best, high = codec, middle
        else:
            low = middle + 1
        steps += 1
        if progress is not None:
            progress(steps, max(steps, 8))
    if best is None:
        raise InputError(f"error {error:g} cannot be reached by clustered PCA; use raw textures")
    return best


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


def _record_within(room: float, count: int, size: int, clusters: int) -> int:
    """Bytes of a record that leave as much of `room` for bases as about three bits a coefficient need."""
    room -= _fixed_bytes(size, clusters)
    lead = int(clusters > 1)
    a_byte = clusters * 8 / 3 * (size + 5)
    return int((room + lead * a_byte) // (count + a_byte))


def _vectors_within(room: float, count: int, size: int, clusters: int, record: int) -> int:
    """How many basis vectors fit into `room` bytes beside `count` records and the rest."""
    return int((room - count * record - _fixed_bytes(size, clusters)) // (size + 5))


def _fixed_bytes(size: int, clusters: int) -> int:
    return clusters * (2 * size + 2) + 4 * 510


class _Learner:
    """Fits codecs of any number of clusters to one sample of textures (n, T, T); in parts of it where that is enough."""

    def __init__(self, sample: NDArray[np.uint8], rng: np.random.Generator) -> None:
        self._rng = rng
        self._sample = sample[rng.permutation(len(sample))]
        some = self._flat(min(len(sample), 4 * _JUDGED)).astype(np.float32)
        self._mean = some.mean(axis=0)
        some -= self._mean
        self._axes = _principal(some, min(len(some), _ROUGH))[1]
        self._points = np.empty((len(sample), min(_AXES, self._axes.shape[1])), np.float32)
        for part in parts(len(sample)):
            self._points[part] = (self._flat(part.stop)[part] - self._mean) @ self._axes[:, :_AXES]

    def fit(
        self,
        clusters: int,
        payload_bytes: int,
        rounds: int,
        *,
        most: int | None = None,
        rough: bool = False,
    ) -> ClusteredPCACodec:
        """Alternate between bases of the clusters and the choice of the best cluster for every texture.

        Parameters
        ----------
        most
            Basis vectors of all clusters together.
        rough
            Look for bases among the leading axes of all textures, which takes a fraction of the time.
        """
        count = min(len(self._sample), max(_SAMPLE, _MEMBERS * clusters))
        flat, sample = self._flat(count), self._sample[:count]
        label = self._first_clusters(clusters, count)
        levels, errors = lloyd_max(_normal_sample())
        more = most, self._axes if rough else None
        codec = _bases(flat, label, clusters, payload_bytes, levels, errors, *more)
        for _ in range(rounds - 1):
            records, _, values = codec.quantized(sample)
            label = records[:, 0].astype(np.int64) if codec.lead else label
            used = np.arange(values.shape[1]) < codec.count[label][:, None]
            if used.any():
                levels, errors = lloyd_max(values[used])
            codec = _bases(flat, label, clusters, payload_bytes, levels, errors, *more)
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


def _principal(centred: NDArray[np.float32], most: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Variances (n,), falling, and axes (D, n) of rows of mean 0 (m, D); n <= `most`."""
    count, size = centred.shape
    if count >= size:
        values, vectors = np.linalg.eigh(centred.T @ centred / np.float32(count))
    else:  # the products of fewer rows than columns have the same variances, and rows for axes
        values, mixtures = np.linalg.eigh(centred @ centred.T / np.float32(count))
        vectors = centred.T @ (mixtures / np.sqrt(np.maximum(values * count, 1e-12)))
    return values[::-1][:most], vectors[:, ::-1][:, :most]


def _bases(
    flat: NDArray[np.uint8],
    label: NDArray[np.int64],
    clusters: int,
    payload_bytes: int,
    levels: NDArray[np.float32],
    errors: NDArray[np.float64],
    most: int | None,
    within: NDArray[np.float32] | None,
) -> ClusteredPCACodec:
    """Centre, basis, widths and scales of every cluster; bases `within` orthonormal axes (D, n), or anywhere."""
    size = flat.shape[1]
    texels = math.isqrt(size)
    budget = 8 * (payload_bytes - int(clusters > 1))
    digits = 2 ** fraction_bits(texels)
    center = np.zeros((clusters, size), np.int16)
    found = []
    order = np.argsort(label, kind="stable")
    members = np.bincount(label, minlength=clusters)
    ends = np.cumsum(members)
    for k in range(clusters):
        own = flat[order[ends[k] - members[k] : ends[k]]].astype(np.float32)
        if len(own) == 0:
            found.append((np.empty(0, np.float32), np.empty((size, 0), np.float32)))
            continue
        mean = own.mean(axis=0)
        center[k] = np.rint(mean / _CENTER_UNIT)
        own -= mean
        values, vectors = _principal(own if within is None else own @ within, size)
        n = int(np.count_nonzero(water_fill(values, errors, budget)))
        found.append((values[:n], vectors[:, :n] if within is None else within @ vectors[:, :n]))
    count = np.array([len(values) for values, _ in found])
    if most is not None and count.sum() > most:
        count = _best_counts([values for values, _ in found], members, errors, budget, most)
    bases, scales, widths = [], [], []
    for n, (values, vectors) in zip(count, found, strict=True):
        bits = water_fill(values[:n], errors, budget)
        largest = np.abs(vectors[:, :n]).max(axis=0)
        bases.append(np.rint(vectors[:, :n] / largest * 127).astype(np.int8).T)
        scales.append((np.sqrt(values[:n]) * largest / 127 * digits).astype(np.float32))
        widths.append(bits.astype(np.uint8))
    if not count.any():  # all textures alike: one vector that adds nothing
        count[0] = 1
        bases, scales, widths = (
            [np.zeros((1, size), np.int8)],
            [np.zeros(1, np.float32)],
            [np.ones(1, np.uint8)],
        )
    return ClusteredPCACodec(
        payload_bytes,
        center,
        count.astype(np.uint16),
        np.concatenate(bases),
        np.concatenate(scales),
        np.concatenate(widths),
        levels,
        texels,
    )


def _best_counts(
    variances: list[NDArray[np.float32]],
    members: NDArray[np.int64],
    errors: NDArray[np.float64],
    budget: int,
    most: int,
) -> NDArray[np.int64]:
    """How many vectors each cluster gets so that `most` in all lower the error of all textures most."""
    gains, owner = [], []
    for k, values in enumerate(variances):
        whole = [0.0]
        for n in range(1, len(values) + 1):
            bits = water_fill(values[:n], errors, budget)
            whole.append(float((values[:n] * (1 - errors[bits])).sum()))
        # A further vector is never worth more than the one before: so the best are simply taken.
        gains.append(members[k] * np.minimum.accumulate(np.diff(whole)))
        owner.append(np.full(len(values), k))
    best = np.argsort(-np.concatenate(gains), kind="stable")[:most]
    return np.bincount(np.concatenate(owner)[best], minlength=len(variances))


def water_fill(
    variances: NDArray[np.floating], errors: NDArray[np.float64], budget: int
) -> NDArray[np.int64]:
    """Give out `budget` bits so that the sum of variances times errors is least.

    Parameters
    ----------
    variances
        (n,) falling.
    errors
        (9,) mean squared error of a quantiser of 0..8 bits for unit variance.

    Returns
    -------
    bits
        (n,) not rising.
    """
    gains = np.minimum.accumulate(-np.diff(errors))  # each further bit gains less: the best are simply taken
    table = np.maximum(variances, 0)[:, None] * gains
    # The smallest variances are rounding.
    table[table < 1e-3] = 0
    order = np.argsort(-table, axis=None, kind="stable")[:budget]
    order = order[table.ravel()[order] > 0]
    return np.bincount(order // table.shape[1], minlength=len(variances))


def lloyd_max(values: NDArray[np.floating]) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Scalar quantisers of 1..8 bits for a sample of values (Lloyd 1982, Max 1960).

    Returns
    -------
    levels, errors
        (510,) float32, rising within every quantiser; (9,) mean squared errors of 0..8 bits over that of 0.
    """
    values = np.sort(np.asarray(values, np.float64).ravel()[:: max(1, values.size // 100_000)])
    sums = np.concatenate([[0], np.cumsum(values)])
    squares = float((values**2).sum())
    found, errors = [], [1.0]
    for bits in range(1, WIDEST + 1):
        # Levels as dense as the cube root of the values' density are nearly the best to begin with.
        grid = values[np.linspace(0, len(values) - 1, 4 * 2**bits + 1).astype(int)]
        density = np.cumsum(np.maximum(np.diff(grid), 1e-9) ** (2 / 3))
        levels = np.interp(
            (np.arange(2**bits) + 0.5) / 2**bits * density[-1], density, 0.5 * (grid[1:] + grid[:-1])
        )
        for _ in range(50):
            cut = np.searchsorted(values, 0.5 * (levels[1:] + levels[:-1]))
            begin, end = np.concatenate([[0], cut]), np.concatenate([cut, [len(values)]])
            n = end - begin
            levels = np.where(n > 0, (sums[end] - sums[begin]) / np.maximum(n, 1), levels)
        levels = np.sort(levels)
        nearest = levels[np.searchsorted(0.5 * (levels[1:] + levels[:-1]), values)]
        errors.append(min(errors[-1], float(((values - nearest) ** 2).sum()) / max(squares, 1e-30)))
        found.append(levels)
    return np.concatenate(found).astype(np.float32), np.asarray(errors)


@lru_cache(maxsize=1)
def _normal_sample() -> NDArray[np.float64]:
    return np.array([NormalDist().inv_cdf((k + 0.5) / 20_001) for k in range(20_001)])
