"""Agreement at the start of the unknowns: one value on the terminal, on both pages and in the results."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

import updyn
from overriding import override
from updyn.cli import main
from updyn.correlation import model_modes
from updyn.job import job_analysis, job_findings, load_job, prepare
from updyn.job.start import (
    agreements_at_start,
    choose_noise_once,
    compute_start_frf,
    start_model,
    start_models,
)
from updyn.model import Group, Model
from updyn.report import data
from updyn.report.start import Start
from updyn.updating.fit.reducing import Reducing
from updyn.updating.fit.settings import REDUCED_TIER
from updyn.updating.problem.noise import Estimated

LINES = np.linspace(0.5, 40.0, 80)
N = 6


def chain() -> Model:
    """Make six masses between springs, without any damping; the last mass stands alone."""
    groups = {}
    for name, cells in (("lower", range(3)), ("upper", range(3, 5))):
        K = np.zeros((N, N))
        for k in cells:
            K[k, k] += 2e3
            if k:
                K[k - 1, k - 1] += 2e3
                K[k, k - 1] = K[k - 1, k] = -2e3
        groups[name] = Group(K, None)
    alone = np.zeros((N, N))
    alone[5, 5] = 500.0
    return Model.from_groups(
        {**groups, "masses": Group(alone, np.eye(N))}, [f"{k + 1}:X" for k in range(N)]
    )


START = {"lower": 0.02, "upper": 0.02}
JOB = """\
[model]
file = "chain.h5"
[test]
file = "test.npz"
[[parameter]]
groups = ["lower", "upper"]
quantity = "stiffness"
bounds = [0.3, 3.0]
start = 1.1
[[parameter]]
groups = ["lower", "upper"]
quantity = "loss_factor"
bounds = [0.0, 0.3]
start = 0.02
[method]
starts = 0
{method}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    true = chain().scaled(
        {"lower": {"stiffness": 0.8, "loss_factor": 0.03}, "upper": {"loss_factor": 0.04}}
    )
    rng = np.random.default_rng(5)
    frf = updyn.response(true, LINES, [f"{k}:X" for k in range(1, 7)], ["2:X"], "accelerance")
    noise = (
        0.01
        * np.abs(frf.values)
        * (rng.standard_normal(frf.values.shape) + 1j * rng.standard_normal(frf.values.shape))
    )
    updyn.write_model(chain(), tmp_path / "chain.h5")
    measured = updyn.FRF(LINES, frf.values + noise, frf.responses, frf.references, "accelerance")
    updyn.write_frf(measured, tmp_path / "test.npz")
    return tmp_path


def residual(folder: Path, responses: list[int], lines: np.ndarray) -> float:
    """Return the median over channels of |HX - HA| / |HX|, by a dense solve.

    Response 6 is not connected with the force: neither model nor data know anything of it.
    """
    model = chain().scaled({name: {"stiffness": 1.1, "loss_factor": 0.02} for name in START})
    K = model.stiffness.toarray() + 1j * model.structural.toarray()
    w = 2.0 * np.pi * LINES
    M, force = model.mass.toarray(), np.eye(N)[1]
    H = np.array([np.linalg.solve(K - x**2 * M, -(x**2) * force) for x in w])
    measured = updyn.read_frf(folder / "test.npz").values[lines][:, :, 0]
    computed = H[lines]
    size = np.sqrt(np.sum(np.abs(measured) ** 2, axis=0))
    error = np.sqrt(np.sum(np.abs(measured - computed) ** 2, axis=0))
    return float(np.median([error[k - 1] / size[k - 1] for k in responses]))


def tile(path: Path) -> float:
    """Return the median residual of a page; of a report that of the start."""
    html = path.read_text(encoding="utf-8")
    (text,) = re.findall(r"<dt>Relative residual, median</dt><dd>([^<]*)<", html)
    return float(text.split("→")[0].strip().removesuffix("%").strip()) / 100.0


