"""Choice of channels by label, tables of pandas and xarray, and sets of unknowns as text."""

from __future__ import annotations

import numpy as np
import pytest

import updyn
from report_case import chain, measured, realistic
from updyn.dofs import Dof
from updyn.errors import DataError, DofError
from updyn.updating.judge.identifiability import Identifiability
from updyn.updating.problem.parameters import Parameter, ParameterSet


@pytest.fixture(scope="module")
def data():
    return measured(chain(), n_lines=40)


# -- choice ----------------------------------------------------------------------------------------
def test_one_channel_is_chosen_by_its_labels(data):
    one = data["4:Z", "12:Z"]
    np.testing.assert_array_equal(one.values[:, 0, 0], data.values[:, 1, 1])
    np.testing.assert_array_equal(one.coherence[:, 0, 0], data.coherence[:, 1, 1])
    np.testing.assert_array_equal(data[Dof(4, "Z"), "12:Z"].values, one.values)


@pytest.mark.parametrize(
    ("chosen", "responses", "references"),
    [
        ("4:Z", ["4:Z"], ["3:Z", "12:Z"]),
        (["9:Z", "1:Z"], ["9:Z", "1:Z"], ["3:Z", "12:Z"]),
        ((slice(None), "12:*"), ["1:Z", "4:Z", "6:-Z", "9:Z", "12:Z"], ["12:Z"]),
        (("*:Z", "3:Z"), ["1:Z", "4:Z", "6:-Z", "9:Z", "12:Z"], ["3:Z"]),
        (("*:-Z", "3:Z"), ["6:-Z"], ["3:Z"]),
        ((["12:Z", "?:Z"], slice(None)), ["12:Z", "1:Z", "4:Z", "6:-Z", "9:Z"], ["3:Z", "12:Z"]),
        (("[14]:Z", "3:Z"), ["1:Z", "4:Z"], ["3:Z"]),
    ],
)
def test_labels_patterns_and_lists(data, chosen, responses, references):
    part = data[chosen]
    assert part.responses.labels == responses
    assert part.references.labels == references


def test_a_label_of_the_opposite_sign_turns_the_values_and_a_pattern_does_not(data):
    np.testing.assert_array_equal(data["6:Z"].values, -data["6:-Z"].values)
    np.testing.assert_array_equal(data["6:*"].values, data["6:-Z"].values)


def test_a_band_is_that_of_select(data):
    part = data.band(50.0, 100.0)
    np.testing.assert_array_equal(part.freq, data.select(band=(50.0, 100.0)).freq)
    assert part.freq[0] >= 50.0
    assert part.freq[-1] <= 100.0
    with pytest.raises(DataError, match="holds no line"):
        data.band(500.0, 600.0)
    with pytest.raises(DataError, match="first must be below the second"):
        data.band(60.0, 50.0)


@pytest.mark.parametrize(
    ("chosen", "message"),
    [
        ("7:Z", "response 7:Z is not among the 5 DOFs"),
        ("9:X*", r"no label like '9:X\*'; valid: '1:Z'"),
        (("1:Z", "4*"), r"reference.*no label like '4\*'"),
        (("1:Z", "3:Z", "12:Z"), "3 entries; expected responses, or responses and references"),
        (0, "responses: expected a label such as '1:Z', a pattern"),
        (slice(0, 2), "expected labels or ':' for all"),
        (["1:Z", "?:Z"], ""),
        (["6:Z", "6:*"], "occurs twice"),
        ([], "at least one DOF"),
    ],
)
def test_what_chooses_nothing_is_told(data, chosen, message):
    if not message:  # what a pattern finds again is found once
        assert data[chosen].responses.labels == ["1:Z", "4:Z", "6:-Z", "9:Z"]
        return
    with pytest.raises((DofError, DataError), match=message):
        data[chosen]


def test_data_are_no_sequence(data):
    with pytest.raises(TypeError, match="not iterable"):
        list(data)
    assert np.asarray(data).shape == ()


# -- tables ----------------------------------------------------------------------------------------
def test_a_table_of_an_frf_has_lines_and_channels(data):
    table = data.to_pandas()
    assert table.index.name == "freq"
    np.testing.assert_array_equal(table.index, data.freq)
    np.testing.assert_array_equal(table["6:-Z", "12:Z"], data.values[:, 2, 1])
    assert table.attrs["quantity"] == "accelerance"
    np.testing.assert_array_equal(
        data.to_pandas("coherence")["9:Z", "3:Z"], data.coherence[:, 3, 0]
    )
    with pytest.raises(DataError, match="the data have no variance"):
        data.to_pandas("variance")
    with pytest.raises(DataError, match="part 'value': did you mean 'values'"):
        data.to_pandas("value")


