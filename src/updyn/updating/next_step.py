"""Next step after an update: the first step of its remedy, or the usual step after its status."""

from __future__ import annotations

import json
from dataclasses import replace

from updyn.frf import FRF
from updyn.modal import ModeSet
from updyn.remedy import IN_PYTHON, Remedy
from updyn.updating.result import JointResult, UpdateResult

__all__ = ["choose_next_step", "plan_test"]

_IN_TERMINAL = "in a terminal, in the folder of this run"


def choose_next_step(result: UpdateResult | JointResult) -> Remedy:
    """Return the first step of a result, with the usual lines after its status if it has none."""
    first = result.first
    if not first.steps and first.usable:
        return _hold_out(first) or _use_model(result)
    step = next(iter(first.steps), None)
    if step is not None and step.lines:
        return step
    usual = _choose_by_status(first, step)
    return usual if step is None else replace(usual, advice=str(step))


def _choose_by_status(result: UpdateResult, step: Remedy | None) -> Remedy:
    """Return the usual next step of a result that is not usable, with lines that suit `step`."""
    on_unknowns = step is None or str(step) == result.identifiability.advice
    if result.status == "not-identifiable" and on_unknowns:
        return plan_test(result.data)
    advice = "Compare model and test before the next fit:"
    return Remedy(advice, ("updyn check job.toml",), _IN_TERMINAL)


def plan_test(data: FRF | ModeSet) -> Remedy:
    """Return the step that plans a test with one more sensor over the band of the data."""
    lines = data.freq if isinstance(data, FRF) else data.frequency
    sensors = len(data.responses) if isinstance(data, FRF) else len(data.dofs)
    band = [float(f"{one:.6g}") for one in (lines[0], lines[-1])]
    return Remedy.table(
        "Plan a test that determines all unknowns:",
        "[plan]",
        {"n_sensors": sensors + 1, "band": band},
        "Then run updyn plan with this job.",
    )


def _hold_out(result: UpdateResult) -> Remedy | None:
    """Return the step that holds a response out of the fit; None if data were held out."""
    asked = result.trust is None or result.trust.validated.asked
    responses = result.fitted_responses
    if asked or not isinstance(result.data, FRF) or len(responses) < 2:
        return None
    advice = "Hold a response out of the fit, to test whether the model predicts it:"
    return Remedy.setting(advice, "method", "validation", [responses[len(responses) // 2]])


def _use_model(result: UpdateResult | JointResult) -> Remedy:
    """Return the step that reads the updated model of the first test."""
    folder = next(iter(result.results))
    file = f"{folder}/model.h5" if folder else "model.h5"
    advice = "The updated model can be used; it is in the folder of this run:"
    return Remedy(advice, (f"model = updyn.read_model({json.dumps(file)})",), IN_PYTHON)