@pytest.mark.parametrize(
    ("method", "responses", "held"),
    [
        ("", [1, 2, 3, 4, 5], slice(0, 0)),
        ('validation = ["1:X", "3:X"]', [2, 4, 5], slice(0, 0)),
        ("validation = [9.7, 20.2]", [1, 2, 3, 4, 5], slice(19, 40)),
        ('lines = "d-optimal:20"', [1, 2, 3, 4, 5], slice(0, 0)),
    ],
)
def test_the_residual_of_the_start_is_one(
    method: str,
    responses: list[int],
    held: slice,
    folder: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    job = folder / "job.toml"
    job.write_text(JOB.format(method=method), encoding="utf-8")
    lines = np.delete(np.arange(len(LINES)), held)
    expected = residual(folder, responses, lines)
    assert main(["correlate", str(job), "--verbose"]) == 0
    out = capsys.readouterr().out
    (said,) = re.findall(r"relative residual, median over channels +(\S+)", out)
    assert float(said) == pytest.approx(expected, rel=6e-3)
    assert tile(folder / "job-correlate" / "correlate.html") == pytest.approx(expected, rel=0.05)
    assert main(["check", str(job), "--verbose"]) in (0, 3)
    out = capsys.readouterr().out
    (said,) = re.findall(r"relative residual, median over channels +(\S+)", out)
    assert float(said) == pytest.approx(expected, rel=6e-3)
    assert tile(folder / "job-check" / "check.html") == pytest.approx(expected, rel=0.05)
    main(["run", str(job), "--verbose"])
    out = capsys.readouterr().out
    (said,) = re.findall(r"relative residual, median over channels +(\S+)", out)
    assert float(said) == pytest.approx(expected, rel=6e-3)
    assert tile(folder / "job" / "report.html") == pytest.approx(expected, rel=0.05)
    written = json.loads((folder / "job" / "result.json").read_text(encoding="utf-8"))
    assert written["correlation"]["before"]["residual_median"] == pytest.approx(expected, rel=1e-9)


def test_the_curve_of_the_start_is_that_of_the_unknowns(folder: Path) -> None:
    from updyn.job import load_job, prepare, run_job
    from updyn.report.data import gather

    job = folder / "job.toml"
    job.write_text(JOB.format(method="max_iterations = 2"), encoding="utf-8")
    result = run_job(load_job(job), folder / "out", prepared=prepare(load_job(job))).result
    drawn = gather(result)
    assert drawn.residual_before is not None
    found = float(np.median(drawn.residual_before[:5]))
    assert found == pytest.approx(residual(folder, [1, 2, 3, 4, 5], np.arange(80)), rel=1e-9)
    model = chain().scaled({name: {"stiffness": 1.1, "loss_factor": 0.02} for name in START})
    known = updyn.modes(model, 5)
    measured = updyn.ModeSet(known.frequency, known.shapes, model.dofs, known.loss_factor)
    for row in updyn.modal_table(result, measured).rows:
        assert row.start is not None
        assert row.test is not None
        assert row.start.frequency == pytest.approx(row.test.frequency, rel=1e-9)
        assert row.start.loss_factor == pytest.approx(row.test.loss_factor, rel=1e-9)


def test_a_reduced_start_model_is_solved_once_for_test_and_page(folder, monkeypatch) -> None:
    path = folder / "job.toml"
    path.write_text(JOB.format(method='tier = "reduced"'), encoding="utf-8")
    ready = prepare(load_job(path))
    (agreement,) = agreements_at_start(ready, start_models(ready, ready.parameters)).values()
    computed = agreement.computed
    assert len(computed.freq) > len(LINES)
    model = start_model(ready.tests[0], ready.parameters)
    channels = computed.responses, computed.references, "accelerance"
    exact = updyn.response(model, computed.freq, *channels).values
    largest = np.abs(exact).max(axis=(1, 2), keepdims=True)
    assert (np.abs(computed.values - exact) / largest).max() < 1e-6
    # The page needs no other lines.
    monkeypatch.setattr(data, "respond_as_measured", None)
    start = Start(
        model=model,
        data=ready.tests[0].data,
        parameters=ready.parameters,
        identifiability=None,
        covariance=np.eye(len(ready.parameters)),
        options={"tier": "reduced"},
        computed=computed,
    )
    made = data.gather_start(start)
    np.testing.assert_array_equal(made.grid, computed.freq)
    np.testing.assert_array_equal(made.before_curve, computed.values)


def test_check_computes_modes_for_higher_frequencies_only(folder, monkeypatch) -> None:
    path, highest = folder / "job.toml", []
    path.write_text(JOB.format(method=""), encoding="utf-8")

    def modes_up_to(*given):
        highest.append(given[1])
        return updyn.dynamics.modes.modes_up_to(*given)

    monkeypatch.setattr(model_modes, "modes_up_to", modes_up_to)
    assert main(["check", str(path)]) == 0
    assert highest == sorted(set(highest))


@pytest.mark.parametrize("validation", ["", 'validation = ["3:X"]'])
def test_the_start_model_is_reduced_once(folder, monkeypatch, validation) -> None:
    override(monkeypatch, REDUCED_TIER, most_exact_dofs=N - 1)
    path, begun = folder / "job.toml", []
    path.write_text(JOB.format(method=validation), encoding="utf-8")
    ready = prepare(load_job(path))
    separate = job_analysis(ready)
    begin = Reducing.begin
    monkeypatch.setattr(Reducing, "begin", lambda reducing: begun.append(1) or begin(reducing))
    starts = start_models(ready, ready.parameters)
    shared = job_analysis(ready, None, starts)
    computed = compute_start_frf(ready.tests[0], starts[""])
    assert begun == [1]
    np.testing.assert_allclose(shared.covariance, separate.covariance, rtol=1e-3, atol=1e-12)
    model = start_model(ready.tests[0], ready.parameters)
    exact = updyn.response(model, computed.freq, computed.responses, computed.references, "accelerance")  # fmt: skip
    np.testing.assert_allclose(computed.values, exact.values, atol=1e-6 * np.abs(exact.values).max())  # fmt: skip


@pytest.mark.parametrize("validation", ["", 'validation = ["3:X"]'])
def test_the_noise_is_estimated_once_with_the_same_results(folder, monkeypatch, validation) -> None:
    path = folder / "job.toml"
    path.write_text(JOB.format(method=validation), encoding="utf-8")
    ready = prepare(load_job(path))
    separate = job_analysis(ready), job_findings(ready.tests[0], ready.parameters)
    chosen = choose_noise_once(ready)
    assert (chosen.tests[0].noise is None) == bool(validation)
    if not validation:
        monkeypatch.setattr(Estimated, "of_data", None)
    np.testing.assert_array_equal(job_analysis(chosen).covariance, separate[0].covariance)
    assert list(map(str, job_findings(chosen.tests[0], chosen.parameters))) == list(
        map(str, separate[1])
    )
