"""Abaqus matrix files: every way to write one matrix, held and internal DOFs, groups by step, set, element and file."""

import time

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp

import updyn
from io_samples import assert_same_geometry
from updyn.errors import FormatError, OptionError, UpdynWarning
from updyn.io import read_model, write_model
from updyn.io.abaqus.model import write_properties
from updyn.model import Group, Model

pytestmark = pytest.mark.kernels

THIRD = 1.0 / 3.0
LABELS = [(1, 1), (1, 2), (7, 1), (7, 6)]
DOFS = ["1:X", "1:Y", "7:X", "7:RZ"]
K = np.array(
    [[3e6, -1.5, 0, 7.0], [-1.5, 2e6 + THIRD, -1e6, 0], [0, -1e6, 1e6, 0.25], [7.0, 0, 0.25, 40.0]]
)
M = np.diag([2.0, 2.0, THIRD, 1e-3])


def rows(matrix, labels=LABELS, keep="both", style="input", element=None):
    """Return a matrix as Abaqus writes it: "both" triangles, "lower" or "upper"."""
    lines = []
    for i, j in zip(*np.nonzero(matrix), strict=True):
        if keep == "both" or i == j or (keep == "lower") == (i > j):
            (a, p), (b, q), value = labels[i], labels[j], f"{matrix[i, j]:.15e}"
            start = "" if element is None else f"{element},"
            lines.append(
                {
                    "input": f"{start}{a},{p}, {b},{q}, {value}",
                    "labels": f" {a:8d} {p:2d} {b:8d} {q:2d}   {value}",
                    "coordinate": f"{i + 1:10d} {j + 1:10d}   {value}",
                }[style]
            )
    return "** written by a test\n" + "\n".join(lines) + "\n"


def job(folder, name="wing", step=1, **matrices):
    letters = {"stiffness": "STIF", "mass": "MASS", "viscous": "DMPV", "structural": "DMPS"}
    for what, text in matrices.items():
        (folder / f"{name}_{letters[what]}{step}.mtx").write_text(text)
    return folder / f"{name}_STIF{step}.mtx"


def check(model, stiffness=K, mass=M, name="wing"):
    np.testing.assert_allclose(model.groups[name].stiffness.toarray(), stiffness, rtol=1e-14)
    np.testing.assert_allclose(model.groups[name].mass.toarray(), mass, rtol=1e-14)


@pytest.mark.parametrize("keep", ["both", "lower", "upper"])
@pytest.mark.parametrize("style", ["input", "labels"])
def test_every_way_to_write_a_matrix_is_the_same_matrix(tmp_path, style, keep):
    path = job(
        tmp_path, stiffness=rows(K, keep=keep, style=style), mass=rows(M, keep=keep, style=style)
    )
    model = read_model(path)
    assert model.dofs.labels == DOFS
    check(model)


@pytest.mark.parametrize("keep", ["both", "lower"])
def test_coordinates_need_the_degrees_of_freedom(tmp_path, keep):
    path = job(
        tmp_path, stiffness=rows(K, keep=keep, style="coordinate"), mass=rows(M, style="coordinate")
    )
    with pytest.raises(
        FormatError, match=r"wing_STIF1.mtx: the rows have no node labels \(FORMAT=COORDINATE\)"
    ):
        read_model(path)
    toml = (
        f'dofs = {DOFS}\n[[group]]\nname = "wing"\nstiffness = "wing_STIF1.mtx"\nmass ='
        ' "wing_MASS1.mtx"\n'
    )
    (tmp_path / "case.toml").write_text(toml.replace("'", '"'))
    model = read_model(tmp_path / "case.toml")
    assert model.dofs.labels == DOFS
    check(model)
    (tmp_path / "case.toml").write_text(toml.replace("'", '"').replace(', "7:RZ"', ""))
    with pytest.raises(
        FormatError, match=r"wing_STIF1.mtx: an entry is in row or column 4; there are 3 labels"
    ):
        read_model(tmp_path / "case.toml")


def test_numbers_of_fortran_and_the_order_of_rows_do_not_matter(tmp_path):
    lines = rows(K, keep="lower").splitlines()[1:]
    text = "\n".join([*reversed(lines), ""]).replace("e+", "D+").replace("e-", "d-")
    check(read_model(job(tmp_path, stiffness=text, mass=rows(M))))


