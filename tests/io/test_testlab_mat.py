"""The MATLAB export of Simcenter Testlab: FRFs, coherence, and what is refused."""

import numpy as np
import pytest

import updyn
from matlab73 import write_matlab73
from testlab_samples import ACCELERANCE, MOBILITY, RECEPTANCE, RNG, N, export, save_5
from updyn.cli import main
from updyn.errors import FormatError, OptionError, UpdynWarning
from updyn.io.matlab import read_coherence


@pytest.fixture(params=[save_5, write_matlab73], ids=["v5", "v7.3"])
def save(request):
    return request.param


@pytest.fixture
def path(tmp_path):
    return tmp_path / "export.mat"


def coherence(responses, references):
    return export(
        responses,
        references,
        unit="/",
        terms={},
        kind="Coherence",
        values=RNG.uniform(0.5, 1.0, (N, len(responses))),
    )


def test_frfs_are_read_with_their_coherence_and_averages(path, save):
    pairs = ["12:+X", "7:-Z", "12:+X", "7:-Z"], ["3:-X", "3:-X", "4:+Y", "4:+Y"]
    frf, gamma = export(*pairs), coherence(*(side[::-1] for side in pairs))
    save(path, {"FRF": frf, "Coh": gamma})
    read = updyn.read_frf(path)
    np.testing.assert_array_equal(read.freq, 1.0 + 0.5 * np.arange(N))
    assert (read.responses.labels, read.references.labels) == (["12:X", "7:-Z"], ["3:-X", "4:Y"])
    assert (read.quantity, read.averages) == ("accelerance", 54)
    np.testing.assert_array_equal(
        read.values.transpose(0, 2, 1).reshape(N, 4), frf["y_values"]["values"]
    )
    assert read.coherence is not None
    np.testing.assert_array_equal(
        read.coherence.transpose(0, 2, 1).reshape(N, 4), gamma["y_values"]["values"][:, ::-1]
    )


@pytest.mark.parametrize(
    ("unit", "terms", "expected"),
    [
        ("(m/s^2)/N", ACCELERANCE, "accelerance"),
        ("(m/s)/N", MOBILITY, "mobility"),
        ("m/N", RECEPTANCE, "receptance"),
    ],
)
def test_the_quantity_follows_from_the_dimension(path, unit, terms, expected):
    save_5(path, {"FRF": export(["1:+Z"], "2:+Z", unit, terms)})
    assert updyn.read_frf(path).quantity == expected
    with pytest.raises(FormatError, match="contradicts the file"):
        updyn.read_frf(path, quantity="mobility" if expected == "receptance" else "receptance")


def test_rotations_have_another_dimension(path):
    terms = {"MASS": -1, "LENGTH": -1, "ANGLE": 1}
    save_5(path, {"FRF": export(["1:+RZ"], "2:+Z", "(rad/s^2)/N", terms)})
    assert updyn.read_frf(path).responses.labels == ["1:RZ"]
    save_5(path, {"FRF": export(["1:+Z"], "2:+Z", "(rad/s^2)/N", terms)})
    with pytest.raises(FormatError, match=r"LENGTH\^-1.*expected motion over force"):
        updyn.read_frf(path)


def test_several_quantities_are_converted_to_one(path, save):
    first, second = (
        export(["Acc1:+X", "Acc2:+X"], "Shaker:-X"),
        export(["Laser:+X"], "Shaker:-X", "(m/s)/N", MOBILITY),
    )
    save(path, {"FRF": first, "FRF_Laser": second})
    with pytest.warns(UpdynWarning) as warned:
        read = updyn.read_frf(path)
    texts = [str(one.message) for one in warned]
    assert all(one.filename == __file__ for one in warned)
    assert any("Acc1 = 900000001, Acc2 = 900000002, Laser" in text for text in texts)
    assert any("converted to accelerance: Laser:+X" in text for text in texts)
    assert (read.responses.labels, read.references.labels) == (
        ["900000001:X", "900000002:X", "900000003:X"],
        ["900000004:-X"],
    )
    np.testing.assert_allclose(
        read.values[:, 2, 0], 2j * np.pi * read.freq * second["y_values"]["values"][:, 0]
    )
    assert "Laser:+X / Shaker:-X" in read.source


