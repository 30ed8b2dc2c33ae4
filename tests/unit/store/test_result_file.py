"""The record of a run: every field comes back, xarray opens it, and `result.json` is strict JSON."""

import dataclasses
import json
from collections.abc import Mapping
from fractions import Fraction

import h5py
import numpy as np
import pytest
import xarray as xr

from io_samples import assert_same_frf, assert_same_model, geometry
from updyn.correlation.model_modes import ModelModes
from updyn.errors import FormatError, InputError, UpdynWarning
from updyn.frf import FRF
from updyn.io.hdf5 import read_model, write_model
from updyn.modal import ModeSet
from updyn.model import Group, Model
from updyn.remedy import Remedy
from updyn.store.result import read_result, result_to_json, write_result, write_result_json
from updyn.store.values import from_text, to_text
from updyn.updating.fit.monitor import Iteration
from updyn.updating.judge.adequacy import Adequacy, Misfit, NoisySensor, Suspect
from updyn.updating.judge.alternatives import Alternative
from updyn.updating.judge.causes.finding import Finding
from updyn.updating.judge.counterparts import Counterparts, Pair
from updyn.updating.judge.identifiability import Identifiability
from updyn.updating.judge.modal_table import ModalTable, compare_modes
from updyn.updating.judge.trust import Claim, Trust
from updyn.updating.problem.parameters import Drive, Parameter, ParameterSet
from updyn.updating.result import JointResult, UpdateResult

INF, NAN = float("inf"), float("nan")
NAMES = ["arm.stiffness", "foot.stiffness", "foot.loss_factor"]


def start_model() -> Model:
    arm = Group(np.array([[2.0e6, -2.0e6], [-2.0e6, 2.0e6]]), np.diag([0.0, 1.5]), loss_factor=0.01)
    foot = Group(np.diag([1.0e6 / 3, 0.0]), np.diag([2.0, 0.0]), loss_factor=0.02)
    return Model.from_groups({"arm": arm, "foot": foot}, ["1:Z", "2:Z"], title="two masses")


def adequacy() -> Adequacy:
    """What is said of a residual of one channel in two bands; nothing was tested in the second."""
    return Adequacy(
        outcome="structure",
        verdict="The model cannot explain channel 1:Z (force 1:Z) near 12 Hz.",
        absolute=True,
        chi_square=3.5,
        p_value=1e-300,
        level=0.02,
        responses=("1:Z",),
        references=("1:Z",),
        bands=np.array([[10.0, 20.0], [30.0, 40.0]]),
        misfit=np.array([[[2.0, NAN]]]),
        correlation_length=np.array([[[4.5, NAN]]]),
        chi_square_p=np.array([[[1e-9, 1.0]]]),
        whiteness_p=np.array([[[1e-300, 1.0]]]),
        worst=(Misfit("1:Z", "1:Z", 10.0, 20.0, 12.0, 2.0, 4.5, 1e-9, 1e-300, "structure"),),
        explained_by=(Suspect("foot", "mass", 2.0 / 3.0, -0.1, 0.3, confirmed=True),),
        noisy=(NoisySensor("1:Z", 10.0 / 3.0),),
        lone=(17.0, 100.0 / 3.0),
    )


def modal() -> ModalTable:
    """Modes of a test at the DOFs of the model, with an unknown loss factor."""
    shapes = np.array([[1.0, 2.0 / 3.0], [-1.0 + 0.1j, 1.0]])
    test = ModeSet([45.0, 200.0], shapes, ["1:Z", "2:-Z"], [0.01, NAN])
    model = start_model()
    updated = model.scaled({"arm": {"stiffness": 1.0 / 3.0}})
    return compare_modes(ModelModes(model), ModelModes(updated), test)


def others() -> tuple[Alternative, ...]:
    """Two answers that fit as well; no sensor tells the second apart."""
    return (
        Alternative(dict(zip(NAMES, [2.0 / 3.0, 0.5, 0.05], strict=True)), 1.25, "2:Z", 0.37),
        Alternative(dict(zip(NAMES, [0.1, 1.0, 0.0], strict=True)), 1e-9, "", 0.0),
    )


