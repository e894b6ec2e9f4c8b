from __future__ import annotations

import numpy as np
import pytest

import luxel
from tests.io.reader_contract import ReaderContract
from tests.io.writers import particles, write_xyz


class TestXyz(ReaderContract):
    format = "xyz"
    suffix = ".extxyz"
    frames = 2
    has_cell = True
    times = (0.0, 0.5)

    def write(self, path, frames):
        return write_xyz(path, frames)


def read(tmp_path, text):
    (tmp_path / "a.xyz").write_text(text)
    return luxel.open(tmp_path / "a.xyz")


def test_plain_xyz_with_further_columns(tmp_path):
    found = read(tmp_path, '2\na comment = odd " text\nH 0 0 0 0.5\n\tO  1 1 1 -0.5\n')[0]
    assert found.categories["species"] == ("H", "O")
    assert found.scalars["column5"].tolist() == [0.5, -0.5]
    assert found.cell is None


def test_cell_and_labels(tmp_path):
    found = luxel.open(write_xyz(tmp_path / "a.xyz", [particles(4)]))[0]
    np.testing.assert_allclose(found.cell.vectors, 2 * np.eye(3))
    assert found.cell.periodic == (True, False, True)
    assert [found.categories["species"][code] for code in found.scalars["species"]] == [
        "He",
        "Ar",
        "He",
        "Ar",
    ]


def test_kinds_of_properties(tmp_path):
    text = '2\nProperties=pos:R:3:flag:L:1:name:S:2:n:I:2:Radius:R:3\n0 0 0 T "a b" c 1 2 1 2 3\n5 5 5 fALSE d e 3 4 4 5 6\n'
    found = read(tmp_path, text)[0]
    assert found.scalars["flag"].tolist() == [1, 0]
    assert found.categories["name"] == ("a b c", "d e")
    assert found.scalars["n"].tolist() == [[1, 2], [3, 4]]
    assert found.radii.tolist() == [2, 5]
    assert found.radii_source == "column Radius, mean of its 3 axes"


def test_blank_lines_between_steps_and_no_newline_at_the_end(tmp_path):
    series = read(tmp_path, "1\n\nH 0 0 0\n\n2\n\nH 0 0 0\nH 1 1 1")
    assert [len(frame) for frame in series] == [1, 2]


def test_truncated_last_step_leaves_the_others_readable(tmp_path):
    series = read(tmp_path, "1\n\nH 0 0 0\n3\n\nH 0 0 0\nH 1 1 1\n")
    assert len(series[0]) == 1
    with pytest.raises(luxel.LuxelError, match=r"a\.xyz, frame 1: 2 lines .* promises 3"):
        series[1]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("2\n\nH 0 0 0\nH 1 1 1\nnonsense\n", r"line 5: the number of particles is expected, got 'nonsense'"),
        ("1\n\nH 0 0 0\n2\n\nH 0 0 0\nH 1 1\n", "frame 1, line 7: 3 fields where 4 are expected"),
        ("2\n\nH 0 0 0\nH 1 one 1\n", "frame 0, line 4: 'one' in column .* is not a number"),
        (
            "1\nProperties=species:S:1:pos:R:3:bad:I:1\nH 0 0 0 1.5\n",
            "line 3: 1.5 in column bad is not a whole",
        ),
        (
            "1\nProperties=species:S:1:pos:R:3:bad:L:1\nH 0 0 0 ok\n",
            "line 3: 'ok' in column bad is not T or F",
        ),
        ("1\nProperties=species:S:1:pos:R:2\nH 0 0\n", "line 2: the positions 'pos' must be three"),
        ("1\nProperties=species:S:1\nH\n", "line 2: Properties has no positions"),
        ("1\nProperties=species:Q:1:pos:R:3\nH 0 0 0\n", "line 2: Properties has species:Q:1"),
        ('1\nLattice="1 0 0" Properties=species:S:1:pos:R:3\nH 0 0 0\n', None),
        ('1\nLattice="1 0 0 x" Properties=species:S:1:pos:R:3\nH 0 0 0\n', "line 2: Lattice must be nine"),
        ("100000000000000\n\nH 0 0 0\n", "frame 0: 1 lines"),
    ],
)
def test_errors_name_the_line(tmp_path, text, message):
    if message is None:
        assert len(read(tmp_path, text)[0]) == 1
        return
    with pytest.raises(luxel.LuxelError, match=message):
        list(read(tmp_path, text))


def test_steps_across_chunks(tmp_path, monkeypatch):
    path = write_xyz(tmp_path / "a.xyz", [particles(k % 5, seed=k) for k in range(30)])
    expected = [frame.positions.tolist() for frame in luxel.open(path)]
    for size in (1, 37, 512):
        monkeypatch.setattr("luxel.io.stream._CHUNK_BYTES", size)
        assert [frame.positions.tolist() for frame in luxel.open(path)] == expected
