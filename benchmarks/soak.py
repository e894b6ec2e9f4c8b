"""Dynamic textures under an erratic user: `python -m benchmarks.soak [--seconds 300]`.

The camera wanders, jumps and rests; lights, albedo and time steps change; the cache is too small for all that is seen. Textures are what views make
by default: estimates first, then better ones. Once with dedicated threads, once with a budget a frame. Prints memory in each third of the time, frames, textures, errors, and how long requests waited: of the
particles in sight one at a time is followed until it has its texture, in pieces of work over the bound 4 (w + 1) of docs/dynamic.md, w
being all that waits when it comes into sight.
"""

from __future__ import annotations

import argparse
import gc
import logging
import statistics
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import luxel
from benchmarks.dynamic import resident
from benchmarks.light_scenes import slab
from benchmarks.measure import report
from luxel.picture.frames import Frame, Frames
from luxel.session import Session
from luxel.textures.spec import TextureSpec
from luxel.trace.tree import thread_count

__all__ = ["Soak", "Witness", "soak"]

_BUDGET_S = 0.033
_LEAST_MADE = 16  # textures between changes of light or time step


@dataclass
class Witness:
    """Follows one request at a time."""

    worst: float = 0.0  # pieces over bound
    longest_s: float = 0.0
    served: int = 0
    left: int = 0  # out of sight, or under another light
    _key: str = ""
    _id: int = -1
    _pieces: int = 0
    _since_s: float = 0.0
    _bound: int = 1

    def look(self, session: Session, frame: Frame, seen: np.ndarray, pieces: int, now_s: float) -> None:
        """Look at a frame and at what it told the session, `pieces` of work having been done so far."""
        if self._id >= 0:
            if session.key != self._key or self._id not in seen:
                self.left += 1
                self._id = -1
            else:
                self.worst = max(self.worst, (pieces - self._pieces) / self._bound)
                self.longest_s = max(self.longest_s, now_s - self._since_s)
                if len(session.tiles([self._id])):
                    self.served += 1
                    self._id = -1
        if self._id < 0 and frame.ready < frame.visible:
            ready = session.tiles(seen).ids
            lacking = np.setdiff1d(seen, ready)
            status = session.status()
            if len(lacking) and not status.over_budget:
                waits = status.queued + status.baking + frame.visible - frame.ready - frame.dim
                self._key, self._id = session.key, int(lacking[-1])
                self._pieces, self._since_s, self._bound = pieces, now_s, 4 * (waits + 1)


@dataclass
class Soak:
    """What came of it."""

    driver: str
    frames: int = 0
    textures: int = 0
    lights: int = 0
    steps: int = 0
    evicted: int = 0
    errors: list[str] = field(default_factory=list)
    bytes_over_budget: int = 0
    resident: list[float] = field(default_factory=list)  # MiB after each frame
    witness: Witness = field(default_factory=Witness)

    def row(self) -> dict[str, Any]:
        """One row of the table."""
        thirds = [statistics.median(part) for part in np.array_split(self.resident, 3)]
        return {
            "driver": self.driver,
            "frames": self.frames,
            "textures": self.textures,
            "evicted": self.evicted,
            "lights": self.lights,
            "time steps": self.steps,
            "errors": len(self.errors),
            "memory by thirds, MiB": " ".join(f"{each:.0f}" for each in thirds),
            "cache over budget, bytes": self.bytes_over_budget,
            "followed, served": self.witness.served,
            "pieces over bound, most": self.witness.worst,
            "longest wait, s": self.witness.longest_s,
        }


class _Errors(logging.Handler):
    def __init__(self, found: list[str]) -> None:
        super().__init__(logging.ERROR)
        self._found = found

    def emit(self, record: logging.LogRecord) -> None:
        self._found.append(record.getMessage())


