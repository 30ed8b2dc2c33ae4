"""CalculiX: what its own *FREQUENCY says against the model made of its matrices; groups, damping, units, write-back."""

import re
import stat

import numpy as np
import pytest

import updyn
from deck_samples import DENSITIES, MODULI, NAMES, bar, needs_ccx, own_frequencies
from updyn.cli.describe import describe_model
from updyn.errors import FormatError, OptionError, UpdynWarning
from updyn.io.calculix import read_model, write_properties
from updyn.io.calculix.program import CalculixProgram

pytestmark = pytest.mark.kernels

PRINTED = 1e-6  # ccx prints seven digits
MM = (1e3, 1e-6, 1e-12)


@pytest.fixture(scope="module")
def deck(tmp_path_factory):
    path = tmp_path_factory.mktemp("ccx") / "bar.inp"
    path.write_text(bar())
    return path


@pytest.fixture(scope="module")
def model(deck):
    return read_model(deck)


def spliced(text, names, file):
    """Return a deck with *INCLUDE in place of the materials."""
    for name in names:
        text = re.sub(rf"\*MATERIAL, NAME={name}\n\*ELASTIC\n.*\n\*DENSITY\n.*\n", "", text)
    return text.replace("*Solid section", f"*INCLUDE, INPUT={file}\n*Solid section", 1)


@needs_ccx
def test_natural_frequencies_are_those_of_the_program(deck, model):
    expected = own_frequencies(deck)
    assert len(expected) == 10
    np.testing.assert_allclose(updyn.modes(model, 10).frequency, expected, rtol=PRINTED)


@needs_ccx
def test_materials_are_merged_by_element_sets(deck, model):
    merged = updyn.read_model(deck, groups={"ends": ["ELSET PART1", "ELSET PART3"]})
    assert list(merged.group("ends").origin.members) == [NAMES[0], NAMES[2]]
    whole = abs(merged.stiffness - model.stiffness).max()
    assert whole <= 1e-15 * abs(model.stiffness).max()


@needs_ccx
def test_groups_are_the_materials_and_add_up(deck, model):
    assert list(model.groups) == list(NAMES)
    assert model.title == "Bar of three materials"
    assert model.n_dofs == 3 * 36
    assert not np.isin(model.dofs.nodes, [1, 2, 3, 4, 5, 6]).any()
    # All free nodes at one speed along X: twice the kinetic energy. Where one side of a linear
    # brick stands still the speed grows along it, which leaves a third: of the two bricks along the
    # steel part one is full.
    ones = (model.dofs.axes == 0).astype(float)
    volume = 0.1 * 0.04 * 0.03
    for name, rho, share in zip(NAMES, DENSITIES, (0.5 + 0.5 / 3, 1.0, 1.0), strict=True):
        assert ones @ (model.groups[name].mass @ ones) == pytest.approx(
            rho * volume * share, rel=1e-9
        )


@needs_ccx
def test_a_factor_on_a_group_is_a_factor_on_its_material(deck, model, tmp_path):
    changed = tmp_path / "changed.inp"
    text = (
        bar()
        .replace(f"{MODULI[1]:.10g}", f"{MODULI[1] * 1.7:.10g}")
        .replace(f"\n{DENSITIES[2]:.10g}", "\n6230.")
    )
    changed.write_text(text)
    scaled = model.scaled({"alu": {"stiffness": 1.7}, "BRONZE": {"mass": 0.7}})
    other = read_model(changed)
    for what in ("stiffness", "mass"):
        A, B = getattr(scaled, what), getattr(other, what)
        assert abs(A - B).max() < 1e-12 * abs(B).max()
    np.testing.assert_allclose(
        updyn.modes(scaled, 10).frequency, own_frequencies(changed), rtol=PRINTED
    )


@needs_ccx
def test_a_deck_in_mm_gives_the_same_model_in_si(model, tmp_path):
    path = tmp_path / "mm.inp"
    path.write_text(bar(unit=MM))
    other = read_model(path, unit="mm")
    for what in ("stiffness", "mass"):
        A, B = getattr(model, what), getattr(other, what)
        assert abs(A - B).max() < 1e-8 * abs(A).max()  # positions are written with nine digits
    np.testing.assert_allclose(other.geometry.xyz, model.geometry.xyz, atol=1e-9)
    with pytest.warns(UpdynWarning, match=r"material 'Steel'.*they fit unit = 'mm'"):
        read_model(path)


