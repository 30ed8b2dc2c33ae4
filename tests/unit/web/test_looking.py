"""What pages show of a job, by value: of one that can be read, and of ones that cannot."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tomlkit import parse

from updyn.demos import chain
from updyn.dofs import DofSet
from updyn.dynamics.modes import modes
from updyn.dynamics.response import response
from updyn.errors import InputError
from updyn.io import write_frf, write_model, write_modes
from updyn.job import load_job, prepare
from updyn.modal import ModeSet
from updyn.model import Model
from updyn.nonlinear.cubic import CubicSpring
from updyn.web import looking
from updyn.web.edits import hold_out, leave_out, set_band
from viewer_case import block

JOB = """\
title = "Chain"
[model]
file = "chain.h5"
[test]
file = "chain.uff"
band = [2.0, 10.0]
exclude = [[4.0, 5.0]]
[[parameter]]
groups = "part*"
quantity = "stiffness"
bounds = [0.3, 3.0]
[method]
name = "output-error"
validation = ["7:X"]
"""


@pytest.fixture
def path(chain_project: Path) -> Path:
    found = chain_project / "job.toml"
    found.write_text("# on disk something else\n")
    return found


def test_a_job_that_can_be_read(path: Path) -> None:
    view = looking.read_view(path, JOB)
    assert (view.title, view.model, view.errors) == ("Chain", "12 DOFs in 4 groups", {})
    assert view.groups == ["part1", "part2", "part3", "part4"]
    assert [(u.name, u.group, u.quantity, u.start, u.lower, u.upper) for u in view.unknowns] == [
        (f"part{n}.stiffness", f"part{n}", "stiffness", 1.0, 0.3, 3.0) for n in (1, 2, 3, 4)
    ]
    (test,) = view.tests
    data = chain.measure()
    assert (test.name, test.quantity, test.band, test.held) == (
        "",
        "accelerance",
        (2.0, 10.0),
        ["7:X"],
    )
    np.testing.assert_allclose(test.freq, data.freq, rtol=1e-6)
    np.testing.assert_allclose(test.values, data.values, rtol=1e-5)
    assert (test.responses, test.references) == (data.responses.labels, data.references.labels)
    f = test.freq
    np.testing.assert_array_equal(test.used, (f >= 2) & (f <= 10) & ~((f >= 4) & (f <= 5)))
    assert {(row["sensor"], row["dof"]) for row in test.matches} == {
        (label, label) for label in ("2:X", "5:X", "7:X", "10:X", "12:X")
    }


@pytest.mark.parametrize(
    ("change", "part", "message", "n_tests", "n_unknowns"),
    [
        (("[test]", "[test"), "job", "job.toml:4: not TOML", 0, 0),
        (('"chain.h5"', '"none.h5"'), "model", "no such file", 1, 0),
        (('"part*"', '"port*"'), "parameter", "port*", 1, 0),
        (('"chain.uff"', '"none.uff"'), "test", "no such file", 0, 4),
        (("[2.0, 10.0]", "[900.0, 901.0]"), "test", "band", 1, 4),
    ],
)
def test_what_is_wrong_is_said_in_its_place_and_the_rest_is_shown(
    path: Path, change: tuple[str, str], part: str, message: str, n_tests: int, n_unknowns: int
) -> None:
    assert change[0] in JOB
    view = looking.read_view(path, JOB.replace(*change))
    assert message in view.errors[part]
    assert view.errors[part].startswith(str(path))
    assert len(view.tests) == n_tests
    assert len(view.unknowns) == n_unknowns
    if part != "job":
        assert view.title == "Chain"


@pytest.fixture
def numbered(path: Path) -> str:
    """A job whose test numbers its sensors from 1, one of them turned, with the table for it."""
    data = chain.measure()
    new = {old: f"{number}:X" for number, old in enumerate(data.responses.labels, 1)}
    new["10:X"] = "4:-X"
    labels = {
        "responses": DofSet(new[label] for label in data.responses.labels),
        "references": DofSet(new[label] for label in data.references.labels),
    }
    write_frf(dataclasses.replace(data, **labels), path.with_name("chain.uff"))
    table = "".join(f'"{sensor.replace("-", "")}" = "{old}"\n' for old, sensor in new.items())
    return JOB.replace("[2.0, 10.0]", "[0.0, 100.0]") + f"[match.table]\n{table}"


def test_responses_are_held_out_by_the_labels_of_the_model(path: Path, numbered: str) -> None:
    (test,) = looking.read_view(path, numbered).tests
    assert test.responses == ["1:X", "2:X", "3:X", "4:-X", "5:X"]
    assert (test.held, test.held_band) == (["7:X"], None)
    assert dict(test.holdable) == {
        "2:X": "2:X (sensor 1:X)",
        "5:X": "5:X (sensor 2:X)",
        "7:X": "7:X (sensor 3:X)",
        "10:-X": "10:-X (sensor 4:X)",
        "12:X": "12:X (sensor 5:X)",
    }
    for label in test.holdable:
        document = parse(numbered)
        hold_out(["7:X", label] if label != "7:X" else [label])(document)
        ready = prepare(load_job(path, text=document.as_string()))
        assert len(ready.tests[0].fitted.responses) == (4 if label == "7:X" else 3)


def test_what_is_held_out_is_offered_as_the_job_writes_it(path: Path, numbered: str) -> None:
    """With another sign, where it cannot be known what it is, and a band in place of responses."""
    (test,) = looking.read_view(path, numbered.replace('"7:X"]', '"7:-X", "10:X"]')).tests
    assert test.held == ["7:-X", "10:X"]
    assert list(test.holdable) == ["2:X", "5:X", "7:-X", "10:X", "12:X"]

    view = looking.read_view(path, numbered.replace('["7:X"]', '["3:X"]'))
    assert "validation response 3:X" in view.errors["method"]
    (test,) = view.tests
    assert (test.held, dict(test.holdable)) == (["3:X"], {"3:X": "3:X"})

    (test,) = looking.read_view(path, numbered.replace('["7:X"]', "[3.0, 4.5]")).tests
    assert (test.held, test.held_band) == ([], (3.0, 4.5))
    assert len(test.holdable) == 5


LABELS = ["2:X", "5:X", "7:X", "10:X", "12:X"]


def test_the_model_is_its_response_at_the_values(path: Path) -> None:
    values = {"part1.stiffness": 0.8, "part3.stiffness": 1.5}
    found = looking.compute_model(path, JOB, values, 0, ["9:X", *LABELS], ["2:X", "12:X"])
    model = chain.build().scaled({"part1": {"stiffness": 0.8}, "part3": {"stiffness": 1.5}})
    expected = response(model, found.freq, LABELS, ["2:X", "12:X"], quantity="accelerance")
    np.testing.assert_allclose(found.values[:, 1:], expected.values, rtol=1e-6)
    assert np.isnan(found.values[:, 0]).all()  # a sensor that the data lack
    f = looking.read_view(path, JOB).tests[0]
    assert set(f.freq[f.used]) < set(found.freq)
    assert found.repaired is None


def test_the_level_error_is_that_of_the_fitted_data(path: Path) -> None:
    found = looking.compute_model(path, JOB, {}, 0, LABELS, ["2:X"])
    data = prepare(load_job(path, text=JOB)).tests[0].fitted
    assert len(data.responses) == 4
    computed = response(chain.build(), data.freq, data.responses, data.references, "accelerance")
    error = np.abs(20.0 * np.log10(np.abs(computed.values / data.values)))
    assert found.level_error == pytest.approx(np.median(error), rel=1e-6)


def test_the_model_has_the_channels_of_the_file_and_the_data_their_repairs(
    path: Path, numbered: str
) -> None:
    """Of sensors that the file numbers otherwise, one of them with the opposite sign."""
    repaired = numbered.replace("band =", 'repair = ["dead-channel:5:X", "sign:7:X"]\nband =')
    (test,) = looking.read_view(path, repaired).tests
    found = looking.compute_model(path, repaired, {}, 0, test.responses, test.references)
    expected = response(chain.build(), found.freq, LABELS, ["2:X", "12:X"], "accelerance").values
    np.testing.assert_allclose(found.values[:, [0, 2, 4]], expected[:, [0, 2, 4]], rtol=1e-6)
    np.testing.assert_allclose(found.values[:, 3], -expected[:, 3], rtol=1e-6)
    assert np.isnan(found.values[:, 1]).all()
    assert found.repaired is not None
    used = np.isin(test.freq, found.repaired_freq)
    np.testing.assert_allclose(found.repaired[:, 0], test.values[used, 0], rtol=1e-6)
    np.testing.assert_allclose(found.repaired[:, 2], -test.values[used, 2], rtol=1e-6)
    assert np.isnan(found.repaired[:, 1]).all()


def test_a_model_with_an_element_is_its_response_at_the_level_of_the_test(path: Path) -> None:
    model = chain.build().with_elements({"stop": (CubicSpring(1e8), "12:X")})
    measured = response(model, np.linspace(1.0, 20.0, 40), ["12:X"], ["12:X"], level=1.0).frf
    write_frf(measured, path.with_name("level.npz"))
    text = """\
