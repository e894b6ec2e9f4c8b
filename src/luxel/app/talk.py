"""What commands tell people on stderr while they work."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from luxel.scene.scene import Scene

__all__ = ["Progress", "say", "say_if_cold", "say_if_dark"]

_QUIET_S = 15.0  # between reports where stderr is a file


def say(text: str) -> None:
    """Print one line on stderr."""
    print(f"luxel: {text}", file=sys.stderr, flush=True)


def say_if_cold() -> None:
    """Compile kernels on a machine that has none yet, and say so."""
    from luxel.kernels.jit import cold

    if cold():
        from luxel.app.warm import compile_ahead

        say("compiling kernels for this machine (once) ...")
        compile_ahead()


def say_if_dark(light: argparse.Namespace | Scene) -> None:
    """Note that light cannot reach into a cell that repeats along all its vectors."""
    closed = light.periodic == "xyz" and light.model != "lambertian"
    if closed and not (light.model == "ao" and light.ao_distance is not None):
        say(
            "note: neither sky nor sun reaches into a cell that repeats along all of x, y and z"
            " — leave one out, or use --model ao with --ao-distance"
        )


class Progress:
    """A progress bar on stderr, made at the first report; silent for short work and, longer, where nobody watches.

    Parameters
    ----------
    label
        What is done.
    unit
        What is counted.

    Attributes
    ----------
    done, total
        Of the last report; 0 before the first.
    """

    def __init__(self, label: str = "lighting", unit: str = "particles") -> None:
        self._bar: Any = None
        self._label, self._unit = label, unit
        self.done = self.total = 0

    def __call__(self, done: int, total: int) -> None:
        """Report so far; the first report says what had been done before."""
        self.done, self.total = done, total
        if self._bar is None:
            from tqdm import tqdm

            watched = sys.stderr.isatty()
            self._bar = tqdm(
                total=total,
                initial=done,
                desc=self._label,
                unit=f" {self._unit}",
                unit_scale=True,
                leave=False,
                file=sys.stderr,
                delay=0.5 if watched else _QUIET_S,
                mininterval=0.1 if watched else _QUIET_S,
            )
        self._bar.total = total
        self._bar.update(done - self._bar.n)

    def close(self) -> None:
        """Take the bar away."""
        if self._bar is not None:
            self._bar.close()

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