@needs_ccx
def test_a_free_bar_moves_as_a_rigid_body(tmp_path):
    path = tmp_path / "free.inp"
    path.write_text(bar().replace("*BOUNDARY\nFixed, 1, 3\n", ""))
    model = read_model(path)
    at = model.geometry.position(model.dofs.nodes)
    turned = np.cross([0.3, -0.5, 0.7], at)[np.arange(model.n_dofs), model.dofs.axes]
    for group in model.groups.values():
        for motion in ((model.dofs.axes == 1).astype(float), turned):
            residual = abs(group.stiffness @ motion).max()
            assert residual < 1e-9 * abs(group.stiffness).max() * abs(motion).max()


SPRINGS = """*ELEMENT, TYPE=SPRING1, ELSET=Ground
901, 40
902, 42
*SPRING, ELSET=Ground
2
2.E6
*ELEMENT, TYPE=SPRINGA, ELSET=Strut
903, 1, 30
*SPRING, ELSET=Strut

3.E7
*ELEMENT, TYPE=MASS, ELSET=Tip
904, 42
*MASS, ELSET=Tip
0.35
*EQUATION
2
41, 3, 1., 42, 3, -1.
*DAMPING, ALPHA=3., BETA=2.E-6
"""


@needs_ccx
def test_springs_masses_equations_and_damping(tmp_path):
    path = tmp_path / "more.inp"
    text = (
        bar()
        .replace("*BOUNDARY", SPRINGS + "*BOUNDARY")
        .replace("\n2700\n", "\n2700\n*DAMPING, STRUCTURAL=0.02\n")
    )
    path.write_text(text)
    model = read_model(path)
    assert list(model.groups) == [*NAMES, "Ground", "Strut", "Tip"]
    np.testing.assert_allclose(
        updyn.modes(undamped(model), 10).frequency, own_frequencies(path), rtol=PRINTED
    )
    assert [g.loss_factor for g in model.groups.values()] == [0.0, 0.02, 0.0, 0.0, 0.0, 0.0]
    ground, tip = model.groups["Ground"], model.groups["Tip"]
    assert ground.mass is None
    assert ground.stiffness.diagonal().sum() == pytest.approx(4e6, rel=1e-9)
    assert ground.stiffness.nnz == 2
    assert tip.stiffness is None
    # The equation ties 41:Z to 42:Z, so 41:Z is gone and the mass at 42 is all there is.
    assert "41:Z" not in model.dofs
    np.testing.assert_allclose(tip.mass.data, 0.35, rtol=1e-9)
    for group in model.groups.values():
        parts = [
            f * A.toarray()
            for f, A in ((3.0, group.mass), (2e-6, group.stiffness))
            if A is not None
        ]
        np.testing.assert_allclose(group.viscous.toarray(), sum(parts), rtol=1e-12)


def undamped(model):
    groups = {name: updyn.Group(g.stiffness, g.mass) for name, g in model.groups.items()}
    return updyn.Model.from_groups(groups, model.dofs)


@needs_ccx
def test_quadratic_elements_and_rotated_supports(tmp_path):
    rng = np.random.default_rng(5)
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]], dtype=float)
    pairs = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3), (1, 4), (2, 4), (3, 4)]
    xyz = np.vstack([corners, [corners[list(p)].mean(axis=0) for p in pairs]]) * 0.1
    xyz[:5] += rng.normal(scale=1e-3, size=(5, 3))
    tets = [(1, 2, 3, 4, 6, 7, 8, 9, 10, 11), (2, 3, 4, 5, 7, 11, 10, 12, 13, 14)]
    lines = ["*NODE", *(f"{i}, {x:.8f}, {y:.8f}, {z:.8f}" for i, (x, y, z) in enumerate(xyz, 1))]
    for number, (name, nodes) in enumerate(zip("AB", tets, strict=True), 1):
        lines += [f"*ELEMENT, TYPE=C3D10, ELSET={name}", f"{number}, {', '.join(map(str, nodes))}"]
        lines += [f"*MATERIAL, NAME={name}", "*ELASTIC", f"{number}.E9, 0.35", "*DENSITY", "1200."]
        lines += [f"*SOLID SECTION, ELSET={name}, MATERIAL={name}"]
    lines += ["*NSET, NSET=S", "1, 2, 4", "*TRANSFORM, NSET=S", "1., 1., 0., -1., 1., 0."]
    lines += ["*BOUNDARY", "S, 1, 2", "4, 3", "*STEP", "*FREQUENCY", "4", "*END STEP"]
    path = tmp_path / "tets.inp"
    path.write_text("\n".join(lines) + "\n")
    np.testing.assert_allclose(
        updyn.modes(read_model(path), 4).frequency, own_frequencies(path), rtol=PRINTED
    )