def soak(
    series: Sequence[luxel.Particles],
    driver: str,
    *,
    seconds: float = float("inf"),
    frames: int = sys.maxsize,
    textures: int = 0,
    changes: int = 0,
    served: int = 0,
    size: tuple[int, int] = (512, 512),
    spec: TextureSpec | None = None,
    max_bytes: int = 64 << 20,
    rest: int = 40,
    seed: int = 0,
) -> Soak:
    """Look around until `seconds` have passed, or so many `frames` are drawn, `textures` made, lights or time steps changed, and followed requests `served`.

    Parameters
    ----------
    driver
        ``"threads"`` or ``"budget"``.
    rest
        Frames between changes of light or time step, on average.
    """
    rng = np.random.default_rng(seed)
    found = Soak(driver)
    handler = _Errors(found.errors)
    logging.getLogger("luxel").addHandler(handler)
    dedicated = driver == "threads"
    try:
        with (
            Session(
                list(series), spec=spec, threads=thread_count(None) if dedicated else 0, max_bytes=max_bytes
            ) as session,
            Frames(session, size=size, antialias=1, bake_budget_s=0.0 if dedicated else _BUDGET_S) as drawn,
        ):
            _look_around(session, drawn, found, rng, seconds, (frames, textures, changes, served), rest)
            error = session.status().error
            if error:
                found.errors.append(error)
    finally:
        logging.getLogger("luxel").removeHandler(handler)
    return found


def _look_around(
    session: Session,
    drawn: Frames,
    found: Soak,
    rng: np.random.Generator,
    seconds: float,
    least: tuple[int, int, int, int],
    rest: int,
) -> None:
    pieces = 0
    seen = np.empty(0, np.int32)

    def heard(batch: object) -> None:
        nonlocal pieces
        pieces += 1  # a lost update makes a wait look shorter by one piece

    sighted = session.sighted

    def noted(ids: Any, *rest: Any, **named: Any) -> None:
        nonlocal seen
        seen = np.array(ids, np.int32)
        sighted(ids, *rest, **named)

    session.sighted = noted  # type: ignore[method-assign]
    session.subscribe(heard)
    session.subscribe_coarse(heard)
    azimuth, elevation, zoom = 0.0, 30.0, 1.0
    changed, frame = 0, None
    start_s = time.monotonic()
    while time.monotonic() - start_s < seconds:
        stats = session._cache.stats()
        found.textures = stats.ready + stats.refined
        so_far = found.frames, found.textures, found.lights + found.steps, found.witness.served
        if all(count >= enough for count, enough in zip(so_far, least, strict=True)):
            break
        # Frames of a small picture come faster than any light could: each gets to make a few textures.
        lit = found.textures - changed >= _LEAST_MADE or frame is None or frame.ready == frame.visible
        if rng.random() < 1 / rest and lit:
            changed = found.textures
            if rng.random() < 0.3 and len(session.series) > 1:
                session.set_frame(int(rng.integers(len(session.series))))
                found.steps += 1
            else:
                lights = (luxel.Sky(1.0), luxel.Sun((*rng.normal(size=2), 1.0), 2.0, 15.0))
                session.relight(lights=lights, albedo=float(rng.uniform(0.2, 0.9)))
                found.lights += 1
        if rng.random() < 0.02:  # jump
            azimuth, elevation, zoom = rng.uniform(0, 360), rng.uniform(-80, 80), rng.uniform(0.15, 1.0)
        elif rng.random() < 0.6:  # wander, else rest
            azimuth += rng.normal() * 3
            elevation = float(np.clip(elevation + rng.normal() * 2, -85, 85))
        camera = luxel.Camera.framing(
            session.particles.bounds, azimuth=azimuth, elevation=elevation, aspect=1
        )
        towards = np.asarray(camera.target) - np.asarray(camera.eye)
        eye = np.asarray(camera.target) - zoom * towards
        frame = drawn.draw(luxel.View(camera=luxel.Camera(eye, camera.target, up=camera.up)))
        found.frames += 1
        found.witness.look(session, frame, seen, pieces, time.monotonic())
        found.bytes_over_budget = max(found.bytes_over_budget, stats.nbytes - session._cache.max_bytes)
        found.evicted = stats.evicted
        if found.frames % 50 == 0:
            gc.collect()
        found.resident.append(resident() / 2**20)
    found.bytes_over_budget = max(0, found.bytes_over_budget)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=300.0, help="of both drivers together")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    series = [slab(200_000, seed=seed) for seed in (3, 4, 5)]
    rows = [
        soak(series, driver, seconds=options.seconds / 2, max_bytes=24 << 20).row()
        for driver in ("threads", "budget")
    ]
    report("soak", rows, options.json)


if __name__ == "__main__":
    main()
