from __future__ import annotations

import numpy as np
import pytest

import luxel
from tests.io.reader_contract import ReaderContract
from tests.io.writers import particles, write_npz


class TestNpz(ReaderContract):
    format = "npz"
    suffix = ".npz"

    def write(self, path, frames):
        return write_npz(path, frames[0])


@pytest.mark.parametrize("names", [("x", "y", "z"), ("X", "Y", "Z"), ("pos_x", "pos_y", "pos_z")])
def test_positions_may_be_three_arrays(tmp_path, names):
    x = particles(5)["position"]
    np.savez(tmp_path / "a.npz", **dict(zip(names, x.T, strict=True)), diameter=np.full(5, 0.5))
    found = luxel.open(tmp_path / "a.npz")[0]
    np.testing.assert_allclose(found.positions, x, rtol=1e-6)
    assert (found.radii == 0.25).all()
    assert found.radii_source == "half of column diameter"


def test_npy_and_big_endian_and_fortran_order(tmp_path):
    x = particles(7)["position"]
    np.save(tmp_path / "a.npy", np.asfortranarray(x.astype(">f4")))
    np.testing.assert_allclose(luxel.open(tmp_path / "a.npy")[0].positions, x, rtol=1e-6)


def test_one_radius_for_all_and_other_arrays(tmp_path):
    np.savez(
        tmp_path / "a.npz",
        position=particles(4)["position"],
        radius=0.5,
        tensor=np.zeros((4, 3, 3)),
        kind=np.array(["b", "a", "b", "c"]),
        note="hello",
        table=np.zeros((3, 5)),
        anything=np.array([{}, 1, 2, 3], dtype=object),
    )
    found = luxel.open(tmp_path / "a.npz")[0]
    assert (found.radii == 0.5).all()
    assert sorted(found.scalars) == ["kind", "radius", "tensor"]
    assert found.scalars["tensor"].shape == (4, 9)
    assert found.scalars["kind"].tolist() == [1, 0, 1, 2]
    assert found.categories["kind"] == ("a", "b", "c")


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"position": np.zeros((4, 2))}, r"array position: shape \(4, 2\)"),
        ({"velocity": np.zeros((4, 3))}, "no array 'position'.*velocity"),
        ({"x": np.zeros(3), "y": np.zeros(3), "z": np.zeros(2)}, r"arrays x y z: shapes \(3,\)"),
        ({"position": np.zeros((4, 3)), "radius": np.ones(3)}, r"array radius: shape \(3,\) does not fit 4"),
        ({"position": np.array([["a", "b", "c"]])}, "real numbers"),
    ],
)
def test_arrays_that_make_no_sense(tmp_path, arrays, message):
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(luxel.LuxelError, match=message):
        luxel.open(tmp_path / "a.npz")[0]


def test_lying_shape_takes_no_memory(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((10, 3)))
    data = (tmp_path / "a.npy").read_bytes().replace(b"(10, 3), }          ", b"(10000000000000, 3),}")
    (tmp_path / "a.npy").write_bytes(data)
    with pytest.raises(luxel.LuxelError, match=r"a\.npy"):
        luxel.open(tmp_path / "a.npy")[0]
