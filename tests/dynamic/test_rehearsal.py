"""Who keeps the books never waits for a compiler: Numba compiles one function at a time, and light takes it half a minute."""

from __future__ import annotations

import subprocess
import sys

# In a process of its own: in this one, other tests have called kernels.
_SCRIPT = """
import numpy as np

import luxel
from luxel.dynamic import cache, desk, engine, look, queue, sightings
from luxel.kernels.requests import pick
from luxel.session import Session
from luxel.textures.spec import TextureSpec
from tests.app.socket_client import InstantBaker
from tests.scenes import cloud

Dispatcher = type(pick)
kernels = {
    name: value for module in (cache, desk, look, queue, sightings)
    for name, value in vars(module).items() if isinstance(value, Dispatcher)
}
assert len(kernels) >= 8, kernels
clock = [0.0]
spec = TextureSpec(texels=4, samples=1)
with Session(
    cloud(20_000), spec=spec, threads=0, clock=lambda: clock[0], make_baker=lambda scene, spec: InstantBaker()
) as session:
    compiled = {name: list(each.signatures) for name, each in kernels.items()}
    assert all(compiled.values()), compiled
    everything = np.arange(20_000, dtype=np.int32)
    for ids in (everything[::3], everything[::2], everything[5_000:9_000], everything[::2]):
        clock[0] += 1.5  # what only the first has lapses with the third
        session.sighted(ids, (0, 0, 5), "one")
        session.sighted(ids[::2], (0, 5, 0), "other")
        session.run_for(1e-9)
        session.status()
        session.tiles(ids, session.key)
    session.forget("one")
    session.status()
    assert {name: list(each.signatures) for name, each in kernels.items()} == compiled
"""


def test_an_engine_compiles_what_keeps_its_books_before_it_begins() -> None:
    done = subprocess.run([sys.executable, "-c", _SCRIPT], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
