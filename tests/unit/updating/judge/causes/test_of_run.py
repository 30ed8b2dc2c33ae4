"""A search that a fault of the data makes vain ends, and the fault is said; no other ends by it."""

from dataclasses import replace

import numpy as np
import pytest

import updyn
from overriding import override
from updyn.elements.drivetrain import Inertia, Motor, Shaft, drivetrain
from updyn.remedy import Remedy
from updyn.updating.judge.causes import diagnosis
from updyn.updating.judge.causes.diagnosis import Diagnosis, find_obstacle
from updyn.updating.judge.causes.finding import Finding
from updyn.updating.judge.causes.suspects import score_faults
from updyn.updating.judge.causes.trial import raise_loss_factors
from updyn.updating.problem.noise import Stated
from updyn.updating.problem.problem import FRFPart
from updyn.updating.problem.session import Stopped
from updyn.updating.problem.settings import EVALUATION

SENSORS = ["2:X", "5:X", "7:X", "10:X", "12:X"]
SAID = "No further start was tried"


@pytest.fixture(scope="module")
def unknowns(chain12):
    return updyn.parameters(chain12, stiffness="all", mass="all", loss_factor="all")


@pytest.fixture(scope="module")
def data(chain12_true, add_noise):
    clean = updyn.response(chain12_true, np.linspace(0.6, 22.0, 60), SENSORS, ["5:X", "12:X"])
    return add_noise(clean, np.random.default_rng(3), 0.01, 1e-3)


def turned(frf):
    """The second sensor the wrong way round."""
    values = frf.values.copy()
    values[:, 1] *= -1.0
    return replace(frf, values=values)


@pytest.mark.parametrize(
    ("method", "tier"),
    [("maximum-likelihood", None), ("log", None), ("maximum-likelihood", "reduced")],
)
def test_a_fault_that_explains_all_ends_the_search(chain12, data, unknowns, method, tier):
    result = updyn.update(chain12, turned(data), unknowns, method, tier=tier)
    assert [one.written for one in result.findings] == ["sign:5:X"]
    assert SAID in result.message
    assert not result.trust["plausible"]
    assert "other answers" not in result.timing_s
    tries = [step for step in result.history if step.stage == "search" and step.step == 0.0]
    assert len(tries) <= 2 * 3  # each on few lines, and on all
    repaired = updyn.update(chain12, result.findings[0].repair(turned(data)), unknowns, method)
    assert repaired.status == "converged"
    assert SAID not in repaired.message


@pytest.fixture
def searches(monkeypatch):
    """The parts in which faults are searched for with the model."""
    made = []
    explain = diagnosis._explain_data

    def counted(part, *about):
        made.append(part)
        return explain(part, *about)

    monkeypatch.setattr(diagnosis, "_explain_data", counted)
    return made


def test_it_is_looked_for_once(chain12, data, unknowns, searches):
    updyn.update(chain12, turned(data), unknowns)
    assert len(searches) == 1
    updyn.update(chain12, data, unknowns)  # the first tries agree: nothing is looked for
    assert len(searches) == 1


def test_the_user_is_asked_between_two_faults(chain12, data, unknowns, monkeypatch):
    """Pairs of sensors that may be swapped go with the square of their number."""
    override(monkeypatch, EVALUATION, stop_interval=0.0)
    asked = []
    known = replace(data, variance=1e-4 * np.abs(data.values) ** 2)
    part = FRFPart.build(chain12, known, unknowns)
    part.session.wants_stop = lambda: bool(asked.append(True))
    found = score_faults(part, part.coordinates.start)
    assert len(asked) > len(found) > len(SENSORS) * (len(SENSORS) - 1) / 2
    part.session.wants_stop = lambda: len(asked) > 10 or bool(asked.append(True))
    asked.clear()
    with pytest.raises(Stopped):
        score_faults(part, part.coordinates.start)