def test_units_of_the_files(tmp_path):
    path = job(tmp_path, stiffness=rows(K), mass=rows(M))
    model = read_model(path, unit="mm")
    T = np.diag([1e3, 1e3, 1e3, 1.0])
    np.testing.assert_allclose(model.stiffness.toarray(), 1e-3 * T @ K @ T, rtol=1e-12)
    # What does not change is the natural frequency.
    expected = np.sqrt(scipy.linalg.eigh(K, M, eigvals_only=True)) / (2 * np.pi)
    np.testing.assert_allclose(updyn.modes(model, 4).frequency, expected, rtol=1e-9)
    with pytest.raises(OptionError, match=r"unit 'cm'; .*'mm' \(mm, N, t\)"):
        read_model(path, unit="cm")


def test_degrees_of_freedom_that_are_held_are_left_out(tmp_path):
    held = K.copy()
    held[1, :] = held[:, 1] = 0.0
    held[1, 1] = 1e36
    model = read_model(job(tmp_path, stiffness=rows(held, keep="lower"), mass=rows(M)))
    assert model.dofs.labels == ["1:X", "7:X", "7:RZ"]
    at = np.ix_([0, 2, 3], [0, 2, 3])
    check(model, K[at], M[at])


def test_empty_degrees_of_freedom_are_left_out_with_a_word(tmp_path):
    text = rows(K) + "9,3, 9,3, 0.000000000000000e+00\n"
    with pytest.warns(
        UpdynWarning, match=r"9:Z has neither stiffness, mass nor damping \(1 such\): removed"
    ):
        check(read_model(job(tmp_path, stiffness=text, mass=rows(M))))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda t: t.replace("1,1, 1,1,", "1,1, 1,1, 1,", 1),
            r"STIF1.mtx:2: found '1,1, 1,1, 1, 3.0\d*e\+06'; expected node, dof, n",
        ),
        (
            lambda t: t.replace("1,2, 1,2, 2", "1,2, 1,2, x", 1),
            r"STIF1.mtx:\d: found '1,2, 1,2, x.*; expected node, dof, n",
        ),
        (
            lambda t: t.replace("7,6, 7,6, 4", "7,6, 7,6, n", 1),
            r"STIF1.mtx:\d+: found '7,6, 7,6, n",
        ),
        (
            lambda t: t.replace("7,6", "7,8"),
            r"degree of freedom 8 \(pressure\); expected 1 to 6 for X, Y, Z",
        ),
        (
            lambda t: t.replace("7,6", "0,6"),
            r"STIF1.mtx:4: found '1,1, 0,6.*finite and counted from 1",
        ),
        (lambda t: t.replace("7,6", "7.5,6"), r"STIF1.mtx:4: found '1,1, 7.5,6"),
        (lambda t: t + "1,1, 1,1, 5.0\n", r"STIF1.mtx: entry \(1:X, 1:X\) occurs twice"),
        (
            lambda t: t.replace("1,1, 1,2, -1.5", "1,1, 1,2, -9.5"),
            r"not symmetric: the entries of 1:X and 1:Y differ by 8",
        ),
        (
            lambda t: t.replace("1,1, 1,2, -1.5", "** -9.5"),
            r"entry \(1:Y, 1:X\) is in only one triangle, others in both",
        ),
        (
            lambda t: t[:-1],
            r"STIF1.mtx:13: the last line, '7,6, 7,6, 4.0.*', does not end: .*trunc",
        ),
        (
            lambda t: t[:-9],
            r"STIF1.mtx:13: the last line, '7,6, 7,6, 4.0.*', does not end: .*trunc",
        ),
        (lambda t: t.replace("e+00", "e+00x", 1), r"STIF1.mtx:3: found .1,1, 1,2, -1.5.*e\+00x."),
        (lambda t: t.replace("e+00", "e+999", 1), r"STIF1.mtx:3: .*of a size that a double holds"),
        (lambda t: t.replace("7,6", "9" * 30 + ",6"), r"STIF1.mtx:4: found '1,1, 9999"),
        (lambda _: "** nothing\n", r"neither content nor suffix|not a Matrix Market file"),
    ],
)
def test_rows_with_faults(tmp_path, change, message):
    text = change(rows(K))
    assert text != rows(K)
    with pytest.raises(FormatError, match=message):
        read_model(job(tmp_path, stiffness=text, mass=rows(M)))


