"""The reader of input decks: cards, includes, sets, elements, materials, units; messages with file and line."""

import time
import warnings
from pathlib import Path

import numpy as np
import pytest

from deck_samples import bar
from overriding import override
from updyn.dofs import DofSet
from updyn.errors import FormatError, OptionError, UpdynWarning
from updyn.io.calculix.model import read_parts
from updyn.io.consistent_units import check_materials, find_units
from updyn.io.keyword_deck.cards import format_number, read_cards
from updyn.io.keyword_deck.structure import nodes_by_shape, read_deck, read_properties
from updyn.io.settings import DECK
from updyn.shapes import unique_edges, unique_faces


def parts_of(path: Path, text: str):
    path.write_text(text)
    return read_parts(path, read_cards(path))


def test_cards_parameters_comments_and_continuation(tmp_path):
    (tmp_path / "d.inp").write_text(
        '** first\n*node, nset = "All"\n 1, 0., 1.D-1,\n\n** between\n2,1.,,\n'
        "*Solid  Section, elset=A,\n  material=Steel\n"
    )
    node, section = read_cards(tmp_path / "d.inp")
    assert (node.name, dict(node.parameters), node.line) == ("NODE", {"NSET": "All"}, 2)
    assert [(r.line, r.fields) for r in node.rows] == [
        (3, ["1", "0.", "1.D-1"]),
        (6, ["2", "1.", ""]),
    ]
    assert (section.name, dict(section.parameters)) == (
        "SOLID SECTION",
        {"ELSET": "A", "MATERIAL": "Steel"},
    )
    assert section.line == 7
    deck = read_deck(tmp_path / "d.inp", [node])
    np.testing.assert_array_equal(deck.xyz, [[0.0, 0.1, 0.0], [1.0, 0.0, 0.0]])
    np.testing.assert_array_equal(deck.nsets["ALL"], [1, 2])


def test_an_included_file_stands_in_place_and_keeps_its_lines(tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "d.inp").write_text("*NODE\n1,0,0,0\n*INCLUDE, INPUT=sub/more.inp\n2,0,0,0\n")
    (tmp_path / "sub" / "more.inp").write_text("** more\n3,0,0,0\n")
    (card,) = read_cards(tmp_path / "d.inp")
    assert [(r.line, r.fields[0]) for r in card.rows] == [(2, "1"), (2, "3"), (4, "2")]
    (tmp_path / "sub" / "more.inp").write_text("** more\nthree,0,0,0\n")
    with pytest.raises(FormatError, match=r"sub/more.inp:2: \*NODE: 'three' is not a whole number"):
        read_deck(tmp_path / "d.inp", read_cards(tmp_path / "d.inp"))


def test_nodes_of_another_file(tmp_path):
    (tmp_path / "d.inp").write_text("*NODE, NSET=a, INPUT=nodes.txt\n*NSET, NSET=b\n2\n")
    (tmp_path / "nodes.txt").write_text("1, 0., 0., 0.\n2, 1., 0., 0.\n")
    node, _ = cards = read_cards(tmp_path / "d.inp")
    assert node.text() == ["*NODE, NSET=a", "1, 0., 0., 0.", "2, 1., 0., 0."]
    np.testing.assert_array_equal(read_deck(tmp_path / "d.inp", cards).nsets["A"], [1, 2])
    (tmp_path / "nodes.txt").unlink()
    with pytest.raises(FormatError, match=r"d.inp:1: \*NODE: no such file 'nodes.txt'"):
        read_cards(tmp_path / "d.inp")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "*INCLUDE, INPUT=mesh.imp\n",
            r"d.inp:1: \*INCLUDE: no such file 'mesh.imp'; did you mean 'mesh.inp'",
        ),
        ("*INCLUDE\n", r"d.inp:1: \*INCLUDE has no INPUT="),
        (
            "*NODE\n*INCLUDE, INPUT=d.inp\n",
            r"d.inp:2: \*INCLUDE, INPUT=d.inp: the file includes itself",
        ),
        ("1, 2\n*NODE\n", r"d.inp:1: found '1, 2' before the first keyword"),
        ("** nothing\n", r"it contains no keyword"),
        (
            "*NODE\n1,0,0,0\n*NSET,\n",
            r"d.inp:3: the file ends after a keyword line with a trailing comma",
        ),
    ],
)
def test_files_that_are_no_decks(tmp_path, text, message):
    (tmp_path / "mesh.inp").write_text("*NODE\n")
    (tmp_path / "d.inp").write_text(text)
    with pytest.raises(FormatError, match=message):
        read_cards(tmp_path / "d.inp")


