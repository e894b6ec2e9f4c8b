"""Small files of every format, written plainly so that they are readable beside the readers."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any

import numpy as np


def particles(count: int = 12, seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {
        "position": rng.random((count, 3)).round(4),
        "radius": (0.05 + 0.05 * rng.random(count)).round(4),
        "velocity": rng.normal(size=(count, 3)).round(3),
        "stress": rng.normal(size=count).round(3),
        "id": rng.permutation(count) + 1,
    }


def write_npz(path: Path, data: dict[str, Any], time: float = 0.5) -> Path:
    np.savez(path, **data, time=np.float64(time))
    return path


def write_csv(path: Path, data: dict[str, Any], mark: str = ",") -> Path:
    names = ["x", "y", "z", "radius", "vx", "vy", "vz", "stress", "id"]
    table = _table(data)
    lines = [mark.join(names), *(mark.join(f"{value:.10g}" for value in row) for row in table)]
    path.write_text("\n".join(lines) + "\n")
    return path


def write_lammps(path: Path, frames: list[dict[str, Any]], scaled: bool = False) -> Path:
    text = ""
    for step, data in enumerate(frames):
        text += f"ITEM: TIMESTEP\n{step * 100}\nITEM: NUMBER OF ATOMS\n{len(data['id'])}\n"
        text += "ITEM: BOX BOUNDS pp pp ff\n0 1\n0 1\n0 1\n"
        text += f"ITEM: ATOMS {'xs ys zs' if scaled else 'x y z'} radius vx vy vz stress id\n"
        text += "".join(" ".join(f"{value:.10g}" for value in row) + " \n" for row in _table(data))
    path.write_text(text)
    return path


def write_xyz(path: Path, frames: list[dict[str, Any]]) -> Path:
    text = ""
    for step, data in enumerate(frames):
        text += f"{len(data['id'])}\n"
        text += 'Lattice="2 0 0 0 2 0 0 0 2" pbc="T F T" Properties='
        text += f"species:S:1:pos:R:3:radius:R:1:velocity:R:3:stress:R:1:id:I:1 Time={step * 0.5}\n"
        for k, row in enumerate(_table(data)):
            text += "HeAr"[2 * (k % 2) :][:2] + "  " + " ".join(f"{value:.10g}" for value in row) + "\n"
    path.write_text(text)
    return path


def write_gsd(path: Path, frames: list[dict[str, Any]]) -> Path:
    import gsd.hoomd

    with gsd.hoomd.open(name=str(path), mode="w") as file:
        for step, data in enumerate(frames):
            frame = gsd.hoomd.Frame()
            frame.configuration.step = step * 100
            frame.configuration.box = [2, 3, 4, 0.5, 0, 0]
            frame.particles.N = len(data["id"])
            frame.particles.position = data["position"].astype(np.float32)
            frame.particles.velocity = data["velocity"].astype(np.float32)
            frame.particles.diameter = 2 * data["radius"].astype(np.float32)
            frame.particles.types = ["He", "Ar"]
            frame.particles.typeid = np.arange(len(data["id"])) % 2
            frame.log["particles/stress"] = data["stress"]
            frame.log["particles/id"] = data["id"]
            file.append(frame)
    return path


def write_vtk(
    path: Path, data: dict[str, Any], mode: str = "binary", cells: bool = True, time: float = 0.5
) -> Path:
    """Write with the vtk package; the suffix says which format, `mode` ascii, binary, appended, raw or lzma."""
    from vtkmodules import vtkCommonCore, vtkCommonDataModel, vtkIOLegacy, vtkIOXML
    from vtkmodules.util.numpy_support import numpy_to_vtk

    unstructured = path.suffix == ".vtu" or "grid" in path.stem
    output = vtkCommonDataModel.vtkUnstructuredGrid() if unstructured else vtkCommonDataModel.vtkPolyData()
    points = vtkCommonCore.vtkPoints()
    points.SetData(numpy_to_vtk(np.ascontiguousarray(data["position"]), deep=1))
    output.SetPoints(points)
    if cells:
        if not unstructured:
            output.AllocateExact(len(data["position"]), len(data["position"]))
        else:
            output.Allocate(len(data["position"]))
        for k in range(len(data["position"])):
            ids = vtkCommonCore.vtkIdList()
            ids.InsertNextId(k)
            output.InsertNextCell(1, ids)
    for name, values in data.items():
        if name != "position":
            array = numpy_to_vtk(np.ascontiguousarray(values), deep=1)
            array.SetName(name)
            output.GetPointData().AddArray(array)
    field = numpy_to_vtk(np.array([time]), deep=1)
    field.SetName("TIME")
    output.GetFieldData().AddArray(field)
    if path.suffix == ".vtk":
        writer = vtkIOLegacy.vtkUnstructuredGridWriter() if unstructured else vtkIOLegacy.vtkPolyDataWriter()
        writer.SetFileTypeToASCII() if mode == "ascii" else writer.SetFileTypeToBinary()
    else:
        writer = vtkIOXML.vtkXMLUnstructuredGridWriter() if unstructured else vtkIOXML.vtkXMLPolyDataWriter()
        if mode == "ascii":
            writer.SetDataModeToAscii()
        elif mode == "binary":
            writer.SetDataModeToBinary()
        else:
            writer.SetDataModeToAppended()
        if mode == "raw":
            writer.EncodeAppendedDataOff()
            writer.SetCompressorTypeToNone()
            writer.SetHeaderTypeToUInt64()
        if mode == "lzma":
            writer.SetCompressorTypeToLZMA()
            writer.SetBlockSize(256)
        if mode == "big":
            writer.SetByteOrderToBigEndian()
            writer.SetCompressorTypeToNone()
    writer.SetFileName(str(path))
    writer.SetInputData(output)
    writer.Write()
    return path


def write_uda(
    path: Path,
    steps: list[dict[str, Any]],
    *,
    endian: str = "<",
    compress: bool = False,
    old: bool = False,
    patches: int = 2,
    skip: tuple[str, int] = ("", -1),
) -> Path:
    """Write a UDA after Uintah's source; particle k has material k % 2 and `skip` drops a (variable, material)."""
    path.mkdir()
    word = "big_endian" if endian == ">" else "little_endian"
    meta = f"<Meta><endianness>{word}</endianness><nBits>64</nBits></Meta>"
    kinds = {
        "p.x": ("Point", "f8"),
        "p.volume": ("double", "f8"),
        "p.velocity": ("Vector", "f8"),
        "p.stress": ("float", "f4"),
        "p.particleID": ("long64", "i8"),
    }
    names = "".join(
        f'<variable type="ParticleVariable&lt;{kind}&gt;" name="{name}"/>'
        for name, (kind, _) in kinds.items()
    )
    index = "".join(
        f'<timestep href="t{k:05d}/timestep.xml" time="{k * 0.5}">{k}</timestep>' for k in range(len(steps))
    )
    root = f"<Uintah_DataArchive>{meta}<variables>{names}</variables><timesteps>{index}</timesteps></Uintah_DataArchive>"
    (path / "index.xml").write_text(root)
    for k, data in enumerate(steps):
        folder = path / f"t{k:05d}"
        (folder / "l0").mkdir(parents=True)
        listing = "".join(f'<Datafile href="l0/p{p:05d}.xml" proc="{p}"/>' for p in range(patches))
        listing = f'<Data><Datafile href="global.xml"/>{listing}</Data>'
        inside = listing if old else ""
        (folder / "timestep.xml").write_text(f"<Uintah_timestep>{meta}{inside}</Uintah_timestep>")
        if not old:
            (folder / "data.xml").write_text(listing)
        values = {
            "p.x": data["position"],
            "p.volume": 4 / 3 * np.pi * data["radius"] ** 3,
            "p.velocity": data["velocity"],
            "p.stress": data["stress"],
            "p.particleID": data["id"],
        }
        number = np.arange(len(data["id"]))
        for p in range(patches):
            xml, payload = "", b""
            for material in (0, 1):
                mine = (number % patches == p) & (number // patches % 2 == material)
                for name, (kind, code) in kinds.items():
                    if (name, material) == skip:
                        continue
                    raw = values[name][mine].astype(endian + code).tobytes()
                    if compress:
                        raw = np.array(len(raw), endian + "u8").tobytes() + zlib.compress(raw)
                    start = len(payload)
                    payload += raw + b"\0" * 16
                    xml += f'<Variable type="ParticleVariable&lt;{kind}&gt;"><variable>{name}</variable>'
                    xml += f"<index>{material}</index><patch>{p}</patch><start>{start}</start>"
                    xml += f"<numParticles>{int(mine.sum())}</numParticles><end>{start + len(raw)}</end>"
                    xml += "<compression>gzip</compression>" if compress else ""
                    xml += f"<filename>p{p:05d}.data</filename></Variable>"
            xml += '<Variable type="NCVariable&lt;double&gt;"><variable>g.mass</variable></Variable>'
            (folder / "l0" / f"p{p:05d}.xml").write_text(f"<Uintah_Output>{xml}</Uintah_Output>")
            (folder / "l0" / f"p{p:05d}.data").write_bytes(payload)
    return path


def _table(data: dict[str, Any]) -> np.ndarray:
    columns = [data["position"], data["radius"], data["velocity"], data["stress"], data["id"]]
    return np.column_stack(columns) if len(data["id"]) else np.empty((0, 9))
