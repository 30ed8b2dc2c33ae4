"""Tortures of the readers: mutants and cuts of a small file of each format.

A mutant may be read as something else, as a changed number is a number. A cut may not: what is read
of a part of a file has to be what stands there in the whole, and no number may be another. (A format
without counts and end marks cannot tell a table from its first half; such a cut is counted as
"less".)
"""

from __future__ import annotations

import functools
import tempfile
import warnings
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

import uff_samples as uff
import updyn
from mutants import bytes_mutant, text_mutant
from native_samples import MARK
from torture import EQUAL, LESS, OTHER, REFUSED, Outcome, Torture
from updyn.frf import FRF
from updyn.geometry import Geometry
from updyn.modal import ModeSet
from updyn.model import Group, Model

#: What stands for one number: where it belongs.
Content = dict[Any, Any]


@dataclass(frozen=True, slots=True)
class Sample:
    """A file to damage, with the files beside it.

    Parameters
    ----------
    files : mapping of str to bytes
        By name.
    damaged : str
        Which of them.
    read : callable
        Takes the folder.
    is_text : bool
        Whether its mutants are those of a text.
    """

    files: Mapping[str, bytes]
    damaged: str
    read: Callable[[Path], Any]
    is_text: bool = True


SAMPLES: dict[str, Callable[[], Sample]] = {}
#: Those that a library reads, in a process of its own.
BOXED: set[str] = set()


def sample(
    name: str, *, is_boxed: bool = False
) -> Callable[[Callable[[], Sample]], Callable[[], Sample]]:
    """Register a function that makes a sample, as a row of the table."""

    def registered(make: Callable[[], Sample]) -> Callable[[], Sample]:
        SAMPLES[name] = functools.cache(make)
        if is_boxed:
            BOXED.add(name)
        return SAMPLES[name]

    return registered


def tortures() -> list[Torture]:
    """Return mutants and cuts of every sample."""
    out = []
    for name in SAMPLES:
        out.append(Torture(name, "mutants", functools.partial(_mutant, name)))
        size = functools.partial(_length, name)
        out.append(Torture(name, "cuts", functools.partial(_cut, name), size))
    return out


def _length(name: str) -> int:
    """Return the size of the file, which is the number of its cuts."""
    one = SAMPLES[name]()
    return len(one.files[one.damaged])


def _mutant(name: str, seed: int, folder: Path) -> Outcome:
    one = SAMPLES[name]()
    random = np.random.default_rng([zlib.crc32(name.encode()), seed])
    mutate = text_mutant if one.is_text else bytes_mutant
    return _read(one, mutate(one.files[one.damaged], random), folder, may_change=True)


def _cut(name: str, seed: int, folder: Path) -> Outcome:
    one = SAMPLES[name]()
    return _read(one, one.files[one.damaged][:seed], folder, may_change=False)


def _read(one: Sample, raw: bytes, folder: Path, *, may_change: bool) -> Outcome:
    for name, content in one.files.items():
        (folder / name).write_bytes(raw if name == one.damaged else content)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            found = content_of(one.read(folder))
        except updyn.UpdynError as error:
            said = str(error)
            is_caught = "cannot be read (reader" in said
            return Outcome(REFUSED, said[:300] if is_caught else "")
    whole = _whole(one, folder)
    if found == whole:
        return Outcome(EQUAL)
    if found.items() <= whole.items():
        return Outcome(LESS)
    changed = next(iter(found.items() - whole.items()))
    return Outcome(OTHER, str(changed)[:200], failed=not may_change)


_WHOLE: dict[int, Content] = {}


def _whole(one: Sample, folder: Path) -> Content:
    """Return what the undamaged file holds."""
    if id(one) not in _WHOLE:
        for name, content in one.files.items():
            (folder / name).write_bytes(content)
        _WHOLE[id(one)] = content_of(one.read(folder))
    return _WHOLE[id(one)]


