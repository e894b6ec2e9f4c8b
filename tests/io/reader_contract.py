"""What every reader must do; each format's tests inherit this suite."""

from __future__ import annotations

import json
import pickle
import random
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import luxel
from luxel.io import describe
from luxel.io.registry import named_reader
from tests.io.writers import particles

MUTATIONS = 40


class ReaderContract:
    """Subclasses say how to write a file of their format, and what differs from the common data set."""

    format = ""
    suffix = ""
    frames = 1
    sorts_by_id = False
    id_name = "id"
    has_cell = False
    times: tuple[float | None, ...] = (0.5,)

    def write(self, path: Path, frames: list[dict[str, Any]]) -> Path:
        raise NotImplementedError

    def written(self, folder: Path, counts: tuple[int, ...] = (12, 9)) -> tuple[Path, list[dict[str, Any]]]:
        frames = [particles(count, seed=k) for k, count in enumerate(counts[: self.frames])]
        return self.write(folder / f"file{self.suffix}", frames), frames

    def test_frames_come_back_as_written(self, tmp_path: Path) -> None:
        path, frames = self.written(tmp_path)
        series = luxel.open(path)
        assert series.format == self.format
        assert len(series) == self.frames
        for k, (expected, found) in enumerate(zip(frames, series, strict=True)):
            order = np.argsort(expected["id"]) if self.sorts_by_id else np.arange(len(expected["id"]))
            np.testing.assert_allclose(found.positions, expected["position"][order], rtol=1e-6)
            np.testing.assert_allclose(found.radii, expected["radius"][order], rtol=1e-6)
            np.testing.assert_allclose(found.scalars["velocity"], expected["velocity"][order], rtol=1e-6)
            np.testing.assert_allclose(found.scalars["stress"], expected["stress"][order], rtol=1e-6)
            assert np.array_equal(found.scalars[self.id_name], expected["id"][order])
            assert found.scalars[self.id_name].dtype.kind == "i"
            assert found.time == self.times[k]
            assert "estimated" not in found.radii_source
            assert (found.cell is not None) == self.has_cell

    def test_radius_argument_wins_over_the_file(self, tmp_path: Path) -> None:
        path, _ = self.written(tmp_path)
        given = luxel.open(path, radius=0.25)[0]
        assert (given.radii == np.float32(0.25)).all()
        assert given.radii_source == "given"
        assert "estimated" in luxel.open(path, radius="auto")[0].radii_source

    def test_format_can_be_named(self, tmp_path: Path) -> None:
        path, _ = self.written(tmp_path)
        assert len(luxel.open(path, format=self.format)[0]) == 12
        assert named_reader(self.suffix).name == self.format

    def test_description_is_json(self, tmp_path: Path) -> None:
        path, _ = self.written(tmp_path)
        described = describe(luxel.open(path))
        json.dumps(described, allow_nan=False)
        assert described["particles"] == 12
        assert described["scalars"]["velocity"]["components"] == 3

    def test_series_goes_to_another_process(self, tmp_path: Path) -> None:
        path, _ = self.written(tmp_path)
        copy = pickle.loads(pickle.dumps(luxel.open(path, radius=0.5)))
        assert copy.format == self.format
        assert (copy[0].radii == 0.5).all()

    def test_steps_without_particles_are_legal(self, tmp_path: Path) -> None:
        path, _ = self.written(tmp_path, (0, 9))
        series = luxel.open(path)
        assert len(series[0]) == 0
        assert series.first_frame() == (1 if self.frames > 1 else 0)
        json.dumps(describe(series, 0), allow_nan=False)

    def test_positions_that_are_nan_are_refused(self, tmp_path: Path) -> None:
        frame = particles(12)
        frame["position"][3, 1] = np.nan
        path = self.write(tmp_path / f"file{self.suffix}", [frame])
        with pytest.raises(luxel.LuxelError, match=r"file.*frame 0.*finite.*particle"):
            luxel.open(path)[0]

    def test_radii_that_are_zero_are_refused_unless_others_are_given(self, tmp_path: Path) -> None:
        frame = particles(12)
        frame["radius"][5] = 0.0
        path = self.write(tmp_path / f"file{self.suffix}", [frame])
        with pytest.raises(luxel.LuxelError, match=r"file.*frame 0.*radii must be positive.*--radius"):
            luxel.open(path)[0]
        assert len(luxel.open(path, radius=0.1)[0]) == 12

    def test_damaged_files_raise_only_luxel_errors(self, tmp_path: Path) -> None:
        path, _ = self.written(tmp_path)
        rng = random.Random(self.format)
        broken = tmp_path / f"broken{self.suffix}"
        refused = 0
        for _ in range(MUTATIONS):
            self.damage(path, broken, rng)
            message = self.outcome(broken)
            refused += bool(message)
            assert not message or "broken" in message  # names the file
        assert refused > MUTATIONS // 8

    def outcome(self, path: Path) -> str:
        """Read every frame; return the error's text, or nothing."""
        try:
            finite = all(np.isfinite(frame.positions).all() for frame in luxel.open(path, format=self.format))
        except luxel.LuxelError as error:
            return str(error)
        assert finite
        return ""

    def damage(self, path: Path, broken: Path, rng: random.Random) -> None:
        """Copy `path` to `broken` with one file of it cut short or with bytes changed."""
        if path.is_dir():
            shutil.rmtree(broken, ignore_errors=True)
            shutil.copytree(path, broken)
            victim = rng.choice(sorted(each for each in broken.rglob("*") if each.is_file()))
        else:
            victim = Path(shutil.copy(path, broken))
        data = bytearray(victim.read_bytes())
        if rng.random() < 0.3:
            del data[rng.randrange(len(data)) :]
        else:
            for _ in range(rng.choice((1, 1, 2, 8))):
                where = rng.randrange(len(data) if rng.random() < 0.5 else min(len(data), 600))
                data[where] = rng.choice((rng.randrange(256), rng.choice(b"0123456789-. ")))
        victim.write_bytes(data)