[model]
file = "chain.h5"
[[element]]
name = "stop"
kind = "cubic-spring"
dofs = "12:X"
coefficient = 1e8
[test]
file = "level.npz"
[[parameter]]
groups = "part1"
quantity = "stiffness"
"""
    found = looking.compute_model(path, text, {"part1.stiffness": 1.1}, 0, ["12:X"], ["12:X"])
    other = model.scaled({"part1": {"stiffness": 1.1}})
    at = np.searchsorted(found.freq, measured.freq)
    expected = response(other, measured.freq, ["12:X"], ["12:X"], level=1.0).values
    np.testing.assert_allclose(found.values[at, 0, 0], expected[:, 0, 0], rtol=0.01)
    assert found.level_error > 0.0


def test_the_model_of_a_run_is_the_updated_one(path: Path) -> None:
    folder = path.with_name("run")
    folder.mkdir()
    job = folder / "job.toml"
    job.write_text(JOB.replace('"chain.', '"../chain.'), encoding="utf-8")
    updated = chain.build().scaled({"part2": {"mass": 1.3}})
    write_model(updated, folder / "model.h5")
    (test,) = looking.read_run(job).tests
    assert test.responses == LABELS
    found = looking.compute_run_model(job, 0, ["5:X"], ["2:X"])
    expected = response(updated, found.freq, ["5:X"], ["2:X"], quantity="accelerance")
    np.testing.assert_allclose(found.values, expected.values, rtol=1e-6)
    with pytest.raises(InputError, match=r"none\.toml: cannot be read"):
        looking.read_run(folder / "none.toml")


def test_what_the_data_could_determine(path: Path) -> None:
    found = looking.assess_identifiability(path, JOB)
    assert (found.rank, found.n, found.undetermined) == (4, 4, {})
    assert found.collinearity >= 1.0
    # Two factors on one stiffness: only their product can be told.
    twice = JOB.replace(
        "[method]",
        '[[parameter]]\nname = "all.scale"\ndrives = { "part1.stiffness" = 1 }\n[method]',
    )
    confused = looking.assess_identifiability(path, twice)
    assert (confused.rank, confused.n) == (4, 5)
    assert {"part1.stiffness", "all.scale"} <= set(confused.undetermined)
    assert "all.scale" in confused.undetermined["part1.stiffness"]


def test_the_structure_of_a_model_without_positions(path: Path) -> None:
    with pytest.raises(InputError, match="the model has no geometry"):
        looking.render_structure(path, JOB)
    assert not looking.read_view(path, JOB).has_picture


MIXED = """\
title = "Mixed"
[model]
file = "chain.h5"
[[test]]
name = "theirs"
modes = "chain.unv"
[[test]]
name = "ours"
file = "chain.uff"
band = [2.0, 10.0]
[[parameter]]
groups = "part*"
quantity = "stiffness"
"""


def test_tests_with_modes_and_tests_with_frfs_keep_their_numbers(path: Path) -> None:
    """An edit or a curve of the second test is of the second, though the first has no FRFs."""
    measured = ModeSet(
        [2.2, 6.4], np.eye(2), ["2:X", "5:X"], [0.02, 0.03], std_frequency=[0.01, np.nan]
    )
    write_modes(measured, path.with_name("chain.unv"))
    view = looking.read_view(path, MIXED)
    assert view.errors == {}
    assert [(test.number, test.name) for test in view.tests] == [(1, "ours")]
    (modal,) = view.modal
    assert (modal.number, modal.name) == (0, "theirs")
    assert [(row["mode"], row["frequency"], row["damping"]) for row in modal.modes] == [
        ("1", "2.2", "0.02"),
        ("2", "6.4", "0.03"),
    ]
    assert [row["dof"] for row in modal.matches] == ["2:X", "5:X"]
    edited = parse(MIXED)
    set_band(3.0, 9.0, view.tests[0].number)(edited)
    assert "band" not in edited["test"][0]
    assert list(edited["test"][1]["band"]) == [3.0, 9.0]
    found = looking.compute_model(path, MIXED, {}, view.tests[0].number, ["5:X"], ["2:X"])
    assert set(view.tests[0].freq[view.tests[0].used]) < set(found.freq)


@pytest.fixture(scope="module")
def solid(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str, Model]:
    """A block with a job whose start has half the stiffness of the file's left half."""
    folder, model = tmp_path_factory.mktemp("solid"), block()
    data = response(model, np.linspace(10.0, 200.0, 40), ["15:X", "15:-Z"], ["15:Z"])
    write_model(model, folder / "block.h5")
    bare = dataclasses.replace(data.geometry, faces=None)  # a universal file has no place for them
    write_frf(dataclasses.replace(data, geometry=bare), folder / "block.uff")
    text = (
        '[model]\nfile = "block.h5"\n[test]\nfile = "block.uff"\n[[parameter]]\n'
        'groups = "left"\nquantity = "stiffness"\nstart = 0.5\n'
    )
    return folder / "job.toml", text, model


