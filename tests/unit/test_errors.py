"""Errors: one hierarchy, places in files, nearest choices."""

from __future__ import annotations

import pickle

import pytest

from updyn import errors


@pytest.mark.parametrize(
    "name",
    [
        "DofError",
        "ModelError",
        "DataError",
        "FormatError",
        "ParameterError",
        "OptionError",
        "JobError",
    ],
)
def test_input_errors_are_updyn_errors_and_value_errors(name):
    kind = getattr(errors, name)
    assert issubclass(kind, errors.InputError)
    assert issubclass(kind, errors.UpdynError)
    assert issubclass(kind, ValueError)


def test_a_solver_error_is_no_input_error_and_a_warning_is_no_error():
    assert issubclass(errors.SolverError, errors.UpdynError)
    assert not issubclass(errors.SolverError, errors.InputError)
    assert issubclass(errors.UpdynWarning, UserWarning)
    assert not issubclass(errors.UpdynWarning, errors.UpdynError)


def test_the_tree_in_the_docstring_names_every_class():
    kinds = [n for n in errors.__all__ if isinstance(getattr(errors, n), type)]
    assert [n for n in kinds if n not in errors.__doc__] == []


@pytest.mark.parametrize("kind", [errors.FormatError, errors.JobError])
@pytest.mark.parametrize(
    ("path", "line", "text"),
    [
        (None, None, "bad"),
        ("a/test.uff", None, "a/test.uff: bad"),
        ("a/test.uff", 12, "a/test.uff:12: bad"),
    ],
)
def test_file_errors_start_with_the_place(kind, path, line, text):
    error = kind("bad", path, line)
    assert str(error) == text
    assert (error.path, error.line) == (path, line)


def test_a_path_object_is_kept_as_text(tmp_path):
    assert errors.FormatError("bad", tmp_path / "x.uff").path == str(tmp_path / "x.uff")


def test_file_errors_survive_a_process_boundary():
    error = pickle.loads(pickle.dumps(errors.FormatError("bad", "x.uff", 3)))  # noqa: S301
    assert (str(error), error.path, error.line) == ("x.uff:3: bad", "x.uff", 3)


@pytest.mark.parametrize(
    ("word", "choices", "expected"),
    [
        ("shfat", ["gear", "shaft", "belt"], ["shaft"]),
        ("SHAFT", ["shafts", "shaft"], ["shaft"]),
        ("xyz", ["shaft"], []),
        ("gear", [], []),
        ("gear", ["gear1", "gear1", "gear2", "gear3", "gear4"], ["gear4", "gear3", "gear2"]),
    ],
)
def test_nearest(word, choices, expected):
    assert errors.nearest(word, choices) == expected


def test_nearest_returns_at_most_n():
    assert errors.nearest("gear", ["gear1", "gear2", "gear3"], n=1) == ["gear3"]


@pytest.mark.parametrize(
    ("word", "choices", "expected"),
    [
        ("shfat", ["gear", "shaft"], "did you mean 'shaft'?"),
        ("masss", ["mass", "mass1"], "did you mean 'mass' or 'mass1'?"),
        ("xyz", ["gear", "shaft"], "valid: 'gear', 'shaft'"),
        ("xyz", [], "no choices exist"),
    ],
)
def test_suggest(word, choices, expected):
    assert errors.suggest(word, choices) == expected


def test_suggest_shows_twelve_of_many():
    text = errors.suggest("xyz", [f"g{i:02d}" for i in range(20)])
    assert text.startswith("valid: 'g00', 'g01'")
    assert text.endswith("'g11', ... (20 in all)")
