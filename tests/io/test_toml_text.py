"""TOML texts that `tomllib` reads or refuses in other ways: too deep, too large."""

import tomllib

import pytest

import updyn
from updyn.errors import FormatError, JobError
from updyn.io.toml_text import parse_toml
from updyn.job import load_job


def test_a_document_is_that_of_tomllib():
    text = 'a = 1\nb = [1.5, "x", true]\n[c.d]\ne = 9223372036854775807\n[[f]]\ng = {h = 2}\n'
    assert parse_toml(text) == tomllib.loads(text)


@pytest.mark.parametrize("text", ["a = 1\nb = 0.0", "b = 1e5", "x = 'y'\nt = 12:30:00", "b = 1_0"])
def test_a_number_at_the_end_that_may_be_cut(text):
    with pytest.raises(
        tomllib.TOMLDecodeError, match=r"the last line, '. = .*', does not end: .* \(at line \d"
    ):
        parse_toml(text)
    assert parse_toml(text + "\n") == tomllib.loads(text)


@pytest.mark.parametrize(
    "text", ["a = 'x1'", "a = [1]", "a = true", "# = 1", "a = 1 # 2", "[a.b2]", "a = {b = 1}"]
)
def test_ends_that_no_cut_leaves(text):
    assert parse_toml(text) == tomllib.loads(text)


@pytest.mark.parametrize("depth", [60, 300, 5000])
def test_deep_nesting(depth, tmp_path):
    text = "a = " + "[" * depth + "]" * depth + "\n"
    with pytest.raises(tomllib.TOMLDecodeError, match="nested more than 50 deep"):
        parse_toml(text)
    (tmp_path / "m.toml").write_text(text)
    with pytest.raises(FormatError, match=r"m\.toml: not a TOML file: .* nested more than 50 deep"):
        updyn.read_model(tmp_path / "m.toml")
    with pytest.raises(JobError, match=r"m\.toml: not TOML: .* nested more than 50 deep"):
        load_job(tmp_path / "m.toml")


@pytest.mark.parametrize("number", ["9" * 20, "-" + "9" * 400, "9" * 5000, "1_" * 30 + "0"])
def test_large_whole_numbers(number, tmp_path):
    (tmp_path / "m.toml").write_text(f"title = 'x'\nb = {number}\n")
    with pytest.raises(FormatError, match=r"m\.toml:2: not a TOML file: .* does not fit 64 bits"):
        updyn.read_model(tmp_path / "m.toml")
    with pytest.raises(JobError, match=r"m\.toml:2: not TOML: .* does not fit 64 bits"):
        load_job(tmp_path / "m.toml")
