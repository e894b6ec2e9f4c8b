"""Scalar quantisers of 1 to 8 bits, and how bits are dealt out among coefficients."""

from __future__ import annotations

from functools import lru_cache
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

__all__ = ["WIDEST", "gains_by_count", "lloyd_max", "normal_sample", "water_fill"]

#: Most bits of a coefficient.
WIDEST = 8


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
    owner, _ = _steps(variances, errors)
    return np.bincount(owner[:budget], minlength=len(variances))


def gains_by_count(
    variances: NDArray[np.floating], errors: NDArray[np.float64], budget: int
) -> NDArray[np.float64]:
    """By how much `budget` bits lower the sum of squared errors if only the first 1, 2 … coefficients may have any.

    Parameters and order as for :func:`water_fill`. Ends where further coefficients would get no bits.

    Returns
    -------
    gains
        (m,) rising, m <= n.
    """
    owner, gain = _steps(variances, errors)
    most = int(owner[:budget].max(initial=-1)) + 1
    allowed = owner < np.arange(1, most + 1)[:, None]
    taken = allowed & (np.cumsum(allowed, axis=1) <= budget)
    return np.asarray((taken * gain).sum(axis=1))


def _steps(
    variances: NDArray[np.floating], errors: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Every bit that could be given, the most useful first: to which coefficient, and what it gains."""
    gains = np.minimum.accumulate(-np.diff(errors))  # each further bit gains less: the best are simply taken
    table = np.maximum(variances, 0)[:, None] * gains
    # The smallest variances are rounding.
    table[table < 1e-3] = 0
    order = np.argsort(-table, axis=None, kind="stable")
    order = order[: np.count_nonzero(table)]
    return order // WIDEST, table.ravel()[order]


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
def normal_sample() -> NDArray[np.float64]:
    """Return a normal distribution of unit variance as a sample."""
    return np.array([NormalDist().inv_cdf((k + 0.5) / 20_001) for k in range(20_001)])
