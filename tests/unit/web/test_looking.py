"""What pages show of a job, by value: of one that can be read, and of ones that cannot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from updyn.demos import chain
from updyn.dynamics.response import response
from updyn.errors import InputError
from updyn.job import load_job
from updyn.web import looking

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
    view = looking.look(path, JOB)
    assert (view.title, view.model, view.wrong) == ("Chain", "12 DOFs in 4 groups", {})
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
    ("change", "part", "message", "n_tests"),
    [
        (("[test]", "[test"), "job", "job.toml:4: not TOML", 0),
        (('"chain.h5"', '"none.h5"'), "all", "no such file", 1),
        (('"part*"', '"port*"'), "all", "port*", 1),
        (('"chain.uff"', '"none.uff"'), "test", "no such file", 0),
        (("[2.0, 10.0]", "[900.0, 901.0]"), "all", "band", 1),
    ],
)
def test_what_is_wrong_is_said_in_its_place_and_the_rest_is_shown(
    path: Path, change: tuple[str, str], part: str, message: str, n_tests: int
) -> None:
    assert change[0] in JOB
    view = looking.look(path, JOB.replace(*change))
    assert message in view.wrong[part]
    assert view.wrong[part].startswith(str(path))
    assert len(view.tests) == n_tests
    assert view.unknowns == []
    if part != "job":
        assert view.title == "Chain"


def test_a_curve_is_the_response_of_the_model_at_the_values(path: Path) -> None:
    values = {"part1.stiffness": 0.8, "part3.stiffness": 1.5}
    found = looking.curve(path, JOB, values, 0, 1, 0)
    model = chain.build().scaled({"part1": {"stiffness": 0.8}, "part3": {"stiffness": 1.5}})
    expected = response(model, found.freq, ["5:X"], ["2:X"], quantity="accelerance")
    np.testing.assert_allclose(found.values, expected.values[:, 0, 0], rtol=1e-9)
    f = looking.look(path, JOB).tests[0]
    np.testing.assert_array_equal(found.freq, f.freq[f.used])


def test_what_the_data_could_determine(path: Path) -> None:
    found = looking.identifiability(path, JOB)
    assert (found.rank, found.n, found.open) == (4, 4, {})
    assert found.collinearity >= 1.0
    # Two factors on one stiffness: only their product can be told.
    twice = JOB.replace(
        "[method]",
        '[[parameter]]\nname = "all.scale"\ndrives = { "part1.stiffness" = 1 }\n[method]',
    )
    confused = looking.identifiability(path, twice)
    assert (confused.rank, confused.n) == (4, 5)
    assert {"part1.stiffness", "all.scale"} <= set(confused.open)
    assert "all.scale" in confused.open["part1.stiffness"]


def test_the_structure_of_a_model_without_positions(path: Path) -> None:
    with pytest.raises(InputError, match="the model has no geometry"):
        looking.structure(path, JOB)


def test_a_proposed_job_can_be_read(path: Path, chain_project: Path) -> None:
    job = chain_project / "new.toml"
    stated: dict[str, object] = {"quantity": None, "scale": None, "unit": None}
    text = looking.propose(chain_project / "chain.h5", chain_project / "chain.uff", job, stated)
    assert not job.exists()
    assert load_job(job, text=text).model.file == "chain.h5"
    assert looking.look(job, text).wrong == {}