def sample(**changes: object) -> UpdateResult:
    """A hand-made result of a 2-DOF model with something in every field, inf and nan included."""
    start = start_model()
    rng = np.random.default_rng(5)
    values = rng.normal(size=(4, 2, 1)) + 1j * rng.normal(size=(4, 2, 1))
    measured = FRF(
        [10.0, 20.0, 30.0, 40.0],
        values,
        ["1:Z", "2:-Z"],
        ["1:Z"],
        "accelerance",
        coherence=rng.uniform(size=(4, 2, 1)),
        averages=12,
        geometry=geometry(),
        source="bench",
    )
    estimate = dict(zip(NAMES, [1.0 / 3.0, 1.0, 0.05], strict=True))
    everything = {
        "status": "not-identifiable",
        "message": "The data determine 2 of 3 unknowns.",
        "steps": (Remedy.repair("Omit it:", "sign:1:Z", "Then run."), Remedy("Look.")),
        "method": "maximum-likelihood",
        "options": {
            "tolerance": 1e-9,
            "noise": None,
            "stages": ("log", "fine"),
            "x": np.array([1.0, NAN]),
            "n": 3,
        },
        "start": start,
        "model": start.scaled({"arm": {"stiffness": 1.0 / 3.0}}),
        "data": measured,
        "lines": np.array([10.0, 30.0]),
        "fitted_responses": ("1:Z",),
        "validation_responses": ("2:-Z",),
        "validation_band": (35.0, 40.0),
        "parameters": ParameterSet(
            (
                Parameter(
                    "arm",
                    "stiffness",
                    1.0,
                    0.1,
                    10.0,
                    0.3,
                    (Drive("arm", "stiffness", 3.0),),
                    nominal=2e-3,
                    unit="m",
                ),
                Parameter("foot", "stiffness", 1.0, 0.01, 100.0),
                Parameter("foot", "loss_factor", 0.02, 0.0, 0.05),
            )
        ),
        "values": estimate,
        "std": dict(zip(NAMES, [1e-3, INF, 0.1 / 3], strict=True)),
        "covariance": np.array([[1e-6, INF, 1e-9], [INF, INF, INF], [1e-9, INF, 0.01 / 9]]),
        "at_bound": {"foot.loss_factor": "upper"},
        "identifiability": Identifiability(
            2,
            3,
            INF,
            (1.2, 0.1, 0.0),
            [{"foot.stiffness": 1.0}],
            [{"arm.stiffness": -0.5}],
            INF,
            "Measure 2:Z.",
        ),
        "history": (
            Iteration(
                "log", 0, 12.5, 0.0, 3.0, True, dict(zip(NAMES, [1.0, 1.0, 0.02], strict=True))
            ),
            Iteration("log", 1, INF, 0.5, NAN, False, {"arm.stiffness": NAN}),
            Iteration("maximum-likelihood", 2, 1e-30, 1e-12, INF, True, estimate),
        ),
        "noise": {
            "kind": "coherence",
            "relative": None,
            "floor": 1e-9,
            "chi_square": INF,
            "inflation": 1.0,
        },
        "correlation": {
            "before": {"frac_median": 0.5, "db_error_median": NAN},
            "after": {"frac_median": 1.0 - 2**-53},
            "validation": {"before": {"frac_median": 0.4}, "after": {"frac_median": 0.9}},
        },
        "timing_s": {"fit": 0.1, "total": 0.3},
        "versions": {"updyn": "0.1.0", "Python": "3.11"},
        "title": "Prüfstand 3",
        "adequacy": adequacy(),
        "trust": Trust(
            Claim(True, "It ended.", further="More steps gain nothing."),
            Claim(False, "Two of three."),
            Claim(None, "Nothing was held out."),
            Claim(True, "Half are off by less than 2 %."),
        ),
        "findings": (
            Finding(
                "swapped",
                ("1:Z", "2:Z"),
                0.0,
                1e9,
                0.8,
                "They are exchanged.",
                Remedy.repair("Look:", "swapped:1:Z,2:Z"),
                "swapped:1:Z,2:Z",
                ("sign:1:Z",),
                of_misfit=0.7,
            ),
        ),
        "alternatives": others(),
        "modes": modal(),
    }
    return UpdateResult(**(everything | changes))