def test_names_of_files(tmp_path):
    path = job(tmp_path, stiffness=rows(K))
    with pytest.raises(
        FormatError,
        match=r"no wing_MASS1.mtx in the same folder; \*MATRIX GENERATE, STIFFNESS, MASS writes both",
    ):
        read_model(path)
    (tmp_path / "K.mtx").write_text(rows(K))
    with pytest.raises(
        FormatError, match=r'K.mtx: its name is not that of an Abaqus matrix.*stiffness = "K.mtx"'
    ):
        read_model(tmp_path / "K.mtx")
    (tmp_path / "case.toml").write_text("[[group]]\n")
    with pytest.raises(OptionError, match="a TOML file states them itself"):
        read_model(tmp_path / "case.toml", unit="mm")


def test_the_deck_of_the_job_says_where_nodes_stand(tmp_path):
    path = job(tmp_path, stiffness=rows(K), mass=rows(M))
    (tmp_path / "wing.inp").write_text("*NODE\n1, 1000., 2., 3.\n7, 4., 5.\n*STEP\n*END STEP\n")
    geometry = read_model(path, unit="mm").geometry
    np.testing.assert_allclose(geometry.xyz, [[1.0, 2e-3, 3e-3], [4e-3, 5e-3, 0.0]], rtol=1e-14)


# -- damping -----------------------------------------------------------------------------------------------
def test_structural_and_viscous_damping(tmp_path):
    C = np.diag([1.0, 2.0, 3.0, 4.0])
    path = job(
        tmp_path,
        stiffness=rows(K),
        mass=rows(M),
        structural=rows(0.03 * K),
        viscous=rows(C, keep="lower"),
    )
    group = read_model(path).groups["wing"]
    assert group.loss_factor == pytest.approx(0.03, rel=1e-13)
    np.testing.assert_allclose(group.viscous.toarray(), C)
    other = 0.03 * K
    other[0, 0] *= 1.01
    path = job(tmp_path, structural=rows(other))
    with pytest.raises(
        FormatError, match=r"group 'wing': structural damping is not a multiple of its stiffness"
    ):
        read_model(path)


# -- internal nodes ----------------------------------------------------------------------------------------
SPRINGS = [(0, 1, 5e4), (1, 4, 8e4), (4, 2, 3e4), (4, 3, 9e4), (2, 3, 1e4), (0, 0, 2e4)]
INNER = [(1, 1), (2, 1), (3, 1), (4, 1), (-1, 1)]


def stiffness_of(springs, n=5):
    out = np.zeros((n, n))
    for i, j, k in springs:
        out[i, i] += k
        if i != j:
            out[j, j] += k
            out[[i, j], [j, i]] -= k
    return out


def two_parts(folder, mass=(1.0, 2.0, 1.5, 1.0, 0.0)):
    """Write springs in two groups; the internal node belongs to the second."""
    job(
        folder,
        "a",
        stiffness=rows(stiffness_of(SPRINGS[:1] + SPRINGS[4:]), INNER),
        mass=rows(np.diag(mass), INNER),
    )
    job(
        folder,
        "b",
        stiffness=rows(stiffness_of(SPRINGS[1:4]), INNER, keep="lower"),
        structural=rows(0.02 * stiffness_of(SPRINGS[1:4]), INNER),
    )
    toml = '[[group]]\nname = "a"\nstiffness = "a_STIF1.mtx"\nmass = "a_MASS1.mtx"\n'
    toml += '[[group]]\nname = "b"\nstiffness = "b_STIF1.mtx"\nstructural = "b_DMPS1.mtx"\n'
    (folder / "case.toml").write_text(toml)
    return toml


def test_internal_nodes_follow_the_largest_of_the_others(tmp_path):
    two_parts(tmp_path)
    model = read_model(tmp_path / "case.toml")
    assert model.dofs.labels == ["1:X", "2:X", "3:X", "4:X", "5:X"]
    Z = (
        stiffness_of(SPRINGS)
        + 0.02j * stiffness_of(SPRINGS[1:4])
        - (2 * np.pi * 30) ** 2 * np.diag([1, 2, 1.5, 1, 0])
    )
    expected = np.linalg.solve(Z, np.eye(5))[np.ix_([0, 3], [1])]
    frf = updyn.response(model, [30.0], ["1:X", "4:X"], ["2:X"])
    np.testing.assert_allclose(frf.values[0], expected, rtol=1e-12)


def test_internal_nodes_with_mass_and_without_positions_are_warned_of(tmp_path):
    two_parts(tmp_path, mass=(1.0, 2.0, 1.5, 1.0, 0.1))
    with pytest.warns(UpdynWarning, match=r"case.toml: internal degrees of freedom have mass, and"):
        read_model(tmp_path / "case.toml")