def test_given_labels_replace_the_names_of_channels(path):
    save_5(path, {"FRF": export(["Top", "Bottom:S"], "Hammer:+Z")})
    with pytest.raises(FormatError, match=r"channel 'Top': expected point:direction.*response_lab"):
        updyn.read_frf(path)
    labels = {"response_labels": ["5:Z", "9:-Z"], "reference_labels": ["5:Z"]}
    read = updyn.read_frf(path, **labels)
    assert (read.responses.labels, read.references.labels) == (["5:Z", "9:-Z"], ["5:Z"])
    with pytest.raises(FormatError, match="1 labels for 2 channels: Top, Bottom:S"):
        updyn.read_frf(path, **labels | {"response_labels": ["5:Z"]})
    with pytest.raises(OptionError, match="order"):
        updyn.read_frf(path, **labels, order=["freq", "response", "reference"])


def test_the_number_after_a_component_is_the_node(path):
    save_5(path, {"FRF": export(["wing:7:+Z", "wing:8:-Z"], "wing:7:+Z")})
    read = updyn.read_frf(path)
    assert (read.responses.labels, read.references.labels) == (["7:Z", "8:-Z"], ["7:Z"])
    save_5(path, {"FRF": export(["left:7:+Z", "right:7:+Z", "9:+Z"], "left:7:+Z")})
    with pytest.warns(UpdynWarning, match=r"left:7 = 900000001, right:7 = 900000002\. To compare"):
        assert updyn.read_frf(path).responses.labels == ["900000001:Z", "900000002:Z", "9:Z"]


def test_values_saved_in_mks_are_in_si_and_the_factor_leads_to_the_label(path):
    struct = export(["1:+Z"], "2:+Z", "g/N", factor=1 / 9.80665)
    save_5(path, {"FRF": struct})
    np.testing.assert_array_equal(
        updyn.read_frf(path).values[:, :, 0], struct["y_values"]["values"]
    )


def test_values_in_the_unit_of_the_label_are_converted_by_the_factor(path):
    struct = export(["1:+Z"], "2:+Z", "g/N", factor=9.80665, info="")
    save_5(path, {"FRF": struct})
    np.testing.assert_allclose(
        updyn.read_frf(path).values[:, :, 0], 9.80665 * struct["y_values"]["values"]
    )


@pytest.mark.parametrize(
    ("unit", "factor"), [("g/N", 9.80665), ("g/N", 1.0), ("EU/N", 2.0), ("(m/s^2)/N", np.nan)]
)
def test_a_contradictory_factor_is_refused(path, unit, factor):
    save_5(path, {"FRF": export(["1:+Z"], "2:+Z", unit, factor=factor)})
    with pytest.raises(FormatError, match="unit of the values is ambiguous"):
        updyn.read_frf(path)


@pytest.mark.parametrize(
    ("unit", "terms"),
    [
        ("(m/s^2)/V", {"LENGTH": -1, "MASS": -1, "TIME": 1, "CURRENT": 1}),
        ("g/g", {}),
        ("N/(m/s^2)", {"MASS": 1}),
        ("(m/s)/N", ACCELERANCE),
    ],
)
def test_a_reference_that_is_no_force_is_named(path, unit, terms):
    save_5(path, {"FRF_1": export(["1:+Z"], "Amplifier:+Z", unit, terms)})
    found = "FRF_1: unit .* of response '1:.Z' with reference 'Amplifier:.Z'; expected motion over"
    with (
        pytest.warns(UpdynWarning, match="Amplifier = 900000001"),
        pytest.raises(FormatError, match=found),
    ):
        updyn.read_frf(path)


def test_real_values_are_refused_unless_declared(path):
    save_5(path, {"FRF": export(["1:+Z"], "2:+Z", values=np.ones((N, 1)))})
    with pytest.raises(FormatError, match=r"real numbers.*real_valued"):
        updyn.read_frf(path)
    np.testing.assert_array_equal(updyn.read_frf(path, real_valued=True).values, 1.0)


def test_coherence_without_frfs_is_described(path, save, capsys):
    save(path, {"Coh": coherence(["Acc1:+X", "Acc2:+X"], "Shaker:-X")})
    assert main(["info", str(path)]) == 0
    shown = capsys.readouterr().out
    assert "Coherence without FRFs: 6 lines from 1 to 3.5 Hz" in shown
    assert "2 pairs of response and reference: Acc1:+X/Shaker:-X, Acc2:+X/Shaker:-X" in shown
    assert list(read_coherence(path).values) == [("Acc1:+X", "Shaker:-X"), ("Acc2:+X", "Shaker:-X")]
    with pytest.raises(
        FormatError, match=r"without FRFs; it has 2 Coherence\. Save its structs and"
    ):
        updyn.read_frf(path)
    with pytest.raises(FormatError, match="it has no model"):
        updyn.read_model(path)


