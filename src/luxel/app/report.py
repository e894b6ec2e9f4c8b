"""Tables for people: what files and stores hold, and what a bake will cost. Nothing is printed here."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

__all__ = ["bytes_text", "distortion_texts", "file_table", "plan_table", "store_table", "time_text"]


def file_table(found: dict[str, Any]) -> str:
    """Lay out what `describe` found for people."""
    lines = [
        f"{found['path']}: {found['format']}, {found['frames']} frame{'' if found['frames'] == 1 else 's'}"
    ]
    time_text = "" if found["time"] is None else f", time {found['time']:g}"
    lines.append(f"frame      {found['frame']}{time_text}")
    lines.append(f"particles  {found['particles']:,}")
    if found["bounds"] is not None:
        low, high = found["bounds"]
        lines.append(
            "bounds     "
            + "  ".join(f"{axis} {_span(a, b)}" for axis, a, b in zip("xyz", low, high, strict=True))
        )
    if found["cell"] is not None:
        periodic = (
            "".join(axis for axis, flag in zip("xyz", found["cell"]["periodic"], strict=True) if flag)
            or "no axis"
        )
        lines.append(f"cell       periodic along {periodic}")
    radii = found["radii"]
    lines.append(f"radii      {_span(radii['min'], radii['max'])}  ({radii['source']})")
    names = found["scalars"]
    lines.append(f"scalars    {'' if names else 'none'}".rstrip())
    width = max((len(name) for name in names), default=0)
    for name, scalar in names.items():
        parts = f"{scalar['dtype']}{'' if scalar['components'] == 1 else ' x ' + str(scalar['components'])}"
        missing = f"  no data: {scalar['no_data']:,}" if scalar["no_data"] else ""
        labels = f"  {', '.join(scalar['categories'][:8])}" if scalar.get("categories") else ""
        lines.append(
            f"  {name:<{width}}  {parts:<11}  {_span(scalar['min'], scalar['max'])}{missing}{labels}"
        )
    return "\n".join(lines)


def store_table(found: dict[str, Any]) -> str:
    """Lay out what `describe_baked` found for people."""
    settings, frames = found["settings"], found["frames"]
    spec, codec = settings["spec"], settings["codec"]
    lights = ", ".join(f"{light['kind']} {light['level']:g}" for light in settings["lights"]) or "none"
    knobs = "".join(
        f", {name} {value:g}" for name, value in codec.items() if name != "kind" and value is not None
    )
    lines = [
        f"{found['path']}: baked textures, {len(frames)} frame{'' if len(frames) == 1 else 's'}",
        f"source     {found['source']}, luxel {found['luxel']}",
        f"light      {settings['model']}, albedo {settings['albedo']:g}, {lights}"
        + (f", periodic along {settings['periodic']}" if settings["periodic"] else ""),
        f"textures   {spec['texels']}x{spec['texels']}, {spec['mode']}, {spec['samples']} samples a texel, {spec['mapping']}",
        f"codec      {codec['kind']}{knobs}{', raw textures kept' if settings['keep_raw'] else ''}",
    ]
    for frame in frames:
        time = "" if frame["time"] is None else f", time {frame['time']:g}"
        lines.append(f"frame      {frame['source_frame']}{time}")
        lines.append(f"  particles   {frame['particles']:,}")
        lines.append(f"  scalars     {', '.join(frame['scalars']) or 'none'}")
        stored = frame["payload_bytes"] + frame["shared_bytes"]
        lines.append(
            f"  bytes       {bytes_text(stored)} of {bytes_text(frame['raw_bytes'])}, ratio {frame['ratio']:.3g}"
        )
        lines += [f"  {name:<11} {text}" for name, text in distortion_texts(frame["distortion"])]
        lines.append(
            f"  error       mean {frame['error_mean']:.3g}, at most {frame['error_max']:.3g} in luminance;"
            f" clipped texels {frame['clipped']:,}"
        )
    return "\n".join(lines)


def distortion_texts(lost: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return what a codec changed, as names and figures: in codes, then in luminance."""
    if not lost["d"]:
        return [("distortion", "none")]
    return [
        (
            "distortion",
            f"d {lost['d']:.4g}, √d {lost['root_d']:.3g}, RMSE {lost['rmse']:.3g} and at most {lost['largest']}"
            f" of 255 levels, PSNR {lost['psnr']:.1f} dB",
        ),
        (
            "luminance",
            f"surface error {lost['surface']:.3g}, in pictures {lost['seen']:.3g} and at most {lost['largest_luminance']:.3g}",
        ),
    ]


def plan_table(path: str, found: dict[str, Any]) -> str:
    """Lay out what `plan_bake` found for people."""
    about = "" if found["exact"] else "about "
    side = found["texels"]
    lines = [
        f"{path}: {found['frames']} frame{'' if found['frames'] == 1 else 's'}, {about}{found['particles']:,} particles",
        f"textures   {side}x{side}, {found['mode']}, {found['samples']} samples a texel",
    ]
    width = max(len(name) for name in found["sizes"])
    for name, (formula, count) in found["sizes"].items():
        lines.append(f"  {name:<{width}}  {bytes_text(count):>8}  {formula}")
    lines.append(
        f"time       about {time_text(found['seconds'])} on this machine: {time_text(found['prepare_s'])} of preparation"
        f" a frame, then {found['rate']:,.0f} textures a second, measured on {found['sampled']:,} of them"
    )
    return "\n".join(lines)


def bytes_text(count: float) -> str:
    """Return 1536 as ``"1.54 kB"``."""
    for unit in ("B", "kB", "MB", "GB", "TB"):
        if count < 999.5 or unit == "TB":
            return f"{count:.3g} {unit}"
        count /= 1000
    raise AssertionError  # pragma: no cover


def time_text(seconds: float) -> str:
    """Return 5000 as ``"1 h 23 min"``."""
    if seconds < 99.5:
        return f"{max(1, round(seconds))} s"
    minutes = round(seconds / 60)
    if minutes < 100:
        return f"{minutes} min"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours < 100 else f"{hours / 24:.3g} days"


def _span(low: float | None, high: float | None) -> str:
    if low is None or high is None:
        return "none"
    return f"{low:.6g}" if low == high else f"{low:.6g} … {high:.6g}"
