"""The real files of other codes: counts, frames and radii, against the manifest and independent readings."""

from __future__ import annotations

import gzip
import json

import numpy as np
import pytest

import luxel
from luxel.io import describe
from tests.conftest import shared_data

pytestmark = pytest.mark.shared_data

# path, particles in the last frame, frames, where radii come from
FILES = [
    ("mpm/foam.pts.gz", 380892, 1, "estimated"),
    ("mpm/cbgeo_dambreak.txt", 36482, 1, "estimated"),
    ("mpm/heatcond.uda", 2560, 4, "p.volume"),
    ("mpm/fireball_4k.uda", 4000, 2, "p.volume"),
    ("mpm_generated/bullet_000.npz", 50016, 1, "column radius"),
    ("mpm_generated/bullet_003.npz", 50016, 1, "column radius"),
    ("mpm_generated/bullet_008.npz", 50016, 1, "column radius"),
    ("mpm_generated/cylinder_003.npz", 49443, 1, "column radius"),
    ("mpm_generated/cylinder_008.npz", 45717, 1, "column radius"),
    ("mpm_generated/fireball_003.npz", 50256, 1, "column radius"),
    ("mpm_generated/fireball_006.npz", 47623, 1, "column radius"),
    ("mpm_generated/foam_crushed.npz", 380892, 1, "column radius"),
    ("solid/peri_disc.0.dump.gz", 103110, 1, "estimated"),
    ("solid/peri_disc.120.dump.gz", 103110, 1, "estimated"),
    ("solid/peri_disc.240.dump.gz", 103110, 1, "estimated"),
    ("solid/peri_disc.300.dump.gz", 103110, 1, "estimated"),
    ("solid/rubber_rings.lammpstrj", 960, 6, "column radius"),
    ("solid/box_crack_00094.vtu", 1000, 1, "estimated"),
    ("solid/box_crack_00188.vtu", 1000, 1, "estimated"),
    ("solid/box_crack_00294.vtu", 1000, 1, "estimated"),
    ("dem/ellipsoids_00019.vtu", 12, 1, "column Radius, mean of its 3 axes"),
    ("dem/pour.lammpstrj.gz", 22533, 5, "column radius"),
    ("sph/dambreak_4.vtk", 42282, 1, "estimated"),
    ("sph/dambreak_8.vtk", 42282, 1, "estimated"),
    ("md/albite_triclinic.dump", 17, 1, "estimated"),
    ("md/chemfiles_lammps_polymer.lammpstrj", 1714, 42, "estimated"),
    ("md/chemfiles_lammps_properties.lammpstrj", 4000, 4, "estimated"),
    ("md/pyscal_cluster.dump", 8192, 1, "estimated"),
    ("md/chemfiles_xyz_extended.xyz", 8, 3, "estimated"),
    ("md/chemfiles_xyz_water.6.xyz.gz", 297, 100, "estimated"),
    ("md/molecules.gsd", 729, 1, "estimated"),
    ("md/rdf_benchmark.gsd", 15625, 5, "estimated"),
    ("astro/hyg_stars.vtp", 107857, 1, "estimated"),
    ("astro/halo_low_res.npy", 32314, 1, "estimated"),
    ("misc/testspheres.0.csv", 5, 1, "column rad"),
    ("misc/testspheres.1.csv", 10, 1, "column rad"),
    ("misc/testspheres.2.csv", 15, 1, "column rad"),
    ("misc/testspheres.3.csv", 20, 1, "column rad"),
    ("converted/fireball_006.vtp", 47623, 1, "column radius"),
    ("converted/fireball_006.vtu", 47623, 1, "column radius"),
    ("converted/fireball_006_ascii.vtk", 4000, 1, "estimated"),
    ("converted/fireball_006.csv", 20000, 1, "column radius"),
    ("converted/fireball_006.extxyz", 3000, 1, "column radius"),
    ("converted/fireball_006.gsd", 3000, 3, "half of particles/diameter"),
    ("converted/bullet_003.vtp", 8000, 1, "column radius"),
]


@pytest.mark.parametrize(("path", "count", "frames", "radii"), FILES)
def test_file(path, count, frames, radii):
    series = luxel.open(shared_data(path))
    assert len(series) == frames
    last = series[-1]
    assert len(last) == count
    assert radii in last.radii_source
    assert (last.radii > 0).all()
    json.dumps(describe(series), allow_nan=False)


BROKEN = [
    (
        "md/chemfiles_lammps_bad_box-wrong-size.lammpstrj",
        "frame 0, line 6: a line of BOX BOUNDS needs 3 numbers",
    ),
    ("md/chemfiles_xyz_bad_extended.xyz", "frame 0, line 3: 4 fields where 5 are expected"),
    ("dem/granularsim_particles.csv", "line 1: 2 columns of numbers without names"),
    ("mpm/centrifuge_vaango.txt", "line 1: 9 columns of numbers without names"),
]


@pytest.mark.parametrize(("path", "message"), BROKEN)
def test_broken_file_is_refused(path, message):
    file = shared_data(path)
    with pytest.raises(luxel.LuxelError, match=message):
        luxel.open(file)[0]


