"""MATLAB models in variables of the user's choice, and the objects of toolboxes that are refused."""

from __future__ import annotations

import struct
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io

import updyn
from io_samples import assert_same_model
from matlab73 import write_matlab73
from updyn.cli import main
from updyn.errors import FormatError, OptionError, UpdynError, UpdynWarning
from updyn.model import Group, Model

K1 = np.array([[2.0, -1.0], [-1.0, 1.0]])
K2 = np.array([[0.0, 0.0], [0.0, 3.0]])
M0 = np.diag([0.5, 0.25])
DOFS = ["1:X", "2:X"]
WORKSPACE = {
    "K_1": K1,
    "K_2": K2,
    "M0": M0,
    "eta": 0.02,
    "dofs": DOFS,
    "run": {"stiff": K1, "names": ["7:Y", "8:Y"], "part": {"K": K2, "M": M0, "loss_factor": 0.1}},
    "notes": "not of the model",
}


def save_5(path, variables):
    stored = {}
    for name, value in variables.items():
        stored[name] = np.array(value, dtype=object)[:, None] if isinstance(value, list) else value
    scipy.io.savemat(path, stored)


@pytest.fixture(params=[save_5, write_matlab73], ids=["v5", "v7.3"])
def path(request, tmp_path):
    request.param(tmp_path / "work.mat", WORKSPACE)
    return tmp_path / "work.mat"


@pytest.mark.parametrize(
    ("variables", "groups", "dofs"),
    [
        ({"K": "K_1", "M": "M0"}, {"model": Group(K1, M0)}, DOFS),
        ({"K": "K_1", "M": "M0", "loss_factor": "eta"}, {"model": Group(K1, M0, 0.02)}, DOFS),
        (
            {"M": "M0", "groups": ["K_1", "K_2"]},
            {"K_1": Group(K1), "K_2": Group(K2), "model": Group(mass=M0)},
            DOFS,
        ),
        (
            {"groups": {"shaft": {"K": "K_1", "M": "M0", "loss_factor": "eta"}, "foot": "K_2"}},
            {"shaft": Group(K1, M0, 0.02), "foot": Group(K2)},
            DOFS,
        ),
        (
            {"groups": {"a": "run.stiff", "b": "run.part"}, "dofs": "run.names"},
            {"a": Group(K1), "b": Group(K2, M0, 0.1)},
            ["7:Y", "8:Y"],
        ),
    ],
)
def test_models(path, variables, groups, dofs):
    expected = Model.from_groups(groups, dofs)
    assert_same_model(updyn.read_model(path, variables=variables), expected)


def test_structs_of_parts_under_other_names(tmp_path):
    save_5(
        tmp_path / "a.mat",
        {"stiff": {"a": K1, "b": K2}, "weight": {"a": M0}, "labels": DOFS},
    )
    model = updyn.read_model(
        tmp_path / "a.mat", variables={"K": "stiff", "M": "weight", "dofs": "labels"}
    )
    assert_same_model(model, Model.from_groups({"a": Group(K1, M0), "b": Group(K2)}, DOFS))


def test_in_the_one_struct_of_the_file(tmp_path):
    save_5(tmp_path / "a.mat", {"s": {"Kg": K1, "Mg": M0, "dofs": np.array([[1.0, 1], [2, 1]])}})
    model = updyn.read_model(tmp_path / "a.mat", variables={"K": "Kg", "M": "Mg"})
    assert_same_model(model, Model.from_groups({"model": Group(K1, M0)}, DOFS))


def test_labels_that_are_stated_replace_those_of_the_file(tmp_path):
    table = np.array([[5.0, 0.0], [6.0, 0.0]])
    save_5(tmp_path / "a.mat", {"Kg": K1, "dofs": DOFS, "ref": table})
    model = updyn.read_model(tmp_path / "a.mat", variables={"K": "Kg", "dof_ref": "ref"})
    assert model.dofs.labels == ["5:X", "6:X"]


def test_matrices_that_are_not_named_are_left_out_with_a_warning(tmp_path):
    """K may be the sum of K_1 and K_2."""
    save_5(tmp_path / "a.mat", {"K": K1 + K2, "K_1": K1, "K_2": K2, "M": M0, "dofs": DOFS})
    with pytest.warns(
        UpdynWarning, match=r"a\.mat: K of the file not read, because variables do not"
    ):
        model = updyn.read_model(tmp_path / "a.mat", variables={"M": "M", "groups": ["K_1", "K_2"]})
    np.testing.assert_array_equal(model.stiffness.toarray(), K1 + K2)


