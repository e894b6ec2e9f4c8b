from __future__ import annotations

import gzip

import numpy as np
import pytest

import luxel
from tests.io.reader_contract import ReaderContract
from tests.io.writers import particles, write_csv


class TestCsv(ReaderContract):
    format = "csv"
    suffix = ".csv"
    times = (None,)

    def write(self, path, frames):
        return write_csv(path, frames[0])


def read(tmp_path, text, name="a.csv", **options):
    (tmp_path / name).write_text(text)
    return luxel.open(tmp_path / name, **options)[0]


@pytest.mark.parametrize("mark", [",", ";", "\t", "   "])
def test_delimiters_are_found(tmp_path, mark):
    found = luxel.open(write_csv(tmp_path / "a.txt", particles(6), mark))[0]
    np.testing.assert_allclose(found.scalars["stress"], particles(6)["stress"])


@pytest.mark.parametrize(
    "header", ["X,Y,Z", '"Points:0","Points:1","Points:2"', "position_x, position_y, position_z", "# x,y,z"]
)
def test_names_of_positions(tmp_path, header):
    found = read(tmp_path, f"{header}\n1,2,3\n4,5,6\n")
    assert found.positions.tolist() == [[1, 2, 3], [4, 5, 6]]


def test_r_is_a_radius_unless_it_is_red(tmp_path):
    assert read(tmp_path, "x,y,z,r\n0,0,0,0.5\n2,2,2,0.25\n").radii.tolist() == [0.5, 0.25]
    found = read(tmp_path, "x,y,z,r,g,b\n0,0,0,0.5,0,0\n2,2,2,0.25,0,0\n")
    assert "estimated" in found.radii_source
    assert sorted(found.scalars) == ["b", "g", "r"]


def test_text_empty_fields_and_quotes(tmp_path):
    found = read(tmp_path, 'x,y,z,kind,"mass, kg",t\n0,0,0,"Mild Steel",1,\n1,1,1,Sand,,NA\n2,2,2,Sand,3,7\n')
    assert found.scalars["kind"].tolist() == [0, 1, 1]
    assert found.categories["kind"] == ("Mild Steel", "Sand")
    assert np.isnan(found.scalars["t"][:2]).all()
    np.testing.assert_array_equal(found.scalars["mass, kg"], [1, np.nan, 3])


def test_bare_points_with_and_without_a_count(tmp_path):
    assert len(read(tmp_path, "0 0 0\n1 1 1\n", "a.pts")) == 2
    assert len(read(tmp_path, "2\n0\t0\t0\n1\t1\t1\n", "b.txt")) == 2
    (tmp_path / "c.pts.gz").write_bytes(gzip.compress(b"0 0 0\n1 1 1\n2 2 2\n"))
    assert len(luxel.open(tmp_path / "c.pts.gz")[0]) == 3
    assert len(read(tmp_path, "0 0 0\n1 1 1\n", "points.xyz")) == 2


def test_windows_line_ends_and_byte_order_mark(tmp_path):
    (tmp_path / "a.csv").write_bytes(b"\xef\xbb\xbfx,y,z\r\n0,0,0\r\n1,1,1\r\n\r\n")
    assert luxel.open(tmp_path / "a.csv")[0].positions.tolist() == [[0, 0, 0], [1, 1, 1]]


def test_indexed_columns_become_a_vector(tmp_path):
    found = read(tmp_path, "x,y,z,stress:0,stress:1,stress:2\n0,0,0,1,2,3\n1,1,1,4,5,6\n")
    assert found.scalars["stress"].tolist() == [[1, 2, 3], [4, 5, 6]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x,y,z\n0,0,0\n1,1\n", r"line 3: 2 fields where 3 are expected \(x y z\)"),
        ("x,y,z,s\n0,0,0,1\n\n1,1,1,oops\n", "line 4: 'oops' in column s is not a number"),
        ("x y z s\n0 0 0 1\n\n1 1 1 oops\n", "line 4: 'oops' in column s is not a number"),
        ("x y z s\n0 0 0 1\n1 1 1 1 9\n", "line 3: 5 fields where 4"),
        ("x,y,z\na,b,c\n", "line 2: column x is a position but holds text: 'a'"),
        ("a,b,c\n0,0,0\n", "line 1: no columns x, y, z; the columns are a, b, c"),
        ("0 0 0 0\n1 1 1 1\n", "line 1: 4 columns of numbers without names.*header line"),
        ("x,y,z,x\n0,0,0,0\n", "line 1: column 'x' appears twice"),
        ("5\n0 0 0\n1 1 1\n", "2 rows where the first line promises 5"),
        ("\n\n", "no table"),
    ],
)
def test_errors_name_the_line(tmp_path, text, message):
    with pytest.raises(luxel.LuxelError, match=message):
        read(tmp_path, text)


def test_binary_file_called_csv(tmp_path):
    (tmp_path / "a.csv").write_bytes(bytes(range(256)) * 4)
    with pytest.raises(luxel.LuxelError, match=r"a\.csv: unknown format.*lammps dump"):
        luxel.open(tmp_path / "a.csv")
