"""IASC-ASCE benchmark, phase I, 12-DOF shear building: missing braces are found from noisy FRFs at four sensors.

Johnson, Lam, Katafygiotis & Beck, J. Eng. Mech. 130 (2004) 3; numbers in
tests/data/cases/iasc_asce.json."""

from __future__ import annotations

import json

import numpy as np
import pytest

import updyn
from places import DATA

CASE = json.loads((DATA / "cases" / "iasc_asce.json").read_text(encoding="utf-8"))
STOREY = {"x": "x_N_m", "y": "y_N_m", "theta": "theta_Nm_rad"}
DIRECTIONS = ("x", "y", "theta")
NOISE = 0.05


def building() -> updyn.Model:
    """The undamaged building: floors as masses, a storey in each direction as a group of its own."""
    labels = [f"{floor}:{d}" for floor in range(1, 5) for d in ("X", "Y", "RZ")]
    groups = {}
    for storey in range(4):
        for i, name in enumerate(DIRECTIONS):
            K = np.zeros((12, 12))
            upper, lower = 3 * storey + i, 3 * (storey - 1) + i
            K[upper, upper] = 1.0
            if storey:
                K[lower, lower] = 1.0
                K[lower, upper] = K[upper, lower] = -1.0
            k = CASE["storey_stiffness"][STOREY[name]]
            groups[f"storey {storey + 1} {name}"] = updyn.Group(k * K, loss_factor=0.02)
        J = CASE["inertia_kg_m2"][storey]
        diagonal = np.zeros(12)
        diagonal[3 * storey : 3 * storey + 3] = [
            CASE["mass_kg"][storey],
            CASE["mass_kg"][storey],
            J,
        ]
        groups[f"floor {storey + 1}"] = updyn.Group(mass=np.diag(diagonal))
    return updyn.Model.from_groups(groups, labels)


#: Factors on the storeys' stiffness: four braces of a storey carry each of x and y.
SHARE = {
    d: 1.0 - 4.0 * CASE["one_brace_N_m"] / CASE["storey_stiffness"][STOREY[d]] for d in ("x", "y")
}
PATTERNS = {
    "damage_1_no_braces_in_storey_1": {1},
    "damage_2_no_braces_in_storeys_1_and_3": {1, 3},
}


def damaged(storeys: set[int]) -> updyn.Model:
    changes = {f"storey {s} {d}": {"stiffness": SHARE[d]} for s in storeys for d in ("x", "y")}
    return building().scaled(changes)


def test_natural_frequencies_of_the_table() -> None:
    printed = [f for d in DIRECTIONS for f in CASE["frequencies_hz"][d]]
    assert updyn.modes(building(), 12).frequency == pytest.approx(sorted(printed), abs=0.006)
    for pattern, storeys in PATTERNS.items():
        found = updyn.modes(damaged(storeys), 12).frequency
        for f in [f for d in ("x", "y") for f in CASE[pattern]["frequencies_hz"][d]]:
            assert np.abs(found - f).min() < 0.006
    first = CASE["damage_1_no_braces_in_storey_1"]
    for d in ("x", "y"):
        whole = CASE["storey_stiffness"][STOREY[d]]
        assert whole * SHARE[d] == pytest.approx(first[f"storey_1_{d}_N_m"], rel=1e-3)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_missing_braces_are_found(pattern: str) -> None:
    """Stiffness and loss factor of every storey in x and y, from four sensors and two forces, 5 % noise."""
    storeys = PATTERNS[pattern]
    sensors, forces = ["2:X", "4:X", "2:Y", "4:Y"], ["4:X", "4:Y"]
    exact = updyn.response(
        damaged(storeys), np.linspace(2.0, 65.0, 400), sensors, forces, "accelerance"
    )
    draw = np.random.default_rng(2004).standard_normal((2, *exact.values.shape))
    values = exact.values * (1.0 + NOISE * np.sqrt(0.5) * (draw[0] + 1j * draw[1]))
    frf = updyn.FRF(exact.freq, values, sensors, forces, "accelerance")
    model = building()
    unknowns = updyn.parameters(
        model, stiffness=["storey ? x", "storey ? y"], loss_factor=["storey ? x", "storey ? y"]
    )
    result = updyn.update(model, frf, unknowns)
    assert result.ok, result.summary()
    for s in range(1, 5):
        for d in ("x", "y"):
            table = CASE["storey_stiffness"][STOREY[d]] * (SHARE[d] if s in storeys else 1.0)
            found = CASE["storey_stiffness"][STOREY[d]] * result.values[f"storey {s} {d}.stiffness"]
            assert found == pytest.approx(table, rel=0.01), (s, d)
            assert result.std[f"storey {s} {d}.stiffness"] < 0.01


def test_a_building_that_is_far_off_is_found():
    """Storeys up to eight times too stiff or too soft, in a start whose first tries agree on a wrong answer."""
    true = damaged({1})
    chosen = ["storey ? x", "storey ? y"]
    clean = updyn.response(
        true,
        np.linspace(2.0, 65.0, 120),
        ["2:X", "4:X", "2:Y", "4:Y"],
        ["4:X", "4:Y"],
        "accelerance",
    )
    names = [p.group for p in updyn.parameters(true, stiffness=chosen)]
    factors = np.exp(np.random.default_rng(1010).uniform(-1.0, 1.0, len(names)) * np.log(8.0))
    start = true.scaled(
        {n: {"stiffness": f, "loss_factor": 0.0} for n, f in zip(names, factors, strict=True)}
    )
    unknowns = updyn.parameters(start, stiffness=chosen, loss_factor=chosen)
    found = updyn.update(start, clean, unknowns)
    assert [found.values[f"{n}.stiffness"] for n in names] == pytest.approx(1.0 / factors, rel=1e-6)
