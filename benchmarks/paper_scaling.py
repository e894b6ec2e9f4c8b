"""The paper's figure 8, and how drawing and baking share a machine. Run through ``benchmarks.paper_tables``.

All on the plate alone, from the first view of the camera path "arc" (see ``paper_tables_dynamic``), one ray a pixel, textures of default quality.

splits: for several splits between drawing and baking, dedicated threads and per-frame budgets (paper figure 7), while requests wait:
frames a second over those of all threads with nothing to bake, and textures a second over a plain bake's on all threads; their sum.
fill: from an empty cache, how long until all that one view at 512² and 1024² shows has its first light, a texture (one sample of each texel in view),
and a refined one (a session's default; at rest, full run), with as many threads for baking as for drawing, while frames are drawn: none, those of a camera at rest, thirty a second as if it moved, or as many as can be. Preparing the
filter is included, in the plain bake too. Antialiased frames at rest see more particles than one ray a pixel. Targets are for the 512² view of a machine with AVX-512.
figure8: efficiency over threads, at 512² and 1024²: medians of five turns, each of which tries all numbers of threads.
"alone": frames with all textures there, and a plain bake, rate(t) / (t · rate(1)): what the machine and its memory let through.
"dedicated": half of the threads draw and half bake, while requests wait; frames a second over t/2 times those of one thread alone, textures
over t/2 times a plain bake's on one thread.
"callback": every thread draws, then bakes, while requests wait, rate(t) / (t · rate(1)). The budget is 33 ms over t, so that a frame holds the same
work whatever t is; and any t begins anew once it has made the textures that one thread has time for, since the nearest, which come first, cost least.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from time import perf_counter, sleep
from typing import Any

import numpy as np
from numpy.typing import NDArray

import luxel
from benchmarks.light_scenes import DataSet
from benchmarks.paper_tables_dynamic import arc
from benchmarks.scenes import plate_camera
from luxel.picture.frames import Frame, Frames
from luxel.picture.raytrace import visible_ids
from luxel.session import Session
from luxel.textures.bake import Baker, bake_with
from luxel.textures.spec import TextureSpec

__all__ = ["figure8", "fill", "splits"]

Rows = list[dict[str, Any]]
_SPEC = TextureSpec.usual()
_BUDGET_S = 0.033
_TARGET = 0.8  # efficiency
_SPLIT_TARGET = 0.9
_FIRST_TARGET_S, _ALL_TARGET_S = 1.0, 6.0
_FRAME_S = 1 / 30


@dataclass(eq=False)
class _Stand:
    """What is drawn and baked, with a baker that has learnt its filter, so that sessions need not."""

    scene: luxel.Scene
    camera: luxel.Camera
    side: int
    baker: Baker
    seen: NDArray[np.int32]
    textures: luxel.LuminanceTextures

    @classmethod
    def of(cls, data: DataSet, side: int, threads: int) -> _Stand:
        scene = data.scene("sky+sun")
        camera = arc(data.particles, 1)[0]
        baker = Baker(scene, _SPEC)
        baker.prepare(threads)
        seen = visible_ids(scene, camera, (side, side))
        return cls(scene, camera, side, baker, seen, bake_with(baker, seen, threads=threads))

    def frames_alone(self, threads: int, for_s: float) -> float:
        """Frames a second with all textures there and nothing being baked."""
        view = luxel.View(camera=self.camera)
        with Frames(
            self.scene, view, (self.side, self.side), textures=self.textures, antialias=1, threads=threads
        ) as frames:
            frames.draw()
            drawn, start = 0, perf_counter()
            while (took := perf_counter() - start) < for_s:
                frames.restart()  # as if the camera had moved: every draw sends a ray through every pixel
                frames.draw()
                drawn += 1
        return drawn / took

    def bake_alone(self, threads: int, for_s: float) -> float:
        """Textures a second of a plain bake."""
        done, start = 0, perf_counter()
        rng = np.random.default_rng(0)
        while (took := perf_counter() - start) < for_s:
            lot = rng.permutation(self.seen)[: 1024 * threads]
            bake_with(self.baker, lot, threads=threads)
            done += len(lot)
        return done / took

    def both(
        self, draw: int, bake: int, budget_s: float, for_s: float, most: float = math.inf
    ) -> tuple[float, float]:
        """Frames and textures a second while requests wait, over as many empty caches as it takes, of each the first `most` textures."""
        drawn = done = 0
        took = 0.0
        for _ in range(50):
            frames, textures, seconds = self._once(draw, bake, budget_s, for_s - took, most)
            drawn, done, took = drawn + frames, done + textures, took + seconds
            if took >= 0.9 * for_s:
                break
        return drawn / took, done / took

    def _once(
        self, draw: int, bake: int, budget_s: float, most_s: float, most: float
    ) -> tuple[int, int, float]:
        """Draw and bake from the first textures on, up to the last or for `most` of them or `most_s` seconds; return frames, textures, seconds."""
        done = 0

        def count(batch: Any) -> None:
            nonlocal done
            done += len(batch.ids)  # each worker tells its own; a lost update is one batch of thousands

        with (
            Session(
                self.scene,
                spec=_SPEC,
                threads=bake,
                max_bytes=1 << 30,
                make_baker=lambda scene, spec: self.baker,
            ) as session,
            Frames(
                session,
                luxel.View(camera=self.camera),
                (self.side, self.side),
                antialias=1,
                threads=draw,
                bake_budget_s=budget_s,
            ) as frames,
        ):
            leave = session.subscribe(count)
            while not done:  # first light
                frames.restart()
                frames.draw()
            done, drawn, start = 0, 0, perf_counter()
            while True:
                frames.restart()
                frame = frames.draw()
                drawn += 1
                took = perf_counter() - start
                if took >= most_s or done >= most or frame.ready == frame.visible:
                    leave()
                    return drawn, done, took


def splits(sets: list[DataSet], quick: bool, threads: int) -> Rows:
    """Shares of the machine that drawing and baking get, for several splits."""
    stand = _Stand.of(sets[0], 512, threads)
    for_s = 2.0 if quick else 6.0
    t = threads
    chosen = [(f"draw {t}, bake {b}", t, b, 0.0) for b in sorted({1, (t + 1) // 2, t})]
    chosen += [
        (f"draw {t - b}, bake {b}", t - b, b, 0.0) for b in sorted({t // 4, t // 2, 3 * t // 4} - {0, t})
    ]
    chosen += [(f"draw {t}, budget {1000 * s:.0f} ms", t, 0, s) for s in (0.010, 0.033)]
    rows: Rows = []
    for name, draw, bake, budget_s in chosen:
        alone = stand.bake_alone(t, for_s / 2)
        frames_alone = stand.frames_alone(t, for_s / 2)
        frames_per_s, textures_per_s = stand.both(draw, bake, budget_s, for_s)
        share = frames_per_s / frames_alone, textures_per_s / alone
        rows.append(
            {
                "split": name,
                "frames/s": frames_per_s,
                "of alone": frames_alone,
                "textures/s": textures_per_s,
                "of a bake's": alone,
                "frame share": share[0],
                "bake share": share[1],
                "sum": sum(share),
                "target": _verdict(sum(share), _SPLIT_TARGET),
            }
        )
    return rows


def fill(sets: list[DataSet], quick: bool, threads: int) -> Rows:
    """Seconds until a view is lit, while frames go on."""
    scene = sets[0].scene("sky+sun")
    camera = plate_camera(sets[0].particles)
    rows: Rows = []
    ways = {"at rest": iter, "30 a second": _thirty_a_second} | (
        {} if quick else {"as many as can be": _flying}
    )
    _fill(scene, camera, 32, threads, iter, refined=False)  # compiles
    for side in (512,) if quick else (512, 1024):
        seen = visible_ids(scene, camera, (side, side))
        luxel.bake(scene, seen[:64], samples=1, mode="fast")  # compiles what bakes need besides
        start = perf_counter()
        bake_with(Baker(scene, _SPEC), seen, threads=threads)
        took = perf_counter() - start
        rows.append(
            {"picture": f"{side}²", "frames": "none: a plain bake", "particles": len(seen), "all s": took}
        )
        for name, way in ways.items():
            refined = not quick and name == "at rest"
            row = _fill(scene, camera, side, threads, way, refined=refined)
            met = row["first light s"] < _FIRST_TARGET_S and row["all s"] < _ALL_TARGET_S
            target = f"< {_FIRST_TARGET_S:g}, < {_ALL_TARGET_S:g}: {'met' if met else 'missed'}"
            rows.append(
                {"picture": f"{side}²", "frames": name, **row} | ({"target": target} if side == 512 else {})
            )
    return rows


def _fill(
    scene: luxel.Scene,
    camera: luxel.Camera,
    side: int,
    threads: int,
    way: Callable[[Frames], Iterator[Frame]],
    *,
    refined: bool,
) -> dict[str, Any]:
    view = luxel.View(camera=camera)
    first_s = all_s = pace = 0.0
    drawn, start = 0, perf_counter()
    with (
        Session(scene, threads=threads, max_bytes=1 << 30) as session,
        Frames(session, view, (side, side), threads=threads) as frames,
    ):
        for frame in way(frames):
            drawn += 1
            took = perf_counter() - start
            if not first_s and frame.visible == frame.ready + frame.dim:
                first_s = took
            if frame.visible == frame.ready and not all_s:
                all_s, pace = took, drawn / took
                if not refined:
                    break
    found = {"particles": frame.visible, "first light s": first_s, "all s": all_s, "frames/s": pace}
    return found | ({"refined s": took} if refined else {})


def _flying(frames: Frames) -> Iterator[Frame]:
    while True:
        frames.restart()
        yield frames.draw()


def _thirty_a_second(frames: Frames) -> Iterator[Frame]:
    due_s = perf_counter()
    for frame in _flying(frames):
        yield frame
        due_s = max(due_s + _FRAME_S, perf_counter())
        sleep(max(0.0, due_s - perf_counter()))


def figure8(sets: list[DataSet], quick: bool, threads: int) -> Rows:
    """Efficiency over threads."""
    counts = sorted({1, threads, *(2**k for k in range(1, 7) if 2**k <= threads)})
    rows: Rows = []
    for side in (512, 1024):
        stand = _Stand.of(sets[0], side, threads)
        turns = [_turn(stand, counts, 0.5 if quick else 3.0) for _ in range(5)]
        rows += [_efficiencies(f"{side}²", count, turns) for count in counts]
    rows.append(
        {
            "picture": "paper",
            "threads": 16,
            "alone: frames": "about 0.8",
            "callback: frames": "flat",
            "callback: textures": "about linear",
        }
    )
    return rows


def _turn(stand: _Stand, counts: list[int], for_s: float) -> dict[int, dict[str, float]]:
    """Rates of everything with each number of threads, one soon after the other, as a machine's speed drifts."""
    found: dict[int, dict[str, float]] = {}
    most = math.inf
    for count in counts:
        half = count // 2
        frames, textures = stand.both(count, 0, _BUDGET_S / count, for_s, most)
        if count == 1:
            most = textures * for_s
        found[count] = {
            "alone: frames": stand.frames_alone(count, for_s / 2),
            "alone: bake": stand.bake_alone(count, for_s / 2),
        }
        if half:
            both = stand.both(count - half, half, 0.0, for_s)
            found[count] |= dict(zip(("dedicated: frames", "dedicated: textures"), both, strict=True))
        found[count] |= {"callback: frames": frames, "callback: textures": textures}
    return found


def _efficiencies(picture: str, count: int, turns: list[dict[int, dict[str, float]]]) -> dict[str, Any]:
    """One row of figure 8: medians over turns."""
    row: dict[str, Any] = {"picture": picture, "threads": count}
    half = count // 2
    ideal = {
        "alone: frames": (count, "alone: frames"),
        "alone: bake": (count, "alone: bake"),
        "dedicated: frames": (count - half, "alone: frames"),
        "dedicated: textures": (half, "alone: bake"),
        "callback: frames": (count, "callback: frames"),
        "callback: textures": (count, "callback: textures"),
    }
    missed = []
    for name, (threads, single) in ideal.items():
        if name not in turns[0][count]:
            row[f"{name}/s"] = row[name] = ""
            continue
        row[f"{name}/s"] = float(np.median([turn[count][name] for turn in turns]))
        row[name] = float(np.median([turn[count][name] / (threads * turn[1][single]) for turn in turns]))
        if row[name] < _TARGET:
            missed.append(name)
    row["target"] = f">= {_TARGET}: " + ("met" if not missed else "missed by " + ", ".join(missed))
    return row


def _verdict(value: float, target: float) -> str:
    return f">= {target}: " + ("met" if value >= target else "missed")
