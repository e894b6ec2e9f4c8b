from __future__ import annotations

import numpy as np
import pytest

import luxel
from tests.io.reader_contract import ReaderContract
from tests.io.writers import particles, write_uda


class TestUda(ReaderContract):
    format = "uintah uda"
    suffix = ".uda"
    frames = 2
    sorts_by_id = True
    id_name = "particleID"
    times = (0.0, 0.5)

    def write(self, path, frames):
        return write_uda(path, frames)


class TestOldBigEndianCompressedUda(TestUda):
    def write(self, path, frames):
        return write_uda(path, frames, endian=">", compress=True, old=True, patches=3)


def test_index_may_be_opened_itself(tmp_path):
    path = write_uda(tmp_path / "a.uda", [particles(9)])
    series = luxel.open(path / "index.xml")
    assert series.format == "uintah uda"
    assert series.times == [0.0]
    assert len(series[0]) == 9


def test_materials_and_radii(tmp_path):
    data = particles(8)
    found = luxel.open(write_uda(tmp_path / "a.uda", [data]))[0]
    assert found.radii_source == "file variable p.volume"
    order = np.argsort(data["id"])
    assert found.scalars["material"].tolist() == (np.arange(8) // 2 % 2)[order].tolist()
    assert sorted(found.scalars) == ["material", "particleID", "stress", "velocity", "volume"]


def test_variable_missing_for_a_material_is_nan(tmp_path):
    found = luxel.open(write_uda(tmp_path / "a.uda", [particles(8)], skip=("p.velocity", 1)))[0]
    nan = np.isnan(found.scalars["velocity"]).all(axis=1)
    assert np.array_equal(nan, found.scalars["material"] == 1)
    assert found.scalars["particleID"].dtype == np.int64


def test_volume_missing_for_a_material_means_estimated_radii(tmp_path, caplog):
    found = luxel.open(write_uda(tmp_path / "a.uda", [particles(8)], skip=("p.volume", 1)))[0]
    assert "estimated" in found.radii_source
    assert "p.volume was not saved for all materials" in caplog.text


def replace(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def test_no_particles(tmp_path):
    path = write_uda(tmp_path / "a.uda", [particles(8)])
    replace(path / "index.xml", 'name="p.x"', 'name="g.x"')
    with pytest.raises(
        luxel.LuxelError, match=r"index\.xml: no particles: particle positions p\.x were not saved"
    ):
        luxel.open(path)


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        (
            "t00000/l0/p00000.xml",
            "<numParticles>2<",
            "<numParticles>9<",
            "variable p.x: .*16 bytes|variable p.x: .*48 bytes where 9",
        ),
        ("t00000/l0/p00000.xml", "<end>48<", "<end>99999<", "variable p.x: bytes 0..99999 are wanted"),
        ("t00000/l0/p00000.xml", "<start>0</start>", "", "variable 1 of the list.*<start> is missing"),
        ("t00000/l0/p00000.xml", "p00000.data", "../../x", "is not the name of a file beside it"),
        ("t00000/data.xml", "l0/p00000.xml", "../../../x.xml", "points outside the archive"),
        ("t00000/data.xml", "l0/p00000.xml", "l0/p9.xml", r"names .*p9\.xml, which does not exist"),
        (
            "index.xml",
            "t00000/timestep.xml",
            "t7/timestep.xml",
            r"names .*t7.timestep\.xml, which does not exist",
        ),
        ("index.xml", "</timesteps>", "", "is not valid XML"),
    ],
)
def test_errors_name_the_place(tmp_path, file, old, new, message):
    path = write_uda(tmp_path / "a.uda", [particles(8)])
    replace(path / file, old, new)
    with pytest.raises(luxel.LuxelError, match=message):
        luxel.open(path)[0]


def test_lying_count_takes_no_memory(tmp_path):
    path = write_uda(tmp_path / "a.uda", [particles(8)], compress=True)
    replace(path / "t00000/l0/p00000.xml", "<numParticles>2<", "<numParticles>99999999999<")
    with pytest.raises(luxel.LuxelError, match="cannot come out of"):
        luxel.open(path)[0]


def test_directory_that_is_no_uda(tmp_path):
    with pytest.raises(luxel.LuxelError, match=r"without index\.xml.*give a pattern"):
        luxel.open(tmp_path)