def test_incomplete_coherence_and_other_variables_are_named(path):
    stored = {
        "FRF": export(["1:+Z", "2:+Z"], "1:+Z"),
        "Coh": coherence(["1:+Z"], "1:+Z"),
        "Power": export(["1:+Z"], "1:+Z", kind="AutoPowerSpectrum"),
        "note": 3.0,
    }
    save_5(path, stored)
    with pytest.warns(UpdynWarning) as warned:
        assert updyn.read_frf(path).coherence is None
    texts = [str(one.message) for one in warned]
    assert any("coherence ignored, because 2:+Z/1:+Z has none" in text for text in texts)
    assert any(
        "ignored: Power, note" in text or "ignored: 'Power', 'note'" in text for text in texts
    )


def _without(struct, *keys):
    *parents, last = keys
    for key in parents:
        struct = struct[key]
    del struct[last]


DAMAGES = {
    "no record": (lambda s: _without(s, "function_record"), "no function_record.type"),
    "no values": (lambda s: _without(s, "y_values", "values"), "no y_values.values"),
    "no lines": (lambda s: _without(s, "x_values", "increment"), "no x_values.increment"),
    "no terms": (
        lambda s: _without(s, "y_values", "quantity", "quantity_terms"),
        "no y_values.quantity.quantity_terms",
    ),
    "terms": (
        lambda s: s["y_values"]["quantity"].update(quantity_terms=3.0),
        "quantity_terms: found",
    ),
    "den": (
        lambda s: s["y_values"]["quantity"]["quantity_terms"][1].update(den=0.0),
        r"quantity_terms\(2\): den is 0",
    ),
    "count": (lambda s: s["x_values"].update(number_of_values=7.0), "is 7, but .* has 6 lines"),
    "empty": (lambda s: s["y_values"].update(values=np.zeros((0, 2))), "is 6, but .* has 0 lines"),
    "axis": (lambda s: s["x_values"]["quantity"].update(label="s"), "x_values in 's'; expected fr"),
    "columns": (
        lambda s: s["y_values"].update(values=np.ones((N, 3)) * 1j),
        r"shape \(6, 3\); expected \(lines, functions\) = \(6, 2\)",
    ),
    "names": (
        lambda s: s["function_record"]["primary_channel"].update(label=["1:+Z"]),
        "1 responses .* 2 references",
    ),
    "texts": (
        lambda s: s["function_record"]["primary_channel"].update(label=3.0),
        "primary_channel.label: found .*; expected texts",
    ),
    "twice": (
        lambda s: s["function_record"]["primary_channel"].update(label=["1:+Z", "1:+Z"]),
        "response '1:.Z' with reference '1:.Z' occurs twice",
    ),
    "averages": (
        lambda s: s["function_record"]["average"].update(nr_of_averages=np.array([2.5, 2.5])),
        "averages: 2.5",
    ),
    "not finite": (
        lambda s: s["y_values"].update(values=np.full((N, 2), np.nan + 0j)),
        "is not finite",
    ),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damaged_struct_ends_with_one_message(path, capsys, name):
    damage, expected = DAMAGES[name]
    struct = export(["1:+Z", "2:+Z"], "1:+Z")
    damage(struct)
    save_5(path, {"FRF": struct})
    with pytest.raises(FormatError, match=expected):
        updyn.read_frf(path)
    assert main(["info", str(path)]) == 2
    shown = capsys.readouterr().err
    assert shown.count("export.mat") == 1
    assert "  as " not in shown


def test_structs_on_other_lines_and_missing_pairs_are_refused(path):
    first, second = export(["1:+Z"], "1:+Z"), export(["2:+Z"], "1:+Z")
    second["x_values"]["increment"] = 0.25
    save_5(path, {"A": first, "B": second})
    with pytest.raises(FormatError, match="B: its frequency lines differ from those of A"):
        updyn.read_frf(path)
    save_5(path, {"A": first, "B": export(["2:+Z"], "3:+Z")})
    with pytest.raises(FormatError, match=r"no FRF of response '1:.Z' and reference '3:.Z'"):
        updyn.read_frf(path)
