"""Accepted unit labels and their factors."""

from __future__ import annotations

import math

import pytest

from updyn.errors import DataError
from updyn.units import Unit, find_ratio, find_unit, merge_units, parse_unit, split_ratio

G = 9.80665
LBF = 4.4482216152605  # N; NIST SP 811, appendix B.8


@pytest.mark.parametrize(
    ("label", "kind", "factor"),
    [
        ("N", "force", 1.0),
        ("n", "force", 1.0),
        ("mN", "force", 1e-3),
        ("MN", "force", 1e6),
        ("KN", "force", 1e3),
        ("daN", "force", 10.0),
        ("kp", "force", G),
        ("lbs", "force", LBF),
        ("kip", "force", 1e3 * LBF),
        ("dyn", "force", 1e-5),
        ("N*mm", "force", 1e-3),
        ("kN·m", "force", 1e3),
        ("Nm", "force", 1.0),
        ("nm", "receptance", 1e-9),
        ("micron", "receptance", 1e-6),
        ("µm", "receptance", 1e-6),
        ("MM", "receptance", 1e-3),
        ("thou", "receptance", 25.4e-6),
        ("deg", "receptance", math.pi / 180),
        ("IPS", "mobility", 0.0254),
        ("mm/sec", "mobility", 1e-3),
        ("rad/s", "mobility", 1.0),
        ("G", "accelerance", G),
        ("g's", "accelerance", G),
        ("mg", "accelerance", G / 1000),
        ("gal", "accelerance", 0.01),
        ("km/s2", "accelerance", 1e3),
        ("(m/s²)", "accelerance", 1.0),
        ("[M/SEC^2]", "accelerance", 1.0),
        ("mm/sec/sec", "accelerance", 1e-3),
        ("mm/sec2", "accelerance", 1e-3),
        ("m/s**2", "accelerance", 1.0),
        ("in / s^2", "accelerance", 0.0254),
    ],
)
def test_labels_of_channels(label, kind, factor):
    found = find_unit(label)
    assert found is not None
    assert found.kind == kind
    assert found.factor == pytest.approx(factor, rel=1e-14)


@pytest.mark.parametrize(
    "label",
    ["", "?", "EU", "mV", "V", "Pa", "dB", "grms", "g rms", "m/s^2/N", "NM", "Mn", "s", "Hz"],
)
def test_labels_that_no_channel_has(label):
    assert find_unit(label) is None


@pytest.mark.parametrize(
    ("label", "kind", "factor"),
    [
        ("ms", "time", 1e-3),
        ("msec", "time", 1e-3),
        ("Sec", "time", 1.0),
        ("µs", "time", 1e-6),
        ("kHz", "frequency", 1e3),
        ("HZ", "frequency", 1.0),
        ("rad/s", "frequency", 1 / (2 * math.pi)),
        ("RPM", "frequency", 1 / 60),
    ],
)
def test_labels_of_axes(label, kind, factor):
    assert find_unit(label, kind) == Unit(kind, pytest.approx(factor, rel=1e-14))


@pytest.mark.parametrize("label", ["MHZ", "ms", "N"])
def test_labels_that_no_frequency_has(label):
    assert find_unit(label, "frequency") is None


@pytest.mark.parametrize(
    ("label", "kind", "factor"),
    [
        ("g/N", "accelerance", G),
        ("m/s^2/kN", "accelerance", 1e-3),
        ("(m/s2)/lbf", "accelerance", 1 / LBF),
        ("m/s/N", "mobility", 1.0),
        ("mm/N", "receptance", 1e-3),
        ("(in/s)/(lbf)", "mobility", 0.0254 / LBF),
    ],
)
def test_ratios(label, kind, factor):
    assert find_ratio(label) == Unit(kind, pytest.approx(factor, rel=1e-14))


def test_a_ratio_has_two_units():
    assert split_ratio("mm/s^2/kN") == (Unit("accelerance", 1e-3), Unit("force", 1e3))
    assert split_ratio("g") is None


@pytest.mark.parametrize("label", ["rad", "mrad/s", "deg/s^2", "Nm", "N mm", "lbf ft"])
def test_units_of_angles_and_moments(label):
    assert find_unit(label).angular


@pytest.mark.parametrize("label", ["m", "mm/s", "g", "N", "lbf"])
def test_units_of_translations_and_forces(label):
    assert not find_unit(label).angular


@pytest.mark.parametrize("label", ["g", "N/m", "g/V", "dB", "m/s"])
def test_labels_that_are_no_ratio(label):
    assert find_ratio(label) is None


def test_an_unknown_label_names_the_channel_and_the_nearest_labels():
    with pytest.raises(DataError, match=r"channel 'hammer': unit 'lbff'; did you mean 'lbf'"):
        parse_unit("lbff", "hammer")
    with pytest.raises(DataError, match=r"channel 'hammer': no unit; valid: 'N'"):
        parse_unit(" ", "hammer")


def test_a_stated_unit_agrees_with_the_file_or_is_refused():
    assert merge_units("m/s^2", "m/s**2", "1:Z") == "m/s^2"
    assert merge_units("N", "", "hammer") == "N"
    with pytest.raises(DataError, match="unit 'N' given, the records say 'kN'"):
        merge_units("N", "kN", "hammer")


@pytest.mark.parametrize(("label", "factor"), [("m", 1.0), ("mm", 1e-3), ("inch", 0.0254)])
def test_units_of_positions(label: str, factor: float) -> None:
    assert find_unit(label, "length") == Unit("length", factor)
    assert find_unit("deg", "length") is None


def test_days_as_xarray_counts_times() -> None:
    assert find_unit("days", "time") == Unit("time", 86400.0)
