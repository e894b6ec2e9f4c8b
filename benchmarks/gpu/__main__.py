"""The viewer on a graphics processor: frames a second of the page's own shaders and draw calls, in OpenGL ES by EGL.

    python -m benchmarks.gpu [--particles 1000000] [--size 1920x1080] [--picture PREFIX.png] [--json]
    python -m benchmarks.gpu --write FILE.npz …       # here, with luxel and Node.js; and on another machine,
    python -m benchmarks.gpu --read FILE.npz …        # with NumPy alone

The page's renderer draws into a WebGL that writes its calls down (record.js); these are played in a context without a window. A frame
is what the page draws while the camera moves: ids of all spheres, light, tone, and a look at what is visible. Its time ends when the
processor has finished it. The first picture of each row is compared with the ray tracer's: particles in percent, levels of 255.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterable
from pathlib import Path

from benchmarks.gpu.play import Row, play

_WIDTHS = (46, 25, 9, 8, 6, 7, 6, 6, 1)


def main() -> None:
    """Prepare, play, print."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.gpu",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--particles", type=int, default=1_000_000)
    parser.add_argument("--size", type=_size, default=(1920, 1080), metavar="WxH")
    parser.add_argument("--write", type=Path, metavar="FILE", help="prepare only")
    parser.add_argument("--read", type=Path, metavar="FILE", help="play what --write has written")
    parser.add_argument("--frames", type=int, default=60, help="a row, at most 60: fewer for slow drivers")
    parser.add_argument("--device", type=int, help="number of the EGL device")
    parser.add_argument(
        "--picture", type=Path, metavar="PREFIX.png", help="save the first picture of each row"
    )
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = options.read or options.write or Path(folder) / "gpu.npz"
        if options.read is None:
            from benchmarks.gpu.prepare import prepare  # needs luxel, which playing does not

            prepare(path, options.particles, options.size)
        if options.write is None:
            _report(play(path, options.frames, options.device, options.picture), options.json)


def _report(rows: Iterable[Row], as_json: bool) -> None:
    """Print rows as they come; end with an error if any has trouble."""
    troubled = False
    for k, row in enumerate(rows):
        troubled |= bool(row["trouble"])
        if k == 0 and not as_json:
            print("  ".join(name.ljust(width) for name, width in zip(row, _WIDTHS, strict=True)))
        line = json.dumps(row) if as_json else _line(row)
        print(line, flush=True)
    if troubled:
        raise SystemExit("some rows have trouble")


def _line(row: Row) -> str:
    return "  ".join(
        _cell(value).ljust(width) for value, width in zip(row.values(), _WIDTHS, strict=True)
    ).rstrip()


def _cell(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _size(text: str) -> tuple[int, int]:
    width, height = text.split("x")
    return int(width), int(height)


if __name__ == "__main__":
    main()