def test_condensed_internal_nodes_change_no_response_also_when_a_group_changes(tmp_path):
    toml = two_parts(tmp_path)
    kept = read_model(tmp_path / "case.toml")
    (tmp_path / "case.toml").write_text('internal = "condense"\n' + toml)
    small = read_model(tmp_path / "case.toml")
    assert small.dofs.labels == ["1:X", "2:X", "3:X", "4:X"]
    for change in (
        {},
        {"b": {"stiffness": 1.7, "loss_factor": 0.05}, "a": {"stiffness": 0.8, "mass": 1.1}},
    ):
        one, two = (
            updyn.response(m.scaled(change), np.linspace(0, 60, 13), ["1:X", "3:X", "4:X"], ["2:X"])
            for m in (kept, small)
        )
        np.testing.assert_allclose(one.values, two.values, rtol=1e-11)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mass": (1.0, 2.0, 1.5, 1.0, 0.1)}, r"group 'a': internal 5:X has mass; keep it"),
        ({"shared": True}, r"internal 5:X belongs to 2 groups; keep it"),
        (
            {"multiplier": True},
            r"group 'b': internal DOFs such as 5:X have a singular stiffness \(Lagrange multip",
        ),
    ],
)
def test_internal_nodes_that_cannot_be_condensed(tmp_path, change, message):
    toml = two_parts(tmp_path, change.get("mass", (1.0, 2.0, 1.5, 1.0, 0.0)))
    if "shared" in change:
        job(tmp_path, "a", stiffness=rows(stiffness_of(SPRINGS[:2] + SPRINGS[4:]), INNER))
    if "multiplier" in change:
        tie = np.zeros((5, 5))
        tie[[1, 2, 4, 4], [4, 4, 1, 2]] = [1e4, -1e4, 1e4, -1e4]
        job(tmp_path, "b", stiffness=rows(tie, INNER), structural=rows(0.02 * tie, INNER))
    (tmp_path / "case.toml").write_text('internal = "condense"\n' + toml)
    with pytest.raises(FormatError, match=message):
        read_model(tmp_path / "case.toml")


@pytest.mark.filterwarnings("ignore:group 'tie':updyn.UpdynWarning")
def test_a_lagrange_multiplier_that_is_kept_ties(tmp_path):
    springs = stiffness_of(SPRINGS[:1] + SPRINGS[4:])
    tie = np.zeros((5, 5))
    tie[[1, 2, 4, 4], [4, 4, 1, 2]] = [1e4, -1e4, 1e4, -1e4]
    job(
        tmp_path,
        "a",
        stiffness=rows(springs, INNER),
        mass=rows(np.diag([1.0, 2.0, 1.5, 1.0, 0.0]), INNER),
    )
    job(tmp_path, "tie", stiffness=rows(tie, INNER))
    toml = '[[group]]\nname = "a"\nstiffness = "a_STIF1.mtx"\nmass = "a_MASS1.mtx"\n'
    (tmp_path / "case.toml").write_text(
        toml + '[[group]]\nname = "tie"\nstiffness = "tie_STIF1.mtx"\n'
    )
    with pytest.warns(UpdynWarning, match=r"group 'tie': stiffness is indefinite"):
        model = read_model(tmp_path / "case.toml")
    T = np.array(
        [[1, 0, 0], [0, 1, 0], [0, 1, 0], [0, 0, 1]], dtype=float
    )  # 2:X and 3:X move together
    Z = springs[:4, :4] - (2 * np.pi * 20) ** 2 * np.diag([1.0, 2.0, 1.5, 1.0])
    expected = T @ np.linalg.solve(T.T @ Z @ T, T.T)
    frf = updyn.response(model, [20.0], ["1:X", "3:X", "4:X"], ["2:X"])
    np.testing.assert_allclose(frf.values[0, :, 0].real, expected[[0, 2, 3], 1], rtol=1e-10)