# -- what was read, number by number ---------------------------------------------------------------
def content_of(read: Any) -> Content:
    """Return every number of an object by its place."""
    if isinstance(read, FRF):
        return _of_frf(read)
    if isinstance(read, Model):
        return dict(_of_model(read))
    if isinstance(read, Geometry):
        return dict(_of_geometry(read))
    if isinstance(read, ModeSet):
        return dict(_of_modes(read))
    if isinstance(read, Mapping):
        return dict(read)
    return {"text": repr(read)}


def _of_frf(frf: FRF) -> Content:
    out: Content = {"quantity": frf.quantity}
    for what in ("values", "coherence", "variance"):
        array = getattr(frf, what)
        if array is not None:
            for (k, i, j), value in np.ndenumerate(array):
                place = (what, float(frf.freq[k]), str(frf.responses[i]), str(frf.references[j]))
                out[place] = complex(value)
    if frf.geometry is not None:
        out |= _of_geometry(frf.geometry)
    return out


def _of_model(model: Model) -> Iterator[tuple[Any, Any]]:
    labels = model.dofs.labels
    for name, group in model.groups.items():
        for part in group.damping:
            yield (name, "damping", str(part)), True
        for what in ("stiffness", "mass", "viscous"):
            matrix = getattr(group, what)
            if matrix is not None:
                entries = sp.coo_array(matrix)
                for i, j, value in zip(entries.row, entries.col, entries.data, strict=True):
                    yield (name, what, labels[i], labels[j]), float(value)
    if model.geometry is not None:
        yield from _of_geometry(model.geometry)


def _of_geometry(geometry: Geometry) -> Iterator[tuple[Any, Any]]:
    for node, xyz in zip(geometry.nodes.tolist(), geometry.xyz.tolist(), strict=True):
        yield ("node", node), tuple(xyz)
    for line in geometry.lines.tolist():
        yield ("line", *line), True


def _of_modes(modes: ModeSet) -> Iterator[tuple[Any, Any]]:
    for k, frequency in enumerate(modes.frequency.tolist()):
        yield (k, "frequency"), frequency
        yield (k, "loss"), repr(float(modes.loss_factor[k]))
        for label, value in zip(modes.dofs.labels, modes.shapes[:, k].tolist(), strict=True):
            yield (k, label), value


def leaves(value: Any) -> Content:
    """Return all that records, tables, lists and arrays hold, by its place."""
    return dict(_leaves(value, ()))


def _leaves(value: Any, place: tuple[Any, ...]) -> Iterator[tuple[Any, Any]]:
    if isinstance(value, FRF | Model | Geometry | ModeSet):
        for key, inner in content_of(value).items():
            yield (*place, key), repr(inner)
    elif is_dataclass(value):
        for field in fields(value):
            yield from _leaves(getattr(value, field.name), (*place, field.name))
    elif isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _leaves(inner, (*place, key))
    elif isinstance(value, list | tuple):
        for at, inner in enumerate(value):
            yield from _leaves(inner, (*place, at))
    elif isinstance(value, np.ndarray):
        for at, number in np.ndenumerate(value):
            yield (*place, *at), repr(number.item())
    else:
        yield place, repr(value)