def test_what_the_bar_is_made_of(tmp_path):
    _, step, deck, parts = parts_of(tmp_path / "bar.inp", bar())
    assert list(parts) == ["STEEL", "ALU", "BRONZE"]
    assert [p.name for p in parts.values()] == ["Steel", "alu", "BRONZE"]
    np.testing.assert_array_equal(deck.elements_of("alu"), [5, 6, 7, 8])
    np.testing.assert_array_equal(deck.nsets["FIXED"], [1, 2, 3, 4, 5, 6])
    assert parts["ALU"].values("stiffness") == [7e10]
    assert parts["ALU"].values("mass") == [2700.0]
    assert step == ["*STEP", "*FREQUENCY, SOLVER=MATRIXSTORAGE", "*END STEP"]
    # 6 x 2 bricks side by side: 6*3*2 edges along X, 7*2*2 along Y, 7*3 along Z.
    edges = unique_edges(nodes_by_shape(deck))
    assert len(edges) == 36 + 28 + 21
    assert np.isin(deck.nodes, edges).all()
    assert (
        len(unique_faces(nodes_by_shape(deck))) == 2 * 12 + 2 * 6 + 2 * 2
    )  # above and below, along, ends


def test_supports_of_the_step_come_along_and_its_loads_do_not(tmp_path):
    step = (
        "*STEP",
        "*STATIC",
        "*BOUNDARY, OP=NEW",
        "Fixed, 1",
        "*CLOAD",
        "42, 3, 1.",
        "*NODE FILE",
        "U",
        "*END STEP",
    )
    assert parts_of(tmp_path / "bar.inp", bar(step=step))[1] == [
        "*STEP",
        "*BOUNDARY, OP=NEW",
        "Fixed, 1",
        "*FREQUENCY, SOLVER=MATRIXSTORAGE",
        "*END STEP",
    ]


def test_a_long_element_goes_on_in_the_next_line_and_sets_hold_sets(tmp_path):
    nodes = "\n".join(f"{i},{i}.,0,0" for i in range(1, 21))
    first, last = ",".join(map(str, range(1, 16))), ",".join(map(str, range(16, 21)))
    text = (
        f"*NODE\n{nodes}\n*ELEMENT, TYPE=C3D20R, ELSET=A\n7,{first},\n{last}\n*ELSET, ELSET=B\nA\n"
    )
    text += (
        "*MATERIAL, NAME=M\n*ELASTIC\n1.,.3\n*DENSITY\n1.\n*SOLID SECTION, ELSET=B, MATERIAL=M\n"
    )
    deck = parts_of(tmp_path / "d.inp", text)[2]
    np.testing.assert_array_equal(deck.elements[0].nodes, [range(1, 21)])
    np.testing.assert_array_equal(deck.elsets["B"], [7])


