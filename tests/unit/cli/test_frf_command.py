"""`updyn frf`: records of one file and of several, what is written, what is refused and where."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import wavfile

import hits
import shaken
import updyn
from updyn.cli import main
from updyn.errors import UpdynWarning

SECONDS, BAND = 2.0, (3.0, 80.0)
JOB = """\
[records]
file = "a.lvm"
excitation = { hammer = "1:Z" }
responses = { "1:Z" = "1:Z", "2:Z" = "2:Z" }
impact = { exponential = 0.02, remove_damping = false }
band = [3, 80]
output = "test.nc"
"""


def lvm(records) -> str:
    """Return records as a LabVIEW measurement file, numbers exact."""
    text = "LabVIEW Measurement\nX_Columns\tNo\n***End_of_Header***\n\n"
    n = len(records.channels)
    for values in records.values:
        text += f"Channels\t{n}\n" + "\t".join(["Samples", *[str(values.shape[1])] * n]) + "\n"
        text += "\t".join(["Y_Unit_Label", *records.units]) + "\n"
        text += "\t".join(["Delta_X", *[repr(records.step)] * n]) + "\n***End_of_Header***\n"
        text += "\t".join(["X_Value", *records.channels, "Comment"]) + "\n"
        text += "".join("\t" + "\t".join(map(repr, row)) + "\n" for row in values.T.tolist())
    return text


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return {
        name: lvm(hits.records(3, seconds=SECONDS, noise=1e-3, seed=seed))
        for seed, name in enumerate(("a.lvm", "b.lvm"))
    }


@pytest.fixture
def folder(written: dict[str, str], tmp_path: Path) -> Path:
    for name, text in written.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path


def put(folder: Path, text: str) -> str:
    path = folder / "job.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def estimated(folder: Path, name: str, force: str = "1:Z", **options) -> updyn.FRF:
    return updyn.estimate_frf(
        updyn.read_records(folder / name),
        {"hammer": force},
        window=updyn.ImpactWindow(exponential=0.02, remove_damping=False),
        band=BAND,
        **options,
    )


def test_it_writes_what_the_library_estimates(folder, capsys):
    assert main(["frf", put(folder, JOB + 'reject = { 2 = "late" }\nestimator = "Hv"\n')]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert (
        "a.lvm: 3 records of 3 channels, 1024 samples in 2 s\n  record 2 is left out: late" in out
    )
    found = updyn.read_frf(folder / "test.nc")
    wanted = estimated(folder, "a.lvm", reject={2: "late"}, estimator="Hv")
    np.testing.assert_array_equal(found.values, wanted.values)
    np.testing.assert_array_equal(found.variance, wanted.variance)
    assert found.source == wanted.source == "a.lvm; record 2 omitted: late"
    lowest = f"{wanted.coherence[:, 0, 0].min():.3f}"
    assert any(line.startswith("1:Z") and lowest in line for line in out.splitlines())


@pytest.mark.parametrize("estimator", ["LRM", "H1-LRM"])
def test_local_models_of_a_lasting_force(tmp_path, capsys, estimator):
    """Faults of hits are not looked for, and nothing is cut off or hit twice."""
    (tmp_path / "a.lvm").write_text(lvm(shaken.records(16.0, noise=(0.01, 0.01))), encoding="utf-8")
    job = (
        '[records]\nfile = "a.lvm"\nexcitation = { a = "1:X" }\n'
        f'responses = {{ p = "3:X", q = "4:X" }}\nestimator = "{estimator}"\n'
        'band = [12, 80]\noutput = "test.nc"\n'
    )
    assert main(["frf", put(tmp_path, job)]) == 0
    out, _ = capsys.readouterr()
    assert "nothing found that is wrong with them" in out
    assert "with the variance of each value" in out
    wanted = updyn.estimate_frf(
        updyn.read_records(tmp_path / "a.lvm"),
        {"a": "1:X"},
        responses={"p": "3:X", "q": "4:X"},
        estimator=estimator,
        band=(12.0, 80.0),
    )
    found = updyn.read_frf(tmp_path / "test.nc")
    np.testing.assert_array_equal(found.values, wanted.values)
    np.testing.assert_array_equal(found.variance, wanted.variance)
    share = np.sqrt(wanted.variance[:, 1, 0]) / np.abs(wanted.values[:, 1, 0])
    row = next(line for line in out.splitlines() if line.startswith("4:X") and "%" in line)
    assert row.split()[2] == f"{100.0 * np.median(share):.2g}"
    assert main(["frf", put(tmp_path, job + "overlap = 0.5\n"), "--force"]) == 2
    assert "job.toml:8: overlap 0.5: estimator" in capsys.readouterr().err


def test_what_a_format_has_no_place_for_is_told_with_the_name_of_the_file(folder, capsys):
    assert main(["frf", put(folder, JOB.replace("test.nc", "test.uff"))]) == 0
    assert f"note: {folder / 'test.uff'}: universal files cannot hold variance" in (
        capsys.readouterr().err
    )


def test_hits_in_several_files_are_counted_on(folder):
    text = JOB.replace('"a.lvm"', '["a.lvm", "b.lvm"]') + 'reject = { 4 = "first of b" }\n'
    assert main(["frf", put(folder, text)]) == 0
    found = updyn.read_frf(folder / "test.nc")
    assert found.averages == 5
    assert found.source == "a.lvm, b.lvm; record 4 omitted: first of b"


def test_a_hammer_that_roves_over_files(folder):
    text = JOB.replace('file = "a.lvm"\nexcitation = { hammer = "1:Z" }\n', "") + (
        '[[records.setup]]\nfile = "a.lvm"\nexcitation = { hammer = "1:Z" }\n'
        '[[records.setup]]\nfile = "b.lvm"\nexcitation = { hammer = "7:-Z" }\nreject = { 1 = "x" }\n'
    )
    assert main(["frf", put(folder, text), "--out", str(folder / "roved.npz")]) == 0
    found = updyn.read_frf(folder / "roved.npz")
    assert found.references.labels == ["1:Z", "7:-Z"]
    np.testing.assert_array_equal(found.values[:, :, 0], estimated(folder, "a.lvm").values[:, :, 0])
    other = estimated(folder, "b.lvm", "7:-Z", reject={1: "x"})
    np.testing.assert_array_equal(found.values[:, :, 1], other.values[:, :, 0])
    assert found.averages is None  # three and two


def test_factors_and_units(folder):
    text = JOB + 'factors = { hammer = 2.0 }\nunits = { hammer = "kN" }\n'
    assert main(["frf", put(folder, text)]) == 0
    found = updyn.read_frf(folder / "test.nc")
    assert found.values == pytest.approx(estimated(folder, "a.lvm").values / 2000.0, rel=1e-12)


def test_nothing_is_written_over_except_by_force(folder, capsys):
    job = put(folder, JOB)
    (folder / "test.nc").write_text("mine", encoding="utf-8")
    assert main(["frf", job]) == 2
    assert "test.nc: exists already; --force writes over it" in capsys.readouterr().err
    assert (folder / "test.nc").read_text(encoding="utf-8") == "mine"
    assert main(["frf", job, "--force"]) == 0
    assert len(updyn.read_frf(folder / "test.nc").responses) == 2


def test_info_describes_records(folder, capsys):
    assert main(["info", str(folder / "a.lvm")]) == 0
    out = capsys.readouterr().out
    assert out.startswith("Time records: 3, of 1024 samples in 2 s (512 a second)\nchannel  unit")
    (folder / "b.lvm").write_text((folder / "a.lvm").read_text(encoding="utf-8")[:-9], "utf-8")
    assert main(["info", str(folder / "b.lvm")]) == 2
    assert "the last line" in capsys.readouterr().err


def test_a_sound_file_that_runs_on_over_several_hits(tmp_path, capsys):
    single = hits.records(3, seconds=SECONDS, noise=1e-4)
    whole = np.concatenate([np.zeros((3, 256)), *single.values], axis=1)
    size = np.abs(whole).max(axis=1, keepdims=True)
    wavfile.write(tmp_path / "a.wav", round(1.0 / single.step), (whole / size).T)
    of_f, of_top, of_tip = size[:, 0].tolist()
    text = f"""
