"""OUTPUT2 files: files of NX and MSC Nastran that come with pyyeti, files of MYSTRAN, files by hand, bad ones."""

from __future__ import annotations

import re
import subprocess
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyyeti
from pyyeti.nastran import op2 as pyyeti_op2

import op2_samples as samples
import updyn
from nastran_decks import mystran
from op2_samples import Writer
from updyn.cli import main
from updyn.errors import AbsentError, FormatError, OptionError, UpdynWarning
from updyn.io.formats import FORMATS
from updyn.io.nastran.op2_file import MAGIC, OP2File, read_matrix

NASTRAN = Path(pyyeti.__file__).parent / "tests"
FULL = NASTRAN / "nas2cam_extseout" / "full"
KINDS = pytest.mark.parametrize(("order", "size"), [("<", 4), (">", 4), ("<", 8), (">", 8)])
_ROW = r"^\s+(\d+)\s+\d+((?:\s+[-+.\dE]+){5})\s*$"


@pytest.fixture
def put(tmp_path):
    def make(raw: bytes, name: str = "a.op2") -> Path:
        (tmp_path / name).write_bytes(raw)
        return tmp_path / name

    return make


def pairs(geometry: updyn.Geometry) -> set[tuple[int, int]]:
    return {(min(a, b), max(a, b)) for a, b in geometry.lines.tolist()}


# -- files of Nastran ---------------------------------------------------------------------------
def test_the_layout_of_every_file_is_that_which_pyyeti_reads():
    found = sorted(NASTRAN.rglob("*.op2"))
    assert len(found) > 30
    for path in found:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of pyyeti; of files without a mark of their end
            own = OP2File(path).blocks
            other = pyyeti_op2.OP2(path)
        assert [b.name for b in own] == other.names
        assert [b.trailer for b in own] == other.trailers
        assert [int(b.is_matrix) for b in own] == other.dbtypes.tolist()


@pytest.mark.parametrize("name", ["double_le", "double_be", "single_le", "single_be"])
def test_a_matrix_in_either_byte_order(name):
    path = NASTRAN / "nastran_op2_data" / f"{name}.op2"
    with pytest.warns(UpdynWarning, match="no end mark"):
        file = OP2File(path)
    first, second = file.matrices[:2]
    expected = pyyeti_op2.rdmats(path)
    np.testing.assert_array_equal(read_matrix(file, first).matrix.toarray(), expected[first.name])
    with pytest.raises(FormatError, match="is complex"):
        read_matrix(file, second)


def test_geometry_is_that_of_the_deck():
    """In single precision, as the file has it; these numbers fit."""
    found, expected = (updyn.read_geometry(FULL.with_suffix(s)) for s in (".op2", ".dat"))
    np.testing.assert_array_equal(found.nodes, expected.nodes)
    np.testing.assert_array_equal(found.xyz, expected.xyz)
    assert pairs(found) == pairs(expected)
    assert len(found.lines) == 117


def test_frequencies_are_those_that_nastran_prints():
    """Of 278 modes, the first six of rigid motion, with those of negative eigenvalue at 0 Hz."""
    modes = updyn.read_modes(FULL.with_suffix(".op2"))
    text = FULL.with_suffix(".out").read_text(encoding="latin-1")
    table = text.split("R E A L   E I G E N V A L U E S", 1)[1]
    printed = {}
    for row in re.finditer(_ROW, table, re.MULTILINE):
        eigenvalue, _, cycles, mass, _ = map(float, row[2].split())
        printed.setdefault(int(row[1]), (cycles if eigenvalue > 0 else 0.0, mass))
    cycles, masses = np.array([printed[n] for n in sorted(printed)][: len(modes)]).T
    assert (masses == 1.0).all()
    np.testing.assert_allclose(modes.frequency, np.sort(cycles), rtol=1e-6)
    assert modes.scaled.all()
    assert np.isnan(modes.loss_factor).all()


def test_shapes_are_those_that_pyyeti_reads_and_make_its_modal_stiffness():
    path = FULL.with_suffix(".op2")
    modes = updyn.read_modes(path)
    with pyyeti_op2.OP2(path) as other:
        other.set_position("OUGV1")
        other.rdop2nt()
        expected = other._rdop2ougv1("OUGV1")
    order = np.argsort(np.maximum(expected["lambda"], 0.0), kind="stable")
    rows = {tuple(dof): row for dof, row in zip(expected["dof"], expected["ougv1"], strict=True)}
    for label, row in zip(modes.dofs, modes.shapes, strict=True):
        at = (label.node, ["X", "Y", "Z", "RX", "RY", "RZ"].index(label.direction) + 1)
        np.testing.assert_allclose(row, rows[at][order], rtol=1e-6)
    stiffness = read_matrix(OP2File(path), OP2File(path).matrices[0]).matrix.diagonal()
    np.testing.assert_allclose(modes.frequency[6:], np.sqrt(stiffness[6:]) / (2 * np.pi), rtol=1e-6)