def drawn(page: str) -> dict[str, Any]:
    """The scene of a page."""
    found = re.search(r'<script type="application/json" id="updyn-scene">(.*?)</script>', page)
    assert found is not None
    scene: dict[str, Any] = json.loads(found[1])
    return scene


def test_the_structure_has_sensors_and_forces_and_tells_of_picks(
    solid: tuple[Path, str, Model],
) -> None:
    page = looking.render_structure(*solid[:2])
    assert looking.read_view(*solid[:2]).has_picture
    assert looking.FORWARD in page
    scene = drawn(page)
    assert [arrow["label"] for arrow in scene["arrows"]] == ["15:X", "15:-Z", "15:Z"]
    assert scene["modes"] is None


def test_the_modes_of_the_structure_are_those_of_the_start(solid: tuple[Path, str, Model]) -> None:
    path, text, model = solid
    rows = drawn(looking.render_structure(path, text, 3))["modes"]["rows"]
    start = modes(model.scaled({"left": {"stiffness": 0.5}}), 3)
    expected = [f"{i}: {f:.5g} Hz" for i, f in enumerate(start.frequency, 1)]
    assert [row["label"].partition(",")[0] for row in rows] == expected
    assert len(drawn(looking.render_structure(path, text, 10**6))["modes"]["rows"]) == model.n_dofs