def assert_same(found: object, expected: object, where: str) -> None:
    """Equal in type and value, all the way down; nan equals nan."""
    if isinstance(expected, Mapping):
        assert list(found) == list(expected), where
        for key, value in expected.items():
            assert_same(found[key], value, f"{where}[{key!r}]")
    elif isinstance(expected, list | tuple):
        assert type(found) is type(expected), where
        assert len(found) == len(expected), where
        for i, (a, b) in enumerate(zip(found, expected, strict=True)):
            assert_same(a, b, f"{where}[{i}]")
    elif isinstance(expected, np.ndarray):
        np.testing.assert_array_equal(found, expected, err_msg=where, strict=True)
    elif isinstance(expected, Model):
        assert_same_model(found, expected)
    elif isinstance(expected, FRF):
        assert_same_frf(found, expected)
    elif dataclasses.is_dataclass(expected):
        for item in dataclasses.fields(expected):
            assert_same(
                getattr(found, item.name), getattr(expected, item.name), f"{where}.{item.name}"
            )
    else:
        assert type(found) is type(expected), where
        assert found == expected or (found != found and expected != expected), where


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {
            "history": (),
            "lines": np.empty(0),
            "validation_responses": (),
            "validation_band": None,
            "title": "",
        },
        {
            "options": {},
            "noise": {},
            "correlation": {},
            "timing_s": {},
            "versions": {},
            "at_bound": {},
            "message": "",
        },
        {
            "status": "failed",
            "values": {},
            "std": dict.fromkeys(NAMES, NAN),
            "covariance": np.full((3, 3), NAN),
        },
        {"adequacy": None},
        {"alternatives": ()},
        {"trust": None},
        {"findings": ()},
        {"modes": None},
        {"modes": ModalTable(notes=("No modes could be identified.",))},
        {
            "counterparts": Counterparts(
                3, 1, (Pair(1.0, 1.1, 0.9),), "1 of 3", True, doubtful=("1:Z",)
            )
        },
    ],
    ids=[
        "full",
        "no history",
        "no figures",
        "failed",
        "residual not tested",
        "one answer",
        "no verdict",
        "no cause",
        "modes not looked for",
        "no modes",
        "counterparts",
    ],
)
def test_every_field_comes_back(tmp_path, changes):
    expected = sample(**changes)
    write_result(expected, tmp_path / "run.nc")
    assert_same(read_result(tmp_path / "run.nc"), expected, "result")


def test_no_field_is_forgotten():
    """A field that UpdateResult or a part of it gains has to be stored too; this list says what is."""
    stored = {
        UpdateResult: (
            "status message steps method options start model data lines fitted_responses"
            " validation_responses validation_band parameters values std covariance at_bound"
            " identifiability history noise correlation timing_s versions title adequacy"
            " alternatives trust findings modes counterparts"
        ),
        Counterparts: (
            "n_measured n_paired pairs statement known n_sensors by_chance source doubtful factor"
            " mistake remedy"
        ),
        Pair: "measured computed mac",
        Finding: "kind channels value odds explains statement step written also test of_misfit",
        Remedy: "advice lines place remark",
        Trust: "converged determined validated plausible resembles",
        Claim: "holds statement asked further",
        ModalTable: "test start updated cross_orthogonality own_orthogonality notes correlations",
        Adequacy: (
            "outcome verdict absolute chi_square p_value level responses references bands misfit"
            " correlation_length chi_square_p whiteness_p worst explained_by noisy lone"
        ),
        Alternative: "values odds sensor difference",
        Misfit: "response reference low high near misfit correlation_length chi_square_p whiteness_p kind",
        NoisySensor: "response times",
        Suspect: "group quantity explains change energy confirmed",
        Iteration: "stage number cost step condition accepted values",
        Parameter: "group quantity start lower upper prior_std drives nominal unit of_element",
        Drive: "group quantity power of_element",
    }
    for kind, names in stored.items():
        found = [f.name for f in dataclasses.fields(kind)]
        assert [name for name in found if name != "kept_basis"] == names.split()


