from __future__ import annotations

import bz2
import gzip
import lzma

import numpy as np
import pytest

import luxel
from tests.io.reader_contract import ReaderContract
from tests.io.writers import particles, write_lammps


class TestLammps(ReaderContract):
    format = "lammps dump"
    suffix = ".lammpstrj"
    frames = 2
    sorts_by_id = True
    has_cell = True
    times = (0.0, 100.0)

    def write(self, path, frames):
        return write_lammps(path, frames)


HEADER = (
    "ITEM: TIMESTEP\n7\nITEM: NUMBER OF ATOMS\n{count}\nITEM: BOX BOUNDS {box}\nITEM: ATOMS {columns}\n{rows}"
)


def read(tmp_path, count=1, box="pp pp pp\n0 2\n0 3\n0 4", columns="id x y z", rows="1 1 1 1\n", before=""):
    text = before + HEADER.format(count=count, box=box, columns=columns, rows=rows)
    (tmp_path / "a.dump").write_text(text)
    return luxel.open(tmp_path / "a.dump")[0]


@pytest.mark.parametrize(("suffix", "module"), [(".gz", gzip), (".bz2", bz2), (".xz", lzma), ("", None)])
def test_compression_is_found_by_content(tmp_path, suffix, module):
    path = write_lammps(tmp_path / "a.dump", [particles(5), particles(8)])
    packed = tmp_path / f"b.dump{suffix}"
    packed.write_bytes(module.compress(path.read_bytes()) if module else path.read_bytes())
    series = luxel.open(packed)
    assert [len(series[k]) for k in (1, 0, 1)] == [8, 5, 8]


def test_truncated_gzip_names_the_file(tmp_path):
    path = write_lammps(tmp_path / "a.dump", [particles(200)])
    (tmp_path / "b.dump.gz").write_bytes(gzip.compress(path.read_bytes())[:-2000])
    with pytest.raises(luxel.LuxelError, match=r"b\.dump\.gz: cannot be read"):
        luxel.open(tmp_path / "b.dump.gz")


def test_scaled_positions_in_a_tilted_box(tmp_path):
    found = read(
        tmp_path,
        2,
        "xy xz yz pp ff pp\n-0.5 3.25 0.25\n-0.25 3 -0.5\n0 4 -0.25",
        "id xs ys zs",
        "1 0 0 0\n2 1 1 1\n",
    )
    # LAMMPS writes the bounding box; the tilts are xy = 0.25, xz = -0.5, yz = -0.25.
    np.testing.assert_allclose(found.cell.origin, [0, 0, 0])
    np.testing.assert_allclose(found.cell.vectors, [[3, 0, 0], [0.25, 3, 0], [-0.5, -0.25, 4]])
    assert found.cell.periodic == (True, False, True)
    np.testing.assert_allclose(found.positions[1], found.cell.vectors.sum(axis=0))


def test_general_triclinic_box(tmp_path):
    found = read(tmp_path, 1, "abc origin pp pp pp\n1 1 0 5\n0 2 0 6\n0 0 3 7", "xs ys zs", "1 1 0\n")
    np.testing.assert_allclose(found.cell.origin, [5, 6, 7])
    np.testing.assert_allclose(found.positions, [[6, 9, 7]])


def test_items_time_and_units(tmp_path):
    found = read(tmp_path, before="ITEM: UNITS\nlj\nITEM: TIME\n0.25\n")
    assert found.time == 0.25


def test_time_of_every_step(tmp_path):
    step = "ITEM: TIME\n{t}\n" + HEADER.format(
        count=1, box="pp pp pp\n0 1\n0 1\n0 1", columns="x y z", rows="0 0 0\n"
    )
    (tmp_path / "a.dump").write_text("ITEM: UNITS\nlj\n" + step.format(t=0.5) + step.format(t=1.5))
    series = luxel.open(tmp_path / "a.dump")
    assert series.times == [0.5, 1.5]
    assert [frame.time for frame in series] == [0.5, 1.5]


def test_columns_become_scalars(tmp_path):
    found = read(
        tmp_path,
        2,
        columns="id element xu yu zu fx fy fz c_S[1] c_S[2] c_T[2] ix",
        rows="2 Cu 0 0 0 1 2 3 4 5 6 7\n1 Ag 1 1 1 1 2 3 8 9 6 -7\n",
    )
    assert sorted(found.scalars) == ["c_S", "c_T[2]", "element", "force", "id", "ix"]
    assert found.scalars["id"].tolist() == [1, 2]
    assert [found.categories["element"][code] for code in found.scalars["element"]] == ["Ag", "Cu"]
    assert found.scalars["c_S"].tolist() == [[8, 9], [4, 5]]
    assert found.positions.tolist() == [[1, 1, 1], [0, 0, 0]]


def test_unfinished_last_step_leaves_the_others_readable(tmp_path):
    path = write_lammps(tmp_path / "a.dump", [particles(50), particles(50)])
    path.write_bytes(path.read_bytes()[:-300])
    series = luxel.open(path)
    assert len(series[0]) == 50
    with pytest.raises(luxel.LuxelError, match=r"a\.dump, frame 1"):
        series[1]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"count": 3}, "frame 0: 1 atoms where NUMBER OF ATOMS promises 3"),
        ({"count": 10**14}, "frame 0: 1 atoms where"),
        ({"count": "many"}, "frame 0, line 4: the number of atoms is 'many'"),
        ({"box": "pp pp pp\n0 2\n0\n0 4"}, "frame 0, line 7: a line of BOX BOUNDS needs 2 numbers, got '0'"),
        ({"box": "xy xz yz pp pp pp\n0 2 0\n0 3\n0 4 0"}, "line 7: a line of BOX BOUNDS needs 3 numbers"),
        ({"box": "pp pp pp\n0 2\n3 0\n0 4"}, "the box has a negative size"),
        ({"rows": "1 1 1\n"}, "frame 0, line 10: 3 fields where 4 are expected"),
        ({"rows": "1 1 one 1\n"}, "column y is a position but holds text"),
        ({"columns": "id x y q"}, "no positions.*id x y q"),
        ({"columns": "id x y x"}, "line 9: column 'x' appears twice"),
    ],
)
def test_errors_name_the_place(tmp_path, options, message):
    with pytest.raises(luxel.LuxelError, match=message):
        read(tmp_path, **options)


def test_marks_across_chunks(tmp_path, monkeypatch):
    path = write_lammps(tmp_path / "a.dump", [particles(k % 7) for k in range(40)])
    expected = [len(frame) for frame in luxel.open(path)]
    for size in (600, 601, 777):
        monkeypatch.setattr("luxel.io.stream._CHUNK_BYTES", size)
        assert [len(frame) for frame in luxel.open(path)] == expected
