"""The beam demo, run as a user runs it: what it reaches, what it says, what it leaves behind."""

from __future__ import annotations

import io
import json
import re
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np
import pytest

import updyn
from updyn.cli import main
from updyn.demos import beam
from updyn.job import load_job, prepare


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, int, str]:
    folder = tmp_path_factory.mktemp("demo") / "beam"
    out, err = io.StringIO(), io.StringIO()
    # `updating/judge/causes/test_measured_beam.py` has tests of the causes.
    with redirect_stdout(out), redirect_stderr(err):
        code = main(["demo", "--out", str(folder)])
    return folder, code, err.getvalue() + out.getvalue()


@pytest.fixture(scope="module")
def results(ran) -> list[updyn.UpdateResult]:
    return [updyn.read_result(ran[0] / name / "run.nc") for name in (".", "segments")]


@pytest.fixture(scope="module")
def measured() -> updyn.FRF:
    return updyn.read_frf(Path(beam.__file__).parent / "data" / "ladisk_beam.uff")


def frac(hx: np.ndarray, ha: np.ndarray) -> np.ndarray:
    return np.abs((hx.conj() * ha).sum(0)) ** 2 / (
        (np.abs(hx) ** 2).sum(0) * (np.abs(ha) ** 2).sum(0)
    )


def test_both_runs_converge_and_leave_their_files(ran) -> None:
    folder, code, _ = ran
    assert code == 0
    for name in (".", "segments"):
        found = json.loads((folder / name / "result.json").read_text())
        assert found["status"] == "converged"
        for file in ("report.html", "run.nc", "model.h5", "job.toml"):
            assert (folder / name / file).stat().st_size > 100
    assert "Copyright (c) 2018 - 2019 Ladisk" in (folder / "inputs" / "README.md").read_text()
    assert "by construction" in (folder / "report.html").read_text()


def test_the_default_demo_prints_forty_lines_at_most(ran, results) -> None:
    """With its progress; the verdict of the last run and the path of its report come last."""
    folder, _, printed = ran
    lines = printed.splitlines()
    assert len(lines) <= 40
    assert lines[-1] == f"Results in {folder / 'segments'}: {folder / 'segments' / 'report.html'}"
    assert f"Details: {folder / 'demo.txt'}" in lines
    ends = [line for line in lines if ": converged after " in line]
    assert [line.split(":")[0] for line in ends] == [result.title for result in results]
    last = lines.index(ends[1])
    assert len(lines) - last <= 20
    steps = [n for n, line in enumerate(lines) if line.startswith("What to do next")]
    assert last < lines.index(next(x for x in lines if x.startswith("unknown "))) < steps[0]
    for result in results:
        figures = result.correlation["after"], result.correlation["validation"]["after"]
        (row,) = (line for line in lines if line.startswith(f"{result.title}  "))
        shown = [float(cell) for cell in row.split()[-2:]]
        assert shown == pytest.approx([one["db_error_median"] for one in figures], abs=5e-4)


def test_the_measurement(measured) -> None:
    assert measured.quantity == "accelerance"
    assert measured.values.shape == (4999, 7, 6)
    np.testing.assert_allclose(measured.freq, np.arange(1, 5000) * 1.0001953506544246, rtol=1e-10)
    # Single precision, as in the source.
    assert (measured.values == measured.values.astype(np.complex64)).all()
    assert [int(n) for n in sorted(measured.geometry.nodes)] == sorted(beam.STATIONS)
    peak = measured.freq[np.abs(measured.values[:, 0, 0])[100:250].argmax() + 100]
    assert peak == pytest.approx(176.07, abs=1.0)  # first bending mode, to a line


def test_it_beats_the_plain_fit_on_all_lines_of_the_band(ran, results, measured) -> None:
    """Recomputed from the files by other means than the library's correlation."""
    band = measured.select(band=beam.BAND)
    assert len(band.freq) == 4400
    for name, result in zip((".", "segments"), results, strict=True):
        assert len(result.lines) == 220
        model = updyn.read_model(ran[0] / name / "model.h5")
        H = updyn.response(
            model, band.freq, band.responses, band.references, quantity="accelerance"
        ).values
        error = np.abs(20 * np.log10(np.abs(H) / np.abs(band.values)))
        agreement = frac(band.values, H)
        held = [band.responses.labels.index(x) for x in beam.HELD_OUT]
        fitted = [i for i in range(7) if i not in held]
        after, validation = result.correlation["after"], result.correlation["validation"]["after"]
        for which, figures in ((fitted, after), (held, validation)):
            assert figures["db_error_median"] == pytest.approx(np.median(error[:, which]), rel=1e-6)
            assert figures["frac_median"] == pytest.approx(np.median(agreement[which]), rel=1e-6)
        assert np.median(error) < 0.42
        assert np.median(agreement) > 0.95
        assert validation["db_error_median"] < 0.4
        assert validation["frac_median"] > 0.93
    before = results[0].correlation["before"]
    assert before["db_error_median"] > 2.5
    assert before["frac_median"] < 0.05


