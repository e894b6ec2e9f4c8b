"""Data sets that pages ask for part by part: what the server answers, and in which numbers."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import luxel
from luxel.app import order, protocol
from luxel.app.hub import Hub
from luxel.app.order import Order, order_of
from luxel.app.server import CLOSE_BAD_MESSAGE
from luxel.app.viewer import Viewer, view
from luxel.errors import ProtocolError
from luxel.session import Session
from luxel.textures.spec import TextureSpec
from luxel.trace.spheres import SphereSet
from tests.app.socket_client import Client, InstantBaker

COUNT = 5000
FIRST = 2048
EYE = (0.0, 0.0, 9.0)


@pytest.fixture(autouse=True)
def few_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(order, "FIRST", FIRST)


@pytest.fixture
def particles() -> luxel.Particles:
    rng = np.random.default_rng(3)
    return luxel.Particles(rng.random((COUNT, 3)), rng.uniform(0.01, 0.02, COUNT), {"T": rng.random(COUNT)})


@pytest.fixture
def viewer(particles: luxel.Particles) -> Iterator[Viewer]:
    def make(scene: Any, spec: Any) -> Any:
        return InstantBaker()

    with (
        Session(particles, spec=TextureSpec(texels=4, samples=1), make_baker=make) as session,
        view(session, block=False, open_browser=False, announce=lambda url: None) as opened,
    ):
        yield opened


@pytest.fixture
def numbers(particles: luxel.Particles) -> Order:
    found = order_of(particles)
    assert found is not None
    return found


def test_parts_of_particles_and_scalars_are_those_asked_for(
    viewer: Viewer, particles: luxel.Particles, numbers: Order
) -> None:
    client = Client(viewer)
    scene = client.next(protocol.SceneState)
    assert (scene.count, scene.first) == (COUNT, FIRST)
    spheres = SphereSet.of(particles)
    for start, count in ((0, FIRST), (4096, FIRST)):
        client.send(protocol.ScalarRequest("T", start, count))
        client.send(protocol.GeometryRequest(scene.epoch, start, count))
        values, geometry = client.next(protocol.Scalar), client.next(protocol.Geometry)
        which = numbers.to_file[start : start + count]
        assert (values.start, geometry.start) == (start, start)
        assert (values.values == particles.scalars["T"][which].astype(np.float32)).all()
        assert tuple(values.range) == luxel.View(color_by="T").scalar_range(particles)
        assert (geometry.positions == spheres.centers[which]).all()
        assert (geometry.radii == spheres.radii[which]).all()
    assert not any(isinstance(each, protocol.Geometry) for each in client.heard[:2])


def test_light_and_particles_go_by_the_numbers_of_the_page(
    viewer: Viewer, particles: luxel.Particles, numbers: Order
) -> None:
    client = Client(viewer)
    key = client.next(protocol.LightState).key
    ids = np.array([7, 500, 1999], np.int32)
    client.send(protocol.Sighted(key, ids, EYE))
    there: dict[int, int] = {}
    while len(there) < len(ids):
        tiles = client.next(protocol.Tiles)
        there |= dict(zip(tiles.ids.tolist(), tiles.codes[:, 0, 0].tolist(), strict=True))
    assert there == {k: int(numbers.to_file[k]) % 251 for k in ids.tolist()}
    for coarse in (each for each in client.heard if isinstance(each, protocol.Coarse)):
        assert set(coarse.ids) <= set(ids)
    client.send(protocol.Inspect(500))
    told = client.next(protocol.ParticleState)
    k = int(numbers.to_file[500])
    assert (told.id, told.number) == (500, k)
    assert dict(told.values)["T"] == f"{particles.scalars['T'][k]:.6g}"


def test_the_second_light_goes_by_them_too(viewer: Viewer, numbers: Order) -> None:
    client = Client(viewer)
    client.next(protocol.LightState)
    client.send(protocol.Compare("shadows"))
    key = client.next(protocol.BesideState).key
    client.send(protocol.Sighted(key, np.array([42], np.int32), EYE))
    tiles = client.next(protocol.Tiles)
    assert tiles.beside
    assert tiles.ids.tolist() == [42]
    assert tiles.codes[0, 0, 0] == numbers.to_file[42] % 251


def test_a_page_that_lets_the_server_draw_uses_numbers_of_the_file(viewer: Viewer) -> None:
    client = Client(viewer, hello=False)
    client.send(protocol.Hello("test", "server"))
    assert client.next(protocol.SceneState).first == 0
    client.send(protocol.Inspect(500))
    assert client.next(protocol.ParticleState).number == 500
    client.send(protocol.ScalarRequest("T"))
    assert client.next(protocol.Scalar).values.size == 0


@pytest.mark.parametrize(
    "start, count, why", [(COUNT, 1, "no particle"), (0, 0, "count"), (0, 1 << 30, "count")]
)
def test_parts_that_there_are_not(viewer: Viewer, start: int, count: int, why: str) -> None:
    client = Client(viewer)
    epoch = client.next(protocol.SceneState).epoch
    client.send(protocol.GeometryRequest(epoch, start, count))
    code, reason = client.closed()
    assert code == CLOSE_BAD_MESSAGE
    assert why in reason


def test_what_waits_for_a_page_is_bounded(particles: luxel.Particles) -> None:
    async def ask() -> None:
        with Session(particles, model="lambertian") as session:
            hub = Hub(session)
            hub.start()
            page = hub.join()
            await hub.receive(page, protocol.Hello("test").encode())
            try:
                for start in range(100):
                    await hub.receive(page, protocol.ScalarRequest("T", start, 1).encode())
            finally:
                hub.stop()

    with pytest.raises(ProtocolError, match="must take in"):
        asyncio.run(ask())
