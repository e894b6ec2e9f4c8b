"""The viewer: frames a second in a real browser, upload, latency of light, what an idle server costs.

    python -m benchmarks.browser [--json]

Frames are drawn by a headless Chromium without graphics hardware (SwiftShader); latency is seen by a client of the
socket that confirms what it gets. About two minutes on two cores.
"""

from __future__ import annotations

import argparse
import statistics
import time
from typing import Any

import numpy as np

import luxel
from benchmarks.measure import report
from benchmarks.scenes import plate, plate_camera
from luxel.app import protocol
from luxel.app.viewer import Viewer, view
from luxel.picture.raytrace import visible_ids
from luxel.session import Session
from luxel.textures.spec import TextureSpec
from luxel.trace.spheres import SphereSet
from tests.app.chromium import Page
from tests.app.socket_client import Client

Row = dict[str, Any]
_PATIENCE_S = 120.0
_ORBIT = """new Promise(done => {
  const start = luxel.camera(), from = luxel.state().frames, began = performance.now();
  let k = 0;
  const turn = () => {
    const angle = 0.03 * ++k, [x, y, z] = start.eye.map((e, i) => e - start.target[i]);
    const eye = [x * Math.cos(angle) - y * Math.sin(angle), x * Math.sin(angle) + y * Math.cos(angle), z];
    luxel.setCamera({ ...start, eye: eye.map((e, i) => e + start.target[i]) });
    const seconds = (performance.now() - began) / 1000;
    if (seconds < 8) requestAnimationFrame(turn);
    else done((luxel.state().frames - from) / seconds);
  };
  turn();
})"""


def frames(count: int) -> Row:
    """Frames a second while the camera orbits and light streams in, 640 x 480."""
    particles = plate(count)
    with Session(particles) as session, _served(session) as viewer, Page(viewer.url, (640, 480)) as page:
        page.wait("window.luxel && luxel.state().loaded > 0 && luxel.state().visible > 0", _PATIENCE_S)
        page.run("document.getElementById('fold').click()")
        found = page.run(_ORBIT)
    return {
        "what": f"orbit over {len(particles):,} particles, 640x480, software WebGL",
        "value": found,
        "unit": "frames/s",
    }


def upload(count: int) -> Row:
    """From a page's first word to its last particle."""
    rng = np.random.default_rng(0)
    with (
        Session(luxel.Particles(rng.random((count, 3)), 0.002), model="lambertian") as session,
        _served(session) as viewer,
    ):
        start = time.perf_counter()
        client = Client(viewer, confirms=True)
        there = 0
        while there < count:
            there += len(client.next(protocol.Geometry).positions)
        took = time.perf_counter() - start
        client.socket.close()
    return {"what": f"upload of {count:,} particles", "value": took, "unit": "s"}


def latency(asks: int) -> list[Row]:
    """From a request to its first light and to its first texture, while all that a view shows is outstanding."""
    particles = plate()
    scene = luxel.Scene(particles)
    camera = plate_camera(particles)
    seen = visible_ids(scene, camera, (512, 512), antialias=1)
    unit = SphereSet.of(particles).to_unit
    eye = tuple(unit(np.asarray(camera.eye, np.float64)).ravel().tolist())
    rng = np.random.default_rng(1)
    with Session(scene, spec=TextureSpec(mode="fast", samples=2)) as session, _served(session) as viewer:
        client = Client(viewer, confirms=True)
        key = client.next(protocol.LightState).key
        client.send(protocol.Sighted(key, seen, eye))
        client.next(protocol.Tiles)  # the filter has been learnt
        first, tile = [], []
        for _ in range(asks):
            wanted = np.setdiff1d(rng.integers(0, len(particles), 64, dtype=np.int32), seen)
            start = time.perf_counter()
            # The eye stands beside them: they are what matters now.
            near = tuple(unit(particles.positions[wanted[0]] + 2.0).ravel().tolist())
            client.send(protocol.Sighted(key, wanted, near))
            lit = None
            while True:
                message = client.next(protocol.Message)
                fits = (
                    isinstance(message, protocol.Tiles | protocol.Coarse)
                    and np.isin(message.ids, wanted).any()
                )
                if fits and lit is None:
                    lit = time.perf_counter() - start
                if fits and isinstance(message, protocol.Tiles):
                    break
            first.append(lit)
            tile.append(time.perf_counter() - start)
            client.send(protocol.Sighted(key, seen, eye))
            while not np.isin(client.next(protocol.Tiles).ids, seen).all():
                pass
        outstanding = session.status().queued
        client.socket.close()
    note = f"{len(seen):,} in sight, {outstanding:,} outstanding at the end"
    return [
        {
            "what": f"request to its {name}, median of {asks}",
            "value": 1e3 * statistics.median(took),
            "unit": "ms",
            "remark": note,
        }
        for name, took in (("first light", first), ("first texture", tile))
    ]


def idle(seconds: float) -> Row:
    """Share of a core that a server takes whose page has all it wants."""
    with Session(plate(20_000), spec=TextureSpec.usual()) as session, _served(session) as viewer:
        client = Client(viewer, confirms=True)
        key = client.next(protocol.LightState).key
        client.send(protocol.Sighted(key, np.arange(2000, dtype=np.int32), (0.0, 0.0, 2.0)))
        there = 0
        while there < 2000:
            there += len(client.next(protocol.Tiles).ids)
        time.sleep(1.0)
        began = time.process_time()
        time.sleep(seconds)
        used = time.process_time() - began
        client.socket.close()
    return {"what": f"idle server over {seconds:g} s", "value": 100 * used / seconds, "unit": "% of a core"}


def _served(session: Session) -> Viewer:
    return view(session, block=False, open_browser=False, announce=lambda url: None)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rows = [frames(50_000), upload(1_000_000), *latency(15), idle(5.0)]
    report("viewer", rows, options.json)


if __name__ == "__main__":
    main()