def test_a_search_goes_on_where_nothing_is_found(chain12, data, searches):
    """A mode that the model lacks keeps every try from the data, and is no reason to end."""
    modes = updyn.response(chain12, data.freq, SENSORS, ["5:X", "12:X"]).values
    shape = np.array([1.0, -0.6, 0.8, 0.5, -0.9])
    pole = 1.0 / (1.0 + 0.02j - (data.freq / 9.0) ** 2)
    more = np.abs(modes).max() * 0.1 * pole[:, None, None] * np.outer(shape, shape[[1, 4]])
    spoilt = replace(data, values=data.values + more)
    unknowns = updyn.parameters(chain12, stiffness="all")
    result = updyn.update(chain12, spoilt, unknowns, starts=3)
    assert [one.kind for one in result.findings] == ["missing-mode"]
    assert SAID not in result.message
    assert "other answers" in result.timing_s
    # The fit ends where the search ended without a fault, which has to be found only once.
    assert len(searches) == 1


def test_only_a_better_fit_is_searched_anew(chain12_task, data, searches):
    """From a start far off, fits end at a poor minimum; the truth leaves noise."""
    model, _, unknowns, truth = chain12_task
    factors = dict(zip(model.groups, [5.0, 0.2, 5.0, 0.2], strict=True))
    far = model.scaled({name: {"stiffness": one} for name, one in factors.items()})
    part = FRFPart.build(far, data, unknowns)
    test = Diagnosis(part, Stated(0.01, 1e-3))
    first = test.find_causes()
    assert test.find_causes([raise_loss_factors(part, part.coordinates.start)]) is first
    assert len(searches) == 1
    values = [
        value / factors[p.group] if p.quantity == "stiffness" else value
        for p, value in zip(unknowns, truth, strict=True)
    ]
    assert test.find_causes([part.coordinates.to_x(np.array(values))]) == []
    assert len(searches) == 2


@pytest.mark.parametrize(
    ("kind", "of_misfit", "value", "overruling"),
    [
        ("sign", 0.99, 0.0, True),
        ("sign", 0.9, 0.0, False),
        ("calibration", 0.99, 0.2, False),
        ("calibration", 0.99, 0.4, True),
        ("calibration", 0.14, 0.4, False),  # it brings unknowns back to their start
        ("missing-mode", 0.99, 9.0, False),
        ("drive-point", 0.0, 0.0, False),  # the data show it by themselves
    ],
)
def test_what_overrules(kind, of_misfit, value, overruling):
    found = Finding(kind, ("5:X",), value, 1e9, 0.99, "", Remedy(""), of_misfit=of_misfit)
    assert found.overruling is overruling


def test_an_undamped_drive_whose_start_is_off_has_no_fault():
    """Its sharp resonances do not overlap with those of the data."""
    true, start = (
        drivetrain([Shaft("s", 1, 2, k), Motor("m", 1, 2e-3), Inertia("l", 2, 0.03)])
        for k in (800.0, 700.0)
    )
    frf = updyn.response(true, np.linspace(5, 150, 30), ["1:RZ", "2:RZ"], ["1:RZ"])
    unknowns = updyn.parameters(start, stiffness=["s"])
    assert not updyn.diagnose(start, frf, unknowns)
    result = updyn.update(start, frf, unknowns, noise={"relative": 0.01})
    assert result.values["s.stiffness"] == pytest.approx(8.0 / 7.0, rel=1e-6)
    assert SAID not in result.message


def test_causes_are_not_sought_in_data_that_are_lost_in_the_noise(chain12, data):
    """A factor of 0.001 that drowns what is left of them in the noise explained them."""
    stiffnesses = updyn.parameters(chain12, stiffness="all")
    result = updyn.update(chain12, data, stiffnesses, noise={"relative": 1.0})
    assert not result.findings
    assert result.trust["plausible"].holds is False
    part = FRFPart.build(chain12, data, stiffnesses)
    assert find_obstacle(part, Stated(relative=1.0, floor=0.0)).endswith("at 60 of 60 lines")
    assert find_obstacle(part, Stated(relative=0.1, floor=0.0)) == ""