FAULTS = [
    ("*BOUNDARY\n", "*BOUNDRY\n", r"unknown keyword \*BOUNDRY; did you mean 'BOUNDARY'"),
    ("Material=alu", "Material=al", r"\*SOLID SECTION: no material 'al'; did you mean 'ALU'"),
    ("Elset=PART2", "Elset=PRT2", r"\*SOLID SECTION: no element set 'PRT2'; did you mean 'PART2'"),
    (
        "Elset=PART2",
        "Elset=PART1",
        r"\*SOLID SECTION: element 1 is in 'PART1' \(line \d+\) and in 'PART1'",
    ),
    (
        "*Solid section, Elset=PART2, Material=alu\n",
        "",
        r"\*ELEMENT: element 5 has no \*SOLID SECTION \(4 such\)",
    ),
    (
        "TYPE=C3D8",
        "TYPE=C3D9",
        r"bar.inp:\d+: \*ELEMENT: type 'C3D9' is not supported; did you mean",
    ),
    (
        "TYPE=C3D8",
        "TYPE=S4R",
        r"S4R is a shell, membrane or plane element: it is expanded into solids",
    ),
    ("TYPE=C3D8", "TYPE=B31", r"B31 is a beam or truss: it is expanded into solids"),
    ("TYPE=C3D8", "TYPE=C3D4", r"bar.inp:48: \*ELEMENT: 8 nodes; C3D4 has 4"),
    (
        "*NSET, NSET=Fixed",
        "*SHELL SECTION, ELSET=A\n0.1\n*NSET, NSET=Fixed",
        r"\*SHELL SECTION is not supported: beams and",
    ),
    (
        "*NSET, NSET=Fixed",
        "*DISTRIBUTING\n*NSET, NSET=Fixed",
        r"\*DISTRIBUTING is not supported: the matrices do not contain its reference node",
    ),
    (
        "*NSET, NSET=Fixed",
        "*PLASTIC\n1.,0.\n*NSET, NSET=Fixed",
        r"\*PLASTIC: expected only linear elastic materials",
    ),
    (
        "*NSET, NSET=Fixed",
        "*DENSITY\n1.\n*NSET, NSET=Fixed",
        r"\*DENSITY does not follow a \*MATERIAL",
    ),
    ("2.1e+11", "2.le+11", r"bar.inp:\d+: \*ELASTIC: '2.le\+11' is not a number"),
    (
        "2.1e+11",
        "000000000210000000000.",
        r"'000000000210000000000.' has 22 characters; expected at most 20",
    ),
    (
        "Fixed, 1, 3",
        "Fixed, 1, 3, 0.001",
        r"\*BOUNDARY: found 'Fixed, 1, 3, 0.001'; expected a support at 0",
    ),
    ("1, 6, 1", "6, 1, 1", r"\*NSET, GENERATE: 6 to 1 by 1 is empty"),
    (", GENERATE\n1, 6, 1", "\n1, Nal", r"\*NSET: no set 'Nal' so far; did you mean 'NALL'"),
    (
        "*ELASTIC\n7",
        "*ELASTIC, TYPE=ORTO\n7",
        r"\*ELASTIC: TYPE=ORTO is not supported; did you mean 'ORTHO'",
    ),
    ("\n3, 0, 0.02, 0", "\n2, 0, 0.02, 0", r"\*NODE: node 2 is defined twice"),
    (
        "\n3, 0, 0.02, 0",
        "\n333, 0, 0.02, 0",
        r"bar.inp:48: \*ELEMENT: element 1 refers to node 3, which is not in the deck",
    ),
    ("\n2, 3, 9", "\n1, 3, 9", r"bar.inp:49: \*ELEMENT: element 1 is defined twice"),
    (
        "NAME=alu",
        "NAME=al.6061",
        r"material 'al.6061' contains '.', which is reserved in names",
    ),
    ("NAME=alu", "NAME=steel", r"\*MATERIAL: 'steel' is defined twice, also on line"),
    (
        "*STEP",
        "*STEP\n*STATIC\n*END STEP\n*STEP, PERTURBATION",
        r"\*STEP, PERTURBATION after another step: preload stiffness",
    ),
]


@pytest.mark.parametrize(("old", "new", "message"), FAULTS)
def test_faults_name_file_and_line(tmp_path, old, new, message):
    assert old in bar()
    with pytest.raises(FormatError, match=message) as caught:
        doubled(tmp_path / "bar.inp", bar().replace(old, new, 1))
    assert "bar.inp" in str(caught.value)


def doubled(path, text):
    return [part.scale_cards(2.0, 2.0) for part in parts_of(path, text)[3].values()]


