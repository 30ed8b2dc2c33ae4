"""The job: what is read and matched, by value; what is written, and that it is written whole or not at all."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import updyn
from updyn.demos import chain
from updyn.elements.constraints import constrain
from updyn.elements.masses import add_masses
from updyn.errors import InputError, JobError, UpdynWarning
from updyn.frf import FRF
from updyn.job import job_identifiability, load_job, prepare, run_job
from updyn.job.folder import can_resume

BASE = """\
[model]
file = "in/chain.h5"
[test]
file = "in/chain.npz"
{test}
{match}
{parameter}
[method]
name = "output-error"
{method}
[output]
report = false
"""
STIFFNESS = '[[parameter]]\ngroups = "part*"\nquantity = "stiffness"\n'


def job_at(
    folder: Path, *, test: str = "", match: str = "", parameter: str = STIFFNESS, method: str = ""
) -> Any:
    path = folder / "job.toml"
    path.write_text(
        BASE.format(test=test, match=match, parameter=parameter, method=method), encoding="utf-8"
    )
    return load_job(path)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "in").mkdir()
    updyn.write_model(chain.build(), tmp_path / "in" / "chain.h5")
    updyn.write_frf(chain.measure(), tmp_path / "in" / "chain.npz")
    return tmp_path


DOCUMENTED = """\
title = "Azimuth drive, run 3"
[model]
file = "model.h5"                 # any readable model; or kind = "drivetrain" | "beam" | ... with its own table
[test]
file = "test.uff"
band = [5.0, 400.0]               # Hz
quantity = "accelerance"          # only where the file does not say; a contradiction is an error
[match]                           # how sensors map to DOFs
by = "label"
[[parameter]]
groups = ["shaft", "gear*"]       # globs
quantity = "stiffness"
bounds = [0.3, 3.0]
prior_std = 0.3                   # optional
[method]
name = "maximum-likelihood"
lines = "d-optimal:60"
validation = ["5:+Z"]             # responses (or a band) held out of the fit and scored afterwards
[output]
report = true
"""


def test_the_documented_job_file(tmp_path: Path) -> None:
    (tmp_path / "job.toml").write_text(DOCUMENTED, encoding="utf-8")
    job = load_job(tmp_path / "job.toml")
    assert job.title == "Azimuth drive, run 3"
    assert job.test.reader_options == {"quantity": "accelerance"}
    (parameter,) = job.parameter
    assert (parameter.groups, parameter.bounds, parameter.prior_std) == (
        ("shaft", "gear*"),
        (0.3, 3.0),
        0.3,
    )
    assert (job.method.lines, job.method.validation, job.method.options) == (
        "d-optimal:60",
        ("5:+Z",),
        {},
    )
    assert job.output.report


def test_the_title_is_that_of_the_job_then_of_its_model_then_the_name_of_the_file(
    tmp_path: Path,
) -> None:
    path = tmp_path / "drive.toml"
    titled, plain = (
        load_job(path, text=DOCUMENTED),
        load_job(path, text=DOCUMENTED[DOCUMENTED.index("[model]") :]),
    )
    assert titled.find_title("Model") == titled.find_title() == "Azimuth drive, run 3"
    assert (plain.find_title("Model"), plain.find_title()) == ("Model", "drive")


# -- load and prepare --------------------------------------------------------------------------------------
def test_a_job_is_immutable_and_knows_its_lines(folder: Path) -> None:
    job = job_at(folder, test="band = [1.0,\n 20]")
    assert job.test.band == (1.0, 20.0)
    assert [job.place(*p) for p in (("test",), ("test", "band", 1), ("parameter", 0, "quantity"), ("nowhere",))] == [
        3, 6, 10, None,
    ]  # fmt: skip
    with pytest.raises(ValueError, match="frozen"):
        job.title = "other"


def test_a_byte_order_mark_and_windows_line_ends_are_read(tmp_path: Path) -> None:
    path = tmp_path / "job.toml"
    text = '[model]\nfile = "m.h5"\n[test]\nfile = "t.uff"\n' + STIFFNESS
    path.write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    job = load_job(path)
    assert job.test.file == "t.uff"
    assert job.place("parameter", 0, "quantity") == 7


def test_band_and_selection(folder: Path) -> None:
    ready = prepare(
        job_at(
            folder, test='band = [2.0, 10.0]\nresponses = ["12:-X", "5:X"]\nreferences = ["2:X"]'
        )
    )
    full = chain.measure()
    keep = (full.freq >= 2.0) & (full.freq <= 10.0)
    np.testing.assert_array_equal(ready.frf.freq, full.freq[keep])
    np.testing.assert_array_equal(ready.frf.values[:, 0, 0], -full.values[keep, 4, 0])
    np.testing.assert_array_equal(ready.frf.values[:, 1, 0], full.values[keep, 1, 0])


def test_a_job_without_a_title_has_that_of_its_model(folder: Path) -> None:
    loaded = job_at(folder)
    assert prepare(loaded).title == chain.build().title
    assert run_job(loaded, folder / "out").result.title == chain.build().title
    again = load_job(folder / "out" / "job.toml")
    assert again.title == chain.build().title
    model = chain.build()
    untitled = updyn.Model(model.groups, model.dofs, model.geometry)
    updyn.write_model(untitled, folder / "in" / "chain.h5")
    assert prepare(job_at(folder)).title == "job"


def test_averages_are_added_and_not_contradicted(folder: Path) -> None:
    assert prepare(job_at(folder, test="averages = 8")).frf.averages == 8
    data = chain.measure()
    told = FRF(data.freq, data.values, data.responses, data.references, data.quantity, averages=5)
    updyn.write_frf(told, folder / "in" / "chain.npz")
    assert prepare(job_at(folder)).frf.averages == 5
    with pytest.raises(
        JobError, match=r"job\.toml:5: test\.averages = 8, but in/chain\.npz states 5"
    ):
        prepare(job_at(folder, test="averages = 8"))


def test_match_table_renames_with_signs(folder: Path) -> None:
    # Sensors 5 and 7 were swapped, and 12 sits upside down under another name.
    data = chain.measure()
    labels = ["2:X", "7:X", "5:X", "10:X", "99:-Z"]
    updyn.write_frf(
        FRF(data.freq, data.values, labels, ["2:X", "99:-Z"], data.quantity),
        folder / "in" / "chain.npz",
    )
    table = '[match.table]\n"7:X" = "5:X"\n"5:X" = "7:X"\n"99:+Z" = "12:-X"'
    ready = prepare(job_at(folder, match=table))
    assert ready.frf.responses.labels == ["2:X", "5:X", "7:X", "10:X", "12:X"]  # - times - is +
    assert ready.frf.references.labels == ["2:X", "12:X"]
    np.testing.assert_array_equal(ready.frf.values, data.values)


def test_all_sensors_without_a_dof_are_named_with_the_nearest(folder: Path) -> None:
    data = chain.measure()
    labels = [f"{n}:Y" for n in (1, 2, 3, 4)] + ["5:X"]
    updyn.write_frf(
        FRF(data.freq, data.values, labels, ["2:X", "30:X"], data.quantity),
        folder / "in" / "chain.npz",
    )
    with pytest.raises(JobError) as caught:
        prepare(job_at(folder))
    message = str(caught.value)
    assert message.startswith(
        f"{folder / 'job.toml'}:4: 5 of the sensors and forces of in/chain.npz"
    )
    assert "response 3:Y is not among the 12 DOFs; nearest: 3:X" in message
    assert "reference 30:X is not among the 12 DOFs; nearest: 12:X" in message
    assert "[match.table]" in message


def test_unknowns_from_several_tables(folder: Path) -> None:
    text = """
