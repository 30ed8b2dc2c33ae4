"""Writes the malformed model files, and FRFs in .npz and .mat, that `tests/io/test_bad_models.py` reads.

Run it from anywhere: ``python tests/data/bad/make_bad_model.py``. Beside the files it writes
``expected.json``: the file to read and the words that the message must hold."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import scipy.io
import scipy.sparse as sp

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parents[1] / "io"))

from matlab73 import write_matlab73  # noqa: E402  (a helper of the tests, not a package)
from updyn.io.hdf5 import write_model  # noqa: E402
from updyn.model import Group, Model  # noqa: E402

K = np.array([[2.0, -1.0], [-1.0, 1.0]])
M = np.diag([0.5, 0.25])
SKEWED = np.array([[2.0, -1.0], [-0.5, 1.0]])
DOFS = np.array(["1:X", "2:X"])
GOOD = {"K": K, "M": M, "dofs": DOFS}
CELLS = np.array(["1:X", "2:X"], dtype=object)[:, None]
MTX = "%%MatrixMarket matrix coordinate real symmetric\n2 2 3\n1 1 2.0\n2 1 -1.0\n2 2 1.0\n"
TOML = 'dofs = ["1:X", "2:X"]\n\n[[group]]\nname = "shaft"\nstiffness = "{}"\n'


def npz(**changes: object) -> Callable[[Path], None]:
    arrays = {name: value for name, value in {**GOOD, **changes}.items() if value is not None}
    return lambda path: np.savez(path, **arrays)


def mat(**changes: object) -> Callable[[Path], None]:
    items = {
        name: value
        for name, value in {**GOOD, "dofs": CELLS, **changes}.items()
        if value is not None
    }
    return lambda path: scipy.io.savemat(path, items, oned_as="column")


def mat73(**changes: object) -> Callable[[Path], None]:
    items = {
        name: value
        for name, value in {**GOOD, "dofs": ["1:X", "2:X"], **changes}.items()
        if value is not None
    }
    return lambda path: write_matlab73(path, items)


def h5(change: Callable[[h5py.File], object]) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        write_model(Model.from_groups({"shaft": Group(K, M, loss_factor=0.01)}, list(DOFS)), path)
        with h5py.File(path, "r+") as file:
            change(file)

    return write


def cut(write: Callable[[Path], None], part: float) -> Callable[[Path], None]:
    def short(path: Path) -> None:
        write(path)
        raw = path.read_bytes()
        path.write_bytes(raw[: int(len(raw) * part)])

    return short


def text(content: str | bytes) -> Callable[[Path], None]:
    return lambda path: path.write_bytes(content.encode() if isinstance(content, str) else content)


def toml(old: str = "", new: str = "", matrix: str | None = MTX) -> Callable[[Path], None]:
    """A TOML file and, unless None, its matrix, which is called as the file is."""

    def write(path: Path) -> None:
        name = path.with_suffix(".mtx").name
        path.write_text(TOML.format(name).replace(old, new) if old else TOML.format(name))
        if matrix is not None:
            path.with_suffix(".mtx").write_text(matrix)

    return write


MODELS: dict[str, tuple[Callable[[Path], None], str]] = {
    # -- npz
    "asymmetric.npz": (
        npz(K=SKEWED),
        "stiffness is not symmetric: entry (1, 2) is -1, (2, 1) is -0.5",
    ),
    "nan_in_mass.npz": (
        npz(M=np.diag([0.5, np.nan])),
        "mass: row 2 holds a number that is not finite",
    ),
    "sizes_differ.npz": (npz(M=np.eye(3)), "the matrices of a group differ in size"),
    "too_few_labels.npz": (npz(dofs=DOFS[:1]), "has 2 DOFs, the model has 1 labels"),
    "dof_twice.npz": (
        npz(dofs=np.array(["1:X", "1:X"])),
        "DOF 1:X occurs twice: at positions 1 and 2",
    ),
    "unknown_direction.npz": (
        npz(dofs=np.array(["1:X", "2:W"])),
        "DOF '2:W': expected node:direction",
    ),
    "no_dofs.npz": (npz(dofs=None), "no 'dofs': the 2 DOFs need labels"),
    "no_matrix.npz": (npz(K=None, M=None), "no matrix: expected K, M or C"),
    "misspelt.npz": (
        npz(M=None, loss_facter=0.1),
        "unknown name 'loss_facter'; did you mean 'loss_factor' or 'loss_table'?",
    ),
    "objects.npz": (npz(dofs=CELLS), "dofs: holds Python objects (pickled), which are never read"),
    "complex_stiffness.npz": (
        npz(K=K * (1 + 0.01j)),
        "found complex numbers; damping goes into loss_factor",
    ),
    "not_square.npz": (npz(K=K[:1]), "expected a square matrix, found shape (1, 2)"),
    "empty_dof.npz": (
        npz(K=np.diag([1.0, 0.0]), M=None),
        "DOF 2:X has neither stiffness, mass nor damping",
    ),
    "text.npz": (text("K = 3\n"), "neither content nor suffix '.npz'"),
    "cut_short.npz": (cut(npz(), 0.6), "not a readable .npz archive"),
    "zero_bytes.npz": (text(b""), "the file is empty"),
    "bad_index.npz": (
        npz(
            **{"K": None, "M": None, "a.K.data": np.ones(2)},
            **{"a.K.indices": np.array([0, 5]), "a.K.indptr": np.array([0, 1, 2])},
        ),
        "a.K: not a sparse matrix of shape (2, 2)",
    ),
    "one_matrix.npz": (
        lambda p: sp.save_npz(p, sp.csr_array(K)),
        "holds one sparse matrix written by scipy.sparse.save_npz",
    ),
    # -- mat
    "no_dofs.mat": (mat(dofs=None), "no 'dofs': the 2 DOFs need labels"),
    "dof_twice.mat": (mat(dofs=np.array([[1.0, 1.0], [1.0, 1.0]])), "DOF 1:X occurs twice"),
    "direction_7.mat": (
        mat(dofs=np.array([[1.0, 1.0], [2.0, 7.0]])),
        "row 2 has direction 7; expected 1..6",
    ),
    "asymmetric.mat": (mat(K=SKEWED), "stiffness is not symmetric"),
    "cell_of_numbers.mat": (
        mat(dofs=np.array([1.0, 2.0], dtype=object)),
        "dofs: cell 1 is not a text",
    ),
    "cut_short.mat": (cut(mat(), 0.7), "truncated or damaged in variable"),
    "version_73_cut_short.mat": (cut(mat73(), 0.5), "MATLAB file"),
    "version_73_header_only.mat": (
        cut(mat73(), 0.05),
        "MATLAB 7.3 file without a readable HDF5 part",
    ),
    "version_73_complex.mat": (
        mat73(K=K * (1 + 0.01j)),
        "found complex numbers; damping goes into loss_factor",
    ),
    "version_73_no_matrix.mat": (mat73(K=None, M=None), "no matrix: expected K, M or C"),
    # -- HDF5
    "no_groups.h5": (h5(lambda f: f.__delitem__("groups")), "no group 'groups'; found: dofs"),
    "empty_groups.h5": (
        h5(lambda f: f.__delitem__("groups/0000")),
        "holds no group; a model needs at least one",
    ),
    "kind_result.h5": (
        h5(lambda f: f.attrs.__setitem__("updyn_kind", "result")),
        "read it with updyn.read_result",
    ),
    "kind_frf.h5": (
        h5(lambda f: f.attrs.__setitem__("updyn_kind", "frf")),
        "read it with updyn.read_frf",
    ),
    "foreign.h5": (
        h5(lambda f: f.attrs.__delitem__("updyn_kind")),
        "without the attribute 'updyn_kind'",
    ),
    "later_format.h5": (h5(lambda f: f.attrs.__setitem__("updyn_format", 99)), "format version 99"),
    "unknown_direction.h5": (
        h5(lambda f: f["dofs/direction"].__setitem__(0, b"W")),
        "direction 1 is 'W'",
    ),
    "lower_triangle.h5": (
        h5(lambda f: f["groups/0000/stiffness/indices"].__setitem__(2, 0)),
        "entry (2, 1) is below the diagonal",
    ),
    "nan.h5": (
        h5(lambda f: f["groups/0000/mass/data"].__setitem__(0, np.nan)),
        "group 'shaft': mass: row 1",
    ),
    "cut_short.h5": (cut(h5(lambda f: None), 0.5), "not a readable HDF5 file"),
    # -- Matrix Market
    "complex.toml": (
        toml(matrix=MTX.replace("real", "complex").replace(".0\n", ".0 0\n")),
        "field 'complex'",
    ),
    "pattern.toml": (
        toml(matrix=MTX.replace("real", "pattern").replace(" 2.0", "")),
        "field 'pattern'",
    ),
    "too_few_entries.toml": (
        toml(matrix=MTX.replace("2 2 3", "2 2 4")),
        "3 entries; the header states 4: the file is truncated",
    ),
    "too_many_entries.toml": (
        toml(matrix=MTX.replace("2 2 3", "2 2 2")),
        "the header states 2: there are too many",
    ),
    "not_square.toml": (
        toml(matrix=MTX.replace("2 2 3", "3 2 3")),
        "the matrix is 3 x 2; expected a square matrix",
    ),
    "both_triangles.toml": (
        toml(matrix=MTX.replace("2 2 3", "2 2 4") + "1 2 -1.0\n"),
        "entry (1, 2) occurs twice; with the header 'symmetric' only one triangle is stored",
    ),
    "unknown_key.toml": (
        toml("stiffness", "stifness"),
        "unknown_key.toml:5: unknown key 'stifness' in [group]",
    ),
    "missing_file.toml": (
        toml(matrix=None),
        "missing_file.toml:5: stiffness: no such file 'missing_file.mtx'",
    ),
    "group_twice.toml": (
        lambda p: (toml()(p), p.write_text(p.read_text() + "\n" + p.read_text().split("\n\n")[1])),
        "group_twice.toml:8: group name 'shaft' occurs twice",
    ),
    "no_dofs.toml": (toml('dofs = ["1:X", "2:X"]', 'title = "x"'), "no 'dofs'"),
    "not_toml.toml": (text("[[group]\nname = 3\n"), "not_toml.toml:1: not a TOML file"),
    "alone.mtx": (
        text(MTX),
        "one matrix is not a model: write a small TOML file in the same folder",
    ),
    "not_a_matrix.mtx": (text("1 2 3\n"), "not a Matrix Market file"),
}

FREQ = np.array([1.0, 2.0, 3.0])
FRF = {
    "freq": FREQ,
    "H": np.ones((3, 2, 1)) * (1 + 2j),
    "responses": DOFS,
    "references": DOFS[:1],
    "quantity": "accelerance",
}


def frf_npz(**changes: object) -> Callable[[Path], None]:
    arrays = {name: value for name, value in {**FRF, **changes}.items() if value is not None}
    return lambda path: np.savez(path, **arrays)


def frf_mat(save: Callable[..., None], **changes: object) -> Callable[[Path], None]:
    tables = {"responses": np.array([[1.0, 1.0], [2.0, 1.0]]), "references": np.array([[1.0, 1.0]])}
    items = {
        name: value for name, value in {**FRF, **tables, **changes}.items() if value is not None
    }
    return lambda path: save(path, items)


FRFS: dict[str, tuple[Callable[[Path], None], str]] = {
    "no_labels.npz": (
        frf_npz(responses=None, references=None, quantity=None),
        (
            "no 'responses' and no 'references' and no 'quantity': found H, freq (H of shape (3,"
            " 2, 1))"
        ),
    ),
    "axes_reversed.npz": (
        frf_npz(H=np.ones((1, 2, 3)) * 1j),
        "found shape (1, 2, 3), expected (lines, responses, references) = (3, 2, 1)",
    ),
    "magnitude.npz": (frf_npz(H=np.ones((3, 2, 1))), "may be magnitudes or decibels"),
    "no_quantity.npz": (frf_npz(quantity=None), "no 'quantity'"),
    "impedance.npz": (frf_npz(quantity="impedance"), "force over a motion"),
    "lines_fall.npz": (frf_npz(freq=FREQ[::-1]), "lines must increase"),
    "not_finite.npz": (frf_npz(H=np.full((3, 2, 1), np.inf + 0j)), "is not finite"),
    "misspelt.npz": (
        frf_npz(coherance=np.ones((3, 2, 1))),
        "unknown name 'coherance'; did you mean 'coherence'?",
    ),
    "coherence_above_1.npz": (
        frf_npz(coherence=np.full((3, 2, 1), 1.01)),
        "coherence at 1 Hz, response 1:X",
    ),
    "objects.npz": (frf_npz(responses=CELLS), "responses: holds Python objects (pickled)"),
    "a_model.npz": (npz(), "read it with updyn.read_model"),
    "no_frequency.mat": (frf_mat(scipy.io.savemat, freq=None), "no 'freq'"),
    "wrong_shape.mat": (frf_mat(scipy.io.savemat, H=np.ones((2, 2)) * 1j), "H: found shape (2, 2)"),
    "version_73_no_H.mat": (frf_mat(write_matlab73, H=None), "no 'H' (or 'values')"),
    "version_73_row.mat": (
        frf_mat(write_matlab73, H=np.ones((2, 3)) * 1j),
        "H: found shape (2, 3)",
    ),
}


def main() -> None:
    for folder, cases in (("model", MODELS), ("frf_npz_mat", FRFS)):
        place = HERE / folder
        place.mkdir(exist_ok=True)
        for name, (write, _) in cases.items():
            write(place / name)
        expected = {name: words for name, (_, words) in cases.items()}
        (place / "expected.json").write_text(json.dumps(expected, indent=1) + "\n")


if __name__ == "__main__":
    main()