ORIENTED = """*ORIENTATION, NAME=turned
1., .2, 0., 0., 1., 0.
*Solid section, Elset=PART3, Material=BRONZE, Orientation=turned
"""
CAP = """*NODE
101, 0.3, -0.01, -0.01
102, 0.3, 0.05, -0.01
103, 0.3, 0.05, 0.04
104, 0.3, -0.01, 0.04
105, 0.36, -0.01, -0.01
106, 0.36, 0.05, -0.01
107, 0.36, 0.05, 0.04
108, 0.36, -0.01, 0.04
*ELEMENT, TYPE=C3D8, ELSET=cap
201, 101, 102, 103, 104, 105, 106, 107, 108
*MATERIAL, NAME=cap
*ELASTIC
5.E10, .3
*DENSITY
3000.
*SOLID SECTION, ELSET=cap, MATERIAL=cap
*SURFACE, NAME=slave, TYPE=NODE
37
38
39
40
41
42
*SURFACE, NAME=master, TYPE=ELEMENT
201, S1
*TIE, NAME=glue, POSITION TOLERANCE=0.002
slave, master
"""


@needs_ccx
@pytest.mark.parametrize(
    ("old", "new", "n_dofs"),
    [
        ("TYPE=C3D8", "TYPE=C3D8R", 108),
        ("TYPE=C3D8", "TYPE=C3D8I", 108 + 12 * 9),
        (
            "*ELASTIC\n1.1e+11, 0.3\n",
            (
                "*ELASTIC, TYPE=ENGINEERING"
                " CONSTANTS\n1.1e11,5.e10,4.e10,.3,.28,.25,3.e10,2.e10,\n1.5e10\n"
            ),
            108,
        ),
        (
            "*ELASTIC\n1.1e+11, 0.3\n",
            "*ELASTIC, TYPE=ORTHO\n1.5e11,6e10,1.4e11,6e10,6e10,1.3e11,4e10,4.1e10,\n4.2e10\n",
            108,
        ),
        ("*ELASTIC\n1.1e+11, 0.3\n", "*ELASTIC\n1.1e11, 0.3, 293.\n1.0e11, 0.3, 393.\n", 108),
        ("*BOUNDARY\n", CAP + "*BOUNDARY\n", 108 - 18 + 24),
    ],
    ids=["reduced", "incompatible modes", "engineering constants", "ortho", "temperature", "tie"],
)
def test_elements_materials_and_ties_of_other_kinds(tmp_path, old, new, n_dofs):
    path = tmp_path / "other.inp"
    text = bar().replace(old, new)
    assert text != bar()
    if "TYPE=ENG" in new or "TYPE=ORTHO" in new:
        text = text.replace("*Solid section, Elset=PART3, Material=BRONZE\n", ORIENTED)
    path.write_text(text)
    model = read_model(path)
    assert model.n_dofs == n_dofs
    np.testing.assert_allclose(
        updyn.modes(model, 10).frequency, own_frequencies(path), rtol=PRINTED
    )


@needs_ccx
@pytest.mark.parametrize("kind", ["C3D8", "C3D8R", "C3D8I"])
@pytest.mark.parametrize("hub", ["", "unnamed", "rotation node"])
def test_mass_that_info_shows_is_density_times_volume(tmp_path, kind, hub):
    path = tmp_path / "bar.inp"
    text = bar().replace("TYPE=C3D8", f"TYPE={kind}").replace("*BOUNDARY\nFixed, 1, 3\n", "")
    if hub:
        nodes = "901, 0.34, 0.02, 0.04\n902, 0., 0., 0.\n"
        body = BODY.replace("901", "901, ROT NODE=902") if hub == "rotation node" else BODY
        text = text.replace("*ELEMENT", nodes + "*ELEMENT", 1).replace(
            "*STEP", SETS + body + HUB + "*STEP"
        )
    path.write_text(text)
    if kind == "C3D8I" and hub == "unnamed":
        with pytest.raises(FormatError, match="ROT NODE"):
            read_model(path)
        return
    described = describe_model(read_model(path))
    found = {
        line.split()[0]: line.split()[2:4] for line in described.splitlines() if " kg " in line
    }
    expected = dict(zip(NAMES, np.array(DENSITIES) * 0.1 * 0.04 * 0.03, strict=True))
    if hub:
        expected["Hub"] = 0.8
    assert {name: float(found[name][0]) for name in expected} == pytest.approx(expected, rel=1e-3)