def test_values_that_steel_can_have(results) -> None:
    whole = results[0].values
    ratio = beam.E * whole["beam.stiffness"] / (beam.RHO * whole["beam.mass"])
    assert np.sqrt(ratio) == pytest.approx(5150, rel=0.02)  # m/s, sound along a steel bar
    assert 1e-3 < whole["beam.loss_factor"] < 6e-3
    assert 1e-3 < beam._ACCELEROMETER * whole["accelerometers.mass"] < 5e-3  # kg
    for name, value in results[1].values.items():
        if name.startswith("segment") and not name.endswith("loss_factor"):
            assert abs(value - 1.0) < 0.06
    assert not results[0].at_bound
    assert not results[1].at_bound


def test_segments_start_from_the_whole_beam(ran, results) -> None:
    """The second job, read from its file, answers at its start as the first result does."""
    ready = prepare(load_job(ran[0] / "inputs" / "segments.toml"))
    frf = results[0].frf.select(lines=results[0].lines[::20])
    first, second = (
        updyn.response(m, frf.freq, frf.responses, frf.references).values
        for m in (results[0].model, ready.model)
    )
    assert (
        np.abs(second / first - 1.0).max() < 1e-3
    )  # the edges of the segments are nodes that the first has not
    assert len(ready.parameters) == 15
    again = prepare(
        load_job(ran[0] / "segments" / "job.toml")
    )  # the resolved one, from the output folder
    assert again.parameters == ready.parameters
    np.testing.assert_array_equal(again.frf.values, ready.frf.values)


def test_the_resolved_job_runs_again_from_the_output_folder(ran, results, tmp_path: Path) -> None:
    """On fewer lines and from what was found, which is quick: the result stays where it is."""
    text = (ran[0] / "job.toml").read_text(encoding="utf-8")
    lines = ", ".join(f"{f:.6f}" for f in results[0].lines[::8])
    text = re.sub(r"lines = \[[^\]]*\]", f"lines = [{lines}]", text)
    text = re.sub(r"starts = \d+", "starts = 1", text).replace("report = true", "report = false")
    job = ran[0] / "fewer.toml"
    job.write_text(text, encoding="utf-8")
    assert main(["run", str(job), "--out", str(tmp_path / "again")]) == 0
    again = updyn.read_result(tmp_path / "again" / "run.nc")
    assert len(again.lines) == 28
    for name in ("beam.stiffness", "beam.mass"):
        assert again.values[name] == pytest.approx(results[0].values[name], rel=0.01)


def test_figures_that_are_said_are_those_of_the_runs(ran, results) -> None:
    said = (ran[0] / "demo.txt").read_text(encoding="utf-8")
    for result in results:
        fitted, held = result.correlation["after"], result.correlation["validation"]["after"]
        row = next(line for line in said.splitlines() if line.startswith(f"{result.title}  "))
        shown = [float(x) for x in row.split()[-4:]]
        expected = [f[k] for f in (fitted, held) for k in ("db_error_median", "frac_median")]
        assert shown == pytest.approx(expected, abs=5e-4)
    for words in (
        "Ladisk",
        "not by the improvement",
        "torsion",
        "inferred",
        "Suspension modes",
        "start, E = 200 GPa",
    ):
        assert words in said


def test_one_mode_of_a_computed_structure_is_found() -> None:
    """One degree of freedom with a hysteretic loss factor of 3 % at 100 Hz, plus a constant in receptance."""
    omega0, freq = 2 * np.pi * 100.0, np.linspace(90.0, 110.0, 81)
    w = 2 * np.pi * freq
    receptance = 2.0 / (omega0**2 * (1 + 0.03j) - w**2) + 1e-6
    values = (-(w**2) * receptance)[:, None, None] * np.array([[1.0], [-0.5]])
    frf = updyn.FRF(freq, values, ["1:Z", "2:Z"], ["1:Z"], "accelerance")
    frequency, loss, residues = beam.fit_one_mode(frf, 101.0)
    assert frequency == pytest.approx(100.0, rel=1e-6)
    assert loss == pytest.approx(0.03, rel=1e-4)
    assert residues[1, 0] / residues[0, 0] == pytest.approx(-0.5, rel=1e-6)


def test_what_remains_is_what_the_data_say(results) -> None:
    computed = updyn.correlate(results[0].model, results[0].frf)
    # Half-power width of mode 1 on the 1 Hz lines cannot say more than 1.5 to 2 %; the fit of a
    # pole says 1.76 %.
    _, loss, _ = beam.fit_one_mode(computed.measured, 176.0)
    assert loss == pytest.approx(0.0175, abs=0.001)  # modal identification
    frequency, mac = beam.find_torsion(computed, beam.LENGTH)
    assert frequency == pytest.approx(1376.6, abs=1.0)
    assert mac > 0.6
    swapped, unexplained = beam.reciprocity(computed.measured, computed.computed)
    assert 0.05 < swapped < 0.12
    assert unexplained < swapped
    levels = beam.sensor_levels(computed.measured, computed.computed)
    assert max(map(abs, levels.values())) < 0.35


def test_the_mode_that_the_model_lacks_is_found_in_the_residual(results) -> None:
    """The torsion at 1377 Hz, which no stiffness or mass of a beam that bends in one plane explains."""
    for result in results:
        found = result.adequacy
        assert found.outcome == "structure"
        assert not found.absolute
        assert 1360.0 <= found.worst[0].near <= 1400.0
        assert found.explained_by == ()
        assert f"near {found.worst[0].near:.4g} Hz" in result.message