def test_the_same_model_in_words_of_four_and_of_eight_bytes():
    both = []
    for bits in (32, 64):
        path = NASTRAN / "nastran_op2_data" / f"tugd_2020_{bits}bit.op2"
        with pytest.warns(UpdynWarning, match="no end mark"):
            both.append(updyn.read_geometry(path))
    np.testing.assert_array_equal(both[0].nodes, both[1].nodes)
    np.testing.assert_allclose(both[0].xyz, both[1].xyz, rtol=1e-6)
    assert pairs(both[0]) == pairs(both[1])


def test_modes_beside_other_results():
    path = NASTRAN / "nas2cam_extseout" / "assemble.op2"
    with pytest.warns(UpdynWarning, match="other than modes are ignored: 3 frequency response"):
        modes = updyn.read_modes(path)
    # Six rigid modes, then those of the same structure without superelements.
    np.testing.assert_allclose(
        modes.frequency[6:10], updyn.read_modes(FULL.with_suffix(".op2")).frequency[6:10], rtol=1e-5
    )


# -- files of MYSTRAN ---------------------------------------------------------------------------
N = 40
LENGTH, WIDTH, HEIGHT, E, RHO = 1.0, 0.02, 0.01, 2.1e11, 7850.0


def cantilever() -> str:
    lines = ["SOL 103", "CEND", "DISP(PRINT,PLOT) = ALL", "SPC = 1", "METHOD = 7", "BEGIN BULK"]
    lines += ["PARAM,POST,-1", "EIGRL,7,,,4", "PARAM,COUPMASS,1", f"MAT1,1,{E:.4E},,0.3,{RHO}"]
    lines += [f"GRID,{i + 1},,{LENGTH * i / N:.4f},0.,0.,,1345" for i in range(N + 1)]
    lines += [f"CBAR,{i},1,{i},{i + 1},0.,0.,1." for i in range(1, N + 1)]
    area, inertia = WIDTH * HEIGHT, HEIGHT * WIDTH**3 / 12
    lines += [f"PBAR,1,1,{area:.4E},{inertia:.5E},{inertia:.5E},1.-8", "SPC1,1,123456,1", "ENDDATA"]
    return "\n".join([*lines, ""])


@pytest.mark.needs("mystran")
def test_a_cantilever_of_mystran(tmp_path):
    """Against its own print, and the theory of Euler and Bernoulli (Blevins 1979, table 8-1: beta L)."""
    (tmp_path / "beam.bdf").write_text(cantilever())
    subprocess.run([str(mystran()), "beam.bdf"], cwd=tmp_path, capture_output=True, check=True)
    modes = updyn.read_modes(tmp_path / "beam.OP2")
    text = (tmp_path / "beam.F06").read_text("latin-1")
    printed = [float(m[2].split()[2]) for m in re.finditer(_ROW, text, re.MULTILINE)]
    np.testing.assert_allclose(modes.frequency, printed[: len(modes)], rtol=2e-6)
    assert modes.dofs.labels[:3] == ["2:Y", "2:RZ", "3:Y"]
    assert modes.dofs.nodes.max() == N + 1
    beta = np.array([1.8751041, 4.6940911, 7.8547574]) / LENGTH
    radius = WIDTH / np.sqrt(12)
    exact = beta**2 * radius * np.sqrt(E / RHO) / (2 * np.pi)
    np.testing.assert_allclose(modes.frequency[:3], exact, rtol=2e-3)
    # cosh - cos - sigma (sinh - sin) of each mode.
    moved = modes.dofs.labels
    at = [moved.index(f"{i + 1}:Y") for i in range(1, N + 1)]
    z = beta * (LENGTH * np.arange(1, N + 1) / N)[:, None]
    sigma = (np.cosh(beta) + np.cos(beta)) / (np.sinh(beta) + np.sin(beta))
    theory = np.cosh(z) - np.cos(z) - sigma * (np.sinh(z) - np.sin(z))
    for k in range(3):
        shape = modes.shapes[at, k].real
        np.testing.assert_allclose(shape / shape[-1], theory[:, k] / theory[-1, k], atol=5e-3)
    # The file says no modal masses, although the shapes of MYSTRAN have unit mass by default.
    assert not modes.scaled.any()