SETS = """*NSET, NSET=tip
37, 38, 39, 40, 41, 42
*NSET, NSET=root
1, 2, 3, 4, 5, 6
*SURFACE, NAME=face, TYPE=NODE
root
"""
BODY = "*RIGID BODY, NSET=tip, REF NODE=901\n"
COUPLING = "*COUPLING, REF NODE=903, SURFACE=face, CONSTRAINT NAME=c\n*KINEMATIC\n1, 3\n"
HUB = """*ELEMENT, TYPE=MASS, ELSET=Hub
904, 901
*MASS, ELSET=Hub
0.8
"""


@needs_ccx
@pytest.mark.parametrize(
    "ties", [BODY.replace("901", "901, ROT NODE=902") + COUPLING, BODY + COUPLING, COUPLING + BODY]
)
@pytest.mark.parametrize("unit", ["m", "mm"])
def test_rotations_of_rigid_bodies(tmp_path, ties, unit):
    path, metre = tmp_path / "rigid.inp", 1.0 if unit == "m" else 1e3
    nodes = "".join(
        f"{n}, {x * metre}, {0.02 * metre}, {0.04 * metre}\n"
        for n, x in ((901, 0.34), (902, 0.0), (903, -0.03))
    )
    text = bar(unit=MM if unit == "mm" else (1.0, 1.0, 1.0)).replace(
        "*ELEMENT", nodes + "*ELEMENT", 1
    )
    text = text.replace("*BOUNDARY\nFixed, 1, 3\n", SETS + ties + HUB)
    path.write_text(text.replace("\n0.8\n", "\n0.8E-3\n") if unit == "mm" else text)
    model = read_model(path, unit=unit)
    labels = model.dofs.labels
    assert {"901:RX", "901:RZ", "903:X", "903:RY"} <= set(labels)
    assert not {"37:X", "1:X", "902:X"} & set(labels)
    # A rotation of the whole about the origin strains nothing.
    turn, at = np.array([0.3, -0.5, 0.7]), model.geometry.position(model.dofs.nodes)
    axis = np.array(model.dofs.axes)
    motion = np.where(axis < 3, np.cross(turn, at)[np.arange(len(axis)), axis % 3], turn[axis % 3])
    assert (
        abs(model.stiffness @ motion).max() < 1e-9 * abs(model.stiffness).max() * abs(motion).max()
    )
    own = own_frequencies(path)
    np.testing.assert_allclose(updyn.modes(model, 10).frequency[6:], own[6:], rtol=PRINTED)


@needs_ccx
def test_what_is_written_back_gives_the_frequencies_of_the_updated_model(deck, model, tmp_path):
    changes = {
        "Steel": {"stiffness": 1.0834729184723, "mass": 0.9482734, "loss_factor": 0.013},
        "BRONZE": {"stiffness": 0.7123456789, "mass": 1.21},
    }
    write_properties(changes, deck, tmp_path / "new.inp")
    again = tmp_path / "again.inp"
    again.write_text(spliced(bar(), ("Steel", "BRONZE"), "new.inp"))
    expected = model.scaled(changes)
    np.testing.assert_allclose(
        updyn.modes(undamped(expected), 10).frequency, own_frequencies(again), rtol=PRINTED
    )
    back = read_model(again)
    assert [back.groups[n].loss_factor for n in NAMES] == [0.013, 0.0, 0.0]
    for what in ("stiffness", "mass"):
        A, B = getattr(expected, what), getattr(back, what)
        assert abs(A - B).max() < 1e-12 * abs(A).max()


