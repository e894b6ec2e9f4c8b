"""The colour bar that explains a picture's colours."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from luxel.particles import Particles
from luxel.picture.ticks import tick_labels
from luxel.scene.colormap import RGB, rgb, srgb_to_linear
from luxel.scene.view import View, lut_rows

if TYPE_CHECKING:
    from PIL.Image import Image as Picture

__all__ = ["draw_colorbar"]

_LEAST_SIZE = (140, 100)  # pixels; on smaller pictures a bar would hide the data
_FULL_SIZE = 720  # rows; lengths below are pixels at this size
_LIGHT, _DARK = (240, 240, 238), (24, 25, 28)
_OVERSAMPLING = 4  # of discs and arrows

Color = tuple[int, int, int]


def draw_colorbar(pixels: NDArray[np.uint8], view: View, particles: Particles) -> NDArray[np.uint8]:
    """Return a copy of `pixels` (H, W, 3 or 4) uint8 with a vertical colour bar at the right.

    Codes and categories are shown as discs with labels, and NaN as one more, "no data". An arrow at an end of the bar says
    that some data lie beyond it. Pictures of particles without a scalar (``color_by=None``), with colours of their own, or smaller
    than 140 x 100 pixels stay as they are.

    Raises
    ------
    ScalarError
        If the particles have no such scalar.
    """
    height, width = pixels.shape[:2]
    if view.color_by is None or view.colormap == RGB or width < _LEAST_SIZE[0] or height < _LEAST_SIZE[1]:
        return pixels.copy()
    sketch = _Sketch(width, height)
    _lay_out(sketch, _legend(view, particles, sketch), view.color_by)
    return sketch.onto(pixels)


@dataclass(frozen=True)
class _Legend:
    """What a legend says."""

    bar: NDArray[np.uint8] | None  # (n, 3) colours from the lowest value to the highest
    ticks: list[tuple[float, str]]  # place along the bar in [0, 1], label
    factor: str  # common to all tick labels
    swatches: list[tuple[Color, str]]
    below: bool  # some data lie below the bar's range
    above: bool


def _legend(view: View, particles: Particles, sketch: _Sketch) -> _Legend:
    values = particles.scalar(view.color_by or "")
    missing = (
        [(_bytes(view.nan_color), "no data")] if values.dtype.kind == "f" and np.isnan(values).any() else []
    )
    if view.categorical(particles):
        swatches = _codes(view, particles)
        most = sketch.most_rows - len(missing)
        if len(swatches) > most:
            swatches = [
                *swatches[: most - 1],
                (_bytes(view.nan_color), f"and {len(swatches) - most + 1} more"),
            ]
        return _Legend(None, [], "", swatches + missing, False, False)
    low, high = view.scalar_range(particles)
    ticks, factor = tick_labels(low, high, log=view.log, count=sketch.most_ticks)
    return _Legend(
        view.lut(), ticks, factor, missing, bool((values < low).any()), bool((values > high).any())
    )


def _codes(view: View, particles: Particles) -> list[tuple[Color, str]]:
    """Colour and label of every code that occurs."""
    name, table = view.color_by or "", view.lut()
    rows = lut_rows(view.normalised(particles), len(table))
    codes, firsts = np.unique(particles.scalar(name), return_index=True)
    labels = particles.categories.get(name, ())
    found = []
    for code, first in zip(codes, firsts, strict=True):
        if np.isfinite(code):
            label = labels[int(code)] if 0 <= code < len(labels) else f"{code:.6g}"
            red, green, blue = (int(channel) for channel in table[rows[first]])
            found.append(((red, green, blue), label))
    return found


def _lay_out(sketch: _Sketch, legend: _Legend, title: str) -> None:
    """Place the parts: title, factor, bar with ticks, discs; left-aligned in a block at the right, centred vertically."""
    px = sketch.px
    small, large = sketch.font(13), sketch.font(15)
    room = 0.4 * sketch.width
    title = _shortened(title, large, room)
    swatches = [(color, _shortened(label, small, room - px(24))) for color, label in legend.swatches]
    bar_width, pitch, arrow = px(16), sketch.pitch, px(11)
    bar_height = sketch.bar_height if legend.bar is not None else 0
    label_x = bar_width + px(9)

    body = max(
        [small.getlength(legend.factor)]
        + [label_x + small.getlength(t) for _, t in [*legend.ticks, *swatches]]
    )
    # A long title may push the bar a little way into the picture; beyond that it juts out to the left.
    heading = large.getlength(title)
    right = sketch.width - px(24)
    x = max(px(6), round(right - max(body, min(heading, body + px(48)))))
    title_x = min(x, max(px(6), round(right - heading)))
    title_height = max(px(28), 18)
    extras = (pitch if legend.factor else 0) + arrow * (legend.below + legend.above)
    total = (
        title_height
        + extras
        + bar_height
        + len(swatches) * pitch
        + (px(10) if bar_height and swatches else 0)
    )
    y = max(px(6), (sketch.height - total) // 2)

    sketch.text(title_x, y + title_height // 3, title, large)
    y += title_height
    if legend.factor:
        sketch.text(x, y + px(4), legend.factor, small)
        y += pitch
    if legend.bar is not None:
        if legend.above:
            sketch.polygon(x, y, [(0, arrow), (bar_width / 2, 0), (bar_width, arrow)], legend.bar[-1])
            y += arrow
        sketch.bar(x, y, bar_width, bar_height, legend.bar)
        for place, label in legend.ticks:
            level = y + (1 - place) * bar_height
            sketch.line(x + bar_width, round(level - 0.5), px(4))
            sketch.text(x + label_x, level, label, small)
        y += bar_height
        if legend.below:
            sketch.polygon(x, y, [(0, 0), (bar_width / 2, arrow), (bar_width, 0)], legend.bar[0])
            y += arrow
        y += px(10)
    for color, label in swatches:
        sketch.disc(x + bar_width / 2, y + pitch / 2, px(14), color)
        sketch.text(x + label_x, y + pitch / 2, label, small)
        y += pitch


@dataclass
class _Sketch:
    """Collects stamps (mask, corner, paint; None is ink), so that the halo below them and the ink's colour come last."""

    width: int
    height: int
    stamps: list[tuple[Picture, tuple[int, int], Color | NDArray[np.uint8] | None]] = field(
        default_factory=list
    )

    @property
    def bar_height(self) -> int:
        return round(0.46 * self.height)

    @property
    def pitch(self) -> int:
        """Distance between rows of text."""
        return max(self.px(23), 12)

    @property
    def most_rows(self) -> int:
        return max(2, int(0.8 * self.height) // self.pitch)

    @property
    def most_ticks(self) -> int:
        return min(max(self.bar_height // (2 * self.pitch), 2), 7)

    def px(self, length: float) -> int:
        """Pixels of a length that is meant for a picture of 720 rows."""
        return max(1, round(length * min(self.width, self.height) / _FULL_SIZE))

    def font(self, size: int) -> Any:
        return _font(max(self.px(size), size - 4))

    def text(self, x: float, y: float, text: str, font: Any) -> None:
        """Write with the middle of the digits' height at `y`."""
        from PIL import Image, ImageDraw

        if not text:
            return
        ascent, descent = font.getmetrics()
        mask = Image.new("L", (int(font.getlength(text)) + 4, ascent + descent), 0)
        ImageDraw.Draw(mask).text((1, ascent), text, fill=255, font=font, anchor="ls")
        middle = -font.getbbox("0", anchor="ls")[1] / 2
        self.stamps.append((mask, (round(x) - 1, round(y + middle) - ascent), None))

    def line(self, x: int, y: int, length: int) -> None:
        from PIL import Image

        self.stamps.append((Image.new("L", (length, self.px(1)), 210), (x, y), None))

    def bar(self, x: int, y: int, width: int, height: int, table: NDArray[np.uint8]) -> None:
        from PIL import Image, ImageDraw

        along = 1 - (np.arange(height) + 0.5) / height
        rows = table[(along * len(table)).astype(np.intp)]
        self.stamps.append(
            (Image.new("L", (width, height), 255), (x, y), np.repeat(rows[:, None], width, axis=1))
        )
        frame = Image.new("L", (width, height), 0)
        ImageDraw.Draw(frame).rectangle((0, 0, width - 1, height - 1), outline=90, width=self.px(1))
        self.stamps.append((frame, (x, y), None))

    def polygon(self, x: int, y: int, corners: list[tuple[float, float]], color: NDArray[np.uint8]) -> None:
        size = math.ceil(max(c[0] for c in corners)), math.ceil(max(c[1] for c in corners))
        mask = _smooth(size, lambda draw, k: draw.polygon([(k * a, k * b) for a, b in corners], fill=255))
        red, green, blue = (int(channel) for channel in color)
        self.stamps.append((mask, (x, y), (red, green, blue)))

    def disc(self, x: float, y: float, diameter: int, color: Color) -> None:
        size = (diameter, diameter)
        mask = _smooth(
            size, lambda draw, k: draw.ellipse((0, 0, k * diameter - 1, k * diameter - 1), fill=255)
        )
        self.stamps.append((mask, (round(x - diameter / 2), round(y - diameter / 2)), color))

    def onto(self, pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a copy of `pixels` with everything drawn on it."""
        from PIL import Image, ImageChops, ImageFilter

        blur = max(1.5, 4.0 * self.px(100) / 100)
        margin = math.ceil(3 * blur)
        left = max(0, min(corner[0] for _, corner, _ in self.stamps) - margin)
        top = max(0, min(corner[1] for _, corner, _ in self.stamps) - margin)
        region = Image.fromarray(pixels[top:, left:]).convert("RGBA")
        shape = Image.new("L", region.size, 0)
        for mask, (x, y), _ in self.stamps:
            layer = Image.new("L", region.size, 0)
            layer.paste(mask, (x - left, y - top))
            shape = ImageChops.lighter(shape, layer)
        ink = _ink_on(np.asarray(region))
        halo = shape.filter(ImageFilter.GaussianBlur(blur)).point(
            [min(150, int(1.6 * v)) for v in range(256)]
        )
        glow = Image.new("RGBA", region.size, _LIGHT if ink == _DARK else _DARK)
        glow.putalpha(halo)
        region.alpha_composite(glow)
        for mask, (x, y), paint in self.stamps:
            stamp = (
                Image.fromarray(paint)
                if isinstance(paint, np.ndarray)
                else Image.new("RGB", mask.size, paint or ink)
            )
            stamp.putalpha(mask)
            box = (max(0, left - x), max(0, top - y), region.width + left - x, region.height + top - y)
            region.alpha_composite(stamp.crop(box), (max(0, x - left), max(0, y - top)))
        drawn = pixels.copy()
        drawn[top:, left:] = np.asarray(region)[..., : pixels.shape[2]]
        return drawn


def _ink_on(region: NDArray[np.uint8]) -> Color:
    """Light or dark ink, whichever stands out from most of the region (transparent pixels count as white paper)."""
    alpha = region[..., 3:] / 255.0
    shade = srgb_to_linear(region[..., :3] / 255.0 * alpha + (1 - alpha)) @ np.array([0.2126, 0.7152, 0.0722])
    return _DARK if float(np.mean(shade)) > 0.3 else _LIGHT


def _smooth(size: tuple[int, int], paint: Any) -> Picture:
    from PIL import Image, ImageDraw

    mask = Image.new("L", (size[0] * _OVERSAMPLING, size[1] * _OVERSAMPLING), 0)
    paint(ImageDraw.Draw(mask), _OVERSAMPLING)
    return mask.resize(size, Image.Resampling.BOX)


def _shortened(text: str, font: Any, room: float) -> str:
    if font.getlength(text) <= room:
        return text
    while len(text) > 1 and font.getlength(text + "…") > room:
        text = text[:-1]
    return text + "…"


def _bytes(color: str) -> Color:
    red, green, blue = (round(255 * channel) for channel in rgb(color))
    return red, green, blue


@lru_cache(maxsize=16)
def _font(size: int) -> Any:
    import matplotlib
    from PIL import ImageFont

    # Pillow's own font lacks Greek letters, superscripts and the minus sign; matplotlib brings one that has them.
    path = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
    return ImageFont.truetype(str(path), size) if path.exists() else ImageFont.load_default(size=size)
