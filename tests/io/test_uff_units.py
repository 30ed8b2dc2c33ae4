"""Units of universal files: labels of records 8 to 10, dataset 164, and how the two combine."""

import numpy as np
import pytest

import uff_samples as uff
import updyn
from updyn.errors import FormatError

Y = np.array([1.5 - 2j, -0.25 + 1e-3j, 3e4 + 7j, -1e-6 - 1j / 3])
G = 9.80665  # m/s^2, by definition
LBF = 4.4482216152605  # N; NIST SP 811, appendix B.8
MM_N = uff.units(10, 1000.0, 1.0)
INCH = uff.units(7, 39.37007874015748, 0.22480894387096)
SI = uff.units(1, 1.0, 1.0)
DISPLACEMENT, VELOCITY, ACCELERATION = (18, 8, 13), (18, 11, 13), (18, 12, 13)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "case.uff"


def read(path, *parts, **options):
    path.write_bytes(b"".join(parts))
    return updyn.read_frf(path, **options)


def frf(above="NONE", below="NONE", types=ACCELERATION, axis="Hz", **options):
    return uff.binary58(Y, units=(axis, above, below), types=types, **options)


def factor(path, *parts, **options):
    ratio = read(path, *parts, **options).values[:, 0, 0] / Y
    np.testing.assert_allclose(ratio, ratio[0].real, rtol=1e-12)
    return ratio[0].real


# -- labels alone --------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("above", "below", "types", "expected"),
    [
        ("g", "N", ACCELERATION, G),
        ("G", "NONE", ACCELERATION, G),
        ("gn", "lbf", ACCELERATION, G / LBF),
        ("mg", "kN", ACCELERATION, G * 1e-6),
        ("g/N", "NONE", ACCELERATION, G),
        ("(g)/N", "", ACCELERATION, G),
        ("g/N", "N", ACCELERATION, G),
        ("m/s^2/kN", "NONE", ACCELERATION, 1e-3),
        ("m/s^2/lbf", "lbf", ACCELERATION, 1 / LBF),
        ("(m/s2)/N", "N", ACCELERATION, 1.0),
        ("km/s2", "N", ACCELERATION, 1e3),
        ("MM/SEC**2", "daN", ACCELERATION, 1e-4),
        ("in/s^2", "lbf", ACCELERATION, 0.0254 / LBF),
        ("gal", "dyn", ACCELERATION, 1e3),
        ("um", "N", DISPLACEMENT, 1e-6),
        ("microns", "kip", DISPLACEMENT, 1e-9 / LBF),
        ("mil", "lbf", DISPLACEMENT, 25.4e-6 / LBF),
        ("mm/N", "NONE", DISPLACEMENT, 1e-3),
        ("IPS", "lbs", VELOCITY, 0.0254 / LBF),
        ("mm/sec", "kp", VELOCITY, 1e-3 / G),
    ],
)
def test_known_labels_are_converted(path, above, below, types, expected):
    assert factor(path, frf(above, below, types)) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("above", "below", "expected"),
    [("deg/s^2", "Nm", np.pi / 180), ("rad/s^2", "lbf in", 1 / (LBF * 0.0254)), ("", "N mm", 1e3)],
)
def test_labels_of_angles_and_moments(path, above, below, expected):
    data = frf(above, below, response=(1, 4), reference=(1, 6))
    assert factor(path, data) == pytest.approx(expected, rel=1e-12)


def test_each_function_has_its_own_unit(path):
    parts = [frf("g", "N"), frf("m/s^2", "N", response=(2, 3)), frf("g", "lbf", response=(3, 3))]
    found = read(path, *parts).values[:, :, 0]
    np.testing.assert_allclose(found, Y[:, None] * [G, 1.0, G / LBF], rtol=1e-12)


def test_functions_that_are_averaged_are_converted_first(path):
    found = read(path, frf("g", "N"), frf("m/s^2", "N"), duplicates="average")
    np.testing.assert_allclose(found.values[:, 0, 0], 0.5 * (G + 1) * Y, rtol=1e-12)


@pytest.mark.parametrize("label", ["dB", "mV", "V", "EU", "EU/N", "Pa", "grms", "g pk", "?", "-"])
def test_an_unknown_label_of_the_motion_is_an_error(path, label):
    with pytest.raises(FormatError) as error:
        read(path, frf(label))
    assert f":11: record 9: unit '{label}'" in str(error.value)
    assert "scale=" in str(error.value)
    assert factor(path, frf(label), scale=2.5) == 2.5