[records]
file = "a.wav"
reader = {{ channels = ["hammer", "top", "tip"] }}
units = {{ hammer = "N", top = "m", tip = "m" }}
factors = {{ hammer = {of_f}, top = {of_top}, tip = {of_tip} }}
excitation = {{ hammer = "1:Z" }}
responses = {{ top = "1:Z", tip = "2:Z" }}
cut = {{ length = 1.75, before = 0.02 }}
output = "test.nc"
"""
    assert main(["frf", put(tmp_path, text)]) == 0
    assert "a.wav: 3 records of 3 channels, 896 samples in 1.75 s" in capsys.readouterr().out
    found = updyn.read_frf(tmp_path / "test.nc")
    first = int(np.argmax(single.values[0, 0] > 0.2 * single.values[:, 0].max()))
    start = first - round(0.02 / single.step)
    own = replace(single, values=single.values[:, :, start : start + 896])
    wanted = updyn.estimate_frf(own, {"hammer": "1:Z"}, responses={"1:Z": "1:Z", "2:Z": "2:Z"})
    assert np.abs(found.values - wanted.values).max() < 1e-9 * np.abs(wanted.values).max()
    job = put(tmp_path, text.replace("length = 1.75", "length = 1.99"))
    assert main(["frf", job, "--force"]) == 2
    assert f"error: {job}:9: record 1: the hit at" in capsys.readouterr().err


def test_two_shakers_at_once(tmp_path):
    rng = np.random.default_rng(0)
    force = rng.standard_normal((2, 8192))
    one, two = hits.displacement(force[0]), hits.displacement(force[1])
    motion = np.array([one[0] + two[1], one[1] - two[0]])
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["all"] = np.concatenate([force, motion])
        file["fs"] = 1.0 / hits.STEP
    text = """
