"""Training of clustered principal components."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxel.errors import InputError
from luxel.textures.codecs.clustered import _CENTER_UNIT, WIDEST, ClusteredPCACodec
from luxel.textures.codecs.linear import fraction_bits
from luxel.textures.codecs.protocol import Codes, Progress, gathered, one_target

__all__ = ["lloyd_max", "train", "water_fill"]

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
    rng = np.random.default_rng(seed)
    judged = _drawn(codes, _JUDGED, rng)
    if target == "error":
        return _to_error(codes, float(value), clusters, rng, judged, progress)
    tries = [clusters] if clusters else [k for k in _CLUSTERS if k * 8 <= len(codes)]
    best, least = None, math.inf
    for step, k in enumerate(tries):
        size = _record_bytes(codes, k, float(value)) if target == "ratio" else int(value)
        if size > int(k > 1):
            codec: ClusteredPCACodec | None = _fit(codes, k, size, rng, rounds=_ROUNDS if clusters else 1)
            if target == "ratio":
                codec = _shrunk(codec, len(codes), float(value)) if codec is not None else None
            if codec is not None:
                found = float(codec.quantized(judged)[1].mean())
                if found < least:
                    best, least = codec, found
        if progress is not None:
            progress(step + 1, len(tries) + 1)
    if best is None:
        raise InputError(
            f"{target} {value:g} cannot be reached with {len(codes)} textures; try a lower ratio, or records of at least 2 bytes"
        )
    if clusters is None:
        finished = _fit(codes, best.clusters, best.payload_bytes, rng, rounds=_ROUNDS)
        shrunk = _shrunk(finished, len(codes), float(value)) if target == "ratio" else finished
        if shrunk is not None and float(shrunk.quantized(judged)[1].mean()) < least:
            best = shrunk
    if progress is not None:
        progress(len(tries) + 1, len(tries) + 1)
    return best


def _to_error(
    codes: Codes,
    error: float,
    clusters: int | None,
    rng: np.random.Generator,
    judged: NDArray[np.uint8],
    progress: Progress | None,
) -> ClusteredPCACodec:
    """Bisect the size of a record."""
    size = codes.shape[1] ** 2
    k = clusters or max(k for k in _CLUSTERS if k * 64 <= max(len(codes), 64))
    low, high, best = 1, size, None
    steps = 0
    while low < high:
        middle = (low + high) // 2
        codec = _fit(codes, k, middle + 1, rng, rounds=2)
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
    if count >= len(codes):
        return np.asarray(codes)
    # Sorted, for a memory map reads them from disk.
    return np.asarray(codes[np.sort(rng.choice(len(codes), count, replace=False))])


def _record_bytes(codes: Codes, clusters: int, ratio: float) -> int:
    """Bytes of a record that leave room for bases of about three bits a coefficient."""
    count, size = len(codes), codes.shape[1] ** 2
    room = count * size / ratio - clusters * (2 * size + 2) - 4 * 510
    lead = int(clusters > 1)
    a_byte = clusters * 8 / 3 * (size + 5)
    return int((room + lead * a_byte) // (count + a_byte))


def _shrunk(codec: ClusteredPCACodec, count: int, ratio: float) -> ClusteredPCACodec | None:
    """Drop the last basis vectors, of the fewest bits first, until `ratio` is reached."""
    size = codec.texels**2
    room = count * size / ratio - count * codec.payload_bytes
    spare = math.ceil(max(0.0, codec.shared_bytes - room) / (size + 5))
    if spare == 0:
        return codec
    if spare >= len(codec.width):
        return None
    # What a vector explains beyond one bit falls with its width; within one, with its scale.
    order = np.lexsort((codec.scale, codec.width))
    keep = np.ones(len(codec.width), bool)
    keep[order[:spare]] = False
    owner = np.repeat(np.arange(codec.clusters), codec.count)
    count_left = np.bincount(owner[keep], minlength=codec.clusters).astype(np.uint16)
    return replace(
        codec, count=count_left, basis=codec.basis[keep], scale=codec.scale[keep], width=codec.width[keep]
    )


def _fit(
    codes: Codes, clusters: int, payload_bytes: int, rng: np.random.Generator, rounds: int
) -> ClusteredPCACodec:
    """Alternate between bases of the clusters and the choice of the best cluster for every texture of a sample."""
    sample = _drawn(codes, max(_SAMPLE, _MEMBERS * clusters), rng)
    flat = sample.reshape(len(sample), -1)
    label = _first_clusters(flat, clusters, rng)
    levels, errors = lloyd_max(_normal_sample())
    codec = _bases(flat, label, clusters, payload_bytes, levels, errors, sample.shape[1])
    for _ in range(rounds - 1):
        records, _, values = codec.quantized(sample)
        label = records[:, 0].astype(np.int64) if codec.lead else label
        used = np.arange(values.shape[1]) < codec.count[label][:, None]
        if used.any():
            levels, errors = lloyd_max(values[used])
        codec = _bases(flat, label, clusters, payload_bytes, levels, errors, sample.shape[1])
    return codec


def _first_clusters(flat: NDArray[np.uint8], clusters: int, rng: np.random.Generator) -> NDArray[np.int64]:
    if clusters == 1:
        return np.zeros(len(flat), np.int64)
    part = flat[rng.choice(len(flat), min(len(flat), 8192), replace=False)].astype(np.float32)
    mean = part.mean(axis=0)
    axes = np.linalg.eigh(np.cov((part - mean).T))[1][:, ::-1][:, :_AXES].astype(np.float32)
    points = (flat.astype(np.float32) - mean) @ axes
    distinct = np.unique(points, axis=0)
    center = distinct[rng.choice(len(distinct), clusters, replace=len(distinct) < clusters)]
    label = np.zeros(len(flat), np.int64)
    for _ in range(12):
        label = np.argmin((center * center).sum(axis=1) - 2 * points @ center.T, axis=1)
        members = np.bincount(label, minlength=clusters)
        sums = np.zeros_like(center, dtype=np.float64)
        np.add.at(sums, label, points)
        center = np.where(members[:, None] > 0, sums / np.maximum(members, 1)[:, None], center).astype(
            np.float32
        )
        empty = np.flatnonzero(members == 0)
        center[empty] = points[rng.choice(len(points), len(empty))]
    return label


def _bases(
    flat: NDArray[np.uint8],
    label: NDArray[np.int64],
    clusters: int,
    payload_bytes: int,
    levels: Any,
    errors: Any,
    texels: int,
) -> ClusteredPCACodec:
    """Centre, basis, widths and scales of every cluster."""
    budget = 8 * (payload_bytes - int(clusters > 1))
    digits = 2 ** fraction_bits(texels)
    size = flat.shape[1]
    center = np.zeros((clusters, size), np.int16)
    count = np.zeros(clusters, np.uint16)
    bases, scales, widths = [], [], []
    order = np.argsort(label, kind="stable")
    ends = np.cumsum(np.bincount(label, minlength=clusters))
    for k in range(clusters):
        members = flat[order[ends[k - 1] if k else 0 : ends[k]]].astype(np.float32)
        if len(members) == 0:
            continue
        mean = members.mean(axis=0)
        center[k] = np.rint(mean / _CENTER_UNIT)
        members -= mean
        values, vectors = np.linalg.eigh(members.T @ members / len(members))
        values, vectors = values[::-1], vectors[:, ::-1]
        bits = water_fill(values, errors, budget)
        n = int(np.count_nonzero(bits))
        if n == 0:
            continue
        largest = np.abs(vectors[:, :n]).max(axis=0)
        bases.append(np.rint(vectors[:, :n] / largest * 127).astype(np.int8).T)
        scales.append((np.sqrt(values[:n]) * largest / 127 * digits).astype(np.float32))
        widths.append(bits[:n].astype(np.uint8))
        count[k] = n
    if not bases:  # all textures alike: one vector that adds nothing
        bases, scales, widths = (
            [np.zeros((1, size), np.int8)],
            [np.zeros(1, np.float32)],
            [np.ones(1, np.uint8)],
        )
        count[0] = 1
    return ClusteredPCACodec(
        payload_bytes,
        center,
        count,
        np.concatenate(bases),
        np.concatenate(scales),
        np.concatenate(widths),
        levels,
        texels,
    )


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