# -- groups by the steps of a deck -------------------------------------------------------------------------
GENERATE = """*HEADING
Two springs
*NODE
1, 0., 0., 0.
2, 1., 0., 0.
3, 2., 0., 0.
*ELEMENT, TYPE=T3D2, ELSET=Left
11, 1, 2
*ELEMENT, TYPE=T3D2, ELSET=Right
12, 2, 3
*MATERIAL, NAME=Steel
*ELASTIC
2.1E11, .3
*DENSITY
7850.
*MATERIAL, NAME=Brass
*ELASTIC
1.0E11, .3
*DENSITY
8500.
*SOLID SECTION, ELSET=Left, MATERIAL=Steel
1.E-4
*SOLID SECTION, ELSET=Right, MATERIAL=Brass
1.E-4
"""
STEP = "*STEP\n*MATRIX GENERATE, STIFFNESS, MASS{0}\n*MATRIX OUTPUT, STIFFNESS, MASS\n*END STEP\n"
LEFT, RIGHT = [(1, 1), (2, 1)], [(2, 1), (3, 1)]
ONE = np.array([[1.0, -1.0], [-1.0, 1.0]])
LINE = np.array([[2.0, 1.0], [1.0, 2.0]]) / 6


def test_element_sets_of_steps_are_groups_and_add_up(tmp_path):
    (tmp_path / "rod.inp").write_text(
        GENERATE
        + STEP.format(", ELSET=Left")
        + STEP.format(", ELSET=rod-1.Right")
        + STEP.format("")
    )
    job(tmp_path, "rod", 1, stiffness=rows(2.1e7 * ONE, LEFT), mass=rows(0.785 * LINE, LEFT))
    job(tmp_path, "rod", 2, stiffness=rows(1e7 * ONE, RIGHT), mass=rows(0.85 * LINE, RIGHT))
    both = [(1, 1), (2, 1), (3, 1)]
    total = {}
    for what, a, b in (("stiffness", 2.1e7 * ONE, 1e7 * ONE), ("mass", 0.785 * LINE, 0.85 * LINE)):
        total[what] = np.zeros((3, 3))
        total[what][:2, :2] += a
        total[what][1:, 1:] += b
    job(tmp_path, "rod", 3, **{what: rows(A, both) for what, A in total.items()})
    model = read_model(tmp_path / "rod.inp")
    assert list(model.groups) == ["Left", "Right"]
    (tmp_path / "other.inp").write_text((tmp_path / "rod.inp").read_text())
    assert read_model(tmp_path / "other.inp", format="abaqus", job="rod").dofs == model.dofs
    assert (model.title, model.dofs.labels) == ("Two springs", ["1:X", "2:X", "3:X"])
    np.testing.assert_allclose(model.stiffness.toarray(), total["stiffness"], rtol=1e-14)
    np.testing.assert_array_equal(model.geometry.nodes, [1, 2, 3])
    total["mass"][2, 2] += 0.2
    job(tmp_path, "rod", 3, mass=rows(total["mass"], both))
    with pytest.raises(
        FormatError,
        match=r"rod_MASS3.mtx: the element sets do not add up to the mass.*3:X, 3:X the difference is 0.2",
    ):
        read_model(tmp_path / "rod.inp")


def test_element_matrices_become_materials(tmp_path):
    (tmp_path / "rod.inp").write_text(GENERATE + STEP.format(", ELEMENT BY ELEMENT"))
    K_rows = rows(2.1e7 * ONE, LEFT, "upper", element=11) + rows(
        1e7 * ONE, RIGHT, "upper", element=12
    )
    M_rows = rows(0.785 * LINE, LEFT, element=11) + rows(0.85 * LINE, RIGHT, element=12)
    job(tmp_path, "rod", 1, stiffness=K_rows, mass=M_rows)
    model = read_model(tmp_path / "rod.inp")
    assert list(model.groups) == ["Steel", "Brass"]
    np.testing.assert_allclose(
        model.groups["Brass"].stiffness.toarray()[1:, 1:], 1e7 * ONE, rtol=1e-14
    )
    np.testing.assert_allclose(
        model.groups["Steel"].mass.toarray()[:2, :2], 0.785 * LINE, rtol=1e-14
    )
    assert model.groups["Steel"].mass.toarray()[2, 2] == 0.0
    merged = read_model(tmp_path / "rod.inp", groups={"rod": ["ELSET LEFT", "Brass"]})
    assert list(merged.group("rod").origin.members) == ["Steel", "Brass"]
    with pytest.raises(FormatError, match="no group 'ELSET LIFT'; did you mean 'ELSET LEFT'"):
        read_model(tmp_path / "rod.inp", groups={"rod": "ELSET LIFT"})
    job(tmp_path, "rod", 1, mass=M_rows + rows(0.85 * LINE, RIGHT, element=13))
    with pytest.raises(FormatError, match=r"rod_MASS1.mtx: element 13 has no section in the deck"):
        read_model(tmp_path / "rod.inp")


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        (
            "*STEP\n*STATIC\n*END STEP\n*PART\n",
            r"rod.inp: no step of the deck writes matrices: add",
        ),
        (
            STEP.format(", ELSET=Left") * 2,
            r"rod.inp:30: \*MATRIX GENERATE, STIFFNESS of step 2: no file 'rod_STIF2.mtx'; did",
        ),
        (
            STEP.format(", ELEMENT BY ELEMENT"),
            r"rod_STIF1.mtx: the matrix is not written by element, as the deck states \(line 26\)",
        ),
        (
            STEP.format("").replace(", STIFFNESS, MASS", "", 1),
            r"\*MATRIX GENERATE has neither STIFFNESS nor MASS",
        ),
    ],
)
def test_steps_with_faults(tmp_path, steps, message):
    (tmp_path / "rod.inp").write_text(GENERATE + steps)
    job(tmp_path, "rod", 1, stiffness=rows(2.1e7 * ONE, LEFT), mass=rows(0.785 * LINE, LEFT))
    with pytest.raises(FormatError, match=message):
        read_model(tmp_path / "rod.inp", format="abaqus")


