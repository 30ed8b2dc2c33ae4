"""Files of transmissibilities: round trips, units, universal files of function type 5, refusals."""

import re

import numpy as np
import pytest

import updyn
from updyn.errors import FormatError, UpdynWarning
from updyn.units import find_ratio

FREQ = np.linspace(5.0, 9.0, 5)
VALUES = np.arange(1.0, 11.0).reshape(5, 2, 1) * (1.0 - 0.25j)


def transmissibility(**excitation):
    return updyn.FRF(FREQ, VALUES, ["3:Z", "4:-X"], ["1:Z"], "transmissibility", **excitation)


def check(frf):
    assert frf.quantity == "transmissibility"
    assert frf.responses.labels == ["3:Z", "4:-X"]
    assert frf.references.labels == ["1:Z"]
    np.testing.assert_allclose(frf.values, VALUES, rtol=1e-15)


@pytest.mark.parametrize("suffix", [".nc", ".npz", ".mat", ".csv"])
@pytest.mark.parametrize(
    "excitation", [{}, {"base": ["1:Z", "2:-Z"]}, {"force": "9:X"}], ids=["none", "base", "force"]
)
def test_round_trip(tmp_path, suffix, excitation):
    updyn.write_frf(transmissibility(**excitation), tmp_path / f"t{suffix}")
    frf = updyn.read_frf(tmp_path / f"t{suffix}")
    check(frf)
    assert (frf.base and frf.base.labels) == excitation.get("base")
    assert (frf.force and str(frf.force)) == excitation.get("force")


def test_universal_file(tmp_path):
    path = tmp_path / "t.uff"
    updyn.write_frf(transmissibility(), path)
    assert b"\n    5         0    0         0 NONE" in path.read_bytes()
    check(updyn.read_frf(path))
    with pytest.warns(UpdynWarning, match="cannot hold base"):
        updyn.write_frf(transmissibility(base=["1:Z"]), path)


def text_file(path, function, above, below, label_above="NONE", label_below="NONE"):
    """Write a dataset 58 in text, (3:+Z over 1:+Z), with two lines."""
    lines = ["    -1", "    58", *["NONE"] * 5]
    lines.append(
        f"{function:5d}{0:10d}{0:5d}{0:10d} {'NONE':<10}{3:10d}{3:4d} {'NONE':<10}{1:10d}{3:4d}"
    )
    lines.append(f"{5:10d}{2:10d}{1:10d}{5.0:13.5e}{1.0:13.5e}{0.0:13.5e}")
    for kind, name, unit in (
        (18, "Frequency", "Hz"),
        (above, "NONE", label_above),
        (below, "NONE", label_below),
        (0, "NONE", "NONE"),
    ):
        lines.append(f"{kind:10d}{0:5d}{0:5d}{0:5d} {name:<20} {unit:<20}")
    lines += [" 1.00000e+00 2.00000e+00 3.00000e+00 4.00000e+00".replace(" ", "  "), "    -1", ""]
    path.write_text("\n".join(lines))


@pytest.mark.parametrize(
    ("kinds", "labels", "factor"),
    [
        ((12, 12), ("NONE", "NONE"), 1.0),
        ((0, 0), ("NONE", "NONE"), 1.0),
        ((12, 12), ("g", "g"), 1.0),
        ((12, 12), ("m/s^2", "g"), 1 / 9.80665),
        ((12, 0), ("g/g", "NONE"), 1.0),
        ((8, 8), ("mm", "m"), 1e-3),
    ],
)
def test_function_type_5(tmp_path, kinds, labels, factor):
    path = tmp_path / "t.uff"
    text_file(path, 5, *kinds, *labels)
    frf = updyn.read_frf(path)
    assert frf.quantity == "transmissibility"
    np.testing.assert_allclose(frf.values[:, 0, 0], factor * np.array([1 + 2j, 3 + 4j]), rtol=1e-12)


def test_function_type_4_of_two_motions(tmp_path):
    """Read if the user states the quantity; otherwise the message says so."""
    path = tmp_path / "t.uff"
    text_file(path, 4, 12, 12)
    with pytest.raises(FormatError, match="two equal ones are read with quantity='transmissib"):
        updyn.read_frf(path)
    assert updyn.read_frf(path, quantity="transmissibility").quantity == "transmissibility"


@pytest.mark.parametrize("kinds", [(12, 13), (12, 8)])
def test_function_type_5_of_other_types(tmp_path, kinds):
    path = tmp_path / "t.uff"
    text_file(path, 5, *kinds)
    with pytest.raises(FormatError, match=r"acceleration over .*; expected two"):
        updyn.read_frf(path)


def test_contradictions(tmp_path):
    path = tmp_path / "t.uff"
    text_file(path, 5, 12, 12)
    with pytest.raises(
        FormatError, match=r"'accelerance' contradicts .* states 'transmissibility'"
    ):
        updyn.read_frf(path, quantity="accelerance")


def test_both_types_in_one_file(tmp_path):
    """The FRFs are read, with a warning, or the transmissibilities if they are asked for."""
    one, two, both = tmp_path / "a.uff", tmp_path / "b.uff", tmp_path / "c.uff"
    text_file(one, 4, 12, 13)
    text_file(two, 5, 12, 12)
    both.write_text(one.read_text() + two.read_text())
    with pytest.warns(UpdynWarning, match="transmissibility"):
        assert updyn.read_frf(both).quantity == "accelerance"
    with pytest.warns(UpdynWarning, match="frequency response function"):
        assert updyn.read_frf(both, quantity="transmissibility").quantity == "transmissibility"


@pytest.mark.parametrize("unit", ["g/g", "(m/s^2)/(m/s²)", "1", "mm/mm"])
def test_units_of_a_table(tmp_path, unit):
    path = tmp_path / "t.csv"
    path.write_text(f"# unit: {unit}\nfreq_Hz,H(3:Z/1:Z) re,H(3:Z/1:Z) im\n5,1,2\n6,3,4\n")
    frf = updyn.read_frf(path)
    assert frf.quantity == "transmissibility"
    np.testing.assert_allclose(frf.values[:, 0, 0], [1 + 2j, 3 + 4j])


def test_selected_columns(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("Frequency,A3 amplitude,A3 phase\n5,2,90\n6,1,180\n")
    channel = {"response": "3:Z", "reference": "1:Z", "magnitude": 2, "phase_deg": 3}
    columns = {"frequency": 1, "unit": "g/g", "channels": [channel]}
    frf = updyn.read_frf(path, columns=columns)
    assert frf.quantity == "transmissibility"
    np.testing.assert_allclose(frf.values[:, 0, 0], [2j, -1], atol=1e-15)


def test_ratios_of_units():
    assert find_ratio("g/g").kind == "transmissibility"
    assert find_ratio("g/(m/s^2)").factor == pytest.approx(9.80665)
    assert find_ratio("g/N").kind == "accelerance"
    assert find_ratio("m/s^2/N").kind == "accelerance"
    assert find_ratio("g/mm") is None
    assert find_ratio("m/s^2") is None


def test_a_rotation_is_not_in_g(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("# unit: g/g\nfreq_Hz,H(3:RX/1:Z) re,H(3:RX/1:Z) im\n5,1,2\n6,3,4\n")
    with pytest.raises(FormatError, match=re.escape("the motion at 3:RX cannot be in 'g/g'")):
        updyn.read_frf(path)
