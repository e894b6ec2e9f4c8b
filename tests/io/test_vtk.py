from __future__ import annotations

import base64
import gzip
import re
import struct

import numpy as np
import pytest

import luxel
from tests.io.reader_contract import ReaderContract
from tests.io.writers import particles, write_vtk

pytest.importorskip("vtkmodules")  # the writer, and the independent reading


class TestLegacyBinary(ReaderContract):
    format = "vtk legacy"
    suffix = ".vtk"

    def write(self, path, frames):
        return write_vtk(path, frames[0])


class TestLegacyAscii(TestLegacyBinary):
    def write(self, path, frames):
        return write_vtk(path, frames[0], "ascii")


class TestXmlBinary(ReaderContract):
    format = "vtk xml"
    suffix = ".vtp"

    def write(self, path, frames):
        return write_vtk(path, frames[0])


class TestXmlAppended(TestXmlBinary):
    suffix = ".vtu"

    def write(self, path, frames):
        return write_vtk(path, frames[0], "appended", cells=False)


class TestXmlAscii(TestXmlBinary):
    def write(self, path, frames):
        return write_vtk(path, frames[0], "ascii")


@pytest.mark.parametrize("mode", ["ascii", "binary", "appended", "raw", "lzma", "big"])
@pytest.mark.parametrize("suffix", [".vtp", ".vtu"])
@pytest.mark.parametrize("cells", [True, False])
def test_every_encoding(tmp_path, mode, suffix, cells):
    data = particles(100)
    data |= {"small": np.arange(100, dtype=np.int8), "big number": np.arange(100) + 2**40}
    found = luxel.open(write_vtk(tmp_path / f"a{suffix}", data, mode, cells))[0]
    np.testing.assert_allclose(found.positions, data["position"], rtol=1e-6)
    for name in ("velocity", "stress", "id", "small", "big number"):
        np.testing.assert_array_equal(found.scalars[name], data[name])
        assert found.scalars[name].dtype == data[name].dtype
    assert found.time == 0.5


@pytest.mark.parametrize("mode", ["ascii", "binary"])
@pytest.mark.parametrize("stem", ["poly", "grid"])
@pytest.mark.parametrize("cells", [True, False])
def test_every_legacy_layout(tmp_path, mode, stem, cells):
    data = particles(50) | {"a name": np.arange(50, dtype=np.uint8)}
    found = luxel.open(write_vtk(tmp_path / f"{stem}.vtk", data, mode, cells))[0]
    np.testing.assert_allclose(found.positions, data["position"], rtol=1e-6)
    assert found.scalars["a name"].tolist() == list(range(50))
    np.testing.assert_array_equal(found.scalars["id"], data["id"])


LEGACY = "# vtk DataFile Version 3.0\ntitle\nASCII\nDATASET {dataset}\nPOINTS 2 float\n0 0 0 1\n1 1\n{rest}"


def legacy(tmp_path, rest="", dataset="POLYDATA"):
    (tmp_path / "a.vtk").write_text(LEGACY.format(dataset=dataset, rest=rest))
    return luxel.open(tmp_path / "a.vtk")[0]


def test_old_legacy_attributes(tmp_path):
    found = legacy(
        tmp_path,
        "VERTICES 2 4\n1 0 1 1\nCELL_DATA 2\nSCALARS c int\nLOOKUP_TABLE default\n7 8\nPOINT_DATA 2\n"
        "SCALARS s float 1\nLOOKUP_TABLE mine\n1.5 2.5\nLOOKUP_TABLE mine 1\n0 0 0 1\nVECTORS v double\n1 2 3 4 5 6\n"
        "TENSORS t float\n1 2 3 4 5 6 7 8 9 1 2 3 4 5 6 7 8 9\nCOLOR_SCALARS k 2\n0 0.5 1 0.5\n"
        "TEXTURE_COORDINATES uv 2 float\n0 0 1 1\nFIELD FieldData 2\nRadius 3 2 float\n1 2 3 4 5 6\n"
        "METADATA\nINFORMATION 0\n\nword 1 2 string\nhello\nworld\n",
    )
    assert sorted(found.scalars) == ["Radius", "k", "s", "t", "uv", "v"]
    assert found.scalars["s"].tolist() == [1.5, 2.5]
    assert found.scalars["t"].shape == (2, 9)
    assert found.radii.tolist() == [2, 5]


