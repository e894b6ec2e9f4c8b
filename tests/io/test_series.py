from __future__ import annotations

import subprocess
import sys
import threading

import numpy as np
import pytest

import luxel
from luxel.errors import FormatError, FrameError, InputError, MissingFileError
from luxel.io import describe
from tests.io.writers import particles, write_csv, write_lammps, write_npz, write_xyz


def test_pattern_in_natural_order(tmp_path):
    for k in (1, 2, 10):
        write_csv(tmp_path / f"step.{k}.csv", particles(k))
    series = luxel.open(str(tmp_path / "step.*.csv"))
    assert [len(frame) for frame in series] == [1, 2, 10]
    assert series.path.endswith("step.*.csv")


def test_list_keeps_its_order_and_files_may_hold_several_frames(tmp_path):
    a = write_lammps(tmp_path / "a.dump", [particles(3), particles(4)])
    b = write_lammps(tmp_path / "b.dump", [particles(5)])
    series = luxel.open([b, a])
    assert [len(frame) for frame in series] == [5, 3, 4]
    assert series.times == [0.0, 0.0, 100.0]


def test_indexing(tmp_path):
    series = luxel.open(write_xyz(tmp_path / "a.xyz", [particles(k) for k in (1, 2, 3, 4)]))
    assert len(series[-1]) == 4
    assert [len(frame) for frame in series[1:3]] == [2, 3]
    assert [len(frame) for frame in series[::-2]] == [4, 2]
    assert len(series[np.int64(2)]) == 3
    with pytest.raises(FrameError, match=r"a\.xyz: no frame 4 — frames are 0\.\.3"):
        series[4]
    with pytest.raises(FrameError, match="frame -5"):
        series[-5]
    with pytest.raises(FrameError, match="there are no frames"):
        series[4:][0]
    with pytest.raises(InputError, match="whole number"):
        series["1"]


def test_only_the_last_frame_is_kept(tmp_path):
    series = luxel.open(write_xyz(tmp_path / "a.xyz", [particles(2), particles(3)]))
    first = series[0]
    assert series[0] is first
    series[1]
    assert series[0] is not first


def test_first_frame_skips_empty_steps(tmp_path):
    assert (
        luxel.open(
            write_lammps(tmp_path / "a.dump", [particles(0), particles(0), particles(2)])
        ).first_frame()
        == 2
    )
    assert luxel.open(write_lammps(tmp_path / "b.dump", [particles(0)])).first_frame() == 0


def test_threads_get_the_right_frames(tmp_path):
    series = luxel.open(write_lammps(tmp_path / "a.dump", [particles(k + 1) for k in range(8)]))
    wrong = []

    def work(k):
        wrong.extend(k for _ in range(5) if len(series[k]) != k + 1)

    threads = [threading.Thread(target=work, args=(k,)) for k in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


def test_missing_file_suggests_a_neighbour(tmp_path):
    write_csv(tmp_path / "particles.csv", particles(2))
    with pytest.raises(MissingFileError, match=r"particle\.csv: no such file.*did you mean particles\.csv\?"):
        luxel.open(tmp_path / "particle.csv")
    with pytest.raises(MissingFileError, match="no file matches this pattern"):
        luxel.open(tmp_path / "*.dump")
    with pytest.raises(MissingFileError, match="nor is there a folder"):
        luxel.open(tmp_path / "no" / "such")
    with pytest.raises(FileNotFoundError):
        luxel.open("nul\0name")


@pytest.mark.parametrize("radius", [0, -1, float("nan"), float("inf"), "big", True, [1]])
def test_bad_radius(tmp_path, radius):
    with pytest.raises(InputError, match="radius"):
        luxel.open(write_csv(tmp_path / "a.csv", particles(2)), radius=radius)


def test_bad_arguments(tmp_path):
    path = write_csv(tmp_path / "a.csv", particles(2))
    with pytest.raises(InputError, match=r"format must be one of uintah uda \(\.uda\), lammps dump"):
        luxel.open(path, format="docx")
    with pytest.raises(InputError, match="empty list"):
        luxel.open([])
    with pytest.raises(InputError, match="path"):
        luxel.open(3)
    (tmp_path / "empty.csv").touch()
    with pytest.raises(FormatError, match="the file is empty"):
        luxel.open(tmp_path / "empty.csv")


def test_content_wins_over_the_suffix(tmp_path):
    assert luxel.open(write_lammps(tmp_path / "a.csv", [particles(3)])).format == "lammps dump"
    path = write_npz(tmp_path / "a.npz", particles(3))
    assert luxel.open(path.rename(tmp_path / "a.dat")).format == "npz"
    assert luxel.open(write_csv(tmp_path / "a.unknown", particles(3))).format == "csv"


def test_describe_a_frame(tmp_path):
    series = luxel.open(write_lammps(tmp_path / "a.dump", [particles(0), particles(5)]))
    found = describe(series)
    assert (found["frame"], found["frames"], found["particles"]) == (1, 2, 5)
    assert found["radii"]["source"] == "column radius"
    assert found["radii"]["min"] <= found["radii"]["mean"] <= found["radii"]["max"]
    assert found["cell"]["periodic"] == [True, True, False]
    empty = describe(series, 0)
    assert empty["bounds"] is None
    assert describe(series, -1)["frame"] == 1


def test_describe_counts_no_data(tmp_path):
    (tmp_path / "a.csv").write_text("x,y,z,s,kind\n0,0,0,,a\n1,1,1,2,b\n")
    found = describe(luxel.open(tmp_path / "a.csv"))["scalars"]
    assert found["s"] == {"components": 1, "dtype": "float64", "min": 2.0, "max": 2.0, "no_data": 1}
    assert found["kind"]["categories"] == ["a", "b"]


def test_import_is_light():
    code = "import sys, luxel.io; print(*sorted({'scipy', 'vtkmodules', 'gsd', 'numba', 'h5py'} & set(sys.modules)))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == ""


def test_particles_never_freeze_the_callers_array():
    x = np.zeros((2, 3), np.float32)
    luxel.Particles(x, 1.0)
    x[0, 0] = 1.0