[[parameter]]
groups = ["part[12]", "part4"]
quantity = "loss_factor"
bounds = [0.001, 0.2]
start = 0.05
[[parameter]]
groups = "part2"
quantity = "stiffness"
bounds = [2.0, 5.0]
start = 2.5
prior_std = 0.3
[[parameter]]
groups = "all"
quantity = "mass"
"""
    found = prepare(job_at(folder, parameter=text)).parameters
    assert [(p.name, p.start, p.lower, p.upper, p.prior_std) for p in found] == [
        ("part1.mass", 1.0, 0.01, 100.0, None),
        ("part1.loss_factor", 0.05, 0.001, 0.2, None),
        ("part2.mass", 1.0, 0.01, 100.0, None),
        ("part2.stiffness", 2.5, 2.0, 5.0, 0.3),
        ("part2.loss_factor", 0.05, 0.001, 0.2, None),
        ("part3.mass", 1.0, 0.01, 100.0, None),
        ("part4.mass", 1.0, 0.01, 100.0, None),
        ("part4.loss_factor", 0.05, 0.001, 0.2, None),
    ]


def test_a_linked_unknown_with_its_physical_quantity(folder: Path) -> None:
    text = """
[[parameter]]
name = "rubber.E"
drives = { "part1.stiffness" = 1, "part[34].stiffness" = 2 }
nominal = 5e6
unit = "Pa"
bounds = [0.5, 2.0]
[[parameter]]
groups = "part2"
quantity = "stiffness"
nominal = 2.1e11
unit = "Pa"
"""
    job = job_at(folder, parameter=text)
    plain, linked = prepare(job).parameters
    assert (plain.name, plain.physical(0.9)) == ("part2.stiffness", "1.89e+11 Pa")
    assert (linked.name, linked.law) == (
        "rubber.E",
        "part1.stiffness, part3.stiffness^2, part4.stiffness^2",
    )
    assert linked.physical(1.2, 0.01) == "6e+06 ± 5e+04 Pa"
    result = run_job(job, out=folder / "out").result
    assert "Pa" in result.summary()
    assert load_job(folder / "out" / "job.toml").parameter == job.parameter
    again = updyn.read_result(folder / "out" / "run.nc")
    assert again.parameters == result.parameters
    assert updyn.read_model(folder / "out" / "model.h5").group(
        "part3"
    ).stiffness.toarray() == pytest.approx(
        prepare(job).model.group("part3").stiffness.toarray() * result.values["rubber.E"] ** 2,
        rel=1e-13,
    )


@pytest.mark.parametrize(
    ("method", "lines", "responses"),
    [
        ("", 60, 5),
        ('validation = ["5:-X", "12:X"]', 60, 3),
        ("validation = [5.0, 12.0]", 60 - 19, 5),
        ("validation = [0.1, 12]", 29, 5),
    ],
)
def test_what_is_held_out_is_not_fitted(
    method: str, lines: int, responses: int, folder: Path
) -> None:
    ready = prepare(job_at(folder, method=method))
    assert (len(ready.fitted.freq), len(ready.fitted.responses)) == (lines, responses)
    assert len(ready.frf.freq) == 60


def test_held_out_data_are_the_ones_that_the_update_holds_out(folder: Path) -> None:
    for method in ('validation = ["5:-X", "12:X"]', "validation = [5.0, 12.0]"):
        job = job_at(folder, method=method + "\nmax_iterations = 1")
        ready = prepare(job)
        result = run_job(job, prepared=ready).result
        assert list(result.fitted_responses) == ready.fitted.responses.labels
        np.testing.assert_array_equal(result.lines, ready.fitted.freq)


def test_a_model_from_a_builder(tmp_path: Path) -> None:
    beam = {
        "length": 0.5,
        "E": 2.1e11,
        "rho": 7850.0,
        "width": 0.02,
        "height": 0.01,
        "n_elements": 4,
    }
    text = (
        "[model]\nkind = 'beam'\n"
        + "".join(f"{k} = {v!r}\n" for k, v in beam.items())
        + "stations = { 7 = 0.25 }\n"
    )
    text += '[test]\nfile = "t.npz"\n[[parameter]]\ngroups = "beam"\nquantity = "stiffness"\n'
    (tmp_path / "job.toml").write_text(text)
    values = np.ones((2, 1, 1), dtype=complex)
    updyn.write_frf(FRF([10.0, 20.0], values, ["7:Z"], ["7:Z"], "receptance"), tmp_path / "t.npz")
    model = prepare(load_job(tmp_path / "job.toml")).model
    assert model.n_dofs == 10
    mass = model.mass.toarray()[::2, ::2].sum()
    assert mass == pytest.approx(7850.0 * 0.5 * 0.02 * 0.01)


# -- run ---------------------------------------------------------------------------------------------------
def test_run_gives_back_what_it_writes(folder: Path) -> None:
    seen = []
    result = run_job(
        job_at(folder, method="lines = 'd-optimal:20'"), folder / "a" / "b", seen.append
    ).result
    again = updyn.read_result(folder / "a" / "b" / "run.nc")
    assert again.values == result.values
    assert again.title == chain.build().title
    assert seen[0].iteration == 0
    assert [p.name for p in (folder / "a" / "b").iterdir() if p.name.startswith(".")] == []


def test_the_report_is_that_of_the_run(folder: Path) -> None:
    path = job_at(folder, method="max_iterations = 1").path
    without = path.read_text(encoding="utf-8")
    path.write_text(without.replace("report = false", ""), encoding="utf-8")
    run_job(load_job(path), folder / "out")
    assert "<section" in (folder / "out" / "report.html").read_text(encoding="utf-8")
    path.write_text(without, encoding="utf-8")
    run_job(load_job(path), folder / "out")
    # that of the earlier run would pass for this one's
    assert not (folder / "out" / "report.html").exists()


def test_the_callback_stops_the_run_and_outputs_are_written(folder: Path) -> None:
    result = run_job(
        job_at(folder), folder / "out", lambda progress: progress.iteration >= 1
    ).result
    assert result.status == "stopped"
    assert updyn.read_result(folder / "out" / "run.nc").status == "stopped"


def test_a_run_that_breaks_down_leaves_its_journal_alone(folder: Path) -> None:
    def fail(_progress: object) -> bool:
        raise RuntimeError("from the callback")

    before = sorted(folder.rglob("*"))
    job, out = job_at(folder), folder / "a" / "b"
    with pytest.raises(RuntimeError, match="from the callback"):
        run_job(job, out, fail)
    left = [folder / "job.toml", folder / "a", out, out / "run.journal"]
    assert sorted(folder.rglob("*")) == sorted([*before, *left])
    assert (
        run_job(job, out, resume=True).result.values == run_job(job, folder / "fresh").result.values
    )


def test_outputs_appear_only_when_all_are_written(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job, out = job_at(folder), folder / "out"
    run_job(job, out)
    before = {p.name: p.read_bytes() for p in out.iterdir()}

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device", "result.json")

    monkeypatch.setattr("updyn.job.run.write_result_json", fail)
    with pytest.raises(OSError, match="No space left"):
        run_job(job_at(folder, method="max_iterations = 1"), out)
    assert {p.name: p.read_bytes() for p in out.iterdir() if p.name != "run.journal"} == before


def test_outputs_can_be_read_by_others_as_any_new_file(folder: Path) -> None:
    run_job(job_at(folder), folder / "out")
    (folder / "plain").touch()
    expected = (folder / "plain").stat().st_mode
    names = ("result.json", "run.nc", "model.h5", "job.toml", "manifest.json")
    assert {p.name: p.stat().st_mode for p in (folder / "out").iterdir()} == dict.fromkeys(
        names, expected
    )


def test_errors_of_the_update_name_the_line_of_the_method(folder: Path) -> None:
    job = job_at(folder, method="max_iterations = 3\nlines = 'd-optimal:61'")
    with pytest.raises(
        JobError, match=r"job\.toml:14: lines 'd-optimal:61': the data have 60 lines"
    ):
        run_job(job)
    assert issubclass(JobError, InputError)
    assert not (folder / "job").exists()


# -- resume ------------------------------------------------------------------------------------------------
def outcome(result: Any) -> tuple[object, ...]:
    return (
        result.status,
        result.values,
        result.std,
        result.history,
        result.correlation,
        result.noise,
    )


def test_a_stopped_run_goes_on_to_the_result_of_one_that_was_not(folder: Path) -> None:
    job = job_at(
        folder,
        method='lines = "d-optimal:25"\nvalidation = ["7:X"]',
        parameter=STIFFNESS + "prior_std = 0.5",
    )
    fresh = run_job(job, folder / "fresh").result
    assert not (folder / "fresh" / "run.journal").exists()
    stopped = run_job(job, folder / "out", lambda progress: progress.iteration >= 2).result
    assert stopped.status == "stopped"
    assert (folder / "out" / "run.journal").exists()
    result = run_job(job, folder / "out", resume=True, engine=1).result
    assert outcome(result) == outcome(fresh)
    assert outcome(updyn.read_result(folder / "out" / "run.nc"))[:2] == outcome(fresh)[:2]
    assert not (folder / "out" / "run.journal").exists()
    assert (folder / "out" / "job.toml").read_text(encoding="utf-8") == (
        folder / "fresh" / "job.toml"
    ).read_text(encoding="utf-8")


def test_a_run_that_needed_more_steps_is_given_them(folder: Path) -> None:
    full = run_job(job_at(folder), folder / "fresh").result
    assert (
        run_job(job_at(folder, method="max_iterations = 2"), folder / "out").result.status
        == "max-iterations"
    )
    assert outcome(run_job(job_at(folder), folder / "out", resume=True).result) == outcome(full)


def test_only_a_run_of_the_same_job_is_resumed(folder: Path) -> None:
    out = folder / "out"
    run_job(job_at(folder, test="band = [1.0, 20.0]", method="max_iterations = 1"), out)
    kept = (out / "run.journal").read_bytes()
    with pytest.raises(JobError, match=r"of another run: the data differ.*without resume"):
        run_job(job_at(folder, test="band = [2.0, 20.0]"), out, resume=True)
    other = STIFFNESS.replace("part*", "part[123]")
    with pytest.raises(JobError, match=r"the unknowns differ \(part4\.stiffness\)"):
        run_job(job_at(folder, test="band = [1.0, 20.0]", parameter=other), out, resume=True)
    with pytest.raises(JobError, match=r"job\.toml:\d+: .*the options differ \(tolerance\)"):
        run_job(
            job_at(folder, test="band = [1.0, 20.0]", method="tolerance = 1e-3"), out, resume=True
        )
    assert (out / "run.journal").read_bytes() == kept


def test_where_nothing_was_saved_the_run_begins_anew_and_says_so(folder: Path) -> None:
    job, out = job_at(folder), folder / "out"
    fresh = run_job(job, folder / "fresh").result
    with pytest.warns(UpdynWarning, match=r"run\.journal' does not exist; the run begins anew"):
        first = run_job(job, out, resume=True).result
    assert outcome(first) == outcome(fresh)
    with pytest.warns(
        UpdynWarning, match=r"the run in .*out' has ended \(converged\); it begins anew"
    ):
        again = run_job(job, out, resume=True).result
    assert outcome(again) == outcome(fresh)


@pytest.mark.parametrize("text", ["[" * 100_000, "\xff", '{"status": ', "[1]", "9" * 5000])
def test_a_damaged_record_of_a_run_is_nothing_to_resume(tmp_path: Path, text: str) -> None:
    (tmp_path / "result.json").write_text(text, encoding="latin-1")
    with pytest.warns(UpdynWarning, match="does not exist; the run begins anew"):
        assert not can_resume(tmp_path)


def test_one_command_for_every_start_of_a_scheduler(folder: Path) -> None:
    """With resume from the first start on, a run that breaks off each time gets to its end."""
    job, out = job_at(folder), folder / "out"
    fresh = run_job(job, folder / "fresh").result
    with pytest.warns(UpdynWarning, match="begins anew"):
        run_job(job, out, lambda progress: progress.iteration >= 1, resume=True)
    stopped = run_job(job, out, lambda progress: progress.iteration >= 3, resume=True).result
    assert stopped.status == "stopped"
    assert outcome(run_job(job, out, resume=True).result) == outcome(fresh)


def test_a_run_that_is_refused_leaves_no_journal(folder: Path) -> None:
    """The drive point is missed only when the method looks, after the start was solved."""
    path = job_at(folder, test='responses = ["2:X"]\nreferences = ["12:X"]').path
    path.write_text(
        path.read_text(encoding="utf-8").replace('"output-error"', '"equation-error"'),
        encoding="utf-8",
    )
    job = load_job(path)
    with pytest.raises(JobError, match="reference 12:X is not among the responses"):
        run_job(job, folder / "out")
    assert not (folder / "out").exists()


SEVERAL = """\
[model]
file = "in/chain.h5"
[[test]]
name = "as it stands"
file = "in/chain.npz"
[[test]]
name = "tip held"
file = "in/held.npz"
grounded = ["12:X"]
masses = {{ "3:X" = 0.4 }}
noise = {{ relative = 0.02 }}
validation = ["5:X"]
[[parameter]]
groups = "part*"
quantity = "stiffness"
{more}
"""


def several(folder: Path, more: str = "") -> Any:
    """A chain as it stands, and with its tip held and a mass added, both of the same truth."""
    loaded = add_masses(chain.build(), {"3:X": 0.4})
    truth = constrain(loaded, grounded=["12:X"]).scaled(chain.TRUTH)
    exact = updyn.response(
        truth, np.linspace(0.7, 22.0, 50), ["2:X", "5:X", "7:X"], ["2:X"], quantity="accelerance"
    )
    draw = np.random.default_rng(5).standard_normal((2, *exact.values.shape))
    values = exact.values * (1.0 + 0.02 * np.sqrt(0.5) * (draw[0] + 1j * draw[1]))
    held = FRF(exact.freq, values, exact.responses, exact.references, "accelerance")
    updyn.write_frf(held, folder / "in" / "held.npz")
    path = folder / "job.toml"
    path.write_text(SEVERAL.format(more=more), encoding="utf-8")
    return load_job(path)


EVERYTHING = """[[parameter]]
groups = "all"
quantity = "mass"
[[parameter]]
groups = "all"
quantity = "loss_factor"
"""


def test_several_tests_of_one_structure(folder: Path) -> None:
    job = several(folder, EVERYTHING)
    ready = prepare(job)
    assert [t.name for t in ready.tests] == ["as it stands", "tip held"]
    assert [t.model.n_dofs for t in ready.tests] == [12, 11]
    assert "added mass.mass" not in ready.parameters.names
    assert job_identifiability(ready).complete
    result = run_job(job, out=folder / "out").result
    assert result.ok, result.summary()
    off = [
        (result.values[p.name] - chain.TRUTH[p.group][p.quantity]) / result.std[p.name]
        for p in result.parameters
    ]
    assert np.abs(off).max() < 4.0
    held = result["tip held"]
    assert held.validation_responses == ("5:X",)
    assert held.noise["kind"] == "stated"
    out = folder / "out"
    assert sorted(p.name for p in out.iterdir()) == [
        "as it stands",
        "job.toml",
        "manifest.json",
        "report.html",
        "result.json",
        "tip held",
    ]
    for name in ("as it stands", "tip held"):
        assert sorted(p.name for p in (out / name).iterdir()) == [
            "model.h5",
            "report.html",
            "run.nc",
        ]
        assert updyn.read_result(out / name / "run.nc").values == result.values
    written = json.loads((out / "result.json").read_text())
    assert list(written["tests"]) == ["as it stands", "tip held"]
    assert written["tests"]["tip held"]["correlation"]["validation"]["after"]["frac_median"] > 0.99
    page = (out / "report.html").read_text()
    assert 'href="tip%20held/report.html"' in page
    again = load_job(out / "job.toml")
    assert [p.test.grounded for p in again.parts] == [None, ("12:X",)]
    assert run_job(again, out=folder / "twice").result.values == result.values


def test_a_single_test_may_have_a_configuration(folder: Path) -> None:
    held = 'grounded = ["12:X"]\nresponses = ["2:X", "5:X"]\nreferences = ["2:X"]'
    ready = prepare(job_at(folder, test=held))
    assert ready.model.dofs.labels == [f"{i}:X" for i in range(1, 12)]