# -- files by hand ------------------------------------------------------------------------------
def test_starts_are_those_that_the_registry_knows():
    assert set(FORMATS["op2"].magic) == set(MAGIC)


@KINDS
def test_geometry_in_millimetres(put, order, size):
    found = updyn.read_geometry(put(samples.whole(order, size)), unit="mm")
    assert found.nodes.tolist() == [1, 2, 3, 4, 7]
    np.testing.assert_allclose(found.position([3, 7]), [[0.1, 0.08, 0], [0, 0.05, 0.03]], atol=1e-9)
    assert pairs(found) == {(1, 2), (2, 3), (3, 4), (1, 4), (4, 7)}
    # Along and around the circle of system 5, at 90 degrees.
    np.testing.assert_allclose(found.axes[4], [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-7)
    np.testing.assert_array_equal(found.axes[0], np.eye(3))


@KINDS
def test_modes_in_si(put, order, size):
    """Shapes in 1/sqrt(t) and 1/(sqrt(t) mm): 1000 kg to a tonne, and modal masses of 1 t and 4 t."""
    modes = updyn.read_modes(put(samples.whole(order, size)), unit="mm")
    np.testing.assert_allclose(modes.frequency, np.array([200.0, 300.0]) / (2 * np.pi), rtol=1e-7)
    assert modes.dofs.labels == ["2:X", "2:Y", "2:Z", "2:RX", "2:RZ", "20:X"]
    given = np.array([[1.0, 2.0, 3.0, 0.5, -0.5, 0.25], [0.0, -1.0, 4.0, 0.0, 2.0, -1.0]]).T
    given[3:5] *= 1e3
    expected = given / np.sqrt(1e3 * np.array([1.0, 4.0]))
    np.testing.assert_allclose(modes.shapes, expected, rtol=1e-12)
    assert modes.scaled.all()
    assert modes.source == "a.op2, subcase 1"


def test_the_writer_of_these_tests_is_read_by_pyyeti(put):
    found = pyyeti_op2.rdmats(put(samples.whole()))
    np.testing.assert_array_equal(found["KGG"], samples.stiffness())


def test_without_modal_masses_the_scale_is_not_known(put):
    modes = updyn.read_modes(put(samples.whole(masses=False)))
    assert not modes.scaled.any()
    np.testing.assert_array_equal(modes.shapes[0], [1.0, 0.0])


def test_complex_modes_are_the_upper_ones_of_pairs(put):
    out = Writer()
    out.head()
    shape = {4: [1.0, 2.0j, 0, 0, 0, 1 - 1j]}
    conjugate = {4: [1.0, -2.0j, 0, 0, 0, 1 + 1j]}
    out.shapes([(1, -3.0 + 400.0j, shape), (2, -3.0 - 400.0j, conjugate)], approach=9)
    modes = updyn.read_modes(put(out.bytes()))
    size = abs(-3.0 + 400.0j)
    np.testing.assert_allclose(modes.frequency, [size / (2 * np.pi)], rtol=1e-7)
    np.testing.assert_allclose(modes.loss_factor, [6.0 / size], rtol=1e-6)
    np.testing.assert_allclose(modes.shapes[:, 0], [1.0, 2.0j, 1 - 1j], rtol=1e-7)


def test_subcases(put):
    out = Writer()
    out.head()
    out.shapes(samples.MODES[:1], scalar=(20,))
    out.shapes(samples.MODES[1:], scalar=(20,), subcase=7)
    path = put(out.bytes())
    with pytest.raises(FormatError, match=r"subcases 1, 7; select one with the option subcase"):
        updyn.read_modes(path)
    assert updyn.read_modes(path, subcase=7).frequency == pytest.approx(300 / (2 * np.pi), rel=1e-7)
    with pytest.raises(FormatError, match=r"no modes of subcase 2; .*'1', '7'"):
        updyn.read_modes(path, subcase=2)


def test_a_model_of_its_matrices(put, tmp_path):
    path = put(samples.whole())
    with pytest.raises(
        AbsentError, match=r"matrices alone \(KGG, MGG\) are not a model: .*a\.op2:KGG"
    ):
        updyn.read_model(path)
    (tmp_path / "a.toml").write_text(
        '[[group]]\nname = "all"\nstiffness = "a.op2:KGG"\nmass = "a.op2:MGG"\nloss_factor = 0.01\n'
    )
    with pytest.warns(UpdynWarning, match="2 of 7 DOFs have no entry .* the first is 3:RX"):
        model = updyn.read_model(path)
    assert model.dofs.labels == ["3:X", "3:Y", "3:Z", "3:RZ", "20:X"]
    kept = [0, 1, 2, 5, 6]
    np.testing.assert_array_equal(
        model.groups["all"].stiffness.toarray(), samples.stiffness()[np.ix_(kept, kept)]
    )
    np.testing.assert_array_equal(model.groups["all"].mass.diagonal(), [2.0, 2.0, 2.0, 3.0, 1.0])
    with pytest.raises(FormatError, match="cannot write_model; did you mean 'op4'"):
        updyn.write_model(model, tmp_path / "b.op2", format="op2")


def of_elements() -> bytes:
    """Assembled matrices, and those of elements with their dictionaries, whose content is not read."""
    out = Writer()
    out.head()
    out.matrix("KGG", samples.stiffness())
    for letter in "KM":
        out.table(f"{letter}DICT", [[1, 2, 3]])
        out.matrix(f"{letter}ELM", samples.stiffness())
    return out.bytes()


def test_matrices_of_elements_are_refused_by_name(put, tmp_path, capsys):
    path = put(of_elements())
    with pytest.raises(AbsentError, match=r"matrices alone \(KGG\) are not a model"):
        updyn.read_model(path)
    for name in ("KELM", "kdict"):
        (tmp_path / "a.toml").write_text(f'[[group]]\nname = "all"\nstiffness = "a.op2:{name}"\n')
        with pytest.raises(
            FormatError, match=rf"{name}: .*elements are not supported.*deck.*OUTPUT4"
        ):
            updyn.read_model(path)
    assert main(["info", str(path)]) == 0
    said = capsys.readouterr().out
    assert "Matrix KGG: 7 x 7" in said
    assert "Matrix KELM" not in said
    assert "Matrices of elements, which are not read: KDICT, KELM, MDICT, MELM" in said


def test_a_file_of_nothing_but_matrices_of_elements(put):
    out = Writer()
    out.head()
    out.table("KDICT", [[1, 2, 3]])
    out.matrix("KELM", samples.stiffness())
    with pytest.raises(FormatError, match=r"a\.op2: KDICT, KELM: matrices of single elements"):
        updyn.read_model(put(out.bytes()))


def test_info(put, capsys):
    path = put(samples.whole())
    assert main(["info", str(path), "--unit", "mm"]) == 0
    said = capsys.readouterr().out
    for part in (
        "OUTPUT2 file of NX2021.1: tables GEOM1S, GEOM2S, EQEXINS, LAMA, OUGV1",
        "Matrix KGG: 7 x 7",
        "Geometry: 5 nodes, 5 lines to draw, in m: X 0 to 0.1",
        "Modes: 2 from 31.831 to 47.7465 Hz",
        "unit mass",
    ):
        assert part in said


def test_info_of_what_is_not_there(put, capsys):
    out = Writer()
    out.head("XXXXXXXX")
    out.table("CASECC", [[1, 2, 3]])
    assert main(["info", str(put(out.bytes()))]) == 0
    said = capsys.readouterr().out
    assert "OUTPUT2 file: tables CASECC" in said
    assert "No geometry: holds no geometry (table GEOM1" in said
    assert "No modes: holds no modes (eigenvectors in the table OUGV1" in said


# -- bad files ----------------------------------------------------------------------------------
def test_every_cut_is_refused_or_said(put):
    """Between two data blocks only the mark of the end is missing: 8 places in this file."""
    raw, ends = samples.whole(), []
    for size in (*range(0, len(raw), 4), *range(len(raw) - 30, len(raw))):
        path = put(raw[:size])
        with warnings.catch_warnings(record=True) as given:
            warnings.simplefilter("always")
            try:
                OP2File(path)
            except FormatError as error:
                said = str(error)
            else:
                (said,) = (str(one.message) for one in given)
                ends.append(size)
        assert re.search("truncated|not an OUTPUT2 file|damaged|no end mark", said)
    assert len(set(ends)) == 8
    assert max(ends) == len(raw) - 12


def test_flipped_bytes_are_read_or_refused_by_name(put):
    raw = samples.whole()
    chance, refused = np.random.default_rng(2), 0
    for _ in range(600):
        mutant = bytearray(raw)
        for at in chance.integers(len(raw), size=chance.integers(1, 4)).tolist():
            mutant[at] = int(chance.integers(256))
        path = put(bytes(mutant))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UpdynWarning)
            for read in (updyn.read_modes, updyn.read_geometry):
                try:
                    read(path, format="op2")
                except FormatError as error:
                    refused += 1
                    said = str(error)
                    assert "cannot be read (reader" not in said
    assert refused > 300