def test_moduli_of_each_kind_of_elasticity(tmp_path):
    kinds = {
        "ISO": ("2., .3\n3., .3, 100.", "4.0, .3\n6.0, .3, 100."),
        "ENGINEERING CONSTANTS": (
            "1.,2.,3.,.1,.2,.3,4.,5.\n6.,20.",
            "2.0, 4.0, 6.0, .1, .2, .3, 8.0, 10.0\n12.0, 20.",
        ),
        "ORTHO": (
            "1.,2.,3.,4.,5.,6.,7.,8.\n9.,20.",
            "2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0, 16.0\n18.0, 20.",
        ),
    }
    for kind, (old, new) in kinds.items():
        path = tmp_path / "m.inp"
        path.write_text(
            f"*MATERIAL, NAME=m\n*ELASTIC, TYPE={kind}\n{old}\n*DENSITY\n5.\n*EXPANSION\n1e-5\n"
        )
        (part,) = read_properties(read_cards(path)).values()
        lines = [line for card in part.scale_cards(2.0, 3.0) for line in card.text()]
        assert lines == [
            "*MATERIAL, NAME=m",
            f"*ELASTIC, TYPE={kind}",
            *new.split("\n"),
            "*DENSITY",
            "15.0",
            "*EXPANSION",
            "1e-5",
        ]


@pytest.mark.parametrize(
    "value", [0.3, 7850, 2.1e11 / 3, 1 / 3e9, -1.2345678901234567e-100, 5e-324, 1.7e308, 1e22]
)
def test_numbers_fit_twenty_characters(value):
    text = format_number(value)
    assert len(text) <= 20
    assert "." in text
    assert float(text) == pytest.approx(value, rel=1e-12, abs=0)


def test_units_become_si():
    dofs = DofSet(["1:X", "1:RX"])
    one = np.ones((2, 2))
    np.testing.assert_allclose(
        find_units("mm").to_si(one, dofs).toarray(), [[1e3, 1.0], [1.0, 1e-3]], rtol=1e-14
    )
    inch = find_units("in").to_si(one, dofs).toarray()
    # 1 lbf/in = 175.126835 N/m, 1 lbf = 4.4482216 N, 1 lbf in = 0.112984829 N m (NIST SP 811,
    # appendix B.8).
    np.testing.assert_allclose(
        inch, [[175.126835, 4.4482216152605], [4.4482216152605, 0.112984829]], rtol=1e-8
    )
    assert find_units("mm").pressure == pytest.approx(1e6)
    assert find_units("mm").density == pytest.approx(1e12)  # t/mm3
    assert find_units("in").pressure == pytest.approx(6894.757, rel=1e-7)
    with pytest.raises(OptionError, match=r"unit 'cm'; .*Consistent units: 'm' \(m, N, kg\)"):
        find_units("cm")


@pytest.mark.parametrize(
    ("unit", "E", "rho", "hint"),
    [
        ("m", 210000.0, 7.85e-9, r"they fit unit = 'mm'"),
        ("mm", 2.1e11, 7850.0, r"they fit unit = 'm'"),
        ("m", 3.0e7, 7.3e-4, r"they fit unit = 'in'"),
        ("mm", 210000.0, 7850.0, r"units are mixed"),
        ("m", 210000.0, 7850.0, r"units are mixed"),
        ("m", None, 7.85e-9, r"they fit unit = 'mm'"),
    ],
)
def test_materials_that_are_no_solids_in_the_unit_stated(unit, E, rho, hint):
    with pytest.warns(
        UpdynWarning, match=rf"material 'a': .*not plausible in unit = '{unit}' .*{hint}"
    ):
        check_materials([("a", E, rho)], find_units(unit), "d.inp")


def test_materials_that_are_solids():
    solids = [
        ("steel", 2.1e11, 7850.0),
        ("rubber", 1e6, 1100.0),
        ("foam", 1e5, 30.0),
        ("diamond", 1.05e12, 3500.0),
    ]
    check_materials([*solids, ("massless", 2e11, None)], find_units("m"), "d.inp")
    check_materials([("steel", 2.1e5, 7.85e-9)], find_units("mm"), "d.inp")
    check_materials([("steel", 3.0e7, 7.3e-4)], find_units("in"), "d.inp")


@pytest.mark.parametrize(
    ("modulus", "density", "is_solid"),
    [
        (1.1e4, None, True),
        (0.9e4, None, False),
        (1.9e12, None, True),
        (2.1e12, None, False),
        (None, 1.1, True),
        (None, 0.9, False),
        (None, 2.9e4, True),
        (None, 3.1e4, False),
        (1e3 * 11.0**2, 1e3, True),  # wave speed in m/s
        (1e3 * 9.0**2, 1e3, False),
        (1e2 * 2.9e4**2, 1e2, True),
        (1e2 * 3.1e4**2, 1e2, False),
    ],
)
def test_the_ranges_of_solids(modulus, density, is_solid):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_materials([("a", modulus, density)], find_units("m"), "d.inp")
    assert (not caught) is is_solid


