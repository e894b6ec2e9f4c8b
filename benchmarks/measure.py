"""How benchmarks measure: rivals take turns in one run, so that a machine whose speed drifts hurts both alike."""

from __future__ import annotations

import json
import os
import platform
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numpy as np


def machine() -> dict[str, Any]:
    """Processor, instruction set and threads, as every table names them."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        model = next(
            (
                line.split(":", 1)[1].strip()
                for line in info.read_text().splitlines()
                if line.startswith("model name")
            ),
            model,
        )
    features = llvm.get_host_cpu_features()
    isa = next((name for name in ("avx512f", "avx2", "neon") if features.get(name)), "scalar")
    if os.environ.get("NUMBA_CPU_NAME"):
        isa = f"as {os.environ['NUMBA_CPU_NAME']}"
    threads = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {"cpu": model, "isa": isa, "threads": threads, "numpy": np.__version__}


def interleaved(rivals: dict[str, Callable[[], Any]], rounds: int) -> dict[str, list[float]]:
    """Seconds of each rival, every round in turn after one warm-up each."""
    for run in rivals.values():
        run()
    seconds: dict[str, list[float]] = {name: [] for name in rivals}
    for _ in range(rounds):
        for name, run in rivals.items():
            start = time.perf_counter()
            run()
            seconds[name].append(time.perf_counter() - start)
    return seconds


def ratio(slow: list[float], fast: list[float]) -> tuple[float, float, float]:
    """Median of the ratios pair by pair, with its lowest and highest."""
    pairs = [a / b for a, b in zip(slow, fast, strict=True)]
    return statistics.median(pairs), min(pairs), max(pairs)


def verdict(met: bool) -> str:
    """What a table says of a target."""
    return "met" if met else "MISSED"


def report(title: str, rows: list[dict[str, Any]], as_json: bool) -> None:
    """Print rows as a table or as JSON, with the machine."""
    if as_json:
        print(json.dumps({"benchmark": title, "machine": machine(), "rows": rows}))
        return
    print(f"# {title} — " + ", ".join(f"{k} {v}" for k, v in machine().items()))
    names = list(dict.fromkeys(k for row in rows for k in row))
    cells = [
        [f"{row.get(n, ''):.3g}" if isinstance(row.get(n), float) else str(row.get(n, "")) for n in names]
        for row in rows
    ]
    widths = [max(len(n), *(len(c[k]) for c in cells)) for k, n in enumerate(names)]
    for line in [names, *cells]:
        print("  ".join(v.ljust(w) for v, w in zip(line, widths, strict=True)).rstrip())