def test_a_table_of_modes_and_their_dataset():
    shapes = np.array([[1.0, 2.0 + 1j], [0.5, -1.0]])
    modes = updyn.ModeSet(
        [20.0, 10.0], shapes, ["1:X", "2:X"], [0.02, 0.04], std_frequency=[0.1, 0.2], source="a.uff"
    )
    table = modes.to_pandas()
    assert table.index.tolist() == [1, 2]
    assert table["frequency"].tolist() == [10.0, 20.0]
    assert table["std_frequency"].tolist() == [0.2, 0.1]
    assert table["damping"].tolist() == [0.02, 0.01]
    data = modes.to_xarray()
    np.testing.assert_array_equal(data["shapes"].sel(dof="2:X"), [-1.0, 0.5])
    assert data["frequency"].attrs["units"] == "Hz"
    assert data["loss_factor"].sel(mode=1) == 0.04
    assert "std_shapes" not in data
    assert data.attrs["source"] == "a.uff"


def test_a_table_of_a_result_has_values_and_intervals():
    result = realistic()
    table = result.to_pandas(level=0.9)
    assert table.index.tolist() == result.parameters.names
    assert table["value"].to_dict() == dict(result.values)
    for name, (low, high) in result.intervals(0.9).items():
        assert tuple(table.loc[name, ["low", "high"]]) == (low, high)
    assert table.loc["bay 8.stiffness", "at_bound"] == "lower"
    open_ = table.index[~np.isfinite(table["std"])]
    assert table.loc[open_, ["low", "high"]].isna().all(axis=None)
    joint = updyn.JointResult({"a": result})
    assert joint.to_pandas(0.9).equals(table)


def test_a_table_of_unknowns():
    table = realistic().parameters.to_pandas()
    assert table.loc["bay 5.mass", "prior_std"] == 0.3
    assert np.isnan(table.loc["bay 2.stiffness", "prior_std"])
    assert table.loc["bay 2.stiffness", ["start", "lower", "upper"]].tolist() == [1.0, 0.4, 2.5]


# -- text ------------------------------------------------------------------------------------------
def test_a_set_of_unknowns_reads_as_a_table():
    items = (
        Parameter("shaft", "stiffness", 1.0, 0.5, 2.0, nominal=2.1e11, unit="Pa"),
        Parameter("hub", "mass_damping", 0.1, 0.0, 3.0),
    )
    assert repr(ParameterSet(items)).splitlines() == [
        "ParameterSet(2 unknowns)",
        "unknown           start  lower  upper  note",
        "shaft.stiffness       1    0.5      2  2.1e+11 Pa",
        "hub.mass_damping    0.1      0      3  in 1/s",
    ]
    many = ParameterSet(tuple(Parameter(f"g{i}", "mass", 1.0, 0.5, 2.0) for i in range(45)))
    assert repr(many).splitlines()[-1] == "... and 5 more"
    assert "prior std" in repr(realistic().parameters)


def test_text_of_unknowns_has_no_control_characters():
    items = (Parameter("a\x1b[31m", "stiffness", 1.0, 0.5, 2.0),)
    assert "\x1b" not in repr(ParameterSet(items))


def test_identifiability_reads_as_a_table():
    found = Identifiability(
        2, 3, 40.0, (1.0, 0.5, 0.0), [{"hub.mass": 1.0, "hub.stiffness": -0.62}],
        [{"hub.stiffness": 1.0, "hub.mass": 0.62}], 12.5, "Measure at the hub.",
    )  # fmt: skip
    assert repr(found).splitlines() == [
        "Identifiability(rank 2 of 3, condition 40, collinearity 12.5)",
        "weight in      undetermined 1  determined 1",
        "hub.mass                   +1         +0.62",
        "hub.stiffness           -0.62            +1",
        "Measure at the hub.",
    ]
    whole = Identifiability(3, 3, 4.0, (1.0, 0.5, 0.3), [], [], 3.0, "")
    assert repr(whole) == "Identifiability(rank 3 of 3, condition 4, collinearity 3)"