def timed(limit=5.0):
    """Return a function that fails if more seconds have passed since."""
    start = time.monotonic()

    def check():
        assert time.monotonic() - start < limit

    return check


def with_sets(*lines, after="*NSET, NSET=Fixed"):
    return bar().replace(after, "\n".join([*lines, after]), 1)


def test_generate_makes_members_of_what_there_is(tmp_path):
    check = timed()
    lines = ["*NSET, NSET=big, GENERATE", "2, 1000000000, 2", "*NSET, NSET=none, GENERATE"]
    lines += ["1000, 2000", "*ELSET, ELSET=all, GENERATE", "1, 1000000000"]
    model, _, deck, _ = parts_of(tmp_path / "bar.inp", with_sets(*lines))
    np.testing.assert_array_equal(deck.nsets["BIG"], np.arange(2, 43, 2))
    np.testing.assert_array_equal(deck.elsets["ALL"], np.arange(1, 13))
    assert not len(deck.nsets["NONE"])
    # What is handed to ccx ends with the last node and the last element.
    sets = {
        c.require(c.name): [r.text for r in c.rows] for c in model if c.name in ("NSET", "ELSET")
    }
    assert sets["big"] == ["2, 42, 2"]
    assert sets["all"] == ["1, 12, 1"]
    assert sets["none"] == []
    assert sets["Fixed"] == ["1, 6, 1"]
    check()


@pytest.mark.parametrize("kind", ["NSET", "ELSET"])
def test_sets_that_double_themselves_hold_each_member_once(tmp_path, kind):
    check = timed()
    lines = [f"*{kind}, {kind}=s0", "1, 2, 3, 4"]
    for n in range(1, 41):
        lines += [f"*{kind}, {kind}=s{n}", f"s{n - 1}, s{n - 1}"]
    model, _, deck, _ = parts_of(tmp_path / "bar.inp", with_sets(*lines))
    found = deck.nsets if kind == "NSET" else deck.elsets
    np.testing.assert_array_equal(found["S40"], [1, 2, 3, 4])
    last = [card for card in model if card.get(kind) == "s40"]
    assert [row.text for row in last[0].rows] == ["1, 2, 3, 4"]
    check()


def test_sets_have_a_limit_that_names_the_line(tmp_path, monkeypatch):
    override(monkeypatch, DECK, set_members=100)
    lines = ["*NSET, NSET=all, GENERATE", "1, 42", "*NSET, NSET=a", "all", "*NSET, NSET=b", "all"]
    with pytest.raises(
        FormatError, match=r"bar.inp:\d+: \*NSET: the sets up to here have more than 100"
    ):
        parts_of(tmp_path / "bar.inp", with_sets(*lines))
    parts_of(tmp_path / "bar.inp", with_sets(*lines[:4]))


def test_files_that_double_are_refused_soon(tmp_path):
    check = timed()
    for n in range(15):
        include = f"*INCLUDE, INPUT=f{n + 1}.inp\n"
        (tmp_path / f"f{n}.inp").write_text(include + include)
    (tmp_path / "f15.inp").write_text("*NODE\n1,0,0,0\n")
    with pytest.raises(
        FormatError, match=r"f\d+.inp:\d: \*INCLUDE, INPUT=.*: more than \d+ repeated inclusions"
    ):
        read_cards(tmp_path / "f0.inp")
    for n in range(15, 25):
        (tmp_path / f"f{n}.inp").write_text(f"*INCLUDE, INPUT=f{n + 1}.inp\n")
    for n in range(15):
        (tmp_path / f"f{n}.inp").write_text(f"*INCLUDE, INPUT=f{n + 1}.inp\n")
    with pytest.raises(FormatError, match=r"nested 20 levels deep"):
        read_cards(tmp_path / "f0.inp")
    check()