@pytest.mark.parametrize("label", ["V", "mV", "oz", "lbm", "EU", "m/s^2/N"])
def test_an_unknown_label_of_the_force_is_an_error(path, label):
    with pytest.raises(FormatError) as error:
        read(path, frf("m/s^2", label))
    assert f":12: record 10: unit '{label}'" in str(error.value)
    assert "scale=" in str(error.value)
    assert factor(path, frf("m/s^2", label), scale=2.5) == 2.5


@pytest.mark.parametrize(
    ("above", "below", "types", "message"),
    [
        ("g", "N", DISPLACEMENT, "record 9: 'g' is a unit of acceleration; expected .* displacement"),
        ("m/s^2/N", "N", VELOCITY, "record 9: 'm/s.2/N' is a unit of acceleration per force; .* velocity per force"),
        ("m", "N", ACCELERATION, "record 9: 'm' is a unit of displacement; .* acceleration"),
        ("N", "N", ACCELERATION, "record 9: 'N' is a unit of force; .* acceleration"),
        ("rad/s^2", "N", ACCELERATION, "record 9: 'rad/s.2' is a unit of angular acceleration; .* acceleration"),
        ("m/s^2", "m/s^2", ACCELERATION, "record 10: 'm/s.2' is a unit of acceleration; .* force"),
        ("m/s^2", "Nm", ACCELERATION, "record 10: 'Nm' is a unit of moment; .* force"),
        ("m/s^2/Nm", "", ACCELERATION, "record 9: 'm/s.2/Nm' is a unit of .* moment; .* force"),
        ("m/s^2/N", "kN", ACCELERATION, "record 10: 'kN' contradicts 'm/s.2/N' of record 9"),
    ],
)  # fmt: skip
def test_labels_of_the_wrong_kind_are_errors(path, above, below, types, message):
    with pytest.raises(FormatError, match=message):
        read(path, frf(above, below, types))


def test_a_translation_in_rad_and_a_rotation_in_metres_are_errors(path):
    with pytest.raises(FormatError, match=r"'m/s.2' is a unit of acceleration; .* angular accel"):
        read(path, frf("m/s^2", "N", response=(1, 5)))
    with pytest.raises(FormatError, match=r"record 10: 'N' is a unit of force; .* moment"):
        read(path, frf("m/s^2", "N", reference=(1, -5)))


def test_labels_are_checked_against_the_quantity_that_is_declared(path):
    data = frf("g", "N", types=(18, 0, 0))
    assert factor(path, data, quantity="accelerance") == pytest.approx(G)
    with pytest.raises(FormatError, match=r"'g' is a unit of acceleration; .* displacement"):
        read(path, data, quantity="receptance")


# -- labels and dataset 164 ----------------------------------------------------------------------
@pytest.mark.parametrize(
    ("units", "above", "below", "expected"),
    [
        (MM_N, "", "", 1e-3),
        (MM_N, "mm/s^2", "N", 1e-3),
        (MM_N, "mm/s^2/N", "", 1e-3),
        (MM_N, "mm/s^2", "", 1e-3),
        (MM_N, "", "N", 1e-3),
        (MM_N, "g", "N", G),
        (MM_N, "g/N", "", G),
        (INCH, "in/s^2", "lbf", 0.0254 / LBF),
        (INCH, "g", "", G / LBF),
        (INCH, "", "", 0.0254 / LBF),
        (SI, "g", "N", G),
        (SI, "m/s^2", "N", 1.0),
    ],
)
def test_labels_that_agree_with_dataset_164(path, units, above, below, expected):
    for parts in ([units, frf(above, below)], [frf(above, below), units]):
        assert factor(path, *parts) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(
    ("units", "above", "below", "message"),
    [
        (MM_N, "m/s^2", "N", "record 9: unit 'm/s.2' contradicts dataset 164 on line 3"),
        (MM_N, "m/s^2/N", "", "record 9: unit 'm/s.2/N' contradicts dataset 164"),
        (MM_N, "mm/s^2", "kN", "record 10: unit 'kN' contradicts dataset 164"),
        (SI, "mm/s^2", "N", "record 9: unit 'mm/s.2' contradicts dataset 164"),
        (SI, "g", "lbf", "record 10: unit 'lbf' contradicts dataset 164"),
        (INCH, "in/s^2", "N", "record 10: unit 'N' contradicts dataset 164"),
        (INCH, "g/N", "", "record 9: unit 'g/N' contradicts dataset 164"),
    ],
)
def test_labels_that_contradict_dataset_164_are_errors(path, units, above, below, message):
    with pytest.raises(FormatError, match=f"{message}.*scale="):
        read(path, units, frf(above, below))
    assert factor(path, units, frf(above, below), scale=3.0) == 3.0


def test_dataset_164_has_no_unit_of_angle(path):
    data = frf("deg/s^2", "N mm", response=(1, 4), reference=(1, 4))
    assert factor(path, MM_N, data) == pytest.approx(1e3 * np.pi / 180)