def test_a_sensor_with_the_wrong_sign_is_found_and_undone(path: Path) -> None:
    data = chain.measure()
    values = data.values.copy()
    values[:, 1] *= -1.0
    write_frf(dataclasses.replace(data, values=values), path.with_name("chain.uff"))
    text = JOB.replace("[2.0, 10.0]", "[0.0, 100.0]")
    found = looking.find_faults(path, text)
    assert found[0].repair == "sign:5:X"
    assert "5:X" in found[0].statement
    assert found[0].omissible == {"responses": ["5:X"]}
    view = found[0].view
    assert view is not None
    assert view.channel in ("5:X / 2:X", "5:X / 12:X")
    np.testing.assert_allclose(view.after, -view.before)
    assert view.residual_after < 1.0 < view.residual_before
    edited = parse(text)
    leave_out(found[0].omissible, {"responses": LABELS})(edited)
    left = looking.read_view(path, edited.as_string())
    assert left.tests[0].responses == ["2:X", "7:X", "10:X", "12:X"]
    assert left.errors == {}
    assert [row.odds for row in found] == sorted((row.odds for row in found), reverse=True)
    repaired = text.replace("band =", 'repair = ["sign:5:X"]\nband =')
    assert all(row.repair != "sign:5:X" for row in looking.find_faults(path, repaired))


def test_coherence_is_that_of_the_file(path: Path) -> None:
    data = chain.measure()
    stated = np.linspace(0.2, 1.0, data.values.size).reshape(data.values.shape)
    write_frf(dataclasses.replace(data, coherence=stated), path.with_name("coherent.nc"))
    assert looking.read_view(path, JOB).tests[0].coherence is None
    seen = looking.read_view(path, JOB.replace("chain.uff", "coherent.nc")).tests[0].coherence
    np.testing.assert_allclose(seen, stated, rtol=1e-6)


def test_a_proposed_job_can_be_read(path: Path, chain_project: Path) -> None:
    job = chain_project / "new.toml"
    stated: dict[str, object] = {"quantity": None, "scale": None, "unit": None}
    text = looking.propose_job(chain_project / "chain.h5", chain_project / "chain.uff", job, stated)
    assert not job.exists()
    assert load_job(job, text=text).model.file == "chain.h5"
    assert looking.read_view(job, text).errors == {}
