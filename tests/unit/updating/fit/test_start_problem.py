"""The problem at the start of a large model: reduced, with the numbers of the whole model."""

import numpy as np
import pytest

import updyn
from overriding import override
from reduced_cases import plate
from updyn.dynamics.fields import LineSolver
from updyn.updating.fit.settings import REDUCED_TIER
from updyn.updating.fit.start_problem import build_start_problem
from updyn.updating.problem.data import Test
from updyn.updating.update import identifiability


@pytest.fixture(scope="module")
def measured():
    """A plate of 676 DOFs with 80 lines at 6 sensors."""
    model = plate(26)
    band = updyn.modes(model, 6).frequency
    freq = np.linspace(0.5 * band[0], band[-1], 80)
    sensors = [f"{i}:Z" for i in (40, 150, 300, 420, 560, 670)]
    frf = updyn.response(model, freq, sensors, sensors[:1], tier="reduced")
    return model, frf, updyn.parameters(model, stiffness="quarter*", loss_factor="quarter*")


def test_lines_of_a_large_model_are_selected_without_solving_it_line_by_line(measured, monkeypatch):
    model, frf, unknowns = measured
    test = Test(model, frf, "", "d-optimal:20", None)
    override(monkeypatch, REDUCED_TIER, most_exact_dofs=1000)
    whole, _ = build_start_problem([test], unknowns)
    override(monkeypatch, REDUCED_TIER, most_exact_dofs=600)

    def refuse(*_: object) -> None:
        raise AssertionError("the whole model was solved")

    monkeypatch.setattr(LineSolver, "solve", refuse)
    reduced, _ = build_start_problem([test], unknowns)
    assert np.array_equal(reduced.parts[0].frf.freq, whole.parts[0].frf.freq)


def test_the_rank_and_the_deviations_are_those_of_the_whole_model(measured, monkeypatch):
    model, frf, unknowns = measured
    reduced = identifiability(model, frf, unknowns)
    override(monkeypatch, REDUCED_TIER, most_exact_dofs=1000)
    whole = identifiability(model, frf, unknowns)
    assert reduced.rank == whole.rank == len(unknowns)
    assert np.allclose(reduced.singular_values, whole.singular_values, rtol=1e-4)
