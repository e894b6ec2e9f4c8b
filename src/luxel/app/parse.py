"""Values of command line options: texts to numbers, sizes and suns. Errors say what was expected."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable
from dataclasses import dataclass

__all__ = [
    "SunOption",
    "axes",
    "frame_budget",
    "frame_range",
    "number",
    "picture_size",
    "positive_int",
    "radius",
    "sky_levels",
    "sun",
]

_LARGEST_SIZE = 16_384
_DURATION = re.compile(r"\s*(\d+\.?\d*|\.\d+)\s*(ms|s)\s*")


@dataclass(frozen=True)
class SunOption:
    """What ``--sun`` says; parts left out have the default sun's values."""

    azimuth: float
    elevation: float
    level: float = 2.0
    diameter: float = 15.0


def positive_int(text: str) -> int:
    """Parse a whole number above zero."""
    try:
        value = int(text)
    except ValueError:
        value = 0
    if value < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number above 0, got {text.strip()!r}")
    return value


def picture_size(text: str) -> tuple[int, int]:
    """Parse 1280x720."""
    match = re.fullmatch(r"\s*(\d+)\s*[xX×]\s*(\d+)\s*", text)
    if not match:
        raise argparse.ArgumentTypeError(f"expected WIDTHxHEIGHT such as 1280x720, got {text!r}")
    width, height = int(match[1]), int(match[2])
    if not (1 <= width <= _LARGEST_SIZE and 1 <= height <= _LARGEST_SIZE):
        raise argparse.ArgumentTypeError(f"width and height must lie in 1..{_LARGEST_SIZE}, got {text!r}")
    return width, height


def number(text: str) -> float:
    """Parse a finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"expected a number, got {text.strip()!r}")
    return value


def axes(text: str) -> str:
    """Parse some of x, y and z."""
    letters = text.strip().lower()
    if not letters or set(letters) - set("xyz") or len(set(letters)) < len(letters):
        raise argparse.ArgumentTypeError(
            f"expected each of x, y and z at most once, such as xy or xyz, got {text.strip()!r}"
        )
    return "".join(sorted(letters))


def radius(text: str) -> float | str:
    """Parse a number, or auto."""
    return "auto" if text.strip() == "auto" else number(text)


def _numbers(least: int, most: int, example: str) -> Callable[[str], list[float]]:
    def parse(text: str) -> list[float]:
        try:
            values = [number(part) for part in text.split(",")]
        except argparse.ArgumentTypeError:
            values = []
        if not least <= len(values) <= most:
            raise argparse.ArgumentTypeError(f"expected {example}, got {text.strip()!r}")
        return values

    return parse


sky_levels = _numbers(1, 2, "LEVEL or LEVEL,GROUND such as 1 or 1,0.3")
_sun_numbers = _numbers(2, 4, "AZIMUTH,ELEVATION[,LEVEL[,DIAMETER]] such as 225,42,2,15, or none")


def sun(text: str) -> SunOption | None:
    """Parse azimuth, elevation, level and diameter; None for none."""
    return None if text.strip() == "none" else SunOption(*_sun_numbers(text))


def frame_range(text: str) -> slice:
    """Parse A:B, A:B:STEP or one frame."""
    match = re.fullmatch(r"\s*(-?\d*)\s*(?:(:)\s*(-?\d*)\s*(?::\s*(\d*)\s*)?)?", text)
    if not match or match[1] == "-" or match[3] == "-" or not (match[1] or match[2]) or match[4] == "0":
        raise argparse.ArgumentTypeError(
            f"expected A:B, A:B:STEP or one frame, such as 0:10, got {text.strip()!r}"
        )
    first, last, step = (int(part) if part else None for part in (match[1], match[3], match[4]))
    if match[2]:
        return slice(first, last, step)
    assert first is not None
    return slice(first, first + 1 or None)


def frame_budget(text: str) -> float:
    """Parse a time such as 33ms or 0.02s, above zero and at most a second; return seconds."""
    match = _DURATION.fullmatch(text)
    seconds = 0.0 if match is None else float(match[1]) * (1e-3 if match[2] == "ms" else 1.0)
    if not 0 < seconds <= 1:
        raise argparse.ArgumentTypeError(
            f"expected a time above 0 and up to 1s, such as 33ms or 0.02s, got {text.strip()!r}"
        )
    return seconds
