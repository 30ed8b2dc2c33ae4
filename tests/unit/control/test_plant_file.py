"""Plants written and read back; what other programs see; files that are damaged."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import updyn
from plants_by_hand import double_integrator, plant, two_masses
from updyn.cli import main
from updyn.control.plant import Plant
from updyn.control.sampled import sampled
from updyn.demos.gear_train import true_model
from updyn.errors import FormatError, OptionError

SUFFIXES = [".json", ".mat", ".npz"]


def assert_same(one: Any, other: Any) -> None:
    """Compare to the last digit, types of facts included."""
    if isinstance(one, Plant):
        for field in fields(Plant):
            assert_same(getattr(one, field.name), getattr(other, field.name))
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype
        assert one.shape == other.shape
        assert one.tobytes() == other.tobytes()
    elif isinstance(one, dict):
        assert list(one) == list(other)
        for name in one:
            assert_same(one[name], other[name])
    elif isinstance(one, float) and np.isnan(one):
        assert np.isnan(other)
    else:
        assert type(one) is type(other)
        assert one == other


PLANTS = {
    "continuous": two_masses(),
    "sampled": sampled(two_masses(), 0.03, delay=0.1),
    "one": double_integrator(),
    "unknown error": double_integrator().__class__(**{
        **{f.name: getattr(double_integrator(), f.name) for f in fields(Plant)}, "error": np.nan, "route": ""
    }),
    "no modes": plant([[-1 / 3]], [[0.1]], [[1e-300]], [[-0.0]]),
}  # fmt: skip


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("name", PLANTS)
def test_it_comes_back_to_the_last_digit(name: str, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"p{suffix}"
    updyn.write_plant(PLANTS[name], path)
    assert_same(updyn.read_plant(path), PLANTS[name])
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", [".json", ".npz"])
def test_one_without_states_comes_back(suffix: str, tmp_path: Path) -> None:
    gain = plant(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), [[1.0, 2.0], [3.0, 4.0]])
    updyn.write_plant(gain, tmp_path / f"p{suffix}")
    assert_same(updyn.read_plant(tmp_path / f"p{suffix}"), gain)


@settings(
    max_examples=20,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=9, max_size=9),
    st.sampled_from(SUFFIXES),
)
def test_any_number_comes_back(tmp_path: Path, numbers: list[float], suffix: str) -> None:
    block = np.reshape(numbers, (3, 3))
    one = plant(block[:2, :2], block[:2, 2:], block[2:, :2], block[2:, 2:])
    updyn.write_plant(one, tmp_path / f"p{suffix}")
    assert_same(updyn.read_plant(tmp_path / f"p{suffix}"), one)


def test_one_that_was_made_from_a_model_comes_back(tmp_path: Path) -> None:
    made = updyn.plant(true_model(), ["1:RZ"], ["1:RZ", "7:RZ"], (2.0, 40.0), 0.05, route="complex")
    digital = updyn.sampled(made, 1e-3, delay=1.4e-3)
    for suffix in SUFFIXES:
        updyn.write_plant(digital, tmp_path / f"p{suffix}")
        assert_same(updyn.read_plant(tmp_path / f"p{suffix}"), digital)
    lines = np.linspace(2.0, 40.0, 4001)
    s = 2j * np.pi * lines
    exact = updyn.response(true_model(), lines, made.outputs, made.inputs).values
    exact = exact * ((1 - np.exp(-s * 1e-3)) / (s * 1e-3) * np.exp(-s * 1.4e-3))[:, None, None]
    off = np.abs(digital.response(lines).values - exact).max(axis=0) / np.abs(exact).max(axis=0)
    assert off.max() < made.error * 1.05 + digital.facts["sampling"]["deviation"]
    assert digital.facts["sampling"]["deviation"] < 1e-3


# -- other programs ----------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["continuous", "sampled"])
def test_what_matlab_loads(name: str, tmp_path: Path) -> None:
    one = PLANTS[name]
    updyn.write_plant(one, tmp_path / "mount.mat")
    found = scipy.io.loadmat(tmp_path / "mount.mat")
    assert (
        str(found["comment"][0])
        == "load('mount.mat'); sys = ss(A,B,C,D,dt,'InputName',inputs,'OutputName',outputs); "
        "% MATLAB also: set(sys,'InputUnit',input_units,'OutputUnit',output_units)"
    )
    for letter in "ABCD":
        np.testing.assert_array_equal(found[letter], getattr(one, letter))
    assert found["dt"].shape == (1, 1)
    assert found["dt"][0, 0] == (one.dt or 0.0)
    for cells, texts in (
        ("inputs", one.inputs),
        ("outputs", one.outputs),
        ("input_units", ("N m", "N m")),
        ("output_units", ("rad", "rad", "rad/s2")),
        ("quantities", one.quantities),
    ):
        assert found[cells].dtype == object
        assert found[cells].shape == (len(texts), 1)
        assert [str(cell[0]) for cell in found[cells][:, 0]] == list(texts)
    system = control.ss(*(found[letter] for letter in "ABCD"), float(found["dt"][0, 0]))
    omega = 2 * np.pi * np.array([0.1, 1.0])
    theirs = np.moveaxis(control.frequency_response(system, omega).complex, -1, 0)
    np.testing.assert_allclose(theirs, one.response([0.1, 1.0]).values, rtol=1e-8)
    assert not any(
        value.dtype.names for value in found.values() if isinstance(value, np.ndarray)
    )  # no struct


@pytest.mark.needs("octave")
def test_octave_runs_the_line_that_the_file_states(tmp_path: Path) -> None:
    for name in ("continuous", "sampled"):
        one = PLANTS[name]
        updyn.write_plant(one, tmp_path / "it's a plant.mat")
        line = str(scipy.io.loadmat(tmp_path / "it's a plant.mat")["comment"][0])
        show = (
            "H = freqresp(sys, 2 * pi * [0.1 1.0]); printf('%.17g ', sys.tsam, real(H), imag(H));"
            " disp(inputs{2})"
        )
        (tmp_path / "show.m").write_text(f"pkg load control\n{line}\n{show}\n", encoding="utf-8")
        command = ["octave-cli", "-q", "show.m"]
        shown = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        if "control is not installed" in shown.stderr:
            pytest.skip("Octave lacks its package control")
        *numbers, _, _, _ = shown.stdout.split()
        values = one.response([0.1, 1.0]).values.transpose(0, 2, 1).ravel()  # as MATLAB counts
        np.testing.assert_allclose(
            np.array(numbers, dtype=float),
            [one.dt or 0.0, *values.real, *values.imag],
            rtol=1e-8,
            atol=1e-12,
        )
        assert shown.stdout.endswith("pair of forces\n")


def test_json_is_for_any_program(tmp_path: Path) -> None:
    one = PLANTS["continuous"]
    updyn.write_plant(one, tmp_path / "p.json")
    found = json.loads((tmp_path / "p.json").read_text(encoding="utf-8"))
    assert (found["format"], found["schema"], found["dt"], found["rigid"]) == (
        "updyn plant",
        3,
        None,
        1,
    )
    assert found["A"] == one.A.tolist()
    assert found["outputs"][2] == {
        "name": "2:RZ / -92.5",
        "unit": "rad/s2",
        "weights": {"2:RZ": -1 / 92.5},
        "rotation": True,
        "quantity": "accelerance",
    }


def test_matlab_may_save_rows_for_columns_and_one_text_for_a_cell(tmp_path: Path) -> None:
    one = PLANTS["one"]
    updyn.write_plant(one, tmp_path / "p.mat")
    found = {
        k: v for k, v in scipy.io.loadmat(tmp_path / "p.mat").items() if not k.startswith("__")
    }
    scipy.io.savemat(tmp_path / "q.mat", {**found, "band": found["band"].T, "inputs": "torque 1"})
    assert_same(updyn.read_plant(tmp_path / "q.mat"), one)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_info_says_what_it_is(
    suffix: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / f"p{suffix}"
    updyn.write_plant(PLANTS["sampled"], path)
    assert main(["info", str(path)]) == 0
    said = capsys.readouterr().out
    assert said.startswith(
        "Plant: 12 states, 2 inputs, 3 outputs, sampled every 0.03 s, input 0.1 s late\n"
    )
    assert "made for 0.05 to 2.5 Hz" in said
    assert "0.013" in said
    assert "pair of forces" in said
    assert "rad/s2" in said


def test_info_says_which_item_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    updyn.write_plant(PLANTS["one"], tmp_path / "p.json")
    changed(lambda p: p.update(rigid=1.5), tmp_path / "p.json")
    assert main(["info", str(tmp_path / "p.json")]) == 2
    assert (
        capsys.readouterr().err
        == f"error: {tmp_path / 'p.json'}: rigid: found 1.5; expected a whole number, 0 or above\n"
    )
    updyn.write_plant(PLANTS["one"], tmp_path / "p.mat")
    found = {
        k: v for k, v in scipy.io.loadmat(tmp_path / "p.mat").items() if not k.startswith("__")
    }
    scipy.io.savemat(tmp_path / "p.mat", {**found, "dt": -1.0})
    assert main(["info", str(tmp_path / "p.mat")]) == 2
    assert "as a plant: dt: found -1.0; expected" in capsys.readouterr().err
    scipy.io.savemat(tmp_path / "p.mat", {"K": 1.0})
    assert main(["info", str(tmp_path / "p.mat")]) == 2
    assert "as a plant" not in capsys.readouterr().err


# -- what is refused ---------------------------------------------------------------------------------------
def test_what_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="expected a plant, found dict"):
        updyn.write_plant({}, tmp_path / "p.json")  # type: ignore[arg-type]
    with pytest.raises(
        FormatError, match=r"suffix '\.slx'.*known suffixes: \.json, \.mat, \.npz, \.h"
    ):
        updyn.write_plant(PLANTS["one"], tmp_path / "p.slx")
    with pytest.raises(FormatError, match="did you mean 'json'"):
        updyn.write_plant(PLANTS["one"], tmp_path / "p", format="jsn")
    with pytest.raises(FormatError, match="does not exist"):
        updyn.write_plant(PLANTS["one"], tmp_path / "none" / "p.json")
    assert list(tmp_path.iterdir()) == []


def test_what_is_not_there_or_no_plant(tmp_path: Path) -> None:
    updyn.write_plant(PLANTS["one"], tmp_path / "mount.json")
    with pytest.raises(FormatError, match=r"no such file; did you mean 'mount\.json'"):
        updyn.read_plant(tmp_path / "mont.json")
    updyn.write_plant(PLANTS["one"], tmp_path / "p.h")
    with pytest.raises(FormatError, match="read the plant from another file"):
        updyn.read_plant(tmp_path / "p.h")
    (tmp_path / "empty.json").touch()
    with pytest.raises(FormatError, match="is empty"):
        updyn.read_plant(tmp_path / "empty.json")
    (tmp_path / "other.json").write_text('{"status": "converged"}', encoding="utf-8")
    with pytest.raises(FormatError, match="holds no plant"):
        updyn.read_plant(tmp_path / "other.json")
    np.savez(tmp_path / "other.npz", A=np.eye(2))
    with pytest.raises(FormatError, match="holds no plant"):
        updyn.read_plant(tmp_path / "other.npz")


def test_the_content_says_what_it_is_before_the_suffix(tmp_path: Path) -> None:
    updyn.write_plant(PLANTS["one"], tmp_path / "p.mat", format="json")
    assert_same(updyn.read_plant(tmp_path / "p.mat"), PLANTS["one"])


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_file_cut_short(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"p{suffix}"
    updyn.write_plant(PLANTS["continuous"], path)
    content = path.read_bytes()
    for share in (0.1, 0.5, 0.9, 0.99):
        path.write_bytes(content[: int(share * len(content))])
        with pytest.raises(FormatError, match=path.name):
            updyn.read_plant(path)


@pytest.mark.parametrize("suffix", [".mat", ".npz"])
def test_a_byte_that_is_wrong_is_noticed_or_means_nothing(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"p{suffix}"
    updyn.write_plant(PLANTS["continuous"], path)
    content, rng, noticed = path.read_bytes(), np.random.default_rng(1), 0
    for _ in range(80):
        at = int(rng.integers(len(content)))
        path.write_bytes(
            content[:at] + bytes([content[at] ^ int(rng.integers(1, 256))]) + content[at + 1 :]
        )
        try:
            found = updyn.read_plant(path)
        except FormatError as error:
            noticed += path.name in str(error)
        else:
            assert_same(found, PLANTS["continuous"])
    assert noticed > 40


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_flipped_bit_changes_no_number(suffix: str, tmp_path: Path) -> None:
    path, rng = tmp_path / f"p{suffix}", np.random.default_rng(17)
    updyn.write_plant(PLANTS["sampled"], path)
    content, refused = path.read_bytes(), 0
    for bit in rng.choice(8 * len(content), 400, replace=False).tolist():
        mutant = bytearray(content)
        mutant[bit // 8] ^= 1 << bit % 8
        path.write_bytes(mutant)
        try:
            found = updyn.read_plant(path)
        except FormatError as error:
            refused += path.name in str(error)
        else:
            assert_same(found, PLANTS["sampled"])
    assert refused > 200


CHANGES: dict[str, Callable[[dict[str, Any]], Any]] = {
    "a digit": lambda p: p["C"][1].__setitem__(0, p["C"][1][0] + 2**-52),
    "a sign": lambda p: p["D"][0].__setitem__(0, -0.0 if p["D"][0][0] == 0.0 else -p["D"][0][0]),
    "the band": lambda p: p.update(band=[0.05, 2.6]),
    "a name": lambda p: p["inputs"][0].update(name="2:RZ"),
    "a fact": lambda p: p["facts"].update(more=1),
    "the schema": lambda p: p.update(schema=2),
    "the digest": lambda p: p.update(sha256="0" * 64),
    "no digest": lambda p: p.update(sha256=3),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_change_is_refused_with_its_remedy(name: str, tmp_path: Path) -> None:
    path = tmp_path / "p.json"
    updyn.write_plant(PLANTS["continuous"], path)
    changed(CHANGES[name], path)
    with pytest.raises(
        FormatError, match=r"differs from what was written.*remove 'sha256'"
    ) as error:
        updyn.read_plant(path)
    assert str(error.value).startswith(f"{path}: sha256: ")


def test_a_wanted_change_is_read_without_the_digest(tmp_path: Path) -> None:
    path = tmp_path / "p.json"
    updyn.write_plant(PLANTS["continuous"], path)
    changed(lambda p: (p.update(band=[0.1, 2.0]), p.pop("sha256")), path)
    assert updyn.read_plant(path).band == (0.1, 2.0)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_files_of_earlier_versions_are_read(suffix: str, tmp_path: Path) -> None:
    """Schema 2 has no digest, schema 1 no relative error and no zeros either."""
    one, path = PLANTS["continuous"], tmp_path / f"p{suffix}"
    for schema, without in ((2, ("sha256",)), (1, ("sha256", "relative_error", "zero_shift"))):
        updyn.write_plant(one, path)
        if suffix == ".json":
            items = json.loads(path.read_text(encoding="utf-8")) | {"schema": schema}
            for name in without:
                del items[name]
            path.write_text(json.dumps(items), encoding="utf-8")
        else:
            load = np.load if suffix == ".npz" else scipy.io.loadmat
            found = {k: v for k, v in load(path).items() if k not in without and k[:2] != "__"}
            found["schema"] = np.array(float(schema))
            if suffix == ".npz":
                np.savez(path, **found)
            else:
                scipy.io.savemat(path, found)
        found = updyn.read_plant(path)
        np.testing.assert_array_equal(found.A, one.A)
        assert np.isnan(found.relative_error) == (schema == 1 or np.isnan(one.relative_error))


def test_programs_may_write_a_plant_in_another_form(tmp_path: Path) -> None:
    """The digest is of the content: order, layout and the form of a number are free."""
    path = tmp_path / "p.json"
    updyn.write_plant(PLANTS["sampled"], path)
    items = json.loads(path.read_text(encoding="utf-8"))
    items["band"] = [0.05, 25e-1]
    path.write_text(json.dumps(items, sort_keys=True, indent=4), encoding="utf-8")
    assert updyn.read_plant(path).A.tobytes() == PLANTS["sampled"].A.tobytes()


def test_the_digest_is_the_same_in_all_formats(tmp_path: Path) -> None:
    found = set()
    for suffix in SUFFIXES:
        updyn.write_plant(PLANTS["sampled"], tmp_path / f"p{suffix}")
    found.add(json.loads((tmp_path / "p.json").read_text(encoding="utf-8"))["sha256"])
    found.add(str(np.load(tmp_path / "p.npz")["sha256"]))
    found.add(str(scipy.io.loadmat(tmp_path / "p.mat")["sha256"][0]))
    assert len(found) == 1


def changed(change: Callable[[dict[str, Any]], Any], path: Path) -> None:
    items = json.loads(path.read_text(encoding="utf-8"))
    change(items)
    path.write_text(json.dumps(items), encoding="utf-8")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda p: p.pop("B"), "'B' is missing"),
        (lambda p: p.update(eror=1), "unknown name 'eror'; did you mean 'error'"),
        (lambda p: p.update(schema=4), "schema: found 4"),
        (lambda p: p.update(dt=-0.1), r"dt: found -0\.1"),
        (lambda p: p.update(band=[2.0, 1.0]), "band: found"),
        (lambda p: p.update(band="all"), "band: expected real numbers, found str"),
        (lambda p: p.update(route=3), "route: found 3"),
        (lambda p: p.update(facts=[]), "facts: found"),
        (lambda p: p.update(facts={"x": {"__wrong__": 1}}), "facts: not JSON as updyn writes it"),
        (lambda p: p.update(rigid=1.5), r"rigid: found 1\.5"),
        (lambda p: p.update(delay=True), "delay: found True"),
        (lambda p: p.update(tolerance=None), "tolerance: found None"),
        (lambda p: p["A"][1].pop(), "A: row 2 has 3 numbers; expected 4"),
        (lambda p: p["A"][1].__setitem__(2, "1"), "A: row 2 contains a value that is not a number"),
        (
            lambda p: p["A"][1].__setitem__(2, {"__float__": "inf"}),
            "A contains a number that is not finite",
        ),
        (lambda p: p["A"][1].__setitem__(2, 10**400), r"A: not JSON.*too large"),
        (lambda p: p["B"].pop(), r"B has shape \(3, 2\); expected \(4, 2\)"),
        (lambda p: p.update(D=[1.0]), r"D: found shape \(1,\)"),
        (lambda p: p["inputs"][0].pop("weights"), "inputs, number 1: 'weights' is missing"),
        (
            lambda p: p["inputs"][0].update(unit="N"),
            "inputs, number 1: found unit 'N', expected 'N m'",
        ),
        (lambda p: p["inputs"][0].update(weights={"1:Q": 1.0}), "inputs, number 1:.*1:Q"),
        (lambda p: p["outputs"][1].update(rotation=1), "outputs, number 2: rotation is 1"),
        (lambda p: p["outputs"][1].update(quantity="receptence"), "did you mean 'receptance'"),
        (lambda p: p["outputs"][1].update(name="1:RZ"), "two outputs are named '1:RZ'"),
        (lambda p: p.update(outputs={}), "outputs: expected a list of ports"),
    ],
)
def test_an_item_that_is_not_valid(
    change: Callable[[dict[str, Any]], Any], said: str, tmp_path: Path
) -> None:
    path = tmp_path / "p.json"
    updyn.write_plant(PLANTS["continuous"], path)
    changed(change, path)
    with pytest.raises(FormatError, match=said) as error:
        updyn.read_plant(path)
    assert str(error.value).startswith(f"{path}:")


def test_a_text_that_is_not_json(tmp_path: Path) -> None:
    path = tmp_path / "p.json"
    updyn.write_plant(PLANTS["one"], path)
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace('"schema": 3,', '"schema": 3'), encoding="utf-8")
    with pytest.raises(FormatError, match=r"p\.json:4: not JSON"):
        updyn.read_plant(path)
    path.write_text(text.replace('"schema": 3,', '"schema": 3, "schema": 3,'), encoding="utf-8")
    with pytest.raises(FormatError, match="'schema' occurs twice"):
        updyn.read_plant(path)
    path.write_text(text.replace('"error": 0.013', '"error": NaN'), encoding="utf-8")
    with pytest.raises(FormatError, match="error: not JSON"):
        updyn.read_plant(path)
    path.write_bytes(text.encode("utf-8").replace(b"modal", b"\xff\xfe"))
    with pytest.raises(FormatError, match="utf-8"):
        updyn.read_plant(path)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"A": None}, "'A' is missing"),
        ({"extra": 1.0}, "unknown name 'extra'"),
        ({"A": np.eye(4) * 1j}, "A: expected real numbers"),
        ({"A": np.eye(4, dtype=bool)}, "A: expected real numbers"),
        ({"inputs": ["one"]}, "inputs: 1 items, input_units: 2 items"),
        ({"input_weight_port": [1.0, 2.0, 3.0]}, "input_weight_port: found 3"),
        ({"input_weight_dof": ["1:RZ", "2:X", "2:X"]}, "input 2 has '2:X' twice"),
        ({"input_rotation": [1.0, 0.5]}, r"number 2: rotation is 0\.5"),
        ({"quantities": ["receptance"]}, "quantities: found 1, expected 3"),
        ({"dt": [0.1, 0.2]}, "dt: found 2 numbers"),
        ({"route": ["a", "b"]}, "route: found 2 texts"),
        ({"facts": "{"}, "facts: not JSON"),
        ({"band": "x"}, "band: expected one row of numbers"),
    ],
)
def test_an_array_that_is_not_valid(change: dict[str, Any], said: str, tmp_path: Path) -> None:
    updyn.write_plant(PLANTS["continuous"], tmp_path / "p.npz")
    with np.load(tmp_path / "p.npz") as stored:
        arrays = {**stored, **change}
    np.savez(
        tmp_path / "p.npz", **{name: value for name, value in arrays.items() if value is not None}
    )
    with pytest.raises(FormatError, match=said) as error:
        updyn.read_plant(tmp_path / "p.npz")
    assert "p.npz:" in str(error.value)


def test_pickles_are_not_read(tmp_path: Path) -> None:
    updyn.write_plant(PLANTS["one"], tmp_path / "p.npz")
    with np.load(tmp_path / "p.npz") as stored:
        arrays = {**stored, "facts": np.array([{}], dtype=object)}
    np.savez(tmp_path / "p.npz", **arrays)
    with pytest.raises(FormatError, match=r"facts: holds Python objects"):
        updyn.read_plant(tmp_path / "p.npz")
