"""No page can ask too much, and no message does more than close its own socket."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Iterator

import numpy as np
import pytest

from luxel.app import protocol
from luxel.app.hub import Hub
from luxel.app.limits import Allowance
from luxel.app.wire import unpack
from luxel.errors import ProtocolError
from luxel.scene.lights import Sky, Sun, sun_direction
from luxel.session import Session
from luxel.textures.spec import TextureSpec
from tests.app.socket_client import InstantBaker
from tests.app.test_protocol import FROM_PAGE
from tests.scenes import cloud

COUNT = 40
MUTATIONS = 100_000


def test_a_page_that_behaves_never_waits() -> None:
    allowance = Allowance(rate=10, burst=20)
    assert [allowance.spend(0, k / 10) for k in range(1000)] == [0.0] * 1000


@pytest.mark.parametrize("nbytes", [0, 64 << 10])
def test_a_flood_is_slowed_to_the_rate(nbytes: int) -> None:
    allowance = Allowance(rate=10, burst=20, unit_bytes=64 << 10)
    now_s = 0.0
    for _ in range(500):
        now_s += allowance.spend(nbytes, now_s)
    price = 1 + nbytes / (64 << 10)
    assert now_s == pytest.approx((500 * price - 20) / 10)


def test_a_rest_gives_back_the_burst_and_no_more() -> None:
    allowance = Allowance(rate=10, burst=20)
    for _ in range(20):
        allowance.spend(0, 0.0)
    assert [allowance.spend(0, 1e6) for _ in range(21)] == [0.0] * 20 + [pytest.approx(0.1)]


@pytest.fixture
def session() -> Iterator[Session]:
    lights = (Sky(1.0), Sun(sun_direction(195.0, 50.0), level=2.0))
    frames = [cloud(COUNT), cloud(COUNT // 2, seed=1)]
    spec = TextureSpec(texels=4, samples=1)
    with Session(
        frames, lights=lights, spec=spec, threads=0, make_baker=lambda scene, spec: InstantBaker()
    ) as made:
        yield made


def mutants(seed: int, count: int) -> Iterator[bytes]:
    """Good messages with bits flipped, bytes replaced, cut, doubled, spliced or with other numbers in their JSON."""
    rng = random.Random(seed)
    good = [message.encode() for message in FROM_PAGE]
    numbers = [b"-1", b"0", b"1e308", b"4294967296", b'"x"', b"null", b"[]", b"true", b"1.5", b"9" * 400]
    for _ in range(count):
        raw = bytearray(rng.choice(good))
        for _ in range(rng.randint(1, 3)):
            place = rng.randrange(len(raw) + 1)
            match rng.randrange(6):
                case 0 if place < len(raw):
                    raw[place] ^= 1 << rng.randrange(8)
                case 1 if place < len(raw):
                    raw[place] = rng.randrange(256)
                case 2:
                    del raw[place:]
                case 3:
                    raw[place:place] = rng.choice(good)[: rng.randrange(64)]
                case 4 if digits := [k for k, byte in enumerate(raw) if 48 <= byte < 58]:
                    k = rng.choice(digits)
                    raw[k : k + 1] = rng.choice(numbers)
                case _:
                    raw = bytearray(rng.choice(good))
        yield bytes(raw)


def test_every_mutated_message_is_taken_or_refused() -> None:
    """Decoding raises nothing but ProtocolError, for which the server closes that socket alone."""
    outcomes = {"taken": 0, "refused": 0}
    for raw in mutants(1, MUTATIONS):
        try:
            message = protocol.decode_client(raw)
        except ProtocolError:
            outcomes["refused"] += 1
        else:
            assert unpack(message.encode())[0] == raw[0]
            outcomes["taken"] += 1
    assert min(outcomes.values()) > MUTATIONS / 50, outcomes  # both ways are exercised


def test_whatever_a_page_sends_the_hub_lives(session: Session) -> None:
    """Taken messages are acted upon; whatever they ask for, the page gets answers that can be sent."""

    async def run() -> None:
        hub = Hub(session)
        hub.start()
        bystander, attacker = hub.join(), hub.join()
        await hub.receive(bystander, protocol.Hello("bystander").encode())
        answers = refusals = 0
        for raw in mutants(2, 3000):
            try:
                if not attacker.greeted:
                    await hub.receive(attacker, protocol.Hello("attacker").encode())
                await hub.receive(attacker, raw)
            except ProtocolError:
                refusals += 1
                await hub.leave(attacker)
                attacker = hub.join()
            while (message := hub.next_message(attacker)) is not None:
                assert protocol.decode(message.encode()).kind == message.kind
                answers += 1
        assert min(answers, refusals) > 0
        ids = np.arange(len(session.particles), dtype=np.int32)
        await hub.receive(bystander, protocol.Sighted(session.key, ids, (0.0, 0.0, 3.0)).encode())
        session.wait(10.0)
        heard = []
        while (message := hub.next_message(bystander)) is not None:
            heard.append(type(message))
        assert protocol.SceneState in heard
        hub.stop()

    asyncio.run(run())
