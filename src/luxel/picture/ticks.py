"""Round numbers along a scale, and how they are written."""

from __future__ import annotations

import math

__all__ = ["tick_labels"]

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def tick_labels(
    low: float, high: float, *, log: bool = False, count: int = 6
) -> tuple[list[tuple[float, str]], str]:
    """Choose round tick values in [low, high] for a scale of about `count` ticks.

    Returns
    -------
    ticks
        Pairs of place along the scale in [0, 1] and label.
    factor
        A factor common to all labels, such as ``"×10⁵"``; usually empty.
    """
    if log:
        values = _log_values(low, high, count)
        if len(values) >= 2:
            start, width = math.log(low), math.log(high) - math.log(low)
            places = [(math.log(value) - start) / width for value in values]
            return list(zip(places, _log_labels(values), strict=True)), ""
    power = max(
        math.floor(math.log10(max(abs(low), abs(high)))), -307
    )  # 10⁻³⁰⁸ has no inverse in double precision
    unit = 10.0**power if not -4 <= power < 5 else 1.0
    if not high / unit - low / unit > 1e-14 * max(abs(low), abs(high)) / unit:  # nothing lies between the two
        return [(0.5, f"{low:.6g}".replace("-", "−"))], ""
    values, digits = _round_values(low / unit, high / unit, count)
    labels = [f"{value:.{digits}f}".replace("-", "−") for value in values]
    factor = "" if unit == 1.0 else f"×10{str(power).translate(_SUPERSCRIPT)}"
    if log:
        places = [math.log(value / (low / unit)) / math.log(high / low) for value in values]
    else:
        places = [(value - low / unit) / (high / unit - low / unit) for value in values]
    return list(zip(places, labels, strict=True)), factor


def _round_values(low: float, high: float, count: int) -> tuple[list[float], int]:
    """Multiples of 1, 2, 2.5 or 5 times a power of ten, and how many decimals they need."""
    rough = (high - low) / count
    power = math.floor(math.log10(rough))
    decimal = 10.0**power
    factor = next(m for m in (1, 2, 2.5, 5, 10) if m * decimal >= rough * (1 - 1e-9))
    step = factor * decimal
    first, last = math.ceil(low / step - 1e-6), math.floor(high / step + 1e-6)
    digits = max(0, (1 if factor == 2.5 else 0) - power - (1 if factor == 10 else 0))
    return [min(max(k * step, low), high) + 0.0 for k in range(first, last + 1)], digits


def _log_values(low: float, high: float, count: int) -> list[float]:
    first, last = math.ceil(math.log10(low) - 1e-9), math.floor(math.log10(high) + 1e-9)
    decades = last - first + 1
    if decades >= 3:
        stride = math.ceil(decades / (count + 1))
        return [10.0**k for k in range(first, last + 1, stride)]
    # Under three decades powers of ten are too few.
    values = [m * 10.0**k for k in range(first - 1, last + 1) for m in (1, 2, 5)]
    return [value for value in values if low * (1 - 1e-9) <= value < math.inf and value * (1 - 1e-9) <= high]


def _log_labels(values: list[float]) -> list[str]:
    if values[0] >= 1e-4 and values[-1] < 1e6:
        return [f"{value:.6g}" for value in values]
    return [_power(value) for value in values]


def _power(value: float) -> str:
    exponent = math.floor(math.log10(value) + 1e-9)
    mantissa = round(value / 10.0**exponent, 6) if exponent > -300 else 1.0
    head = "" if mantissa == 1 else f"{mantissa:g}×"
    return head + "10" + str(exponent).translate(_SUPERSCRIPT)