@needs_ccx
def test_as_a_deck_of_abaqus_the_model_keeps_the_frequencies_of_the_program(deck, model, tmp_path):
    updyn.write_model(model, tmp_path / "case.inp")
    back = updyn.read_model(tmp_path / "case.inp")
    assert list(back.groups) == list(model.groups)
    np.testing.assert_allclose(updyn.modes(back, 10).frequency, own_frequencies(deck), rtol=PRINTED)


def test_the_written_file_says_old_and_new(tmp_path):
    (tmp_path / "bar.inp").write_text(bar())
    write_properties(
        {"alu": {"stiffness": 1.5, "mass": 2.0}}, tmp_path / "bar.inp", tmp_path / "new.inp"
    )
    text = (tmp_path / "new.inp").read_text().splitlines()
    assert [line for line in text if not line.startswith("**")] == [
        "*MATERIAL, NAME=alu",
        "*ELASTIC",
        "105000000000.0, 0.3",
        "*DENSITY",
        "5400.0",
    ]
    assert "** material alu: stiffness x 1.5, mass x 2.0" in text
    assert "** old modulus: 70000000000.0" in text
    assert "** old density: 2700.0" in text


def test_damping_of_the_whole_deck_stays_where_it_is(tmp_path):
    (tmp_path / "bar.inp").write_text(
        bar().replace("\n8900\n", "\n8900\n*DAMPING, ALPHA=3., BETA=2.E-6\n")
    )
    write_properties({"BRONZE": {"mass": 2.0}}, tmp_path / "bar.inp", tmp_path / "new.inp")
    text = (tmp_path / "new.inp").read_text()
    assert "17800.0" in text
    assert "*DAMPING" not in text
    assert (
        "** ALPHA and BETA apply to the whole deck: viscous damping changes with mass and"
        " stiffness." in text
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"allu": {"stiffness": 1.5}}, r"no material, spring or mass 'allu'; did you mean 'alu'"),
        (
            {"alu": {"stifness": 1.5}},
            r"group 'alu': no quantity 'stifness'; did you mean 'stiffness'",
        ),
        (
            {"alu": {"stiffness": -1.0}},
            r"group 'alu': stiffness -1.0; expected a finite number above 0",
        ),
        (
            {"alu": {"loss_factor": -0.1}},
            r"group 'alu': loss_factor -0.1; expected a finite number of at least 0",
        ),
        (
            {"alu": {"viscous": 2.0}},
            r"bar.inp:\d+: group 'alu': ALPHA and BETA apply to the whole deck",
        ),
        ({"Ground": {"mass": 2.0}}, r"bar.inp:\d+: group 'Ground' has no mass to change"),
        (
            {"Ground": {"loss_factor": 0.1}},
            r"group 'Ground': \*SPRING cannot hold a loss factor",
        ),
    ],
)
def test_changes_that_the_deck_has_no_place_for(tmp_path, changes, message):
    (tmp_path / "bar.inp").write_text(bar().replace("*BOUNDARY", SPRINGS + "*BOUNDARY"))
    with pytest.raises(FormatError, match=message):
        write_properties(changes, tmp_path / "bar.inp", tmp_path / "new.inp")
    assert not (tmp_path / "new.inp").exists()


def test_without_the_program_the_message_says_what_to_install(tmp_path):
    (tmp_path / "bar.inp").write_text(bar())
    with pytest.raises(
        OptionError,
        match=r"bar.inp: CalculiX is needed.*program 'no-such-ccx' was not found.*apt install calc",
    ):
        read_model(tmp_path / "bar.inp", ccx="no-such-ccx")
    with pytest.raises(OptionError, match=r"timeout 0; expected seconds above 0"):
        read_model(tmp_path / "bar.inp", timeout=0)


def stand_in(folder, script):
    """Write a program that behaves as the script says."""
    path = folder / "ccx-like"
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(path.stat().st_mode | stat.S_IEXEC)
    return str(path)