# -- samples --------------------------------------------------------------------------------------
def written(write: Callable[[Path], None]) -> dict[str, bytes]:
    """Return the files that a function writes into a folder."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        write(Path(folder))
        return {file.name: file.read_bytes() for file in sorted(Path(folder).iterdir())}


def small_model() -> Model:
    K = np.array([[2.0e3, -0.5, 0.0], [-0.5, 3.25e3, -12.0], [0.0, -12.0, 4.0e3]])
    groups = {
        "a": Group(K, np.diag([1.25, 2.5, 0.75]), loss_factor=0.02),
        "b": Group(np.diag([0.0, 55.0, 0.0]), viscous=np.diag([0.0, 1.75, 0.0])),
    }
    geometry = Geometry([1, 22], [[0.0, 0.5, 0.0], [1.25, 0.0, 0.0]], [[1, 22]])
    return Model.from_groups(groups, ["1:X", "1:Y", "22:Z"], geometry=geometry, title="three")


def small_frf(*, with_geometry: bool = False) -> FRF:
    random = np.random.default_rng(4)
    shape = (4, 2, 1)
    values = random.normal(size=shape) + 1j * random.normal(size=shape)
    geometry = Geometry([1, 22], [[0.0, 0.5, 0.0], [1.25, 0.0, 0.0]], [[1, 22]])
    return FRF(
        [10.0, 12.5, 15.0, 17.5],
        values,
        ["1:X", "22:Z"],
        ["1:X"],
        "accelerance",
        coherence=random.uniform(size=shape),
        geometry=geometry if with_geometry else None,
    )


def of_model_file(name: str, damaged: str, *, is_text: bool = True) -> Sample:
    files = written(lambda folder: updyn.write_model(small_model(), folder / name))
    return Sample(files, damaged, lambda folder: updyn.read_model(folder / name), is_text)


def of_frf_file(name: str, frf: FRF, *, is_text: bool = True) -> Sample:
    files = written(lambda folder: updyn.write_frf(frf, folder / name))
    return Sample(files, name, lambda folder: updyn.read_frf(folder / name), is_text)


@sample("Matrix Market, coordinate")
def _mtx() -> Sample:
    return of_model_file("case.toml", "case_01_K.mtx")


@sample("Matrix Market, array")
def _mtx_array() -> Sample:
    one = of_model_file("case.toml", "case_01_M.mtx")
    text = b"%%MatrixMarket matrix array real symmetric\n% mass\n3 3\n1.25\n0\n0\n2.5\n0\n0.75\n"
    return Sample({**one.files, one.damaged: text}, one.damaged, one.read)


@sample("model, TOML")
def _toml() -> Sample:
    return of_model_file("case.toml", "case.toml")


@sample("table of DOFs")
def _dofs() -> Sample:
    return of_model_file("case.toml", "case_dofs.csv")


@sample("table of nodes")
def _nodes() -> Sample:
    return of_model_file("case.toml", "case_nodes.csv")


@sample("table of lines")
def _lines() -> Sample:
    return of_model_file("case.toml", "case_lines.csv")


@sample("CSV")
def _csv() -> Sample:
    return of_frf_file("a.csv", small_frf())


@sample("universal file, 58b")
def _58b() -> Sample:
    return of_frf_file("a.uff", small_frf(with_geometry=True), is_text=False)


@sample("universal file, 58 in text")
def _58() -> Sample:
    frf = small_frf()
    raw = uff.units(1, 1.0, 1.0)
    raw += uff.nodes2411((1, 0, 0, 0.0, 0.5, 0.0), (22, 0, 0, 1.25, 0.0, 0.0)) + uff.trace82(1, 22)
    for i, response in enumerate(((1, 1), (22, 3))):
        raw += uff.ascii58(frf.values[:, i, 0], response, (1, 1))
    return Sample({"a.unv": raw}, "a.unv", lambda folder: updyn.read_frf(folder / "a.unv"))


@sample("universal file, geometry")
def _uff_geometry() -> Sample:
    axes = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    raw = uff.systems2420((5, 0, axes, [0.0, 0.0, 0.25]))
    raw += uff.nodes15((1, 0, 5, 0.0, 0.5, 0.0), (22, 5, 0, 1.25, 0.0, 0.0)) + uff.trace82(1, 22)
    return Sample({"a.unv": raw}, "a.unv", lambda folder: updyn.read_geometry(folder / "a.unv"))


@sample("universal file, modes")
def _modes() -> Sample:
    shapes = np.array([[1.0, 0.5 + 0.1j], [2.0, 1.0], [3.0, -1.0j]])
    dofs = updyn.DofSet(["1:X", "12:Y", "123:Z"])
    modes = ModeSet([10.0, 20.0], shapes, dofs, [0.01, 0.02], [True, True], [np.nan] * 2, "x")
    files = written(lambda folder: updyn.write_modes(modes, folder / "a.unv"))
    return Sample(files, "a.unv", lambda folder: updyn.read_modes(folder / "a.unv"))


_ABAQUS = (
    b"** stiffness\n1,1, 1,1, 2.00000e+03\n1,2, 1,1, -5.0e-01\n1,2, 1,2, 3.25e+03\n"
    b"22,3, 1,2, -1.2e+01\n22,3, 22,3, 4.0D+03\n"
)
_ABAQUS_MASS = b"1,1, 1,1, 1.25\n1,2, 1,2, 2.5\n22,3, 22,3, 0.75\n"


@sample("Abaqus, matrices")
def _abaqus() -> Sample:
    files = {"w_STIF1.mtx": _ABAQUS, "w_MASS1.mtx": _ABAQUS_MASS}
    return Sample(files, "w_STIF1.mtx", lambda folder: updyn.read_model(folder / "w_STIF1.mtx"))


@sample("Abaqus, deck of matrices")
def _abaqus_deck() -> Sample:
    deck = b"*HEADING\nthree\n*NODE\n1, 0., 0.5, 0.\n22, 1.25, 0., 0.\n"
    deck += b"*MATRIX INPUT, NAME=K\n" + _ABAQUS.split(b"\n", 1)[1]
    deck += b"*MATRIX INPUT, NAME=M, SCALE FACTOR=2.\n" + _ABAQUS_MASS
    deck += b"*MATRIX ASSEMBLE, STIFFNESS=K, MASS=M\n"
    return Sample({"w.inp": deck}, "w.inp", lambda folder: updyn.read_model(folder / "w.inp"))


@sample("CalculiX, deck")
def _calculix() -> Sample:
    import deck_samples
    from updyn.io.calculix.model import read_parts
    from updyn.io.keyword_deck.cards import read_cards

    def read(folder: Path) -> Content:
        path = folder / "bar.inp"
        cards = read_cards(path)
        read_parts(path, cards)
        seen: Counter[str] = Counter()
        out: Content = {}
        for card in cards:
            seen[card.name] += 1
            for row, text in enumerate(card.text()):
                out[card.name, seen[card.name], row] = text
        return out

    return Sample({"bar.inp": deck_samples.bar(1).encode() + b"\n"}, "bar.inp", read)


@sample("Nastran, deck")
def _nastran() -> Sample:
    import nastran_decks

    text = nastran_decks.plate().encode()
    return Sample({"p.bdf": text}, "p.bdf", lambda folder: updyn.read_geometry(folder / "p.bdf"))


_OP4 = b'dofs = ["1:X", "1:Y", "22:Z"]\n[[group]]\nname = "a"\nstiffness = "m.op4:K"\n'


def _op4_sample(*, is_text: bool) -> Sample:
    from updyn.io.nastran.op4 import write_op4

    def write(folder: Path) -> None:
        write_op4({"K": small_model().groups["a"].stiffness}, folder / "m.op4", text=is_text)

    files = {**written(write), "m.toml": _OP4}
    return Sample(files, "m.op4", lambda folder: updyn.read_model(folder / "m.toml"), is_text)


@sample("OUTPUT4 in text")
def _op4_text() -> Sample:
    return _op4_sample(is_text=True)


@sample("OUTPUT4, binary")
def _op4_binary() -> Sample:
    return _op4_sample(is_text=False)


@sample("DMIG")
def _dmig() -> Sample:
    one = written(lambda folder: updyn.write_model(small_model(), folder / "m.pch"))
    return Sample(one, "m.pch", lambda folder: updyn.read_model(folder / "m.pch"))


@sample("job, TOML")
def _job() -> Sample:
    from updyn.job import load_job

    text = (
        b'title = "three"\n[model]\nfile = "m.h5"\n[test]\nfile = "t.uff"\nband = [5.0, 400.0]\n'
        b'[[parameter]]\ngroups = ["a*"]\nquantity = "stiffness"\nbounds = [0.3, 3.0]\n'
        b"prior_std = 0.25\n"
        b'[method]\nname = "maximum-likelihood"\nlines = "d-optimal:60"\n[output]\nreport = true\n'
    )

    def read(folder: Path) -> Content:
        return leaves(load_job(folder / "job.toml").model_dump(exclude_unset=True))

    return Sample({"job.toml": text}, "job.toml", read)


@sample("Ansys, archive")
def _archive() -> Sample:
    from updyn.io.ansys.archive import check_archive

    return Sample({"a.cdb": _CDB}, "a.cdb", lambda folder: check_archive(folder / "a.cdb"))


_CDB = (
    b"/COM,ANSYS RELEASE 2019 R2\n/PREP7\nET,        1,186\n"
    b"NBLOCK,6,SOLID,         2,         2\n(3i9,6e21.13e3)\n"
    b"        1        0        0 1.0000000000000E+000 2.0000000000000E+000\n"
    b"        2        0        0 1.5000000000000E+000\nN,R5.3,LOC,       -1,\n"
    b"EBLOCK,19,SOLID,         1,         1\n(19i10)\n"
    + b"".join(b"%10d" % n for n in (1, 1, 1, 1, 0, 0, 0, 0, 2, 0, 1, 1, 2))
    + b"\n        -1\nCMBLOCK,ONE     ,ELEM,       1  ! elements\n(8i10)\n         1\n"
    b"RLBLOCK,       1,       4,       8,       7\n(2i8,6g16.9)\n(7g16.9)\n       4       2"
    b"      1.00000000      2.00000000\nMP,EX  ,1, 2.1e11\n/GO\nFINISH\n"
)


@sample("Ansys, attributes", is_boxed=True)
def _attributes() -> Sample:
    from updyn.io.ansys.attributes import read_attributes

    def read(folder: Path) -> Content:
        found = read_attributes(folder / "a.cdb")
        out: Content = {("element", n): True for n in found.elements.tolist()}
        for what, numbers in found.numbers.items():
            out |= {(what, n): m for n, m in zip(found.elements.tolist(), numbers, strict=True)}
        for node, xyz in zip(found.nodes.tolist(), found.xyz.tolist(), strict=True):
            out["node", node] = tuple(xyz)
        return out

    return Sample({"a.cdb": _CDB}, "a.cdb", read)


@sample("Ansys, properties of a deck")
def _properties() -> Sample:
    from updyn.io.ansys.properties import read_deck

    def read(folder: Path) -> Content:
        deck = read_deck(folder / "a.cdb")
        out: Content = {}
        for number, labels in deck.materials.items():
            for label, found in labels.items():
                out |= {(number, label, at): text for at, text in enumerate(found.values)}
        for number, real in deck.reals.items():
            out |= {("real", number, at): text for at, text in enumerate(real.values)}
        return out

    return Sample({"a.cdb": _CDB}, "a.cdb", read)


@sample("Ansys, .emat")
def _emat() -> Sample:
    import ansys_samples

    spring = 1e3 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    K = np.kron(spring, np.eye(3))
    elements = [
        (1, [1, 2], {"stiffness": K, "mass": np.eye(6)}),
        (2, [2, 3], {"stiffness": 2.0 * K, "mass": np.eye(6)}),
    ]
    files = written(lambda folder: ansys_samples.write_emat(folder / "a.emat", elements))

    def read(folder: Path) -> Model:
        return updyn.read_model(folder / "a.emat", groups={"a": [1], "b": [2]}, supports=[])

    return Sample(files, "a.emat", read, is_text=False)


@sample("npz, FRF")
def _npz() -> Sample:
    return of_frf_file("a.npz", small_frf(with_geometry=True), is_text=False)


@sample("npz, model")
def _npz_model() -> Sample:
    return of_model_file("a.npz", "a.npz", is_text=False)


@sample("MATLAB 5, FRF", is_boxed=True)
def _mat() -> Sample:
    return of_frf_file("a.mat", small_frf(), is_text=False)


def foreign(one: Sample) -> Sample:
    """Return the sample without its digest, as if another program had written it."""
    content = one.files[one.damaged]
    raw = content[: content.rindex(MARK)]
    return Sample({**one.files, one.damaged: raw}, one.damaged, one.read, one.is_text)


@sample("HDF5, model", is_boxed=True)
def _hdf5() -> Sample:
    return foreign(of_model_file("a.h5", "a.h5", is_text=False))


@sample("netCDF, FRF", is_boxed=True)
def _netcdf() -> Sample:
    return foreign(of_frf_file("a.nc", small_frf(with_geometry=True), is_text=False))
