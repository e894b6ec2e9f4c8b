"""What a hub tells pages while there is something to wait for."""

from __future__ import annotations

import asyncio

import numpy as np

from luxel.app.hub import Hub
from luxel.dynamic.work import CoarseBatch, TileBatch
from luxel.session import Session
from luxel.textures.spec import TextureSpec
from tests.scenes import lattice


def test_kernels_are_said_to_be_compiled_until_there_are_textures_not_only_first_light() -> None:
    async def run(session: Session) -> None:
        hub = Hub(session, "Compiling …")
        hub.start()
        ids = np.zeros(1, np.int32)
        hub._hear(CoarseBatch(session.key, ids, np.ones((1, 4), np.float32)))
        await asyncio.sleep(0)
        assert hub.notice == "Compiling …"
        tiles = np.zeros((1, 4, 4), np.uint8)
        hub._hear(TileBatch(session.key, ids, tiles, np.zeros(1, np.bool_)))
        await asyncio.sleep(0)
        assert hub.notice == ""
        hub.stop()

    with Session([lattice(2)], spec=TextureSpec(texels=4, samples=1), threads=0) as session:
        asyncio.run(run(session))