@pytest.mark.parametrize(
    ("rest", "dataset", "message"),
    [
        ("", "STRUCTURED_POINTS", "holds STRUCTURED_POINTS, expected points"),
        (
            "POINT_DATA 2\nSCALARS s float\nLOOKUP_TABLE default\n1\n",
            "POLYDATA",
            "2 values are announced, 1 are there",
        ),
        (
            "POINT_DATA 2\nSCALARS s float\nLOOKUP_TABLE default\n1 x\n",
            "POLYDATA",
            ".*2 numbers of type float",
        ),
        ("POINT_DATA 999999999999\nVECTORS s float\n1\n", "POLYDATA", "2999999999997 values are announced"),
        (
            "POINT_DATA 1\nSCALARS s float\nLOOKUP_TABLE default\n1\n",
            "POLYDATA",
            "array s has 1 values for 2 points",
        ),
        ("POINT_DATA 2\nSCALARS s quad\nLOOKUP_TABLE default\n1 1\n", "POLYDATA", "unknown type 'quad'"),
        ("7 7 7\n", "POLYDATA", "unknown keyword '7'"),
    ],
)
def test_legacy_errors(tmp_path, rest, dataset, message):
    with pytest.raises(luxel.LuxelError, match=rf"a\.vtk, before byte \d+: {message}"):
        legacy(tmp_path, rest, dataset)


XML = """<VTKFile type="{kind}" byte_order="LittleEndian"><{kind}>{pieces}</{kind}></VTKFile>"""
PIECE = """<Piece NumberOfPoints="{count}"><Points><DataArray type="Float32" NumberOfComponents="3" format="ascii">
{points}</DataArray></Points><PointData><DataArray type="Int32" Name="a" format="ascii">{a}</DataArray></PointData></Piece>"""


def xml(tmp_path, pieces, kind="PolyData"):
    (tmp_path / "a.vtp").write_text(XML.format(kind=kind, pieces=pieces))
    return luxel.open(tmp_path / "a.vtp")[0]


def test_pieces_are_joined(tmp_path):
    found = xml(
        tmp_path, PIECE.format(count=1, points="1 2 3", a=7) + PIECE.format(count=1, points="4 5 6", a=8)
    )
    assert found.positions.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert found.scalars["a"].tolist() == [7, 8]


@pytest.mark.parametrize(
    ("pieces", "kind", "message"),
    [
        (
            PIECE.format(count=2, points="1 2 3", a=7),
            "PolyData",
            "the points.*3 numbers where 2 points need 6",
        ),
        (PIECE.format(count=1, points="1 2 3", a="x"), "PolyData", "array a"),
        (
            PIECE.format(count=99999999999999, points="1 2 3", a="x"),
            "PolyData",
            "the points.*3 numbers where",
        ),
        ("", "ImageData", "type 'ImageData', expected PolyData or UnstructuredGrid"),
        ("<Piece>", "PolyData", "is not valid XML: mismatched tag"),
    ],
)
def test_xml_errors(tmp_path, pieces, kind, message):
    with pytest.raises(luxel.LuxelError, match=message):
        xml(tmp_path, pieces, kind)


def test_lying_compressed_sizes_take_no_memory(tmp_path):
    path = write_vtk(tmp_path / "a.vtp", particles(10), "binary")

    def lie(match):  # one block of 2 GiB, where all of it is packed
        packed = struct.unpack("<4I", base64.b64decode(match[0]))[3]
        return base64.b64encode(struct.pack("<4I", 1, 1 << 31, 0, packed))

    text, count = re.subn(rb"AQAAAACAAA[A-Za-z0-9+/]{12}==", lie, path.read_bytes())
    assert count > 3
    path.write_bytes(text)
    with pytest.raises(luxel.LuxelError, match=r"a\.vtp, .*2147483648 bytes"):
        luxel.open(path)[0]


def test_compressed_file(tmp_path):
    path = write_vtk(tmp_path / "a.vtk", particles(10))
    (tmp_path / "b.vtk.gz").write_bytes(gzip.compress(path.read_bytes()))
    assert len(luxel.open(tmp_path / "b.vtk.gz")[0]) == 10