[records]
file = "a.h5"
reader = { values = "all", channels = ["a", "b", "p", "q"], order = ["channel", "time"], rate = "fs" }
units = { a = "N", b = "N", p = "m", q = "m" }
excitation = { a = "1:Z", b = "2:Z" }
responses = { p = "3:Z", q = "4:Z" }
segment = 2.0
output = "test.nc"
"""
    assert main(["frf", put(tmp_path, text)]) == 0
    found = updyn.read_frf(tmp_path / "test.nc")
    assert (found.references.labels, found.responses.labels) == (["1:Z", "2:Z"], ["3:Z", "4:Z"])
    exact = hits.receptance(found.freq)
    wanted = np.stack(
        [np.stack([exact[:, 0], exact[:, 1]], 1), np.stack([exact[:, 1], -exact[:, 0]], 1)], 1
    )
    quiet = found.freq > 70.0  # beyond the peaks nothing leaks
    error = np.abs(found.values - wanted)[quiet] / np.abs(wanted[quiet]).max()
    assert np.median(error) < 0.05


SETUPS = """\
[[records.setup]]
file = "a.lvm"
[[records.setup]]
file = "b.lvm"
"""


@pytest.mark.parametrize(
    ("old", "new", "line", "message"),
    [
        ("excitation", "exitation", 3, "unknown key 'exitation' in [records]; did you mean"),
        ("exponential", "exponent", 5, "unknown key 'exponent' in [records.impact]"),
        ("a.lvm", "c.lvm", 2, "records.file = 'c.lvm': no such file; did you mean"),
        ("hammer =", "hamer =", 3, "no channel 'hamer'; did you mean 'hammer'?"),
        ('"2:Z" = "2:Z"', '"2:Z" = "2:Q"', 4, "channel '2:Z': DOF '2:Q'"),
        ("[3, 80]", "[300, 800]", 6, "no line in it; lines go to 256 Hz"),
        ('"test.nc"', '"test.doc"', 7, "neither content nor suffix '.doc'"),
        ('"test.nc"', '"a.lvm"', 7, "a.lvm: is a file to read"),
        ("output", "outpt", 7, "unknown key 'outpt' in [records]; did you mean 'output'?"),
        ('output = "test.nc"', "", 1, "[records] names no output; add one, or --out FILE"),
        ("band", 'reject = { 9 = "x" }\nband', 6, "reject: no record 9; there are 3"),
        ("band", 'reject = { one = "x" }\nband', 6, "record 'one'; expected whole numbers"),
        ("band", 'units = { hammer = "m" }\nband', 6, "unit 'm' given, the records say 'N'"),
        ("band", "factors = { hamer = 2 }\nband", 6, "no channel 'hamer'"),
        ("band", "segment = 0.5\nband", 1, "windows for hits need whole records"),
        ("band", "reader = { rate = 3 }\nband", 6, "has no option 'rate'"),
        ("band", 'format = "lvn"\nband', 6, "format 'lvn' cannot read_records; did you mean 'lvm'"),
        ("band", 'estimator = "H4"\nband', 6, "records.estimator = 'H4': valid: 'H1', 'H2', 'Hv'"),
        ("[records]", "[record]", 1, "unknown key 'record'; did you mean 'records'?"),
        ('file = "a.lvm"\n', "", 1, "missing key 'file', or [[records.setup]] with files"),
        ('file = "a.lvm"\n', 'file = "job.toml"\n', 2, "is of a format that can read_records"),
        (
            JOB,
            JOB.replace('file = "a.lvm"\n', "") + SETUPS,
            9,
            "response 1:Z to reference 1:Z was measured twice: in a.lvm and in b.lvm",
        ),
        (JOB, JOB + SETUPS, 1, "file and [[records.setup]]; expected one of the two"),
    ],
)
def test_bad_jobs_are_refused_with_their_line(folder, capsys, old, new, line, message):
    assert old in JOB
    job = put(folder, JOB.replace(old, new, 1))
    before = {p.name for p in folder.iterdir()}
    assert main(["frf", job]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"error: {job}:{line}: "), err
    assert message in err
    assert {p.name for p in folder.iterdir()} == before


# -- an update of FRFs that come straight from records ------------------------------------------------
UPDATE = """\
[model]
file = "model.h5"
[test]
responses = ["1:Z"]
[[parameter]]
groups = "all"
quantity = "stiffness"
[output]
report = false
"""


@pytest.fixture
def with_model(folder: Path) -> Path:
    """A single mass on a spring beside the records; only that it runs is looked at."""
    group = updyn.Group(stiffness=[[(2 * np.pi * 12.0) ** 2 * 2.0]], mass=[[2.0]], loss_factor=0.04)
    updyn.write_model(updyn.Model.from_groups({"all of it": group}, ["1:Z"]), folder / "model.h5")
    return folder


def test_a_test_without_a_file_takes_the_records(with_model, capsys):
    text = JOB.replace('output = "test.nc"\n', "").replace("[3, 80]", "[8, 16]") + UPDATE
    job = put(with_model, text)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UpdynWarning)
        main(["run", job])
    record = json.loads((with_model / "job" / "result.json").read_text(encoding="utf-8"))
    (found,) = record["parameters"]
    assert found["value"] == pytest.approx(1.0, abs=0.2)
    err = capsys.readouterr().err
    assert "note: a.lvm: Record 1, 1:Z: at its end" in err
    # The resolved job names the records as seen from its folder, and runs again.
    again = (with_model / "job" / "job.toml").read_text(encoding="utf-8")
    assert 'file = ["../a.lvm"]' in again
    assert main(["check", str(with_model / "job" / "job.toml")]) == 0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (UPDATE, ":3: missing key 'file' in [test], and no [records] or modes in its place"),
        (
            JOB + UPDATE.replace("[test]\n", '[test]\nfile = "b.lvm"\n'),
            ":1: [records] are used by no test",
        ),
        (
            JOB + UPDATE.replace("[test]\n", '[test]\nquantity = "mobility"\n'),
            ":11: test.quantity belongs to a file of FRFs",
        ),
    ],
)
def test_a_test_has_a_file_or_records(with_model, capsys, text, message):
    assert main(["check", put(with_model, text)]) == 2
    assert message in capsys.readouterr().err


def test_records_alone_give_modes(folder: Path) -> None:
    """`updyn modes` needs neither a model nor [test]."""
    assert main(["modes", put(folder, JOB), "--out", str(folder / "out")]) == 0
    found = updyn.read_modes(folder / "out" / "modes.unv")
    expected = updyn.identify_modes(estimated(folder, "a.lvm"))
    assert found.frequency == pytest.approx(expected.frequency, rel=1e-5)
