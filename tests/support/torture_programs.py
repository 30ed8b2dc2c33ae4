"""More samples of `torture_readers`: binary files of Ansys, meshes, MATLAB, SDynPy, and what programs and runs of
updyn leave behind to be read again.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import Any

import meshio
import numpy as np
from asammdf import MDF, Signal
from nptdms import ChannelObject, TdmsWriter
from scipy.io import wavfile

import ansys_samples
import matlab73
import meshes
import native_samples
import op2_samples
import plants_by_hand
import uff_samples as uff
import updyn
from torture_readers import (
    SAMPLES,
    Content,
    Sample,
    content_of,
    foreign,
    leaves,
    of_model_file,
    sample,
    small_frf,
    small_model,
    tortures,
    written,
)
from updyn.elements.mesh import read_mesh
from updyn.geometry import Geometry
from updyn.io.atomic import write_json
from updyn.io.items import guard_reader
from updyn.io.named import frf_items, model_items
from updyn.modal import ModeSet
from updyn.model import Model

__all__ = ["SAMPLES", "tortures"]

_STEEL = {"E": 2.1e11, "nu": 0.3, "rho": 7850.0}
_K = np.array([[2.0e3, -0.5, 0.0], [-0.5, 3.25e3, -12.0], [0.0, -12.0, 4.0e3]])


# -- Nastran --------------------------------------------------------------------------------------
@sample("OUTPUT2, geometry")
def _op2_geometry() -> Sample:
    out = op2_samples.Writer()
    out.head()
    op2_samples.geometry(out)

    def read(folder: Path) -> Geometry:
        return updyn.read_geometry(folder / "a.op2", format="op2")

    return Sample({"a.op2": out.bytes()}, "a.op2", read, is_text=False)


@sample("OUTPUT2, modes")
def _op2_modes() -> Sample:
    out = op2_samples.Writer(">", 8)
    out.eigenvalues([(1, 4.0e4, 1.0), (2, 9.0e4, 4.0)])
    out.shapes(op2_samples.MODES, scalar=(20,))

    def read(folder: Path) -> ModeSet:
        return updyn.read_modes(folder / "a.op2", format="op2")

    return Sample({"a.op2": out.bytes()}, "a.op2", read, is_text=False)


@sample("OUTPUT2, matrices")
def _op2_matrices() -> Sample:
    out = op2_samples.Writer()
    out.table("EQEXINS", [[3, 1, 20, 2], [3, 11, 20, 72]])
    out.matrix("KGG", op2_samples.stiffness())
    table = b'[[group]]\nname = "a"\nstiffness = "a.op2:KGG"\n'

    def read(folder: Path) -> Model:
        return updyn.read_model(folder / "a.toml")

    return Sample({"a.op2": out.bytes(), "a.toml": table}, "a.op2", read, is_text=False)


# -- Ansys ----------------------------------------------------------------------------------------
@sample("Ansys, .full")
def _full() -> Sample:
    nodes = [(22, (1, -2)), (1, (1, 2))]
    K, M = np.zeros((4, 4)), np.diag([1.25, 9.0, 2.5, 0.75])
    K[np.ix_([0, 2, 3], [0, 2, 3])] = _K
    K[1, 1] = 7.0
    C = np.diag([0.0, 0.0, 1.75, 0.5])

    def write(folder: Path) -> None:
        ansys_samples.write_full(folder / "a.full", nodes, K, M, C)

    def read(folder: Path) -> Model:
        return updyn.read_model(folder / "a.full")

    return Sample(written(write), "a.full", read, is_text=False)


@sample("Ansys, .rst", is_boxed=True)
def _rst() -> Sample:
    from ansys.mapdl.reader import examples

    from updyn.io.ansys.attributes import read_attributes

    def read(folder: Path) -> Content:
        path = folder / "a.rst"
        with guard_reader(path, "ansys_rst"):
            found = read_attributes(path)
        return leaves(
            {
                "numbers": found.numbers,
                "nodes": dict(zip(found.nodes.tolist(), found.xyz.tolist(), strict=True)),
                "angles": dict(zip(found.nodes.tolist(), found.angles.tolist(), strict=True)),
            }
        )

    return Sample({"a.rst": Path(examples.rstfile).read_bytes()}, "a.rst", read, is_text=False)


# -- meshes ---------------------------------------------------------------------------------------
_TABLE = {
    "top": {"thickness": 0.01, **_STEEL},
    "legs": {"section": {"shape": "tube", "outer": 0.05, "inner": 0.04}, **_STEEL},
    "tip": {"mass": 3.0},
}


def _mesh(name: str, raw: bytes, *, is_text: bool = True, **options: Any) -> Sample:
    def read(folder: Path) -> Content:
        updyn.read_model(folder / name, format="mesh", unit="mm", **options)
        found = read_mesh(folder / name, unit="mm")
        cells = {}
        for group, kinds in found.groups.items():
            for kind, rows in kinds.items():
                cells |= {(group, kind, *row): True for row in rows.tolist()}
        where = dict(zip(found.nodes.tolist(), map(tuple, found.xyz.tolist()), strict=True))
        return leaves({"cells": cells, "sets": found.node_sets, "nodes": where})

    return Sample({name: raw}, name, read, is_text)


def _plate() -> meshio.Mesh:
    points = np.array([[0.0, 0, 0], [500, 0, 0], [500, 250, 0], [0, 250, 0], [1000, 125.5, 0]])
    cells = [("quad", np.array([[0, 1, 2, 3]])), ("triangle", np.array([[1, 4, 2]]))]
    return meshio.Mesh(points, cells)


def _saved(name: str, **options: Any) -> bytes:
    """Return a plate of a quad and a triangle as meshio writes it."""
    return written(lambda folder: _plate().write(folder / name, **options))[name]


def _plate_mesh(name: str, *, is_text: bool, **options: Any) -> Sample:
    raw = _saved(name, **options)
    return _mesh(name, raw, is_text=is_text, materials={"all": _TABLE["top"]})


@sample("Gmsh 4.1", is_boxed=True)
def _gmsh() -> Sample:
    return _mesh("a.msh", meshes.MSH.encode(), materials=_TABLE, grounded=["foot"])


@sample("Gmsh 2.2", is_boxed=True)
def _gmsh22() -> Sample:
    mesh = _plate()
    mesh.field_data = {"plate": np.array([7, 2])}
    tags = [np.array([7]), np.array([7])]
    mesh.cell_data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
    raw = written(lambda folder: mesh.write(folder / "a.msh", "gmsh22", binary=False))["a.msh"]
    return _mesh("a.msh", raw, materials={"plate": _TABLE["top"]})


@sample("VTK in text", is_boxed=True)
def _vtk_text() -> Sample:
    return _plate_mesh("a.vtk", is_text=True, binary=False)


@sample("VTK, binary", is_boxed=True)
def _vtk() -> Sample:
    return _plate_mesh("a.vtk", is_text=False, binary=True)


@sample("VTU in text", is_boxed=True)
def _vtu_text() -> Sample:
    return _plate_mesh("a.vtu", is_text=True, binary=False)


@sample("VTU, packed", is_boxed=True)
def _vtu() -> Sample:
    return _plate_mesh("a.vtu", is_text=True, binary=True, compression="zlib")


@sample("MED", is_boxed=True)
def _med() -> Sample:
    return _plate_mesh("a.med", is_text=False)


@sample("XDMF", is_boxed=True)
def _xdmf() -> Sample:
    return _plate_mesh("a.xdmf", is_text=True, data_format="XML")


@sample("XDMF, HDF5 beside it", is_boxed=True)
def _xdmf_hdf5() -> Sample:
    mesh = _plate()
    files = written(lambda folder: mesh.write(folder / "a.xdmf"))

    def read(folder: Path) -> Content:
        found = read_mesh(folder / "a.xdmf", unit="mm")
        return leaves({"xyz": found.xyz, "groups": found.groups})

    return Sample(files, "a.h5", read, is_text=False)


@sample("Abaqus, mesh", is_boxed=True)
def _inp() -> Sample:
    deck = "*HEADING\ntwo\n*NODE\n 101, 0., 0., 0.\n 102, 500., 0., 0.\n 103, 500., 250.5, 0.\n"
    deck += " 104, 0., 250., 0.\n 205, 1000., 125., 0.\n*ELEMENT, TYPE=S4, ELSET=lower\n"
    deck += " 1, 101, 102, 103, 104\n*ELEMENT, TYPE=S3, ELSET=upper\n 2, 102, 205, 103\n"
    deck += "*NSET, NSET=base\n 101, 104\n"
    materials = {"lower": _TABLE["top"], "upper": _TABLE["top"]}
    return _mesh("a.inp", deck.encode(), materials=materials, grounded=["base"])


# -- MATLAB, SDynPy -------------------------------------------------------------------------------
@sample("MATLAB 5, model", is_boxed=True)
def _mat_model() -> Sample:
    return of_model_file("a.mat", "a.mat", is_text=False)


def _mat73(items: dict[str, Any], read: Callable[[Path], Any]) -> Sample:
    files = written(lambda folder: matlab73.write_matlab73(folder / "a.mat", items))
    return Sample(files, "a.mat", lambda folder: read(folder / "a.mat"), is_text=False)


@sample("MATLAB 7.3, FRF", is_boxed=True)
def _mat73_frf() -> Sample:
    return _mat73(frf_items(small_frf()), updyn.read_frf)


@sample("MATLAB 7.3, model", is_boxed=True)
def _mat73_model() -> Sample:
    return _mat73(model_items(small_model()), updyn.read_model)


@sample("SDynPy")
def _sdynpy() -> Sample:
    kind = [("node", "uint64"), ("direction", "int8")]

    def write(folder: Path) -> None:
        np.savez(
            folder / "a.npz",
            mass=np.diag([1.25, 2.5, 0.75]),
            stiffness=_K,
            damping=np.diag([0.0, 1.75, 0.0]),
            transformation=np.eye(3),
            coordinate=np.array([(1, 1), (1, 2), (22, -3)], dtype=kind),
            enforce_symmetry=np.array(True),
        )

    return Sample(written(write), "a.npz", lambda f: updyn.read_model(f / "a.npz"), is_text=False)


# -- time records ---------------------------------------------------------------------------------
@sample("LabVIEW, records")
def _lvm() -> Sample:
    text = "LabVIEW Measurement\nSeparator\tTab\nDecimal_Separator\t.\nX_Columns\tOne\n"
    text += "***End_of_Header***\n\n"
    for first in (1.5, 2.25):
        text += "Channels\t2\nSamples\t3\t3\nY_Unit_Label\tN\tg\nX_Dimension\tTime\tTime\n"
        text += "Delta_X\t0.25\t0.25\n***End_of_Header***\t\t\nX_Value\tforce\ttop\tComment\n"
        text += f"0.0\t{first}\t-2.0E-1\n0.25\t0.0\t3.125\n0.5\t2.5\t4.0\n"

    return _records("a.lvm", text.encode())


def _records(name: str, raw: bytes, *, is_text: bool = True) -> Sample:
    def read(folder: Path) -> Content:
        found = updyn.read_records(folder / name)
        unit = dict(zip(found["channel"].values, found["unit"].values, strict=True))
        return leaves({"values": found.values, "time": found["time"].values, "unit": unit})

    return Sample({name: raw}, name, read, is_text=is_text)


@sample("WAV, records")
def _wav() -> Sample:
    content = io.BytesIO()
    wavfile.write(content, 2048, np.array([[1.5, -0.2], [0.0, 3.125], [2.5, 4.0]], np.float32))
    return _records("a.wav", content.getvalue(), is_text=False)


@sample("TDMS, records", is_boxed=True)
def _tdms() -> Sample:
    def write(folder: Path) -> None:
        timing = {"wf_increment": 0.25, "wf_start_offset": 0.0}
        with TdmsWriter(folder / "a.tdms") as writer:
            for first in (1.5, 2.25):
                force = ChannelObject("g", "force", np.array([first, 0.0]), timing)
                top = ChannelObject(
                    "g", "top", np.array([-0.2, 3.125]), {**timing, "unit_string": "g"}
                )
                writer.write_segment([force, top])

    return _records("a.tdms", written(write)["a.tdms"], is_text=False)


def _mdf(compression: int) -> Sample:
    def write(folder: Path) -> None:
        times = 0.25 * np.arange(4)
        force = Signal(np.array([1.5, 0.0, 2.25, 0.0]), times, name="force", unit="N")
        top = Signal(np.array([-0.2, 3.125, 1.0, 7.5]), times, name="top", unit="g")
        with MDF(version="4.10") as mdf:
            mdf.append([force, top], acq_name="g")
            mdf.save(folder / "a.mf4", compression=compression)

    return _records("a.mf4", written(write)["a.mf4"], is_text=False)


@sample("MDF, records", is_boxed=True)
def _mdf_plain() -> Sample:
    return _mdf(0)


@sample("MDF, packed records", is_boxed=True)
def _mdf_packed() -> Sample:
    return _mdf(2)


@sample("universal file, records")
def _time_responses() -> Sample:
    raw = b""
    for first in (1.5, 2.25):
        for node, kind in ((1, 13), (22, 12)):
            y = np.array([first, 0.25 * node, -0.2])
            units = ("s", "N" if kind == 13 else "g", "NONE")
            axes = {"types": (17, kind, 0), "units": units}
            raw += uff.ascii58(y, (node, 3), (1, 3), kind=1, start=0.0, step=0.25, **axes)
    return _records("a.uff", raw)


@sample("table of records")
def _table_of_records() -> Sample:
    text = "time,hammer [N],3:-Z [g]\n0.0,1.5,-0.2\n0.25,0.0,3.125\n0.5,2.5,4.0\n"
    return _records("a.csv", text.encode())


# -- what CalculiX and MYSTRAN leave --------------------------------------------------------------
@sample("CalculiX, matrices")
def _ccx() -> Sample:
    from updyn.io.calculix.program import CalculixProgram

    def triangle(matrix: np.ndarray) -> bytes:
        lines = []
        for j, i in zip(*np.nonzero(np.tril(matrix)), strict=True):
            lines.append(f"{i + 1} {j + 1} {matrix[i, j]:.13e}\n")
        return "".join(lines).encode()

    def read(folder: Path) -> Content:
        with guard_reader(folder / "job.sti", "calculix"):
            found = CalculixProgram("ccx", 1.0, folder / "job.inp")._read_matrices(folder)
            return content_of(
                Model.from_groups({"a": updyn.Group(found.stiffness, found.mass)}, found.dofs)
            )

    files = {"job.dof": b"1.1\n1.2\n22.3\n", "job.mas": triangle(np.diag([1.25, 2.5, 0.75]))}
    return Sample({**files, "job.sti": triangle(_K)}, "job.sti", read)


def _fortran(form: str, *values: Any) -> bytes:
    """Return a record as Fortran writes it."""
    length = struct.calcsize("<" + form)
    return struct.pack(f"<i{form}i", length, *values, length)


@sample("MYSTRAN, matrices")
def _mystran() -> Sample:
    from updyn.io.nastran import mystran

    terms = list(zip(*np.nonzero(np.triu(_K)), strict=True))
    raw = _fortran("i", 3) + _fortran("i", len(terms))
    raw += b"".join(_fortran("iid", i + 1, j + 1, _K[i, j]) for i, j in terms)
    table = _fortran("5s", b"TDOFI") + _fortran("i", 3) + _fortran("i", 13)
    for number, (node, component) in enumerate(((1, 1), (1, 2), (22, 3)), 1):
        for value in (node, component, 0, 0, number, *[0] * 8):
            table += _fortran("i", value)

    def read(folder: Path) -> Content:
        with guard_reader(folder / "run.bdf", "nastran"):
            dofs, _ = mystran._dofs(folder / "run.L1C", folder / "run.bdf")
            found = mystran._symmetric(folder / "run.L1L", len(dofs), folder / "run.bdf")
            return content_of(Model.from_groups({"a": updyn.Group(found)}, dofs))

    return Sample({"run.L1C": table, "run.L1L": raw}, "run.L1L", read, is_text=False)


@sample("MYSTRAN, table of DOFs")
def _mystran_dofs() -> Sample:
    one = _mystran()
    return Sample(one.files, "run.L1C", one.read, is_text=False)


# -- plants ---------------------------------------------------------------------------------------
def _plant(name: str, *, is_text: bool) -> Sample:
    from updyn.control.files.plant_file import read_plant, write_plant

    plant = plants_by_hand.two_masses(facts=plants_by_hand.FACTS)

    def read(folder: Path) -> Content:
        return leaves(read_plant(folder / name))

    return Sample(written(lambda folder: write_plant(plant, folder / name)), name, read, is_text)


@sample("plant, JSON")
def _plant_json() -> Sample:
    return _plant("a.json", is_text=True)


@sample("plant, npz")
def _plant_npz() -> Sample:
    return _plant("a.npz", is_text=False)


@sample("plant, MATLAB 5", is_boxed=True)
def _plant_mat() -> Sample:
    return _plant("a.mat", is_text=False)


# -- what a run leaves ----------------------------------------------------------------------------
def _native(name: str) -> Sample:
    (native,) = (one for one in native_samples.NATIVE if one.name == name)
    files = written(lambda folder: native.write(folder / name))
    return foreign(
        Sample(files, name, lambda folder: leaves(native.read(folder / name)), is_text=False)
    )


@sample("run.nc", is_boxed=True)
def _run() -> Sample:
    return _native("run.nc")


@sample("uncertainty.nc, draws", is_boxed=True)
def _draws() -> Sample:
    return _native("uncertainty.nc")


@sample("uncertainty.nc, profiles", is_boxed=True)
def _profiles() -> Sample:
    from updyn.uncertainty.profile import Interval, Profile, Profiles

    numbers = np.array([0.5, 0.7, 0.9])
    ranges = (Interval(0.5, 0.6, 0.65, 0.1), Interval(0.69, 0.7, 0.8, 0.0))
    one = Profile(
        "a.mass", 0.7, numbers, numbers**2, np.arange(6.0).reshape(3, 2), ranges, "level", "bound"
    )
    found = Profiles((one,), 0.95, 1.92, ("c.mass",), {"a.stiffness": 0.6})
    files = written(lambda folder: updyn.write_uncertainty(found, folder / "u.nc"))

    def read(folder: Path) -> Content:
        return leaves(updyn.read_uncertainty(folder / "u.nc"))

    return foreign(Sample(files, "u.nc", read, is_text=False))


@sample("journal of a run")
def _journal() -> Sample:
    from updyn.updating.fit.checkpoint import Checkpoint

    head = {"updyn": "1", "model": "a", "data": "b", "unknowns": {"a": [1.0, 0.5]}, "options": {}}
    keys = [bytes([i]) * 16 for i in range(3)]

    def write(folder: Path) -> None:
        journal = Checkpoint(folder / "run.journal", head)
        for i, key in enumerate(keys):
            journal.store(key, (np.arange(3.0) + i, np.array([1j * i])))
        journal.close()

    def read(folder: Path) -> Content:
        journal = Checkpoint(folder / "run.journal", head, resume=True)
        try:
            return leaves({key: found for key in keys if (found := journal.get(key)) is not None})
        finally:
            journal.close()

    return Sample(written(write), "run.journal", read, is_text=False)


@sample("manifest.json")
def _manifest() -> Sample:
    from updyn.outputs.manifest import MANIFEST, Entry, Manifest

    entries = {f"{name}.nc": Entry(name * 64, "8d", "run") for name in "ab"}
    files = written(Manifest(MappingProxyType(entries)).write)
    return Sample(files, MANIFEST, lambda folder: leaves(Manifest.read(folder).entries))


@sample("plan of a switch")
def _plan() -> Sample:
    from updyn.outputs.switch import PLAN, _Plan, _read_plan

    plan = _Plan({"run.nc": ["a" * 64, "b" * 64], "model.h5": [None, "c" * 64]}, {"x.h": "d" * 64})
    files = written(lambda folder: write_json(asdict(plan), folder / PLAN))
    return Sample(files, PLAN, lambda folder: leaves(_read_plan(folder)))


@sample("true values, TOML")
def _truth_toml() -> Sample:
    return _truth("truth.toml", b'"part 1.stiffness" = 0.875\n["part 2"]\nmass = 1.5e-1\n')


@sample("true values, JSON")
def _truth_json() -> Sample:
    return _truth("truth.json", b'{"part 1.stiffness": 0.875,\n "part 2": {"mass": 1.5e-1}}\n')


def _truth(name: str, raw: bytes) -> Sample:
    from updyn.job.comparison import read_truth
    from updyn.updating.problem.parameters import Parameter, ParameterSet

    known = ParameterSet(
        (
            Parameter("part 1", "stiffness", 1.0, 0.1, 9.0),
            Parameter("part 2", "mass", 1.0, 0.1, 9.0),
        )
    )
    return Sample({name: raw}, name, lambda folder: leaves(read_truth(folder / name, known)))