@pytest.mark.parametrize(
    ("variables", "said", "key"),
    [
        ({"K": "k_1"}, "work.mat: no variable 'k_1'; did you mean .*'K_1'", ("variables", "K")),
        (
            {"K": "run.stif"},
            "no variable 'run.stif'; did you mean .*'run.stiff'",
            ("variables", "K"),
        ),
        (
            {"groups": ["K_1", "K_3"]},
            "no variable 'K_3'; did you mean",
            ("variables", "groups", 1),
        ),
        (
            {"groups": {"a": {"K": "K_1", "M": "M1"}}},
            "no variable 'M1'; ",
            ("variables", "groups", "a", "M"),
        ),
        ({"groups": ["K_1", "K_1"]}, "variables.groups: 'K_1' occurs twice", None),
        ({"groups": []}, "variables.groups = .*: expected variables", None),
        ({"groups": 3}, "variables.groups = 3: expected variables", None),
        (
            {"groups": {"a": {"stiffness": "K_1"}}},
            "no item 'stiffness'; did you mean 'stiffness_damping'",
            None,
        ),
        ({"groups": ["dofs"]}, "dofs: found 2 texts; expected a matrix, or a struct", None),
        ({"groups": {"model": "K_1"}, "M": "M0"}, "M in addition to groups become the group", None),
        ({"Ks": "K_1"}, "variables: no item 'Ks'; did you mean 'K'", ("variables", "Ks")),
        ({"K": 3}, "variables.K = 3: expected the name of a variable", ("variables", "K")),
        ({}, "expected a table of item = variable", ("variables",)),
        (["K_1"], "expected a table of item = variable", ("variables",)),
        ({"K": "notes"}, "K: found 1 texts; expected numbers", None),
    ],
)
def test_what_is_refused(path, variables, said, key):
    with pytest.raises(UpdynError, match=said) as caught:
        updyn.read_model(path, variables=variables)
    assert isinstance(caught.value, FormatError | OptionError)
    if key is not None:
        assert caught.value.key == key


def test_in_a_job(path, capsys):
    from updyn.cli import main
    from updyn.job import load_job

    model = updyn.read_model(path, variables={"M": "M0", "groups": ["K_1", "K_2"]})
    truth = model.scaled({"K_2": {"stiffness": 1.3}})
    frf = updyn.response(truth, [0.05, 0.1, 0.2, 0.4], ["1:X", "2:X"], ["2:X"])
    updyn.write_frf(frf, path.parent / "test.npz")
    job = path.parent / "job.toml"
    text = """
[model]
file = "work.mat"
variables = { M = "M0", groups = ["K_1", "K_2"] }
[test]
file = "test.npz"
[[parameter]]
groups = "K_2"
quantity = "stiffness"
[output]
report = false
"""
    job.write_text(text)
    out = path.parent / "out"
    assert main(["run", str(job), "--out", str(out)]) == 0
    assert updyn.read_result(out / "run.nc").values["K_2.stiffness"] == pytest.approx(1.3, rel=1e-6)
    # The copy of the job in the folder states the same model.
    copied = load_job(out / "job.toml")
    assert copied.model.keys["variables"] == {"M": "M0", "groups": ["K_1", "K_2"]}
    capsys.readouterr()
    job.write_text(text.replace('"K_2"]', '"K2"]'))
    assert main(["check", str(job)]) == 2
    said = capsys.readouterr().err
    assert "no variable 'K2'; did you mean" in said
    assert said.count("\n") <= 3