def bad(**changes: Any) -> bytes:
    out = Writer()
    out.head()
    out.shapes(changes.pop("modes", samples.MODES), **changes)
    return out.bytes()


@pytest.mark.parametrize(
    ("raw", "said"),
    [
        (bad(table=2007), r"OUGV1, mode 1: sorted by node \(SORT2\)"),
        (bad(form=3), r"8 words per node of format 3; expected 8, real"),
        (bad(table=10), r"holds no modes .*it holds OUGV1 with 2 table 10 of modes"),
        (bad(approach=5), r"it holds OUGV1 with 2 frequency response"),
        (bad(modes=[samples.MODES[0], samples.MODES[0]]), r"mode 1 of subcase 1 occurs 2 times"),
        (bad(modes=[samples.MODES[0], (2, 9.0, {2: [1.0] * 6})]), "are not at the same nodes"),
        (bad(modes=[(1, 4.0, {2: [np.nan] * 6})]), "node 2 has a number that is not finite"),
        (bad(modes=[(1, 4.0, {2: [0.0] * 6})]), "the shape at .* Hz is zero"),
        (bad(modes=[(1, np.nan, {2: [1.0] * 6})]), "an eigenvalue is not finite"),
        (bad(name="CASECC"), r"holds no modes .*it holds CASECC"),
    ],
)  # fmt: skip
def test_modes_that_are_refused(put, raw, said):
    with pytest.raises(FormatError, match=said):
        updyn.read_modes(put(raw))


