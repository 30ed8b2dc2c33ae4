"""`updyn new`: a job that loads, says what was found, and never writes over a file."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import updyn
from updyn.cli import main
from updyn.demos import chain
from updyn.dofs import DofSet
from updyn.elements.beam import beam
from updyn.geometry import Geometry
from updyn.io import write_frf, write_model
from updyn.job import load_job, prepare


def test_the_job_of_the_chain_can_be_checked(
    chain_folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(chain_folder)
    assert main(["new", "chain.h5", "chain.npz"]) == 0
    said = capsys.readouterr().out
    assert "5 of 5 sensors and forces are DOFs of the model, by label" in said
    assert said.endswith("Next: updyn check job.toml\n")
    text = Path("job.toml").read_text(encoding="utf-8")
    assert "# chain.h5:\n#   Model 'Chain of twelve masses': 12 DOFs, 4 groups" in text
    assert "# chain.npz:\n#   FRF: accelerance, 60 lines from 0.634882 to 22.6954 Hz" in text
    assert "#   2 references: 2:X, 12:X" in text
    assert "band = [0.63" in text
    assert "Hz; lines to use, both ends included" in text
    job = load_job(Path("job.toml"))
    assert (job.model.file, job.test.file, job.match.by) == ("chain.h5", "chain.npz", "label")
    ready = prepare(job)
    assert set(ready.parameters.names) == {
        f"part{i}.{what}" for i in (1, 2, 3, 4) for what in ("stiffness", "loss_factor")
    }
    (held,) = job.validation or ()
    assert held in chain.measure().responses.labels
    assert held not in chain.measure().references.labels
    assert main(["check", "job.toml"]) == 0
    assert "The data determine 8 of 8 unknowns" in capsys.readouterr().out


def test_every_proposal_in_a_comment_can_be_used(
    chain_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Lines that are settings in comments, taken one by one."""
    monkeypatch.chdir(chain_folder)
    assert main(["new", "chain.h5", "chain.npz"]) == 0
    lines = Path("job.toml").read_text(encoding="utf-8").splitlines()
    taken = 0
    for number, line in enumerate(lines):
        key = line.removeprefix("# ").partition(" = ")[0]
        if not line.startswith("# ") or key not in ("band", "responses", "lines", "noise"):
            continue
        changed = [*lines[:number], line.removeprefix("# "), *lines[number + 1 :]]
        Path("other.toml").write_text("\n".join(changed), encoding="utf-8")
        assert main(["check", "other.toml"]) == 0
        taken += 1
    assert taken == 4
    masses = [line.removeprefix("# ") for line in lines[_mass(lines) :]]
    Path("other.toml").write_text(
        "\n".join([*lines[: _mass(lines)], *masses]).replace("The noise", "# The noise"),
        encoding="utf-8",
    )
    names = prepare(load_job(Path("other.toml"))).parameters.names
    assert "part1.mass" in names


def _mass(lines: list[str]) -> int:
    return lines.index("# [[parameter]]")


def test_files_are_named_from_the_folder_of_the_job(chain_folder: Path) -> None:
    (chain_folder / "jobs").mkdir()
    out = chain_folder / "jobs" / "first.toml"
    files = [str(chain_folder / name) for name in ("chain.h5", "chain.npz")]
    assert main(["new", *files, "--out", str(out)]) == 0
    assert 'file = "../chain.h5"' in out.read_text(encoding="utf-8")
    assert main(["check", str(out)]) == 0