@pytest.mark.parametrize(
    ("script", "message"),
    [
        ("sleep 30", r"ccx exceeded its time limit of 0.3 s; increase timeout="),
        (
            "echo ' *ERROR reading *X: bad'; echo '        card'; echo; exit 201",
            r"ccx reports: reading \*X: bad card",
        ),
        (
            "echo ' *WARNING reading the input file. Card image:'; echo '   1,2'",
            r"ccx reports: .*Card image: 1,2",
        ),
        (
            "echo last words; exit 3",
            r"ccx ended by exit code 3 and wrote no matrices; its last output: last words",
        ),
        (
            "kill -SEGV $$",
            r"ccx ended by signal SIGSEGV and wrote no matrices; its last output: none",
        ),
        ("kill -KILL $$", r"ccx ended by signal SIGKILL \(out of memory\?\)"),
        (
            "echo 7.1 > job.dof; echo x > job.sti; touch job.mas",
            r"the output of ccx cannot be read: .*job.sti:1: found 'x'; expected row, column, entry",
        ),
        (
            "echo 7.4 > job.dof; touch job.sti job.mas",
            r"ccx writes the degree of freedom '7.4'",
        ),
        ("touch job.dof job.sti job.mas", r"no degree of freedom is free"),
    ],
)
def test_failures_of_the_program_are_told(tmp_path, script, message):
    (tmp_path / "bar.inp").write_text(bar())
    with pytest.raises(FormatError, match=message):
        read_model(
            tmp_path / "bar.inp",
            ccx=stand_in(tmp_path, script),
            timeout=0.3 if "sleep" in script else 30.0,
        )


@needs_ccx
def test_what_the_program_itself_refuses_is_told_in_its_words(tmp_path):
    (tmp_path / "bar.inp").write_text(
        bar().replace("*BOUNDARY", "*EQUATION\n2\n40,1,1.\n*BOUNDARY", 1)
    )
    with pytest.raises(FormatError, match=r"bar.inp: ccx reports: .*EQUATION"):
        read_model(tmp_path / "bar.inp")


@needs_ccx
def test_remarks_of_the_program_are_passed_on_once(tmp_path, recwarn):
    (tmp_path / "bar.inp").write_text(
        bar().replace("*BOUNDARY\n", CAP.replace("S1", "S2") + "*BOUNDARY\n")
    )
    read_model(tmp_path / "bar.inp")
    assert [str(w.message).count("no tied MPC generated for node 37") for w in recwarn] == [1]


@needs_ccx
def test_constraints_that_make_no_numbers_are_told(tmp_path):
    plane = "*MPC\nPLANE, 37, 38, 39, 40, 41, 42\n"  # of which ccx says nothing itself
    (tmp_path / "bar.inp").write_text(bar().replace("*BOUNDARY\n", plane + "*BOUNDARY\n"))
    with pytest.raises(
        FormatError, match=r"ccx writes numbers that are not finite; look at the constraints"
    ):
        read_model(tmp_path / "bar.inp")


@needs_ccx
def test_what_is_left_out_is_told(tmp_path):
    text = bar().replace(
        "*BOUNDARY", "*MATERIAL, NAME=spare\n*ELASTIC\n1.E9, .3\n*DENSITY\n1000.\n*BOUNDARY"
    )
    (tmp_path / "bar.inp").write_text(text)
    with pytest.warns(UpdynWarning, match=r"no element is made of material 'spare': removed"):
        assert list(read_model(tmp_path / "bar.inp").groups) == list(NAMES)
    (tmp_path / "light.inp").write_text(bar().replace("*DENSITY\n2700\n", ""))
    with pytest.warns(
        UpdynWarning, match=r"material 'alu' has no \*DENSITY: its group has no mass"
    ):
        assert read_model(tmp_path / "light.inp").groups["alu"].mass is None


@pytest.mark.parametrize("name", ["job.sti", "job.mas"])
def test_matrices_of_a_full_disk_are_refused(tmp_path, name):
    """ccx ends with code 0 all the same; of each column it writes the upper triangle, the diagonal last."""
    files = {"job.dof": "1.1\n1.2\n", "job.sti": "1 1 2.0\n1 2 -1.0\n2 2 3.0\n"}
    files["job.mas"] = "1 1 0.5\n2 2 0.25\n"
    for file, text in files.items():
        (tmp_path / file).write_text(text)
    program = CalculixProgram("ccx", 1.0, tmp_path / "bar.inp")
    found = program._read_matrices(tmp_path)
    assert found.stiffness.toarray().tolist() == [[2.0, -1.0], [-1.0, 3.0]]
    whole = files[name].splitlines(keepends=True)
    for count in range(len(whole)):
        (tmp_path / name).write_text("".join(whole[:count]))
        with pytest.raises(
            FormatError, match=r"bar\.inp: the output of ccx cannot be read: .*truncated"
        ):
            program._read_matrices(tmp_path)
