"""Next step after an update: advice, and the lines to paste into the job, a terminal or Python."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, replace

from updyn.frf import FRF
from updyn.modal import ModeSet
from updyn.updating.judge.verdict import STEP
from updyn.updating.result import JointResult, UpdateResult

__all__ = ["NextStep", "choose_next_step", "plan_test", "read_step", "split_sentences"]

#: Boundary between two sentences.
_SENTENCE = re.compile(r"(?<=[.!?]) (?=[A-Z0-9])")
#: A setting of a job within a sentence: key and value, with arrays nested once.
_VALUE = r'"[^"]*"|\[(?:[^][]|\[[^][]*\])*\]|\{[^{}]*\}|-?\d[\d.]*(?:e[-+]?\d+)?\b'
_SETTING = re.compile(rf"\b([a-z_]+) = ({_VALUE})")
#: A table of a job, such as ``[[parameter]] with groups = ["hub"] and ...``.
_TABLE = re.compile(r"\[\[([a-z_]+)\]\] with ")
#: The next setting of a table.
_FURTHER = re.compile(rf"(?:, | and )?{_SETTING.pattern}")
#: The table of a setting, before or after it.
_UNDER = re.compile(r" ?\bunder \[([a-z_]+)\]")
#: Statements of Python that end a sentence.
_PYTHON = re.compile(r"model = model\.with_element\(.*\)$")
#: Tables of settings whose table is not stated.
_TABLES = {"repair": "test", "exclude": "test"}
_PLACEHOLDER = "..."
_IN_JOB, _IN_TERMINAL = "at the end of the job", "in a terminal, in the folder of this run"


@dataclass(frozen=True, slots=True)
class NextStep:
    """One step: advice in sentences, lines to paste, the place for them, and a further remark."""

    advice: str
    lines: str = ""
    place: str = ""
    remark: str = ""


def split_sentences(text: str) -> list[str]:
    """Return the sentences of a text."""
    return [sentence for sentence in _SENTENCE.split(text.strip()) if sentence]


def read_step(text: str) -> NextStep:
    """Return advice with the lines that it quotes taken out of its sentences."""
    for read in (_read_table, _read_setting, _read_python):
        found = read(text)
        if found is not None:
            return found
    return NextStep(text.strip())


def _read_table(text: str) -> NextStep | None:
    """Return the step of a text that quotes a table of a job."""
    table = _TABLE.search(text)
    if table is None:
        return None
    lines, end = [f"[[{table[1]}]]"], table.end()
    while setting := _FURTHER.match(text, end):
        lines.append(f"{setting[1]} = {setting[2]}")
        end = setting.end()
    return _split_at(text, (table.start(), end), "\n".join(lines), _IN_JOB)


def _read_setting(text: str) -> NextStep | None:
    """Return the step of a text that quotes one setting of a job."""
    setting = _SETTING.search(text)
    if setting is None or _PLACEHOLDER in setting[2]:
        return None
    under = _UNDER.search(text)
    table = under[1] if under else _TABLES.get(setting[1], "method")
    step = _split_at(text, setting.span(), setting[0], f"under [{table}] of the job")
    advice, remark = (_UNDER.sub("", part) for part in (step.advice, step.remark))
    return replace(step, advice=advice, remark=remark.strip(" ,.)"))


def _read_python(text: str) -> NextStep | None:
    """Return the step of a text that ends in statements of Python."""
    match = _PYTHON.search(text)
    if match is None:
        return None
    return _split_at(text, match.span(), match[0].replace("; ", "\n"), "in Python")


def _split_at(text: str, span: tuple[int, int], lines: str, place: str) -> NextStep:
    """Return the step of a text whose characters from `span` are the lines."""
    before, after = text[: span[0]].rstrip(" :(,"), text[span[1] :]
    return NextStep(f"{before}:", lines, place, after.strip(" ,.)"))


def choose_next_step(result: UpdateResult | JointResult) -> NextStep:
    """Return the first step of the remedy of a result, or the step that follows from its status."""
    first = result.first
    step = read_step(first.remedy.partition(STEP)[0])
    if step.lines:
        return step
    if first.usable and not step.advice:
        return _hold_out(first) or _use_model(result)
    usual = _choose_by_status(first)
    return replace(usual, advice=step.advice or usual.advice)


def _choose_by_status(result: UpdateResult) -> NextStep:
    """Return the usual next step of a result that is not usable."""
    for option in ("max_iterations", "starts"):
        number = result.options.get(option)
        if re.search(rf"\bRaise {option}\b", result.remedy) and isinstance(number, int):
            setting = f"{option} = {2 * max(number, 1)}"
            return NextStep("", setting, "under [method] of the job")
    if result.status == "stopped":
        place = "in a terminal, with the job file of this run and its --out"
        return NextStep("Continue the run.", "updyn run JOB.toml --resume", place)
    if result.status == "not-identifiable":
        return plan_test(result.data)
    advice = "Compare model and test before the next fit."
    return NextStep(advice, "updyn check job.toml", _IN_TERMINAL)


def plan_test(data: FRF | ModeSet) -> NextStep:
    """Return the step that plans a test with one more sensor over the band of the data."""
    lines = data.freq if isinstance(data, FRF) else data.frequency
    sensors = len(data.responses) if isinstance(data, FRF) else len(data.dofs)
    table = f"[plan]\nn_sensors = {sensors + 1}\nband = [{lines[0]:.6g}, {lines[-1]:.6g}]"
    advice = "Plan a test that determines all unknowns."
    return NextStep(advice, table, _IN_JOB, "Then run updyn plan with this job")


def _hold_out(result: UpdateResult) -> NextStep | None:
    """Return the step that holds a response out of the fit; None if data were held out."""
    asked = result.trust is None or result.trust.validated.asked
    responses = result.fitted_responses
    if asked or not isinstance(result.data, FRF) or len(responses) < 2:
        return None
    setting = f'validation = ["{responses[len(responses) // 2]}"]'
    advice = "Hold a response out of the fit, to test whether the model predicts it."
    return NextStep(advice, setting, "under [method] of the job")


def _use_model(result: UpdateResult | JointResult) -> NextStep:
    """Return the step that reads the updated model of the first test."""
    folder = next(iter(result.results))
    file = f"{folder}/model.h5" if folder else "model.h5"
    advice = "The updated model can be used: it is in the folder of this run."
    return NextStep(advice, f"model = updyn.read_model({json.dumps(file)})", "in Python")