# -- units in axis names -------------------------------------------------------------------------
def test_a_unit_in_the_name_of_an_axis_must_agree(path):
    data = frf().replace(b" NONE                 NONE", b" Accel (g)            NONE", 1)
    with pytest.raises(
        FormatError, match=r":11: record 9: the axis name 'Accel \(g\)' .* 'g'.* scale="
    ):
        read(path, data)
    assert factor(path, data, scale=G) == G
    named = data.replace(b"Accel (g)            NONE", b"Accel (g)            g   ")
    assert factor(path, named) == pytest.approx(G)
    named = data.replace(b"Accel (g)            NONE", b"Accel [m/s^2]        NONE")
    assert factor(path, named) == 1.0
    named = data.replace(b"Accel (g)            NONE", b"Accel (filtered)     NONE")
    assert factor(path, named) == 1.0


# -- the abscissa --------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("label", "unit"),
    [("Hz", 1.0), ("", 1.0), ("kHz", 1e3), ("rad/s", 1 / (2 * np.pi)), ("RPM", 1 / 60)],
)
def test_lines_are_converted_to_hz(path, label, unit):
    for x in (None, np.array([1.0, 1.25, 40.0, 1000.5])):
        found = read(path, uff.binary58(Y, x=x, units=(label, "NONE", "NONE")))
        expected = np.array([1.0, 1.5, 2.0, 2.5]) if x is None else x
        np.testing.assert_allclose(found.freq, unit * expected, rtol=1e-14)


def test_lines_of_frf_and_coherence_may_have_different_units(path):
    gamma = uff.binary58(
        np.full(4, 0.5), kind=6, types=(18, 0, 0), units=("kHz", "", ""), start=1e-3, step=5e-4
    )
    found = read(path, uff.binary58(Y), gamma)
    np.testing.assert_array_equal(found.coherence[:, 0, 0], 0.5)


@pytest.mark.parametrize("label", ["s", "order", "dB", "EU"])
def test_an_unknown_unit_of_the_abscissa_is_an_error(path, label):
    with pytest.raises(FormatError, match=f":10: record 8: .*'{label}'; expected frequency in Hz"):
        read(path, frf(axis=label))


def test_an_abscissa_of_speed_is_an_error(path):
    with pytest.raises(FormatError, match=r"record 8: .* speed in 'rpm'; expected frequency"):
        read(path, frf(types=(19, 12, 13), axis="rpm"))


# -- time records --------------------------------------------------------------------------------
X = np.array([0.0, 1.0, -2.0, 0.5])


def record(path, *parts):
    path.write_bytes(b"".join(parts))
    return updyn.read_records(path)


def response(above="NONE", axis="s", types=(17, 12, 0), **options):
    options = {"start": 0.0, "step": 0.25} | options
    return uff.ascii58(X, kind=1, types=types, units=(axis, above, "NONE"), **options)


@pytest.mark.parametrize(
    ("parts", "unit", "scale"),
    [
        ([response("g")], "g", 1.0),
        ([response("mm/s^2")], "mm/s^2", 1.0),
        ([response()], "m/s^2", 1.0),
        ([MM_N, response()], "m/s^2", 1e-3),
        ([MM_N, response("g")], "g", 1.0),
        ([MM_N, response("mm/s^2")], "mm/s^2", 1.0),
        ([response("EU")], "EU", 1.0),
        ([response("degC", types=(17, 5, 0))], "degC", 1.0),
    ],
)
def test_records_keep_their_labels(path, parts, unit, scale):
    found = record(path, *parts)
    assert found["unit"].values.tolist() == [unit]
    np.testing.assert_allclose(found.values[0, 0], scale * X)


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ([response("N")], ":11: record 9: 'N' is a unit of force; expected .* acceleration"),
        ([response("g", types=(17, 8, 0))], ":11: record 9: 'g' is a unit of acceleration"),
        ([MM_N, response("m/s^2")], ":17: record 9: unit 'm/s.2' contradicts dataset 164"),
        ([response(axis="Hz")], ":10: record 8: .*'Hz'; expected time in s"),
        ([response(axis="EU")], ":10: record 8: .*'EU'; expected time in s"),
    ],
)
def test_records_with_wrong_labels_are_errors(path, parts, message):
    with pytest.raises(FormatError, match=message):
        record(path, *parts)


@pytest.mark.parametrize(("label", "unit"), [("s", 1.0), ("sec", 1.0), ("ms", 1e-3), ("µs", 1e-6)])
def test_times_are_converted_to_s(path, label, unit):
    np.testing.assert_allclose(record(path, response(axis=label)).time, unit * 0.25 * np.arange(4))