def test_pour_grows():
    series = luxel.open(shared_data("dem/pour.lammpstrj.gz"))
    assert [len(frame) for frame in series] == [0, 6438, 12876, 16095, 22533]
    assert series.first_frame() == 1
    assert describe(series, 0)["particles"] == 0
    assert (np.diff(series[-1].scalars["id"]) > 0).all()


def test_csv_series():
    folder = shared_data("misc/testspheres.0.csv").parent
    series = luxel.open(folder / "testspheres.*.csv")
    assert [len(frame) for frame in series] == [5, 10, 15, 20]
    assert series[0].radii[0] == np.float32(0.0727)


def test_lammps_against_numpy():
    path = shared_data("solid/peri_disc.300.dump.gz")
    with gzip.open(path) as file:
        table = np.loadtxt(file, skiprows=9)
    table = table[np.argsort(table[:, 0])]
    found = luxel.open(path)[0]
    np.testing.assert_array_equal(found.local, table[:, 2:5].astype(np.float32))
    np.testing.assert_array_equal(found.scalars["velocity"], table[:, 5:8])
    np.testing.assert_array_equal(found.scalars["c_ke"], table[:, 9])


def test_polymer_keeps_its_atoms_through_time():
    series = luxel.open(shared_data("md/chemfiles_lammps_polymer.lammpstrj"))
    first, last = series[0], series[-1]
    assert np.array_equal(first.scalars["id"], last.scalars["id"])
    assert np.array_equal(first.scalars["mol"], last.scalars["mol"])


def test_scaled_triclinic():
    found = luxel.open(shared_data("md/albite_triclinic.dump"))[0]
    # The atom that comes first in the file has id 192 and xs ys zs = 0.204242 0.016215 0.0425371.
    k = found.scalars["id"].tolist().index(192)
    scaled = np.linalg.solve(found.cell.vectors.T, found.positions[k] - found.cell.origin)
    np.testing.assert_allclose(scaled, [0.204242, 0.016215, 0.0425371], atol=1e-6)


@pytest.mark.parametrize("path", [name for name, *_ in FILES if name.endswith((".vtk", ".vtp", ".vtu"))])
def test_vtk_files_against_the_vtk_package(path):
    vtk_xml = pytest.importorskip("vtkmodules.vtkIOXML")
    vtk_legacy = pytest.importorskip("vtkmodules.vtkIOLegacy")
    from vtkmodules.util.numpy_support import vtk_to_numpy

    file = shared_data(path)
    reader = {
        ".vtk": vtk_legacy.vtkDataSetReader,
        ".vtp": vtk_xml.vtkXMLPolyDataReader,
        ".vtu": vtk_xml.vtkXMLUnstructuredGridReader,
    }[file.suffix]()
    if file.suffix == ".vtk":
        reader.ReadAllScalarsOn()
        reader.ReadAllVectorsOn()
        reader.ReadAllFieldsOn()
    reader.SetFileName(str(file))
    reader.Update()
    attributes = reader.GetOutput().GetPointData()
    found = luxel.open(file)[0]
    points = vtk_to_numpy(reader.GetOutput().GetPoints().GetData())
    scale = np.abs(points).max()
    np.testing.assert_allclose(found.positions, points, rtol=0, atol=1e-7 * scale)
    names = [attributes.GetArrayName(k) for k in range(attributes.GetNumberOfArrays())]
    assert sorted(names) == sorted(found.scalars)
    for name in names:
        np.testing.assert_array_equal(found.scalars[name], vtk_to_numpy(attributes.GetArray(name)))


@pytest.mark.parametrize("path", [name for name, *_ in FILES if name.endswith(".gsd")])
def test_gsd_files_against_the_gsd_package(path):
    hoomd = pytest.importorskip("gsd.hoomd")
    file = shared_data(path)
    with hoomd.open(name=str(file), mode="r") as reference:
        for frame, found in zip(reference, luxel.open(file), strict=True):
            np.testing.assert_array_equal(found.local, frame.particles.position)
            for name in found.scalars.keys() & {"velocity", "diameter", "typeid", "image"}:
                np.testing.assert_array_equal(found.scalars[name], getattr(frame.particles, name))
            for name, values in frame.log.items():
                np.testing.assert_array_equal(found.scalars[name.removeprefix("particles/")], values)


def test_conversions_agree_with_their_origin():
    origin = luxel.open(shared_data("mpm_generated/fireball_006.npz"))[0]
    for suffix in ("vtp", "vtu"):
        found = luxel.open(shared_data(f"converted/fireball_006.{suffix}"))[0]
        np.testing.assert_array_equal(found.local, origin.local)
        np.testing.assert_array_equal(found.radii, origin.radii)
        np.testing.assert_array_equal(found.scalars["stress"], origin.scalars["stress"])
    table = luxel.open(shared_data("converted/fireball_006.csv"))[0]
    np.testing.assert_allclose(table.positions, origin.positions[:20000], rtol=1e-4)
    np.testing.assert_allclose(table.radii, origin.radii[:20000], rtol=1e-4)


def test_uda_materials():
    found = luxel.open(shared_data("mpm/fireball_4k.uda"))[-1]
    assert np.bincount(found.scalars["material"]).tolist() == [879, 1616, 1505]
    missing = np.isnan(found.scalars["localized"])
    assert missing.any()
    assert set(found.scalars["material"][missing]) == {1}
    assert (np.diff(found.scalars["particleID"]) > 0).all()
