"""Several tests of one structure: what one test leaves open two determine, and the sums are those of the parts."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import updyn
from updyn.errors import InputError
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import LogError

#: A motor on a shaft to a load: inertias in kg m2, stiffness in N m/rad.
MOTOR, LOAD, SHAFT = 0.02, 0.5, 900.0
NAMES = ["motor.mass", "shaft.stiffness", "shaft.loss_factor", "load.mass"]


def train(locked: bool) -> updyn.Model:
    """The drive with its rotor free, or held."""
    spring = SHAFT * np.array([[1.0, -1.0], [-1.0, 1.0]])
    groups = {
        "motor": updyn.Group(mass=np.diag([MOTOR, 0.0])),
        "shaft": updyn.Group(spring, loss_factor=0.02),
        "load": updyn.Group(mass=np.diag([0.0, LOAD])),
    }
    if not locked:
        return updyn.Model.from_groups(groups, ["1:RZ", "2:RZ"])
    held = {
        "shaft": updyn.Group([[SHAFT]], loss_factor=0.02),
        "load": updyn.Group(mass=[[LOAD]]),
    }
    return updyn.Model.from_groups(held, ["2:RZ"])


CHANGES = {
    "motor": {"mass": 1.3},
    "shaft": {"stiffness": 0.8, "loss_factor": 0.05},
    "load": {"mass": 1.1},
}
BANDS = {True: np.linspace(2.0, 15.0, 50), False: np.linspace(10.0, 70.0, 70)}


def measured(locked: bool, noise: float = 0.0, seed: int = 0) -> updyn.FRF:
    model = train(locked)
    truth = model.scaled({g: c for g, c in CHANGES.items() if g in model.groups})
    sensors = ["2:RZ"]
    frf = updyn.response(truth, BANDS[locked], sensors, ["2:RZ"] if locked else ["1:RZ"])
    draw = np.random.default_rng(seed).standard_normal((2, *frf.values.shape))
    values = frf.values * (1.0 + noise * np.sqrt(0.5) * (draw[0] + 1j * draw[1]))
    return updyn.FRF(frf.freq, values, frf.responses, frf.references, "receptance")


def both(noise: float = 0.0, seed: int = 0) -> list[updyn.Test]:
    return [
        updyn.Test(train(True), measured(True, noise, seed), "rotor locked"),
        updyn.Test(train(False), measured(False, noise, seed + 1), "rotor free"),
    ]


def unknowns() -> updyn.updating.problem.parameters.ParameterSet:
    return updyn.parameters(
        train(False), stiffness="shaft", mass=["motor", "load"], loss_factor="shaft"
    )


TRUE = {"motor.mass": 1.3, "shaft.stiffness": 0.8, "shaft.loss_factor": 0.05, "load.mass": 1.1}


def test_both_together_find_what_the_locked_rotor_cannot() -> None:
    result = updyn.update_jointly(both(), unknowns())
    assert result.ok, result.summary()
    assert result.values == pytest.approx(TRUE, rel=1e-8)
    assert list(result.results) == ["rotor locked", "rotor free"]
    for locked, name in ((True, "rotor locked"), (False, "rotor free")):
        one = result[name]
        assert one.model.dofs == train(locked).dofs
        assert one.correlation["after"]["frac_min"] == pytest.approx(1.0, abs=1e-10)
        assert one.model.group("shaft").loss_factor == pytest.approx(0.05)
    assert "motor" not in result["rotor locked"].model.groups
    text = result.summary()
    assert text.count("motor.mass") == 1
    for name in result.results:
        table = text.split(f"\n\n{name}\n")[1].splitlines()
        assert table[0].split() == ["agreement", "before", "after"]
        assert table[1].split()[-1] in ("1.0000", ">0.9999")
    assert text.count("agreement") == 2


@pytest.mark.parametrize("method", ["log", "output-error"])
def test_other_methods(method: str) -> None:
    near = unknowns().with_start(
        {"motor.mass": 1.28, "shaft.stiffness": 0.81, "shaft.loss_factor": 0.045}
    )
    result = updyn.update_jointly(both(), near, method)
    assert result.values == pytest.approx(TRUE, rel=1e-6)


def test_the_sum_is_that_of_the_parts() -> None:
    chosen, x = unknowns(), np.array([0.1, -0.1, 0.03, 0.05])
    parts = [FRFPart.build(t.model, t.frf, chosen, name=t.name) for t in both(0.01)]
    sum_ = LogError().local(Problem(tuple(parts)), x)
    each = [LogError().local(Problem.of([part]), x) for part in parts]
    assert sum_.cost == pytest.approx(sum(e.cost for e in each), rel=1e-12)
    np.testing.assert_allclose(
        sum_.R.T @ sum_.R, sum(e.R.T @ e.R for e in each), rtol=1e-10, atol=1e-10
    )
    np.testing.assert_allclose(
        sum_.R.T @ sum_.q, sum(e.R.T @ e.q for e in each), rtol=1e-10, atol=1e-10
    )
    assert not each[0].R[:, 0].any()  # the motor is not in the model of the locked rotor


def test_noise_is_each_test_s_own_and_errors_are_as_stated() -> None:
    off = []
    for seed in range(0, 40, 2):
        result = updyn.update_jointly(both(0.02, seed), unknowns(), starts=0)
        off.append([(result.values[n] - TRUE[n]) / result.std[n] for n in NAMES])
    rms = np.sqrt(np.mean(np.square(off)))
    assert 0.75 < rms < 1.3  # 80 values: a standard error of 8 %
    noisy = [
        updyn.Test(train(True), measured(True, 0.05), "a"),
        updyn.Test(train(False), measured(False, 0.005), "b"),
    ]
    result = updyn.update_jointly(noisy, unknowns())
    assert result["a"].noise["relative"] == pytest.approx(0.05, rel=0.3)
    assert result["b"].noise["relative"] == pytest.approx(0.005, rel=0.3)


def test_one_test_is_a_plain_update() -> None:
    frf = measured(False, 0.01)
    joint = updyn.update_jointly([updyn.Test(train(False), frf)], unknowns())
    plain = updyn.update(train(False), frf, unknowns())
    assert joint.values == plain.values
    assert joint.std == plain.std
    assert list(joint.results) == ["test 1"]


def test_lines_noise_and_validation_are_each_test_s_own(tmp_path) -> None:
    first, second = both(0.01)
    chosen = [
        updyn.Test(first.model, first.frf, "a", lines="d-optimal:12", noise={"relative": 0.01}),
        updyn.Test(second.model, second.frf, "b", validation=(30.0, 40.0)),
    ]
    journal = tmp_path / "run.journal"
    result = updyn.update_jointly(chosen, unknowns(), checkpoint=journal)
    assert len(result["a"].lines) == 12
    assert result["a"].noise["kind"] == "stated"
    assert result["b"].validation_band == (30.0, 40.0)
    assert len(result["b"].lines) < len(second.frf.freq)
    again = updyn.update_jointly(chosen, unknowns(), checkpoint=journal, resume=True)
    assert again.values == result.values


def test_the_reduced_tier_and_processes_give_the_same() -> None:
    exact = updyn.update_jointly(both(0.01), unknowns())
    reduced = updyn.update_jointly(both(0.01), unknowns(), tier="reduced")
    assert reduced["rotor free"].options["tier"] == "reduced"
    assert reduced.values == pytest.approx(exact.values, rel=1e-4)
    spread = updyn.update_jointly(both(0.01), unknowns(), engine=2)
    assert spread.values == exact.values


def test_what_is_open_in_all_tests_is_said_with_the_test_that_would_cure_it() -> None:
    locked = [
        updyn.Test(train(True), measured(True), "a"),
        updyn.Test(train(True), measured(True, 0.01), "b"),
    ]
    with pytest.raises(InputError, match="no group 'motor'"):
        updyn.update_jointly(locked, unknowns())
    with pytest.raises(InputError, match="two tests are called 'a'"):
        updyn.update_jointly([locked[0], locked[0]], unknowns())
    with pytest.raises(InputError, match="at least one Test"):
        updyn.update_jointly([], unknowns())


def test_a_sensor_that_points_elsewhere_is_said() -> None:
    model, frf = train(False), measured(False)
    turned = np.array([[[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]])
    oblique = dataclasses.replace(frf, geometry=updyn.Geometry([2], [[0.0, 0.0, 0.0]], axes=turned))
    with pytest.warns(updyn.UpdynWarning, match="2:RZ points 90 degrees away from the model's"):
        updyn.update(model, oblique, unknowns(), starts=0)


@pytest.mark.parametrize("tests", [None, [], "tests", 3])
def test_something_else_than_tests_is_refused(tests):
    unknowns = updyn.parameters(train(locked=False), stiffness=["shaft"])
    with pytest.raises(InputError, match="expected a sequence of at least one Test"):
        updyn.update_jointly(tests, unknowns)


@pytest.mark.parametrize("most", [3, 100])
def test_what_would_explain_frfs_is_looked_for_beside_modes(
    chain12, chain12_true, chain12_frf, most
):
    """Stiffness alone cannot follow data of other masses: the residual of the FRFs says so."""
    modes = updyn.modes(chain12_true, 5)
    measured = updyn.ModeSet(modes.frequency, modes.shapes, modes.dofs)
    tests = [updyn.Test(chain12, measured, "modes"), updyn.Test(chain12, chain12_frf, "frfs")]
    unknowns = updyn.parameters(chain12, stiffness="all")
    joint = updyn.update_jointly(tests, unknowns, starts=0, max_iterations=most)
    assert joint["modes"].adequacy is None
    if joint.status != "max-iterations":
        assert joint["frfs"].adequacy.explained_by


def test_intervals_do_not_depend_on_which_test_is_first() -> None:
    """Noise of each is estimated from few numbers: 2 x 6 and 2 x 9, less the share of 4 unknowns."""
    few = []
    for test, lines in zip(both(0.01), (6, 9), strict=True):
        freq = test.frf.freq[:: len(test.frf.freq) // lines][:lines]
        few.append(dataclasses.replace(test, data=test.frf.select(lines=freq)))
    unknowns = updyn.parameters(train(False), mass="all", stiffness="all", loss_factor=["shaft"])
    joint, turned = (updyn.update_jointly(tests, unknowns, starts=0) for tests in (few, few[::-1]))
    # Satterthwaite: shares 0.4 and 0.6 of the data; 12 - 2 and 18 - 3 numbers to spare.
    freedom = round(1.0 / (0.4**2 / 10 + 0.6**2 / 15))
    for result in (*joint.results.values(), *turned.results.values()):
        assert result.noise["degrees_of_freedom"] == freedom
    for name, ends in joint.intervals().items():
        assert ends == pytest.approx(turned.intervals()[name], rel=1e-6)
    apart = list(joint.results.values())
    assert apart[0].intervals() == apart[1].intervals() == joint.intervals()