def test_element_sets_in_a_toml_file(tmp_path):
    (tmp_path / "rod.inp").write_text(GENERATE)
    job(
        tmp_path,
        "rod",
        1,
        stiffness=rows(2.1e4 * ONE, LEFT, element=11) + rows(1e4 * ONE, RIGHT, element=12),
    )
    toml = 'title = "rod"\nunit = "m"\ndeck = "rod.inp"\n'
    for name in ("Left", "Right"):
        toml += (
            f'[[group]]\nname = "{name.lower()}"\nstiffness = "rod_STIF1.mtx"\nelset = "{name}"\n'
        )
    (tmp_path / "case.toml").write_text(toml + "loss_factor = 0.125\n")
    model = read_model(tmp_path / "case.toml")
    assert (model.title, list(model.groups), model.groups["right"].loss_factor) == (
        "rod",
        ["left", "right"],
        0.125,
    )
    np.testing.assert_allclose(
        model.groups["right"].stiffness.toarray()[1:, 1:], 1e4 * ONE, rtol=1e-14
    )
    for old, new, message in (
        (
            'elset = "Right"',
            'elset = "Rigth"',
            r"case.toml:11: the deck has no element set 'Rigth'; did you mean 'RIGHT'",
        ),
        (
            'elset = "Right"\n',
            "",
            r"case.toml:9: group 'right': its files are written element by element; select",
        ),
        ('deck = "rod.inp"\n', "", r"case.toml:6: elset needs deck = '...'"),
        ('unit = "m"', 'units = "m"', r"case.toml:2: unknown key 'units'; did you mean 'unit'"),
        (
            'stiffness = "rod_STIF1.mtx"\nelset = "Right"',
            'stifness = "rod_STIF1.mtx"',
            r"unknown key 'stifness' in \[group\]",
        ),
        ('name = "right"\n', "", r"case.toml:8: \[\[group\]\] number 2 has no name"),
    ):
        (tmp_path / "case.toml").write_text(toml.replace(old, new))
        with pytest.raises(FormatError, match=message):
            read_model(tmp_path / "case.toml")


# -- decks that read matrices ------------------------------------------------------------------------------
def sample():
    rng = np.random.default_rng(11)
    A, B = rng.standard_normal((2, 4, 4))
    groups = {
        "wing": Group(
            1e6 * (A @ A.T + np.eye(4)), np.diag([1.0, THIRD, 2.0, 1e-3]), loss_factor=0.1 / 3
        ),
        "engine 1/é": Group(mass=np.diag([0.0, 2.0, 0.0, 0.0])),
        "mount": Group(
            sp.csr_array(([5e6], [0], [0, 1, 1, 1, 1]), shape=(4, 4)), viscous=1e-5 * B @ B.T
        ),
    }
    geometry = updyn.Geometry([1, 7], [[0.0, THIRD, 1e-9], [1.0, -2.5, 3e5]])
    return Model.from_groups(groups, DOFS, geometry=geometry, title="A wing")


