"""Readers: particle files in, :class:`luxel.Particles` out; one module a format."""

from luxel.io.info import describe
from luxel.io.series import Series
from luxel.io.series import open_series as open  # noqa: A004  luxel.open is meant to read like the builtin

__all__ = ["Series", "describe", "open"]
