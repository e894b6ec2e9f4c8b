from __future__ import annotations

import gzip
import sys

import numpy as np
import pytest

import luxel
from tests.io.reader_contract import ReaderContract
from tests.io.writers import particles, write_gsd

gsd_hoomd = pytest.importorskip("gsd.hoomd")


class TestGsd(ReaderContract):
    format = "gsd"
    suffix = ".gsd"
    frames = 2
    has_cell = True
    times = (None, 100.0)  # GSD omits the default step 0

    def write(self, path, frames):
        return write_gsd(path, frames)


def test_types_and_cell(tmp_path):
    found = luxel.open(write_gsd(tmp_path / "a.gsd", [particles(4)]))[0]
    assert found.categories["typeid"] == ("He", "Ar")
    assert found.radii_source == "half of particles/diameter"
    np.testing.assert_allclose(found.cell.vectors, [[2, 0, 0], [1.5, 3, 0], [0, 0, 4]])
    np.testing.assert_allclose(found.cell.origin, [-1.75, -1.5, -2])


def test_defaults_are_no_scalars(tmp_path):
    frame = gsd_hoomd.Frame()
    frame.particles.N = 3
    frame.particles.position = particles(3)["position"]
    with gsd_hoomd.open(name=str(tmp_path / "a.gsd"), mode="w") as file:
        file.append(frame)
    found = luxel.open(tmp_path / "a.gsd")[0]
    assert dict(found.scalars) == {}
    assert "estimated" in found.radii_source


def test_chunks_of_the_first_frame_serve_the_later_ones(tmp_path):
    same = [particles(6), particles(6)]
    series = luxel.open(write_gsd(tmp_path / "a.gsd", same))
    np.testing.assert_allclose(series[1].scalars["velocity"], same[1]["velocity"], rtol=1e-6)
    assert series[1].categories["typeid"] == ("He", "Ar")


def test_compressed(tmp_path):
    path = write_gsd(tmp_path / "a.gsd", [particles(6), particles(5)])
    (tmp_path / "b.gsd.gz").write_bytes(gzip.compress(path.read_bytes()))
    assert [len(frame) for frame in luxel.open(tmp_path / "b.gsd.gz")] == [6, 5]


def test_missing_package_names_the_command(tmp_path, monkeypatch):
    path = write_gsd(tmp_path / "a.gsd", [particles(6)])
    monkeypatch.setitem(sys.modules, "gsd.fl", None)
    with pytest.raises(luxel.LuxelError, match=r"pip install 'luxel\[gsd\]'") as caught:
        luxel.open(path)
    assert isinstance(caught.value, ImportError)