def test_a_written_model_comes_back_to_twelve_digits(tmp_path):
    model = sample()
    write_model(model, tmp_path / "case.inp")
    back = read_model(tmp_path / "case.inp")
    assert list(back.groups) == list(model.groups)
    assert back.dofs == model.dofs
    assert back.title == model.title
    assert_same_geometry(back.geometry, updyn.Geometry(model.geometry.nodes, model.geometry.xyz))
    for name, group in model.groups.items():
        assert back.groups[name].loss_factor == pytest.approx(group.loss_factor, rel=1e-12)
        for what in ("stiffness", "mass", "viscous"):
            A, B = getattr(group, what), getattr(back.groups[name], what)
            assert (A is None) == (B is None)
            if A is not None:
                np.testing.assert_allclose(B.toarray(), A.toarray(), rtol=1e-12)
    for file in tmp_path.glob("*.mtx"):
        assert all(
            len(f.strip()) <= 20 for line in file.read_text().splitlines() for f in line.split(",")
        )
    np.testing.assert_allclose(
        updyn.modes(back, 4).frequency, updyn.modes(model, 4).frequency, rtol=1e-10
    )


def test_models_that_a_deck_cannot_hold(tmp_path):
    def one(node="1", name="a", axes=None):
        place = updyn.Geometry([int(node)], np.zeros((1, 3)), axes=axes)
        return Model.from_groups({name: Group(np.eye(1), np.eye(1))}, [f"{node}:X"], geometry=place)

    for model, message in (
        (one("-3"), r"node -3; expected node numbers from 1 to"),
        (one(name="a,b"), r"group 'a,b': names in a deck cannot contain quotes, commas"),
    ):
        with pytest.raises(FormatError, match=message):
            write_model(model, tmp_path / "case.inp")
    both = Model.from_groups({"a": Group(np.eye(1)), "A": Group(mass=np.eye(1))}, ["1:X"])
    with pytest.raises(FormatError, match=r"groups 'a' and 'A' have the same name in a deck"):
        write_model(both, tmp_path / "case.inp")
    with pytest.warns(UpdynWarning, match="a deck cannot hold directions of nodes"):
        write_model(one(axes=[np.eye(3)[[1, 0, 2]]]), tmp_path / "case.inp")


USAGE = """*NODE, NSET=all
1, 0., 0., 0.
7, 1., 0., 0.
*MATRIX INPUT, NAME=K, INPUT=wing_STIF1.mtx, SCALE FACTOR=2.
*MATRIX INPUT, NAME=M
{mass}*MATRIX ASSEMBLE, STIFFNESS=K, MASS=M
*STEP
*FREQUENCY
4
*BOUNDARY
1, 2
*END STEP
"""


def test_matrices_in_the_deck_scaled_and_supported(tmp_path):
    job(tmp_path, stiffness=rows(K, keep="lower"))
    (tmp_path / "use.inp").write_text(USAGE.format(mass=rows(M)))
    model = read_model(tmp_path / "use.inp")
    assert model.dofs.labels == ["1:X", "7:X", "7:RZ"]
    at = np.ix_([0, 2, 3], [0, 2, 3])
    check(model, 2 * K[at], M[at], "K")
    with pytest.raises(
        FormatError,
        match=r"use.inp: the deck consists of matrices.*write_model\(result.model",
    ):
        updyn.write_properties(
            {"K": {"stiffness": 2.0}}, tmp_path / "use.inp", tmp_path / "new.inp"
        )


def test_a_set_of_a_billion_nodes_is_refused_soon(tmp_path):
    job(tmp_path, stiffness=rows(K, keep="lower"))
    text = USAGE.format(mass=rows(M))
    (tmp_path / "use.inp").write_text(
        text.replace("*BOUNDARY", "*NSET, NSET=big, GENERATE\n1, 1000000000\n*BOUNDARY", 1)
    )
    with pytest.raises(FormatError, match=r"use.inp:\d+: \*NSET: the sets .* more than 10000000"):
        read_model(tmp_path / "use.inp")
    (tmp_path / "use.inp").write_text(
        text.replace("*BOUNDARY", "*NSET, NSET=big, GENERATE\n1, 4000000\n*BOUNDARY\nbig, 1", 1)
    )
    start = time.monotonic()
    assert read_model(tmp_path / "use.inp").dofs.labels == ["7:RZ"]
    assert time.monotonic() - start < 10.0


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("STIFFNESS=K,", "STIFFNESS=KK,", r"\*MATRIX ASSEMBLE: no matrix 'KK'; did you mean 'K'"),
        (
            "wing_STIF1",
            "wing_STIF2",
            r"use.inp:4: \*MATRIX INPUT: no such file 'wing_STIF2.mtx'; did you mean 'wing_STIF1",
        ),
        ("SCALE FACTOR=2.", "TYPE=UNSYMMETRIC", r"use.inp:4: \*MATRIX INPUT, TYPE=UNSYMMETRIC"),
        ("wing_STIF1.mtx", "wing_X1.sim", r"use.inp:4: \*MATRIX INPUT of a .sim file"),
        (
            "*MATRIX ASSEMBLE",
            "*EQUATION\n2\n1,1,1.,7,1,-1.\n*MATRIX ASSEMBLE",
            r"\*EQUATION together with \*MATRIX ASSEMBLE is not",
        ),
        ("1, 2\n", "al, 2\n", r"\*BOUNDARY: no node set 'al'; did you mean 'ALL'"),
        (
            "1, 2\n",
            "all, 1, 7\n",
            r"\*BOUNDARY: found 'all, 1, 7'; expected directions from 1 to 6",
        ),
        ("1, 2\n", "all, ENCASTRE\n", r"no degree of freedom is free: all are fixed"),
    ],
)
def test_decks_of_matrices_with_faults(tmp_path, old, new, message):
    job(tmp_path, stiffness=rows(K))
    text = USAGE.format(mass=rows(M)).replace("** written by a test\n", "")
    assert old in text
    (tmp_path / "use.inp").write_text(text.replace(old, new))
    with pytest.raises(FormatError, match=message):
        read_model(tmp_path / "use.inp")