# -- objects of toolboxes -----------------------------------------------------------------------
def element(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def opaque(name: bytes, kind: bytes) -> bytes:
    """A variable of class mxOPAQUE as MATLAB stores an object: name, MCOS, class, reference."""
    flags = element(6, struct.pack("<II", 17, 0))
    reference = element(
        14,
        element(6, struct.pack("<II", 13, 0))
        + element(5, struct.pack("<ii", 2, 1))
        + element(1, b"")
        + element(6, struct.pack("<II", 0xDD000000, 2)),
    )
    return element(
        14, flags + element(1, name) + element(1, b"MCOS") + element(1, kind) + reference
    )


@pytest.mark.parametrize("kind", ["frd", "idfrd"])
@pytest.mark.parametrize("version", ["v5", "v7.3"])
def test_frd_objects_are_refused_with_what_to_save_instead(
    tmp_path: Path, kind: str, version: str
) -> None:
    path = tmp_path / "test.mat"
    if version == "v5":
        scipy.io.savemat(path, {"x": 1.0})
        path.write_bytes(path.read_bytes() + opaque(b"Gm", kind.encode()))
    else:
        write_matlab73(path, {"x": 1.0, "Gm": np.zeros((1, 6))})
        with h5py.File(path, "r+") as file:
            file["Gm"].attrs["MATLAB_class"] = np.bytes_(kind)
    for read in (updyn.read_frf, updyn.read_model):
        with pytest.raises(FormatError, match=rf"test\.mat: Gm: MATLAB class '{kind}'") as caught:
            read(path)
        assert "H = permute(G.ResponseData, [3 1 2])" in str(caught.value)
        assert "chgFreqUnit(G, 'Hz')" in str(caught.value)


def test_other_objects_are_named(tmp_path: Path) -> None:
    path = tmp_path / "test.mat"
    scipy.io.savemat(path, {"x": 1.0})
    path.write_bytes(path.read_bytes() + opaque(b"names", b"string"))
    with pytest.raises(FormatError, match=r"names: MATLAB class 'string' .* save cellstr"):
        updyn.read_model(path)


# -- variables that are not asked for -----------------------------------------------------------
@pytest.fixture(params=["v5", "v7.3"])
def crowded(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """The workspace with two objects, a cell array of numbers, a struct array, and an object in a struct."""
    path = tmp_path / "work.mat"
    mixed = np.array([[1.0, "a"]], dtype=object)
    several = np.array([(1.0,), (2.0,)], dtype=[("K", object)])
    workspace = {**WORKSPACE, "run": {**WORKSPACE["run"], "when": np.zeros((1, 6))}}
    if request.param == "v5":
        save_5(path, {**WORKSPACE, "mixed": mixed, "several": several})
        raw = path.read_bytes()
        objects = opaque(b"Gm", b"frd") + opaque(b"log", b"table")
        path.write_bytes(raw[:128] + objects + raw[128:])
    else:
        write_matlab73(path, {**workspace, "Gm": np.zeros((1, 6)), "log": np.zeros((1, 6))})
        with h5py.File(path, "r+") as file:
            for name, kind in (("Gm", "frd"), ("log", "table"), ("run/when", "datetime")):
                file[name].attrs["MATLAB_class"] = np.bytes_(kind)
    return path


def test_variables_that_are_not_asked_for_may_be_of_any_class(crowded: Path) -> None:
    asked = {"groups": {"a": "run.stiff", "b": "run.part"}, "dofs": "run.names"}
    expected = Model.from_groups({"a": Group(K1), "b": Group(K2, M0, 0.1)}, ["7:Y", "8:Y"])
    assert_same_model(updyn.read_model(crowded, variables=asked), expected)


def test_what_is_asked_for_says_why_it_cannot_be_used(crowded: Path) -> None:
    for name, kind in (("Gm", "frd"), ("log", "table")):
        with pytest.raises(FormatError, match=rf"work\.mat: {name}: MATLAB class '{kind}'"):
            updyn.read_model(crowded, variables={"K": name, "M": "M0"})
        with pytest.raises(FormatError, match=rf"work\.mat: {name}: MATLAB class '{kind}'"):
            updyn.read_records(crowded, values={"a": name}, rate=10.0)


def test_records_beside_objects(crowded: Path) -> None:
    found = updyn.read_records(crowded, values={"a": "M0"}, order=["time", "record"], rate=10.0)
    assert found.values.tolist() == [[[0.5, 0.0]], [[0.0, 0.25]]]
    with pytest.raises(FormatError, match=r"work\.mat: log: MATLAB class 'table'"):
        updyn.read_records(crowded, values={"a": "M0"}, order=["time", "record"], time="log")


def test_an_item_of_the_model_that_cannot_be_used_is_refused(tmp_path: Path) -> None:
    """A loss factor that is not read would be none."""
    path = tmp_path / "work.mat"
    save_5(path, {"K": K1, "M": M0, "dofs": DOFS})
    whole = path.read_bytes()
    path.write_bytes(whole + opaque(b"loss_factor", b"table"))
    with pytest.raises(FormatError, match="loss_factor: MATLAB class 'table' cannot be used"):
        updyn.read_model(path)
    path.write_bytes(whole + opaque(b"loss_factor", b"table"))
    with pytest.raises(FormatError, match="loss_factor: MATLAB class 'table' cannot be used"):
        updyn.read_model(path, variables={"K": "K", "loss_factor": "loss_factor"})


def test_objects_beside_a_model_of_plain_names_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "work.mat"
    save_5(path, {"K": K1, "M": M0, "dofs": DOFS})
    path.write_bytes(path.read_bytes() + opaque(b"t0", b"datetime") + opaque(b"log", b"table"))
    with pytest.warns(
        UpdynWarning, match="cannot be read: t0: MATLAB class 'datetime'.*; log: MATLAB"
    ):
        assert_same_model(updyn.read_model(path), Model.from_groups({"model": Group(K1, M0)}, DOFS))
    assert main(["info", str(path)]) == 0
    said = capsys.readouterr()
    assert "t0: MATLAB class 'datetime'" in said.out + said.err
    assert "log: MATLAB class 'table'" in said.out + said.err


def test_a_name_that_stands_twice_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "work.mat"
    save_5(path, {"K": K1})
    raw = path.read_bytes()
    path.write_bytes(raw + raw[128:])
    with pytest.raises(FormatError, match="variable 'K' occurs twice"):
        updyn.read_model(path, variables={"K": "K"})


def test_damage_in_a_variable_that_is_not_asked_for_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "work.mat"
    save_5(path, {"K": K1, "dofs": DOFS, "rest": np.arange(9.0)})
    raw = path.read_bytes()
    path.write_bytes(raw[:-8])
    with pytest.raises(FormatError, match="truncated or damaged in variable 3"):
        updyn.read_model(path, variables={"K": "K"})
