"""What every TextureSource promises to renderers; a source inherits the suite by making itself."""

from __future__ import annotations

import numpy as np
import pytest

from luxel.particles import Particles
from luxel.session import Session
from luxel.textures.spec import TextureSpec
from luxel.textures.textures import LuminanceTextures, TextureSource, TextureTable, decode

from .fakes import FakeBaker, code_of

COUNT = 60
TEXELS = 4
READY = np.arange(0, COUNT, 3, dtype=np.int32)
EYE = np.array([9.0, 9.0, 9.0])


def grid() -> Particles:
    return Particles(np.stack(np.unravel_index(np.arange(COUNT), (3, 4, 5)), axis=1).astype(float), 0.5)


class SourceContract:
    """Subclasses provide `source`, whose READY particles have textures full of `code_of(key, ids)`, and its key."""

    source: TextureSource
    key: str
    scale: float

    def table(self) -> TextureTable:
        return self.source.snapshot(self.key)

    def test_a_snapshot_has_a_slot_for_every_particle(self):
        table = self.table()
        assert table.slot.dtype == np.int32
        assert table.slot.shape == (COUNT,)
        assert (table.slot >= -1).all()
        assert set(np.flatnonzero(table.slot >= 0)) == set(READY.tolist())

    def test_codes_are_tiles_of_bytes_in_one_block(self):
        table = self.table()
        assert table.codes.dtype == np.uint8
        assert table.codes.shape[1:] == (TEXELS, TEXELS)
        assert table.codes.flags.c_contiguous
        assert table.slot.max() < len(table.codes)
        assert (table.codes[table.slot[READY]] == code_of(self.key, READY)[:, None, None]).all()

    def test_the_decoding_table_is_that_of_the_scale(self):
        table = self.table()
        assert table.decoding.dtype == np.float32
        every = np.arange(256, dtype=np.uint8)
        assert (table.decoding == decode(every, self.scale, "sqrt")).all()

    def test_a_snapshot_does_not_change(self):
        table = self.table()
        slot, codes = table.slot.copy(), table.codes[table.slot[READY]].copy()
        self.source.sighted(np.arange(COUNT, dtype=np.int32), EYE)
        self.proceed()
        assert (table.slot == slot).all()
        assert (table.codes[table.slot[READY]] == codes).all()

    def test_another_light_key_gives_an_empty_table(self):
        table = self.source.snapshot("no such key")
        assert table.slot.shape == (COUNT,)
        assert (table.slot == -1).all()
        assert table.decoding.shape == (256,)

    def test_sightings_of_nothing_are_fine(self):
        self.source.sighted(np.empty(0, dtype=np.int32), EYE)
        self.test_a_snapshot_has_a_slot_for_every_particle()

    def proceed(self) -> None:
        """Let the source do whatever it does between frames."""


class TestBakedTextures(SourceContract):
    @pytest.fixture(autouse=True)
    def make(self):
        self.key, self.scale = "key", 2.5
        codes = np.empty((len(READY), TEXELS, TEXELS), dtype=np.uint8)
        codes[:] = code_of(self.key, READY)[:, None, None]
        order = np.random.default_rng(0).permutation(len(READY))
        self.source = LuminanceTextures(READY[order], codes[order], self.scale, "sqrt", COUNT, self.key)


class TestSessionTextures(SourceContract):
    @pytest.fixture(autouse=True)
    def make(self):
        with Session(
            grid(),
            spec=TextureSpec(texels=TEXELS, mode="fast", samples=1),
            threads=0,
            make_baker=lambda scene, spec: FakeBaker(self.key),
        ) as session:
            self.session, self.key, self.scale = session, session.key, session.scale
            self.source = session.source
            self.source.sighted(READY, EYE)
            session.wait()
            yield

    def proceed(self):
        self.session.wait()
        assert self.session.status().ready == COUNT

    def test_what_was_sighted_arrives(self):
        self.source.sighted(np.arange(COUNT, dtype=np.int32), EYE)
        self.session.wait()
        assert (self.table().slot >= 0).all()