# -- write-back --------------------------------------------------------------------------------------------
PARTS = """*HEADING
*PART, NAME=P
*NODE
1, 0., 0., 0.
*SHELL SECTION, ELSET=Skin, MATERIAL=Alu
2.E-3
*SOLID SECTION, ELSET=Spar, MATERIAL=Steel
*END PART
*ASSEMBLY, NAME=A
*END ASSEMBLY
*MATERIAL, NAME=Alu
*DENSITY
2700.,
*ELASTIC
7.0E10, 0.33
*DAMPING, ALPHA=4., BETA=1.E-5, STRUCTURAL=0.01
*EXPANSION
2.4E-5
*MATERIAL, NAME=Steel
*ELASTIC
2.1E11, 0.3
*DENSITY
7850.
*PLASTIC
2.5E8, 0.
"""


def test_new_materials_for_a_deck_with_parts(tmp_path):
    (tmp_path / "wing.inp").write_text(PARTS)
    changes = {
        "Skin": {"stiffness": 1.25, "mass": 0.5, "loss_factor": 0.03, "viscous": 2.0},
        "Steel": {"stiffness": 0.5, "loss_factor": 0.02},
    }
    updyn.write_properties(changes, tmp_path / "wing.inp", tmp_path / "new.inp")
    text = (tmp_path / "new.inp").read_text().splitlines()
    assert (
        [line for line in text if not line.startswith("**")]
        == [
            "*MATERIAL, NAME=Alu",
            "*DENSITY",
            "1350.0",
            "*ELASTIC",
            "87500000000.0, 0.33",
            "*DAMPING, ALPHA=16.0, BETA=1.6E-05, STRUCTURAL=0.03",  # C = 2 (4 M + 1e-5 K) of M/2 and 1.25 K
            "*EXPANSION",
            "2.4E-5",
            "*MATERIAL, NAME=Steel",
            "*ELASTIC",
            "105000000000.0, 0.3",
            "*DENSITY",
            "7850.",
            "*PLASTIC",
            "2.5E8, 0.",
            "*DAMPING, STRUCTURAL=0.02",
        ]
    )
    assert "** old damping: ALPHA=4., BETA=1.E-5, STRUCTURAL=0.01" in text


def test_element_sets_that_share_a_material(tmp_path):
    (tmp_path / "wing.inp").write_text(PARTS.replace("MATERIAL=Steel", "MATERIAL=Alu"))
    both = {"Skin": {"stiffness": 1.25}, "Spar": {"stiffness": 1.25}}
    write_properties(both, tmp_path / "wing.inp", tmp_path / "new.inp")
    assert (tmp_path / "new.inp").read_text().count("*MATERIAL") == 1
    with pytest.raises(
        FormatError,
        match=r"group 'Skin' shares material 'ALU' with 'SPAR', which has different changes",
    ):
        write_properties({"Skin": {"stiffness": 1.25}}, tmp_path / "wing.inp", tmp_path / "new.inp")
    with pytest.raises(
        FormatError, match=r"no material or element set 'Skni'; did you mean 'SKIN'"
    ):
        write_properties({"Skni": {"stiffness": 1.25}}, tmp_path / "wing.inp", tmp_path / "new.inp")