def test_an_existing_file_is_never_written_over(
    chain_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = chain_folder / "mine.toml"
    out.write_text("mine", encoding="utf-8")
    files = [str(chain_folder / name) for name in ("chain.h5", "chain.npz")]
    assert main(["new", *files, "--out", str(out)]) == 2
    said, err = capsys.readouterr()
    assert (said, err.count("error:")) == ("", 1)
    assert "mine.toml: exists already; choose another name with --out" in " ".join(err.split())
    assert out.read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize(
    ("words", "fragment"),
    [
        (["chain.npz", "chain.npz"], "chain.npz"),
        (["chain.hh", "chain.npz"], "no such file; did you mean 'chain.h5'"),
        (["chain.h5", "chain.npz", "--quantity", "receptance"], "contradicts the file"),
        (["chain.h5", "chain.npz", "--out", "no/job.toml"], "does not exist"),
    ],
)
def test_what_cannot_be_read_is_refused(
    words: list[str],
    fragment: str,
    chain_folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(chain_folder)
    before = sorted(Path().rglob("*"))
    assert main(["new", *words]) == 2
    err = capsys.readouterr().err
    assert fragment in err
    assert err.count("error:") == 1
    assert sorted(Path().rglob("*")) == before


def test_a_quantity_that_the_file_does_not_state_is_left_to_the_user(
    chain_folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(chain_folder)
    write_frf(chain.measure(), "chain.csv")
    csv = Path("chain.csv")
    lines = csv.read_text(encoding="utf-8").splitlines()
    csv.write_text("\n".join(x for x in lines if "quantity" not in x) + "\n", encoding="utf-8")
    assert main(["new", "chain.h5", "chain.csv"]) == 0
    said = capsys.readouterr().out
    assert "Before it can run, state what was measured: quantity in [test]" in said
    text = Path("job.toml").read_text(encoding="utf-8")
    assert "a quantity that is not stated" in text
    assert "accelerance, 60 lines" not in text
    assert main(["check", "job.toml"]) == 2
    assert "quantity" in capsys.readouterr().err
    stated = text.replace('# quantity = "accelerance"', 'quantity = "accelerance"')
    Path("job.toml").write_text(stated, encoding="utf-8")
    assert main(["check", "job.toml"]) == 0
    words = ["--quantity", "accelerance", "--out", "second.toml"]
    assert main(["new", "chain.h5", "chain.csv", *words]) == 0
    assert main(["check", "second.toml"]) == 0


def test_sensors_that_are_no_dofs_are_listed_to_be_filled_in(
    chain_folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(chain_folder)
    data = chain.measure()
    labels = [x.replace("7:X", "70:X").replace("10:X", "100:X") for x in data.responses.labels]
    write_frf(replace(data, responses=DofSet(labels)), "other.npz")
    assert main(["new", "chain.h5", "other.npz"]) == 0
    said = capsys.readouterr().out
    assert "state where 2 of 5 sensors and forces are on the model: [match.table]" in said
    text = Path("job.toml").read_text(encoding="utf-8")
    assert "validation = " in text
    assert main(["check", "job.toml"]) == 2
    for label, of_model in (("70:X", "7:X"), ("100:X", "10:X")):
        assert f'# "{label}" = ""' in text
        text = text.replace(f'# "{label}" = ""', f'"{label}" = "{of_model}"')
    Path("job.toml").write_text(text, encoding="utf-8")
    assert main(["check", "job.toml"]) == 0


def test_two_sensors_on_one_degree_of_freedom_are_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Both lie next to the same node: neither labels nor coordinates match."""
    monkeypatch.chdir(tmp_path)
    model = beam(length=1.0, E=2e11, rho=7850.0, width=0.05, height=0.01, n_elements=4)
    write_model(model, "beam.h5")
    data = updyn.response(model, [5.0, 9.0], ["2:Z", "3:Z"], ["2:Z"], quantity="mobility")
    positions = Geometry(np.array([901, 902]), np.array([[0.25, 0, 0], [0.251, 0, 0]]))
    named = DofSet(["901:Z", "902:Z"])
    moved = replace(data, responses=named, references=DofSet(["901:Z"]), geometry=positions)
    write_frf(moved, "beam.uff")
    assert main(["new", "beam.h5", "beam.uff"]) == 0
    assert "2 of 2 sensors and forces" in capsys.readouterr().out
    text = Path("job.toml").read_text(encoding="utf-8")
    assert "#   By coordinates: " in text
    assert load_job(Path("job.toml")).match.by == "label"


def test_sensors_are_matched_by_coordinates_where_labels_do_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    model = beam(
        length=1.0,
        E=2e11,
        rho=7850.0,
        width=0.05,
        height=0.01,
        n_elements=8,
        supports=[("foot", 0.0, 1e6, 1e4)],
        loss_factor=0.01,
    )
    write_model(model, "beam.h5")
    geometry = model.geometry
    assert geometry is not None
    nodes, own = geometry.nodes[[2, 4, 6, 8]], geometry.xyz[[2, 4, 6, 8]]
    freq = np.linspace(5.0, 300.0, 40)
    of_model = [f"{node}:Z" for node in nodes]
    data = updyn.response(model, freq, of_model, of_model[-1:], quantity="accelerance")
    named = [f"{901 + k}:Z" for k in range(4)]
    moved = replace(
        data,
        responses=DofSet(named),
        references=DofSet(named[-1:]),
        geometry=Geometry(np.array([901, 902, 903, 904]), own + np.array([0.001, 0.0, 0.0])),
    )
    write_frf(moved, "beam.uff")
    assert main(["new", "beam.h5", "beam.uff"]) == 0
    assert "4 of 4 sensors and forces are DOFs of the model, by coordinates" in (
        capsys.readouterr().out
    )
    job = load_job(Path("job.toml"))
    assert job.match.by == "coordinates"
    text = Path("job.toml").read_text(encoding="utf-8")
    assert f"901:Z   response                {of_model[0]} " in text
    assert main(["check", "job.toml"]) in (0, 3)
    assert prepare(job).tests[0].frf.responses.labels == of_model


def two_masses(*groups: str, title: str = "") -> updyn.Model:
    stiffness = np.array([[2.0, -1.0], [-1.0, 1.0]]) * 1e5
    made = {
        name: updyn.Group(stiffness=stiffness * (number + 1), mass=np.eye(2), loss_factor=0.02)
        for number, name in enumerate(groups)
    }
    return updyn.Model.from_groups(made, dofs=["1:X", "2:X"], title=title)


def test_names_with_any_character_give_a_job_that_loads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    model = two_masses('a "b" \\ \x7f', "all", title='\x7f \x1b[31m "é" \\')
    write_model(model, "mod\nel.h5")
    frf = updyn.response(model, np.linspace(5.0, 200.0, 9), ["1:X", "2:X"], ["1:X"])
    write_frf(frf, "me as\x7f.npz")
    assert main(["new", "mod\nel.h5", "me as\x7f.npz", "--out", "jo b.toml"]) == 0
    assert capsys.readouterr().out.endswith("Next: updyn check 'jo b.toml'\n")
    job = load_job("jo b.toml")
    assert job.title == model.title
    assert (job.model.file, job.test.file) == ("mod\nel.h5", "me as\x7f.npz")
    assert len(prepare(job).parameters) == 4  # of "all" too, which is the name of a group here


def test_masses_are_counted_where_nothing_is_elastic(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    model = updyn.Model.from_groups({"rotor": updyn.Group(mass=np.eye(1))}, dofs=["1:X"])
    write_model(model, "model.h5")
    write_frf(updyn.response(model, [5.0, 9.0], ["1:X"], ["1:X"]), "test.npz")
    assert main(["new", "model.h5", "test.npz"]) == 0
    assert "\nproposed: 1 unknown\n" in capsys.readouterr().out
    assert len(prepare(load_job("job.toml")).parameters) == 1


@pytest.mark.skipif(os.name != "posix", reason="names of files are text elsewhere")
@pytest.mark.parametrize("name", ["model", "test", "job"])
def test_names_that_are_not_utf8_are_refused_and_nothing_is_written(
    chain_folder: Path,
    name: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(chain_folder)
    names = {"model": "chain.h5", "test": "chain.npz", "job": "job.toml"}
    odd = f"f\udcff{Path(names[name]).suffix}"
    if name != "job":
        Path(names[name]).rename(odd)
    names[name] = odd
    before = sorted(Path().iterdir())
    assert main(["new", names["model"], names["test"], "--out", names["job"]]) == 2
    assert "the name is not UTF-8" in capsys.readouterr().err
    assert sorted(Path().iterdir()) == before


def test_nothing_is_left_of_a_look_that_was_interrupted(
    chain_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else the next one would be told that the job exists already."""

    def interrupted(*_: object) -> str:
        raise KeyboardInterrupt

    monkeypatch.chdir(chain_folder)
    monkeypatch.setattr("updyn.cli.commands.describe_model", interrupted)
    assert main(["new", "chain.h5", "chain.npz"]) == 130
    assert not Path("job.toml").exists()


# -- labels and positions ----------------------------------------------------------------------------
#: Nodes of the beam at which sensors 1 to 5 of the test are, from its other end.
PLACES = [21, 17, 13, 9, 5]


def beam_with_wrong_numbers(factor: float = 1.0, n: int = 5, at: int = 0) -> None:
    """Write a model, and a test whose numbers 1 to n are those of other nodes of the model."""
    model = beam(
        length=1.0,
        E=2e11,
        rho=7850.0,
        width=0.05,
        height=0.01,
        n_elements=20,
        supports=[("foot", 0.0, 1e6, 1e4)],
        loss_factor=0.01,
    )
    write_model(model, "beam.h5")
    assert model.geometry is not None
    of_model = [f"{node}:-Z" for node in PLACES[:n]]
    freq = np.linspace(5.0, 300.0, 40)
    data = updyn.response(model, freq, of_model, of_model[-1:], quantity="accelerance")
    named = [f"{at + k + 1}:-Z" for k in range(n)]
    xyz = factor * model.geometry.position(PLACES[:n])
    moved = replace(
        data,
        responses=DofSet(named),
        references=DofSet(named[-1:]),
        geometry=Geometry(np.arange(at + 1, at + n + 1), xyz),
    )
    write_frf(moved, "beam.uff")


@pytest.mark.parametrize(
    ("factor", "unit"), [(1.0, None), (1000.0, "mm"), (1.0 / 0.0254, "in")], ids=["m", "mm", "in"]
)
@pytest.mark.parametrize("at", [0, 900], ids=["contradictory", "unknown"])
def test_coordinates_are_proposed_where_labels_are_not_those_of_the_model(
    factor: float,
    unit: str | None,
    at: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    beam_with_wrong_numbers(factor, at=at)
    assert main(["new", "beam.h5", "beam.uff"]) == 0
    said = capsys.readouterr().out
    assert "5 of 5 sensors and forces are DOFs of the model, by coordinates" in said
    reason = "are not DOFs of the model:" if at else "labels and positions contradict each other"
    assert reason in said
    text = Path("job.toml").read_text(encoding="utf-8")
    assert reason in text.replace("\n#   ", " ")
    job = load_job(Path("job.toml"))
    assert (job.match.by, job.match.unit) == ("coordinates", unit)
    if unit is not None:
        assert f'unit = "{unit}"' in said
    assert prepare(job).tests[0].frf.responses.labels == [f"{node}:-Z" for node in PLACES]
    assert main(["check", "job.toml"]) in (0, 3)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("at", [0, 900])
def test_the_response_that_is_proposed_for_validation_is_one_of_the_job(
    n: int, at: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    beam_with_wrong_numbers(n=n, at=at)
    assert main(["new", "beam.h5", "beam.uff"]) == 0
    lines = Path("job.toml").read_text(encoding="utf-8").splitlines()
    (number,) = (k for k, line in enumerate(lines) if "validation = [" in line)
    lines[number] = lines[number].removeprefix("# ")
    Path("job.toml").write_text("\n".join(lines), encoding="utf-8")
    job = load_job(Path("job.toml"))
    (held,) = job.validation or ()
    if n == 1:
        with pytest.raises(updyn.UpdynError, match="holds out everything"):
            prepare(job)
        return
    ready = prepare(job)
    assert held in ready.frf.responses.labels
    assert len(ready.tests[0].fitted.responses) == n - 1


def test_positions_in_another_system_are_left_to_the_user(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    beam_with_wrong_numbers()
    frf = updyn.read_frf("beam.uff")
    assert frf.geometry is not None
    turned = frf.geometry.xyz @ np.array([[0.0, 1.0, 0], [-1, 0, 0], [0, 0, 1]]) + [0, 3.0, 0]
    write_frf(replace(frf, geometry=Geometry(frf.geometry.nodes, turned)), "turned.uff")
    assert main(["new", "beam.h5", "turned.uff"]) == 0
    said = capsys.readouterr().out
    assert "labels and positions contradict each other" in said
    assert "Before it can run, state how the sensors lie on the model: [match]" in said
    text = Path("job.toml").read_text(encoding="utf-8")
    assert "validation" not in text
    assert main(["check", "job.toml"]) == 2
    assert "labels and positions contradict each other" in capsys.readouterr().err


def test_equal_labels_in_millimetres_are_kept_and_it_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    beam_with_wrong_numbers(1000.0)
    frf = updyn.read_frf("beam.uff")
    assert frf.geometry is not None
    same = {k + 1: node for k, node in enumerate(PLACES)}
    responses, references = (
        DofSet([f"{same[dof.node]}:-Z" for dof in dofs]) for dofs in (frf.responses, frf.references)
    )
    geometry = Geometry(PLACES, frf.geometry.position(list(same)))
    write_frf(replace(frf, responses=responses, references=references, geometry=geometry), "b.uff")
    assert main(["new", "beam.h5", "b.uff"]) == 0
    said = capsys.readouterr().out
    assert "5 of 5 sensors and forces are DOFs of the model, by label" in said
    assert "The positions of the test look like mm" in said
    assert load_job(Path("job.toml")).match.by == "label"
    assert main(["check", "job.toml"]) in (0, 3)
    assert "look like mm" in capsys.readouterr().out


def test_options_of_the_readers_are_used_and_written_into_the_job(
    chain_folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(chain_folder)
    frf = chain.measure()
    H = frf.values[:, 0, 0]
    rows = [
        f"{f!r};{h.real!r};{h.imag!r}" for f, h in zip(frf.freq.tolist(), H.tolist(), strict=True)
    ]
    Path("table.csv").write_text("\n".join(["f (Hz);re;im", *rows]) + "\n")
    response, reference = frf.responses.labels[0], frf.references.labels[0]
    channel = f'{{response = "{response}", reference = "{reference}", real = 2, imaginary = 3}}'
    option = f"columns={{frequency = 1, channels = [{channel}]}}"
    arguments = ["new", "chain.h5", "table.csv", "--quantity", frf.quantity]
    assert main([*arguments, "--test-option", option]) == 0
    read = prepare(load_job(Path("job.toml"))).frf
    np.testing.assert_allclose(read.values[:, 0, 0], H, rtol=1e-14)
    assert main(["info", "table.csv", "--quantity", frf.quantity, "--test-option", option]) == 0
    assert f"1 responses: {response}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--model-option", "spc"], "--model-option 'spc': expected KEY=VALUE"),
        (["--model-option", "a=1", "--model-option", "a=2"], "a is given twice"),
        (["--unit", "mm", "--model-option", "unit=m"], "by --unit and by --model-option"),
        (["--model-option", "unitt=m"], "has no option 'unitt'"),
    ],
)
def test_options_of_a_reader_that_are_wrong(
    options: list[str],
    message: str,
    chain_folder: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(chain_folder)
    assert main(["new", "chain.h5", "chain.npz", *options]) == 2
    assert message in capsys.readouterr().err
    assert not Path("job.toml").exists()
