"""Descriptions, by the numbers in them."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np

from updyn.cli.describe import (
    describe_frf,
    describe_identifiability,
    describe_model,
    describe_modes,
)
from updyn.cli.reading import read_anything
from updyn.frf import FRF
from updyn.geometry import Geometry
from updyn.grouping import GroupOrigin
from updyn.io import write_modes
from updyn.modal import ModeSet
from updyn.model import Group, Model
from updyn.updating.judge.identifiability import Identifiability


def test_a_model_with_rotations_grounding_and_dampers() -> None:
    shaft = Group(np.array([[5.0, -5.0], [-5.0, 5.0]]) * 1e3, np.diag([2.0, 0.0]), loss_factor=0.01)
    motor = Group(mass=np.diag([0.0, 0.25]), viscous=np.diag([0.0, 7.5]))
    model = Model.from_groups({"shaft": shaft, "motor": motor}, ["1:RZ", "2:RZ"])
    text = describe_model(model)
    rows = {
        line.split()[0]: line.split()[1:]
        for line in text.splitlines()
        if line.startswith(("shaft", "motor"))
    }
    assert rows == {
        "shaft": ["2", "2", "kg", "m2", "5000", "0.01", "-"],
        "motor": ["1", "0.25", "kg", "m2", "-", "-", "7.5"],
    }
    assert "2 DOFs, 2 groups, directions RZ" in text
    free = np.sqrt(5e3 * (1 / 2.0 + 1 / 0.25)) / (2 * np.pi)
    assert text.splitlines()[-1] == f"Natural frequencies (Hz): 0, {free:.5g}"


def masses(model: Model) -> dict[str, float]:
    """Return the masses in the table of groups by group, in kg."""
    found = {}
    for line in describe_model(model).splitlines():
        if line.split()[:1] and line.split()[0] in model.groups:
            found[line.split()[0]] = float(line.split()[2])
    return found


def test_displacements_of_nodes_without_position_are_not_translations() -> None:
    # A bar of 6 kg with a bubble function of mass 8/15 of the bar, as in C3D8I.
    M = 6.0 * np.array([[1 / 3, 1 / 6, 1 / 3], [1 / 6, 1 / 3, 1 / 3], [1 / 3, 1 / 3, 8 / 15]])
    K = np.array([[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 16 / 3]])
    geometry = Geometry([1, 2], np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    labels = ["1:X", "2:X", "3:X"]
    model = Model.from_groups({"bar": Group(K, M)}, labels, geometry=geometry)
    assert masses(model) == {"bar": 6.0}
    assert "node 3 has no position" in describe_model(model)
    assert "no position" not in describe_model(Model.from_groups({"bar": Group(K, M)}, labels))


def test_a_model_whose_nodes_all_lack_a_position_has_its_mass() -> None:
    geometry = Geometry([7], np.zeros((1, 3)))
    chain = {"chain": Group(np.eye(2), np.diag([2.0, 3.0]))}
    assert masses(Model.from_groups(chain, ["1:X", "2:X"], geometry=geometry)) == {"chain": 5.0}


def test_mass_of_nodes_with_displacement_directions() -> None:
    # A bar of 6 kg, consistent mass; node 2 is turned by 90 degrees about Z.
    blocks = np.kron(np.array([[2.0, 1.0], [1.0, 2.0]]), np.eye(2))
    turn = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    T = np.eye(4)
    T[2:, 2:] = turn[:2, :2]
    M = T @ blocks @ T.T
    geometry = Geometry(
        [1, 2], np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), axes=np.array([np.eye(3), turn])
    )
    model = Model.from_groups(
        {"bar": Group(np.eye(4), M)}, ["1:X", "1:Y", "2:X", "2:Y"], geometry=geometry
    )
    assert masses(model) == {"bar": 6.0}


def test_a_model_that_has_no_modes_is_described_all_the_same() -> None:
    model = Model.from_groups({"a": Group(np.eye(2))}, ["1:X", "2:X"])
    assert describe_model(model).splitlines()[-1].startswith("Natural frequencies: ")


def test_what_a_measurement_says_of_its_confidence() -> None:
    values = np.array([3.0, 4.0j, -5.0]).reshape(3, 1, 1)
    coherence = np.array([0.5, 0.9, 0.8]).reshape(3, 1, 1)
    geometry = Geometry([1, 2], np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]]))
    frf = FRF(
        [1.0, 2.0, 4.0],
        values,
        ["1:-Z"],
        ["2:Z"],
        "mobility",
        coherence,
        averages=7,
        geometry=geometry,
    )
    assert describe_frf(frf).splitlines() == [
        "FRF: mobility, 3 lines from 1 to 4 Hz, 1 to 2 Hz apart",
        "1 responses: 1:-Z",
        "1 references: 2:Z",
        "|H| from 3 to 5",
        "coherence: median 0.800, lowest 0.500",
        "7 averages",
        "Geometry: 2 nodes, 0 lines to draw, in m: X 0 to 1, Y 0 to 2, Z 0 to 3",
    ]
    one = FRF([2.0], values[:1], ["1:Z"], ["2:Z"], "mobility", variance=np.ones((1, 1, 1)))
    assert describe_frf(one).splitlines()[0] == "FRF: mobility, 1 lines from 2 to 2 Hz"
    assert describe_frf(one).splitlines()[-1] == "with the variance of each value"


def test_the_excitation_of_frfs():
    values, lines = np.ones((2, 1, 1)), [1.0, 4.0]
    swept = FRF(lines, values, ["1:Z"], ["2:Z"], "mobility", decay=0.5, level=3.0, sweep="up")
    assert describe_frf(swept).splitlines()[-2:] == ["window exp(-0.5 t)", "level 3 N up"]
    noise = FRF(lines, values, ["1:Z"], ["2:Z"], "mobility", level=3.0, excitation="random")
    shown = "level 3 N random, with a spectrum from 1 to 4 Hz"
    assert describe_frf(noise).splitlines()[-1] == shown
    base = FRF(lines, values, ["1:Z"], ["2:Z"], "transmissibility", base=["2:Z", "3:Z"])
    assert describe_frf(base).splitlines()[-1] == "base: 2:Z, 3:Z"
    force = FRF(lines, values, ["1:Z"], ["2:Z"], "transmissibility", force="3:Z")
    assert describe_frf(force).splitlines()[-1] == "force: 3:Z"


def test_open_combinations_are_named_largest_weight_first() -> None:
    found = Identifiability(
        2, 3, np.inf, (1.0, 0.5, 0.0), [{"a.mass": 0.2, "b.mass": -1.0}], [], 2e9, "Measure b."
    )
    assert describe_identifiability(found).splitlines() == [
        "The data determine 2 of 3 unknowns (condition inf, collinearity index 2e+09).",
        "  undetermined combination 1: -1 b.mass, +0.2 a.mass",
        "Measure b.",
    ]


def test_modes_of_a_file_are_told(tmp_path: Path) -> None:
    modes = ModeSet(
        [10.0, 20.5],
        [[1.0, 1.0], [0.5, 1.0]],
        ["1:X", "2:X"],
        [0.01, np.nan],
        [True, False],
        [0.995, np.nan],
        std_frequency=[0.02, np.nan],
        std_loss_factor=[0.003, np.nan],
    )
    write_modes(modes, tmp_path / "modes.unv")
    kind, content = read_anything(tmp_path / "modes.unv")
    assert kind == "modes"
    assert describe_modes(content).splitlines() == [
        "Modes: 2 from 10 to 20.5 Hz",
        "2 DOFs: 1:X, 2:X",
        "mode  frequency (Hz)   std  loss factor    std      scale  phase collinearity  quality",
        "1                 10  0.02         0.01  0.003  unit mass               1.000   0.9950",
        "2               20.5     -            -      -        any               1.000        -",
    ]


def many_groups(n: int) -> Model:
    """Return a model of n springs, four of them of another family, and a mass."""
    groups = {f"PELAS {k}": Group([[float(k)]], [[1.0]]) for k in range(1, n - 4)}
    groups |= {f"PBUSH {k}": Group([[float(k)]]) for k in (7, 3, 5, 9)}
    mass = Group(mass=[[1.0]]).with_origin(GroupOrigin(labels=("MAT1 3", "SET 5")))
    return Model.from_groups({**groups, "mass": mass}, ["1:X"])


def test_merging_of_many_groups_is_shown() -> None:
    lines = describe_model(many_groups(31)).splitlines()
    assert '[model] groups = { pelas = "PELAS 1-26", pbush = "PBUSH 3-9" }' in lines
    assert "materials and sets: MAT1 3, SET 5" in lines
    assert "[model] groups" not in describe_model(many_groups(30))


def test_the_example_of_merging_is_valid_toml() -> None:
    groups = {f'größe "{k}': Group([[1.0]]) for k in range(31)}
    text = describe_model(Model.from_groups(groups, ["1:X"]))
    (line,) = (line for line in text.splitlines() if line.startswith("[model] groups"))
    example = tomllib.loads(line.removeprefix("[model] "))
    assert list(example["groups"].values()) == ['größe "0-30']


def test_members_of_a_merged_group_are_shown() -> None:
    model = many_groups(31).merge_groups({"bushes": "PBUSH *"})
    text = describe_model(model)
    assert "bushes consists of PBUSH 7, PBUSH 3, PBUSH 5, PBUSH 9" in text.splitlines()
    assert "[model] groups" not in text