def test_modes_that_are_read_with_a_warning(put):
    low = [(1, -4.0e4, {2: [1.0] * 6}), (2, 9.0e4, {2: [1.0] * 6})]
    with pytest.warns(UpdynWarning, match="1 modes have a negative eigenvalue, the lowest -40000"):
        assert updyn.read_modes(put(bad(modes=low))).frequency[0] == 0.0


def _geometry(points: list[Any], elements: list[Any]) -> bytes:
    out = Writer()
    out.head()
    out.table("GEOM1", [points])
    out.table("GEOM2", [elements])
    return out.bytes()


PLAIN = [*samples.GRID, 1, 0, 0.0, 0.0, 0.0, 0, 0, 0, 2, 0, 1.0, 0.0, 0.0, 0, 0, 0]


@pytest.mark.parametrize(
    ("raw", "said"),
    [
        (_geometry(PLAIN[:-1], [1, 2, 3]), "GRID: 15 words are not valid entries of 8 or 11 words"),
        (
            _geometry([*PLAIN, 2, 0, 1.5, 0.0, 0.0, 0, 0, 0], [*samples.END]),
            "GRID 2 is defined twice",
        ),
        (_geometry([*PLAIN[:-3], 9, 0, 0], [*samples.END]), "GRID 2: no coordinate system 9"),
        (_geometry(PLAIN, [3001, 30, 48, 1, 1, 1, 5]), "CROD: 4 words are not valid entries of 4"),
        (_geometry([501, 5, 43, 1], [1, 2, 3]), "CORD3G"),
        (_geometry([1], [1]), "GEOM1: a record of 4 bytes"),
    ],
)
def test_geometry_that_is_refused(put, raw, said):
    with pytest.raises(FormatError, match=said):
        updyn.read_geometry(put(raw))


def test_elements_that_are_not_known_are_said(put):
    with pytest.warns(UpdynWarning, match=r"not drawn: entries of the key \(1908, 19, 104\)"):
        found = updyn.read_geometry(put(_geometry(PLAIN, [1908, 19, 104, 1, 2, 3])))
    assert found.nodes.tolist() == [1, 2]


def test_other_files_and_options(put):
    with pytest.raises(FormatError, match="not an OUTPUT2 file"):
        updyn.read_modes(put(b"something else"), format="op2")
    path = put(samples.whole())
    with pytest.raises(OptionError, match="no option 'units'; did you mean 'unit'"):
        updyn.read_modes(path, units="mm")
    with pytest.raises(OptionError, match="unit 'cm'"):
        updyn.read_modes(path, unit="cm")
    with pytest.raises(FormatError, match=r"bytes after the end"):
        updyn.read_modes(put(samples.whole() + b"more"))