def test_xarray_opens_the_main_data(tmp_path):
    result = sample()
    write_result(result, tmp_path / "run.nc")
    with xr.open_dataset(tmp_path / "run.nc", engine="h5netcdf") as data:
        assert data.attrs["updyn_kind"] == "result"
        assert data.attrs["status"] == "not-identifiable"
        np.testing.assert_array_equal(
            data["frf"].sel(response="2:-Z", reference="1:Z"), result.frf.values[:, 1, 0]
        )
        assert float(data["value"].sel(parameter="arm.stiffness")) == 1.0 / 3.0
        assert np.isinf(data["std"].sel(parameter="foot.stiffness"))
        assert data["covariance"].dims == ("parameter", "parameter_other")
        np.testing.assert_array_equal(data["history_cost"], [12.5, INF, 1e-30])
        assert json.loads(str(data["versions"].values)) == {"updyn": "0.1.0", "Python": "3.11"}
    with h5py.File(tmp_path / "run.nc") as file:
        assert (
            file["start_model/groups/0001/stiffness"] == file["updated_model/groups/0001/stiffness"]
        )  # unchanged: stored once


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "run.nc"
    write_result(sample(), path)
    before = path.read_bytes()
    for changes in ({"values": {"arm.stifness": 1.0}}, {"at_bound": {"arm.stifness": "lower"}}):
        with pytest.raises(
            InputError, match=r"contains 'arm.stifness', .* did you mean 'arm.stiffness'"
        ):
            write_result(sample(**changes), path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["run.nc"]


def test_an_object_among_the_options_is_kept_as_text_with_a_warning(tmp_path):
    with pytest.warns(UpdynWarning, match="options contains a Fraction, .* '1/3' is stored"):
        write_result(sample(options={"ratio": Fraction(1, 3)}), tmp_path / "run.nc")
    assert read_result(tmp_path / "run.nc").options == {"ratio": "1/3"}


def change(name, value):
    def apply(file):
        del file[name]
        if value is not None:
            file[name] = value

    return apply


@pytest.mark.parametrize(
    ("alter", "message"),
    [
        (lambda f: f.__delitem__("start_model"), "no group 'start_model'"),
        (lambda f: f.__delitem__("updated_model/groups/0000"), "group|stiffness"),
        (lambda f: f.attrs.__setitem__("status", "done"), "status 'done'; "),
        (lambda f: f.attrs.__delitem__("method"), "attribute 'method' is None"),
        (lambda f: f.attrs.__setitem__("updyn_kind", "model"), "read it with updyn.read_model"),
        (change("options", "{'a': 1}"), "options: not JSON as updyn writes it"),
        (change("noise", '{"a": NaN}'), "noise: not JSON .*NaN is not JSON"),
        (change("identifiability", '{"rank": 1}'), "identifiability: "),
        (change("timing_s", None), "no variable 'timing_s'"),
        (change("adequacy", '{"outcome": "noise"}'), "adequacy: not a valid record of a run"),
        (change("alternatives", '[{"odds": 2}]'), "alternatives: not a valid record of a run"),
        (change("alternatives", "2"), "alternatives: not a valid record of a run"),
        (change("residual_correlation_length", None), "no variable 'residual_correlation_length'"),
    ],
)
def test_a_changed_file_is_refused(tmp_path, alter, message):
    path = tmp_path / "run.nc"
    write_result(sample(), path)
    with h5py.File(path, "r+") as file:
        alter(file)
    with pytest.raises(FormatError, match=message) as caught:
        read_result(path)
    assert str(caught.value).startswith(str(path))


def with_directions(path, place, directions, dtype):
    with h5py.File(path, "r+") as file:
        group = file[place]
        del group["direction"]
        group.create_dataset("direction", data=directions, dtype=dtype)


@pytest.mark.parametrize("place", ["start_model/dofs", "updated_model/dofs"])
def test_directions_as_text_of_any_length(tmp_path, place):
    """As other programs write them; a label that is no direction is named, whatever its letters."""
    write_result(sample(), tmp_path / "run.nc")
    texts = h5py.string_dtype("utf-8")
    with_directions(tmp_path / "run.nc", place, ["Z", "Z"], texts)
    assert_same_model(read_result(tmp_path / "run.nc").start, sample().start)
    for found, shown in (("Ü", "Ü"), ("X\u20ac", "X\u20ac"), ("Z" * 50, "Z" * 20)):
        with_directions(tmp_path / "run.nc", place, ["Z", found], texts)
        with pytest.raises(FormatError, match=f"/{place}: direction 2 is '{shown}'; "):
            read_result(tmp_path / "run.nc")
    with_directions(tmp_path / "run.nc", place, np.array([b"Z", b"\xdc"]), "S2")
    with pytest.raises(FormatError, match="direction 2 is '\ufffd'"):
        read_result(tmp_path / "run.nc")


def test_other_files_are_refused_by_name(tmp_path):
    write_model(start_model(), tmp_path / "model.h5")
    with pytest.raises(FormatError, match=r"read it with updyn.read_model"):
        read_result(tmp_path / "model.h5")
    write_result(sample(), tmp_path / "run.nc")
    with pytest.raises(FormatError, match=r"read it with updyn.read_result"):
        read_model(tmp_path / "run.nc")
    with pytest.raises(FormatError, match=r"no such file; did you mean 'run.nc'"):
        read_result(tmp_path / "rn.nc")
    (tmp_path / "run.nc").write_bytes((tmp_path / "run.nc").read_bytes()[:3000])
    with pytest.raises(FormatError, match="not a readable record of a run"):
        read_result(tmp_path / "run.nc")


# -- result.json -------------------------------------------------------------------------------------------
def test_json_has_the_agreed_structure(tmp_path):
    write_result_json(sample(), tmp_path / "result.json")
    text = (tmp_path / "result.json").read_text(encoding="utf-8")
    found = json.loads(text, parse_constant=lambda c: pytest.fail(f"{c} is not JSON"))
    assert found == result_to_json(sample())
    assert found["parameters"] == [
        {
            "name": "arm.stiffness",
            "group": "arm",
            "quantity": "stiffness",
            "start": 1.0,
            "value": 1.0 / 3.0,
            "std": 1e-3,
            "lower": 0.1,
            "upper": 10.0,
            "nominal": 0.002,
            "unit": "m",
            "drives": [{"group": "arm", "quantity": "stiffness", "power": 3.0}],
            "at_bound": False,
            "bound": None,
            "identifiable": True,
        },
        {
            "name": "foot.stiffness",
            "group": "foot",
            "quantity": "stiffness",
            "start": 1.0,
            "value": 1.0,
            "std": None,
            "lower": 0.01,
            "upper": 100.0,
            "nominal": None,
            "unit": "",
            "drives": [],
            "at_bound": False,
            "bound": None,
            "identifiable": False,
        },
        {
            "name": "foot.loss_factor",
            "group": "foot",
            "quantity": "loss_factor",
            "start": 0.02,
            "value": 0.05,
            "std": 0.1 / 3,
            "lower": 0.0,
            "upper": 0.05,
            "nominal": None,
            "unit": "",
            "drives": [],
            "at_bound": True,
            "bound": "upper",
            "identifiable": True,
        },
    ]
    ident = found["identifiability"]
    assert {
        k: ident[k] for k in ("rank", "n_parameters", "condition", "null_directions", "advice")
    } == {
        "rank": 2,
        "n_parameters": 3,
        "condition": None,
        "null_directions": [{"foot.stiffness": 1.0}],
        "advice": "Measure 2:Z.",
    }
    assert found["correlation"]["before"] == {"frac_median": 0.5, "db_error_median": None}
    assert found["correlation"]["validation"]["after"] == {"frac_median": 0.9}
    assert (found["status"], found["method"], found["iterations"]) == (
        "not-identifiable",
        "maximum-likelihood",
        1,
    )
    assert found["history"][1]["cost"] is None
    assert found["timing_s"] == {"fit": 0.1, "total": 0.3}
    assert found["versions"] == {"updyn": "0.1.0", "Python": "3.11"}


def test_json_has_the_other_answers():
    assert result_to_json(sample())["alternatives"] == [
        {
            "values": {"arm.stiffness": 2.0 / 3.0, "foot.stiffness": 0.5, "foot.loss_factor": 0.05},
            "odds": 1.25,
            "sensor": "2:Z",
            "difference": 0.37,
        },
        {
            "values": {"arm.stiffness": 0.1, "foot.stiffness": 1.0, "foot.loss_factor": 0.0},
            "odds": 1e-9,
            "sensor": "",
            "difference": 0.0,
        },
    ]
    assert result_to_json(sample(alternatives=()))["alternatives"] == []


def test_a_record_from_before_other_answers_were_looked_for_has_none(tmp_path):
    write_result(sample(), tmp_path / "run.nc")
    with h5py.File(tmp_path / "run.nc", "r+") as file:
        del file["alternatives"]
    assert read_result(tmp_path / "run.nc").alternatives == ()


def test_a_record_from_before_modes_were_looked_for_has_none(tmp_path):
    write_result(sample(), tmp_path / "run.nc")
    with h5py.File(tmp_path / "run.nc", "r+") as file:
        del file["modes"]
    assert read_result(tmp_path / "run.nc").modes is None


def test_json_has_the_modes():
    table = modal()
    found = result_to_json(sample())["modes"]
    assert found["known"]
    assert [row["test"]["frequency"] for row in found["rows"] if row["test"]] == [45.0, 200.0]
    assert found["rows"][-1]["test"]["loss_factor"] is None
    paired = [row for row in found["rows"] if row["test"] and row["start"]]
    assert paired
    for row in paired:
        start, test = row["start"], row["test"]
        assert start["change"] == pytest.approx(100 * (start["frequency"] / test["frequency"] - 1))
        assert start["mac"] == found["mac"]["start"][start["number"]][test["number"]]
    assert np.array(found["auto_mac"]) == pytest.approx(table.correlations["start"].auto_mac)
    assert list(found["comac"]["start"]) == list(found["ecomac"]["updated"]) == ["1:Z", "2:-Z"]
    assert result_to_json(sample(modes=None))["modes"] is None
    nothing = result_to_json(sample(modes=ModalTable(notes=("too few lines",))))["modes"]
    assert (nothing["known"], nothing["rows"], nothing["notes"]) == (False, [], ["too few lines"])


def test_json_says_what_is_left():
    found = result_to_json(sample())["adequacy"]
    told = {
        k: found[k]
        for k in ("outcome", "absolute", "chi_square", "p_value", "level", "bands", "misfit")
    }
    assert told == {
        "outcome": "structure",
        "absolute": True,
        "chi_square": 3.5,
        "p_value": 1e-300,
        "level": 0.02,
        "bands": [[10.0, 20.0], [30.0, 40.0]],
        "misfit": [[[2.0, None]]],
    }
    assert found["verdict"].startswith("The model cannot explain")
    assert [(p["response"], p["near"], p["kind"]) for p in found["worst"]] == [
        ("1:Z", 12.0, "structure")
    ]
    assert found["explained_by"][0] == {
        "group": "foot",
        "quantity": "mass",
        "explains": 2.0 / 3.0,
        "change": -0.1,
        "energy": 0.3,
        "confirmed": True,
    }
    assert found["noisy"] == [{"response": "1:Z", "times": 10.0 / 3.0}]
    assert found["lone"] == [17.0, 100.0 / 3.0]
    assert result_to_json(sample(adequacy=None))["adequacy"] is None


def test_json_of_several_tests_says_it_of_each():
    joint = JointResult({"a": sample(), "b": sample(adequacy=None)}, "both")
    tests = result_to_json(joint)["tests"]
    assert tests["a"]["adequacy"]["outcome"] == "structure"
    assert tests["b"]["adequacy"] is None


def test_json_of_a_failed_run_without_figures():
    found = result_to_json(sample(status="failed", values={}, std={}, correlation={}))
    assert found["correlation"] == {"before": {}, "after": {}, "validation": {}}
    assert [(p["value"], p["std"], p["identifiable"]) for p in found["parameters"]] == [
        (None, None, False)
    ] * 3


# -- mixed values as text ----------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "value",
    [
        {"a": (1, (2.5, None)), "b": [True, "x"], "c": {"d": -INF}},
        {1: "one", (2, "a"): 0.1},
        {"__float__": "no number", "b": 1},
        np.array([[1, 2], [3, 4]], dtype=np.int32),
        np.array([1 + 2j, complex(NAN, INF)]),
        np.array(["a", "bb"]),
        np.array([True, False]),
        np.empty((0, 3)),
        complex(1, INF),
        "Prüfstand \u2028 \x00 \U0001f600",
    ],
)
def test_mixed_values_come_back(value):
    text = to_text(value, "options")
    json.loads(text, parse_constant=lambda c: pytest.fail(f"{c} is not JSON"))
    assert_same(from_text(text, "options", "run.nc"), value, "value")


def test_numpy_numbers_become_numbers():
    assert_same(
        from_text(to_text({"a": np.float64(0.1), "b": np.int8(3)}, "o"), "o", "f"),
        {"a": 0.1, "b": 3},
        "value",
    )
