"""FRF: validation, conversion, selection, xarray, immutability."""

from __future__ import annotations

import copy
import dataclasses
import pickle
import re

import numpy as np
import pytest

from updyn.dofs import DofSet
from updyn.errors import DataError, DofError
from updyn.frf import FRF, check_quantity
from updyn.geometry import Geometry

FREQ = np.array([1.0, 2.5, 4.0, 7.0])


def raises(text: str, kind: type[Exception] = DataError):
    return pytest.raises(kind, match=re.escape(text))


@pytest.fixture
def frf() -> FRF:
    """Four lines, three responses, two references; every value tells where it stands."""
    line, row, column = np.meshgrid(range(4), range(3), range(2), indexing="ij")
    values = (100 * (line + 1) + 10 * (row + 1) + column + 1) * (1 + 2j)
    return FRF(
        FREQ,
        values,
        ["1:X", "2:-Y", "3:RZ"],
        ["1:X", "9:Z"],
        "receptance",
        coherence=np.full(values.shape, 0.9),
        variance=np.abs(values) ** 2 * 1e-4,
        averages=8,
        geometry=Geometry([1, 2, 3, 9], np.arange(12.0).reshape(4, 3), [[1, 2]]),
        source="bench",
    )


def one(freq, values, quantity="receptance", **more) -> FRF:
    return FRF(freq, np.reshape(values, (-1, 1, 1)), ["1:X"], ["1:X"], quantity, **more)


# -- quantity ----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("quantity", ["receptance", "mobility", "accelerance"])
def test_known_quantities(quantity):
    assert check_quantity(quantity) == quantity


@pytest.mark.parametrize(
    ("quantity", "partner"),
    [
        ("dynamic stiffness", "receptance"),
        ("Dynamic_Stiffness", "receptance"),
        ("impedance", "mobility"),
        ("apparent-mass", "accelerance"),
    ],
)
def test_inverses_are_refused_with_the_reason(quantity, partner):
    with raises(f"quantity {quantity!r} is a force over a motion. One measured element") as caught:
        check_quantity(quantity)
    assert f"the inverse of one {partner} (all other DOFs would have to be held)" in str(
        caught.value
    )


@pytest.mark.parametrize(
    ("quantity", "text"),
    [
        ("Mobility", "quantity 'Mobility': did you mean 'mobility'?"),
        ("acelerance", "quantity 'acelerance': did you mean 'accelerance' or 'receptance'?"),
        ("volts", "quantity 'volts': valid: 'receptance', 'mobility', 'accelerance'"),
        (None, "quantity None: valid: 'receptance', 'mobility', 'accelerance'"),
    ],
)
def test_unknown_quantities_name_the_nearest(quantity, text):
    with raises(text):
        check_quantity(quantity)
    with raises(text):
        one([1.0], [1.0], quantity)


def test_the_quantity_has_no_default():
    with pytest.raises(TypeError, match="quantity"):
        FRF([1.0], [[[1.0]]], ["1:X"], ["1:X"])


# -- what is held ------------------------------------------------------------------------------------------
def test_what_is_held(frf):
    assert frf.freq.tolist() == FREQ.tolist()
    assert frf.values[2, 1, 0] == 321 * (1 + 2j)
    assert frf.responses == DofSet(["1:X", "2:-Y", "3:RZ"])
    assert frf.references == DofSet(["1:X", "9:Z"])
    assert (frf.quantity, frf.averages, frf.source) == ("receptance", 8, "bench")
    assert repr(frf) == "FRF(receptance, 4 lines 1-7 Hz, 3 responses x 2 references)"


def test_real_and_single_precision_values_become_complex_double():
    assert one([1], [1]).values.dtype == np.complex128
    held = one(np.array([1], dtype=np.float32), np.array([1 + 1j], dtype=np.complex64))
    assert held.values.dtype == np.complex128
    assert held.freq.dtype == np.float64


@pytest.mark.parametrize(
    ("freq", "text"),
    [
        ([], "freq: expected at least one line in one dimension, found shape (0,)"),
        (5.0, "freq: expected at least one line in one dimension, found shape ()"),
        ([[1.0]], "found shape (1, 1)"),
        ([1.0, np.nan], "freq: line 2 is not finite"),
        ([-1.0, 2.0], "freq: the first line is -1 Hz; expected 0 or above"),
        ([1.0, 2.0, 2.0], "freq: lines must increase; line 3 (2 Hz) does not exceed line 2 (2 Hz)"),
        ([3.0, 2.0], "line 2 (2 Hz) does not exceed line 1 (3 Hz)"),
        (["1"], "freq: expected real numbers, found <U1"),
        (np.array([1j]), "freq: expected real numbers, found complex128"),
        ([True], "freq: expected real numbers, found bool"),
    ],
)
def test_freq_is_checked(freq, text):
    with raises(text):
        FRF(freq, np.ones((1, 1, 1)), ["1:X"], ["1:X"], "mobility")


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (
            {"values": np.ones((4, 2, 3))},
            "values: expected shape (lines, responses, references) = (4, 3, 2), found (4, 2, 3)",
        ),
        ({"values": [[1], [1, 2]]}, "values: not an array of numbers"),
        (
            {"values": np.full((4, 3, 2), "1")},
            "values: expected complex or real numbers, found <U1",
        ),
        (
            {"values": np.ma.masked_greater(np.arange(24.0).reshape(4, 3, 2), 20)},
            "values: holds masked values",
        ),
        (
            {"coherence": np.ones((4, 3))},
            "coherence: expected shape (lines, responses, references) = (4, 3, 2), found (4, 3)",
        ),
        (
            {"coherence": np.full((4, 3, 2), 1.1)},
            "coherence at 1 Hz, response 1:X, reference 1:X is 1.1; expected 0 to 1",
        ),
        ({"variance": np.full((4, 3, 2), 1j)}, "variance: expected real numbers, found complex128"),
        ({"responses": []}, "responses: expected at least one DOF, found none"),
        ({"references": []}, "references: expected at least one DOF, found none"),
        ({"averages": 0}, "averages 0: expected a whole number of at least 1"),
        ({"averages": 2.5}, "averages 2.5: expected a whole number"),
        ({"averages": True}, "averages True: expected a whole number"),
        ({"geometry": "bench"}, "geometry: expected a Geometry, found str"),
    ],
)
def test_data_are_checked(frf, change, text):
    with raises(text):
        dataclasses.replace(frf, **change)


@pytest.mark.parametrize("bad", [np.nan, np.inf, complex(0, np.nan)])
def test_a_number_that_is_not_finite_is_located(frf, bad):
    values = frf.values.copy()
    values[1, 2, 1] = bad
    with raises("values at 2.5 Hz, response 3:RZ, reference 9:Z is not finite"):
        dataclasses.replace(frf, values=values)


def test_a_bound_that_is_broken_is_located(frf):
    variance = frf.variance.copy()
    variance[3, 1, 0] = -2.0
    with raises("variance at 7 Hz, response 2:-Y, reference 1:X is -2; expected 0 to inf"):
        dataclasses.replace(frf, variance=variance)


def test_a_dof_that_stands_twice(frf):
    with raises("DOF 1:X occurs twice: at positions 1 and 2", DofError):
        dataclasses.replace(frf, responses=["1:X", "1:-X", "2:Y"])


# -- immutable ---------------------------------------------------------------------------------------------
def test_nothing_can_be_changed(frf):
    with pytest.raises(dataclasses.FrozenInstanceError):
        frf.quantity = "mobility"
    for name in ("freq", "values", "coherence", "variance"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(frf, name)[0] = 1.0


def test_the_arrays_given_are_copied():
    values = np.ones((1, 1, 1), dtype=complex)
    freq = np.array([1.0])
    held = FRF(freq, values, ["1:X"], ["1:X"], "mobility")
    values[:] = 5
    freq[:] = 5
    assert held.values[0, 0, 0] == 1
    assert held.freq[0] == 1


def same(a: FRF, b: FRF) -> bool:
    for name in ("freq", "values", "coherence", "variance"):
        x, y = getattr(a, name), getattr(b, name)
        if (x is None) != (y is None) or (x is not None and not np.array_equal(x, y)):
            return False
    return (a.responses, a.references, a.quantity, a.averages, a.source) == (
        b.responses,
        b.references,
        b.quantity,
        b.averages,
        b.source,
    )


@pytest.mark.parametrize("through", [lambda f: pickle.loads(pickle.dumps(f)), copy.deepcopy])  # noqa: S301
def test_copies_are_equal_and_read_only(frf, through):
    other = through(frf)
    assert same(other, frf)
    assert other.geometry.nodes.tolist() == [1, 2, 3, 9]
    for name in ("freq", "values", "coherence", "variance"):
        assert not getattr(other, name).flags.writeable


# -- conversion --------------------------------------------------------------------------------------------
def oscillator(quantity: str, m=2.0, c=3.0, k=5e3) -> np.ndarray:
    """Motion over force of one mass on a spring and a dashpot, from its equation of motion in each quantity."""
    w = 2 * np.pi * FREQ
    return {
        "receptance": 1 / (k - w**2 * m + 1j * w * c),
        "mobility": 1 / (k / (1j * w) + 1j * w * m + c),
        "accelerance": 1 / (m - k / w**2 + c / (1j * w)),
    }[quantity]


@pytest.mark.parametrize("start", ["receptance", "mobility", "accelerance"])
@pytest.mark.parametrize("end", ["receptance", "mobility", "accelerance"])
def test_conversion_against_the_oscillator(start, end):
    got = one(FREQ, oscillator(start), start).converted(end)
    assert got.quantity == end
    np.testing.assert_allclose(got.values[:, 0, 0], oscillator(end), rtol=1e-13)


def test_accelerance_of_a_real_receptance_is_minus_omega_squared_exactly():
    got = one([3.0], [2.0]).converted("accelerance").values[0, 0, 0]
    assert got.real == pytest.approx(-2.0 * (2 * np.pi * 3.0) ** 2, rel=1e-15)
    assert got.imag == 0.0


@pytest.mark.parametrize(("quantity", "power"), [("mobility", 2), ("accelerance", 4)])
def test_variance_goes_with_the_square_of_the_factor(frf, quantity, power):
    got = frf.converted(quantity)
    w = (2 * np.pi * FREQ)[:, None, None]
    np.testing.assert_allclose(got.variance, frf.variance * w**power, rtol=1e-14)
    np.testing.assert_allclose(got.variance / np.abs(got.values) ** 2, 1e-4, rtol=1e-13)
    assert np.array_equal(got.coherence, frf.coherence)
    assert got.averages == 8
    assert got.geometry is frf.geometry


def test_conversion_to_itself_changes_nothing(frf):
    assert frf.converted("receptance") is frf
    static = one([0.0, 1.0], [1.0, 2.0])
    assert static.converted("receptance") is static


@pytest.mark.parametrize(
    ("start", "end"),
    [("receptance", "mobility"), ("accelerance", "receptance"), ("mobility", "accelerance")],
)
def test_the_0_hz_line_is_refused(start, end):
    with raises(f"the 0 Hz line cannot be converted from {start} to {end}") as caught:
        one([0.0, 0.5], [1.0, 1.0], start).converted(end)
    assert "a band that starts at 0.5 Hz" in str(caught.value)
    with raises("a band that starts at a positive frequency"):
        one([0.0], [1.0], start).converted(end)


# -- selection ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("band", "lines"),
    [
        ((1.0, 7.0), [1.0, 2.5, 4.0, 7.0]),
        ((2.5, 4.0), [2.5, 4.0]),
        ((2.6, 6.9), [4.0]),
        ((0, 1e9), [1.0, 2.5, 4.0, 7.0]),
        ((0, 1), [1.0]),
        ([2.5, np.inf], [2.5, 4.0, 7.0]),
    ],
)
def test_band_includes_its_edges(frf, band, lines):
    got = frf.select(band=band)
    assert got.freq.tolist() == lines
    at = np.isin(FREQ, lines)
    for name in ("values", "coherence", "variance"):
        assert np.array_equal(getattr(got, name), getattr(frf, name)[at])


@pytest.mark.parametrize(
    ("band", "text"),
    [
        ((3.0, 3.5), "band 3 to 3.5 Hz holds no line; the data run 1 to 7 Hz"),
        ((4.0, 2.0), "band 4 to 2 Hz: the first must be below the second"),
        ((4.0, 4.0), "band 4 to 4 Hz: the first must be below the second"),
        ((np.nan, 4.0), "the first must be below the second"),
        ((1.0,), "band (1.0,): expected two frequencies in Hz, lowest and highest"),
        (5.0, "band 5.0: expected two frequencies in Hz"),
        (("1", 2), "band: expected real numbers, found <U"),
    ],
)
def test_band_is_checked(frf, band, text):
    with raises(text):
        frf.select(band=band)


def test_lines_are_found_in_any_order_and_kept_ascending(frf):
    got = frf.select(lines=[7.0, 1.0])
    assert got.freq.tolist() == [1.0, 7.0]
    assert got.values[:, 0, 0].tolist() == [111 * (1 + 2j), 411 * (1 + 2j)]
    assert frf.select(lines=2.5).freq.tolist() == [2.5]
    assert frf.find_lines([4.0, 2.5]).tolist() == [1, 2]


def test_lines_match_to_rounding_and_come_back_as_the_data_have_them(frf):
    assert frf.select(lines=[2.5 * (1 + 5e-10)]).freq.tolist() == [2.5]
    assert frf.select(lines=[2.5 * (1 - 5e-10)]).freq.tolist() == [2.5]
    with raises(
        "line 2.50000001 Hz is not in the data (1 such); nearest: 2.5 and 4 Hz. Lines are not"
        " interpolated"
    ):
        frf.select(lines=[2.5 * (1 + 4e-9)])


@pytest.mark.parametrize(
    ("lines", "text"),
    [
        ([3.0, 2.5, 5.0], "line 3 Hz is not in the data (2 such); nearest: 2.5 and 4 Hz"),
        ([0.5], "line 0.5 Hz is not in the data (1 such); nearest: 1 and 2.5 Hz"),
        ([9.0], "line 9 Hz is not in the data (1 such); nearest: 4 and 7 Hz"),
        ([2.5, 2.5], "line 2.5 Hz is named twice"),
        ([], "lines: expected at least one finite frequency in Hz"),
        ([np.nan], "lines: expected at least one finite frequency in Hz"),
        ([[1.0, 2.5]], "in one dimension"),
        (["2.5"], "lines: expected real numbers, found <U3"),
        ([True], "lines: expected real numbers, found bool"),
    ],
)
def test_lines_are_checked(frf, lines, text):
    with raises(text):
        frf.select(lines=lines)


def test_the_static_line_and_a_single_line_are_found():
    assert one([0.0, 1.0], [1.0, 2.0]).find_lines([0.0]).tolist() == [0]
    assert one([3.0], [1.0]).find_lines([3.0]).tolist() == [0]
    with raises("nearest: 0 and 1 Hz"):
        one([0.0, 1.0], [1.0, 2.0]).find_lines([1e-12])
    with raises("line 4 Hz is not in the data"):
        one([3.0], [1.0]).find_lines([4.0])


def test_a_line_outside_the_band_is_an_error(frf):
    assert frf.select(band=(2, 5), lines=[4.0]).freq.tolist() == [4.0]
    with raises("line 1 Hz lies outside the band 2 to 5 Hz (2 such)"):
        frf.select(band=(2, 5), lines=[4.0, 7.0, 1.0])


def test_excluded_bands_are_left_out_with_both_ends(frf):
    whole = frf.freq.tolist()
    got = frf.select(band=(2, 6), exclude=[(3.5, 4.0)])
    assert got.freq.tolist() == [f for f in whole if 2 <= f <= 6 and f != 4.0]
    np.testing.assert_array_equal(got.values, frf.values[np.isin(frf.freq, got.freq)])


@pytest.mark.parametrize(
    ("exclude", "text"),
    [
        ((4.2, 4.4), "exclude: 4.2 to 4.4 Hz holds no line that is used; the nearest is at 4 Hz"),
        ((0.5, 9.0), "exclude: without 0.5 to 9 Hz no line remains"),
        ((4.0, 2.0), "band 4 to 2 Hz: the first must be below the second"),
    ],
)
def test_excluded_bands_are_checked(frf, exclude, text):
    with raises(text) as caught:
        frf.select(exclude=[exclude])
    assert caught.value.key[0] == "exclude"


def test_an_excluded_line_cannot_be_asked_for(frf):
    with raises("line 4 Hz is excluded"):
        frf.select(exclude=[(3.9, 4.1)], lines=[4.0])
    with raises("line 4 Hz lies outside the band 2 to 5 Hz, or is excluded"):
        frf.select(band=(2, 5), exclude=[(3.9, 4.1)], lines=[4.0])


def test_dofs_come_in_the_order_asked_for(frf):
    got = frf.select(responses=["3:RZ", "1:X"], references=["9:Z"])
    assert got.responses.labels == ["3:RZ", "1:X"]
    assert got.references.labels == ["9:Z"]
    assert got.values[0, :, 0].tolist() == [132 * (1 + 2j), 112 * (1 + 2j)]
    assert np.array_equal(got.variance, frf.variance[:, [2, 0]][:, :, [1]])


@pytest.mark.parametrize(
    ("response", "reference", "sign"),
    [("2:-Y", "9:Z", 1), ("2:Y", "9:Z", -1), ("2:-Y", "9:-Z", -1), ("2:Y", "9:-Z", 1)],
)
def test_the_opposite_sign_turns_the_values(frf, response, reference, sign):
    got = frf.select(responses=[response], references=[reference])
    assert got.responses.labels == [response]
    assert got.references.labels == [reference]
    assert np.array_equal(got.values[:, 0, 0], sign * frf.values[:, 1, 1])
    assert np.array_equal(got.variance[:, 0, 0], frf.variance[:, 1, 1])
    assert np.array_equal(got.coherence[:, 0, 0], frf.coherence[:, 1, 1])


@pytest.mark.parametrize(
    ("asked", "kind", "text"),
    [
        (
            {"responses": ["1:Y"]},
            DofError,
            "response 1:Y is not among the 3 DOFs; nearest: 1:X, 2:-Y, 3:RZ",
        ),
        (
            {"references": ["2:X"]},
            DofError,
            "reference 2:X is not among the 2 DOFs; nearest: 1:X, 9:Z",
        ),
        ({"responses": "1:X"}, DofError, "DOFs '1:X': expected a list of labels, found one text"),
        ({"responses": []}, DataError, "responses: expected at least one DOF, found none"),
    ],
)
def test_dofs_asked_for_have_to_be_there(frf, asked, kind, text):
    with raises(text, kind):
        frf.select(**asked)


def test_selecting_nothing_in_particular_keeps_all(frf):
    got = frf.select()
    assert same(got, frf)
    assert got.geometry is frf.geometry


# -- xarray ------------------------------------------------------------------------------------------------
def test_the_dataset_says_what_it_is(frf):
    data = frf.to_xarray()
    assert data["frf"].dims == ("freq", "response", "reference")
    assert data["freq"].attrs["units"] == "Hz"
    assert data.attrs == {"quantity": "receptance", "source": "bench", "averages": 8}
    assert complex(data["frf"].sel(freq=4.0, response="2:-Y", reference="9:Z")) == 322 * (1 + 2j)
    assert data["xyz"].sel(node=9).values.tolist() == [9.0, 10.0, 11.0]
    assert set(one([1.0], [1.0]).to_xarray().variables) == {"frf", "freq", "response", "reference"}


def test_there_and_back(frf):
    back = FRF.from_xarray(frf.to_xarray())
    assert same(back, frf)
    assert np.array_equal(back.geometry.xyz, frf.geometry.xyz)
    assert np.array_equal(back.geometry.lines, frf.geometry.lines)
    assert back.geometry.axes is None
    bare = one([1.0, 2.0], [1j, 2.0], "accelerance")
    assert same(FRF.from_xarray(bare.to_xarray()), bare)
    assert FRF.from_xarray(bare.to_xarray()).geometry is None


def test_displacement_directions_go_there_and_back(frf):
    axes = np.array([np.eye(3)[[1, 2, 0]]] * 4)
    geometry = Geometry(frf.geometry.nodes, frf.geometry.xyz, axes=axes)
    back = FRF.from_xarray(dataclasses.replace(frf, geometry=geometry).to_xarray())
    assert np.array_equal(back.geometry.axes, axes)


def test_dimensions_come_in_any_order(frf):
    data = frf.to_xarray().transpose("axis", "reference", "freq", "node", "response", ...)
    back = FRF.from_xarray(data)
    assert same(back, frf)
    assert np.array_equal(back.geometry.xyz, frf.geometry.xyz)


def test_a_dataset_that_does_not_say_what_it_measured(frf):
    data = frf.to_xarray()
    del data.attrs["quantity"]
    with raises(
        "the dataset does not say what it measured: give quantity='receptance', 'mobility',"
        " 'accelerance' or 'transmissibility'"
    ):
        FRF.from_xarray(data)
    assert FRF.from_xarray(data, quantity="mobility").quantity == "mobility"


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("averages", 2.7, "averages 2.7: expected a whole number"),
        ("averages", "many", "averages 'many': expected a whole number"),
        ("decay", "slow", "decay 'slow': expected a number in 1/s"),
    ],
)
def test_an_attribute_of_a_dataset_is_not_coerced(frf, name, value, message):
    data = frf.to_xarray()
    data.attrs[name] = value
    with pytest.raises(DataError, match=message):
        FRF.from_xarray(data)
    for three in (np.int64(3), np.array(3), np.array([3.0])):
        data.attrs[name] = three
        assert getattr(FRF.from_xarray(data), name) == 3


@pytest.mark.parametrize("channels", [[["1:X"]], [5], (slice(None), [None])])
def test_what_is_no_label_chooses_no_channel(frf, channels):
    with pytest.raises(DofError, match=r"expected labels or patterns, found .* among them"):
        frf[channels]


def test_a_contradiction_is_an_error(frf):
    with raises("quantity 'mobility' contradicts the dataset, which states 'receptance'"):
        FRF.from_xarray(frf.to_xarray(), quantity="mobility")
    assert FRF.from_xarray(frf.to_xarray(), quantity="receptance").quantity == "receptance"


def test_a_dataset_without_its_parts(frf):
    with raises("dataset: no variable 'frf'; did you mean 'frff'?"):
        FRF.from_xarray(frf.to_xarray().rename(frf="frff"))
    with raises(
        "dataset: 'frf' has dimensions ('freq', 'response'); expected ('freq', 'response',"
        " 'reference')"
    ):
        FRF.from_xarray(frf.to_xarray().assign(frf=(("freq", "response"), np.ones((4, 3)))))
    data = frf.to_xarray()
    data["freq"].attrs["units"] = "rad/s"
    with raises("dataset: freq is in 'rad/s'; expected 'Hz'"):
        FRF.from_xarray(data)


@pytest.mark.parametrize("above", [np.float32(1 + 1e-7), np.float32(1) + 2 * np.float32(2**-23)])
def test_coherence_that_rounding_puts_above_1_is_1(above: np.float32) -> None:
    assert above > 1.0
    coherence = np.array([[[0.5]], [[above]], [[0.0]]], dtype=np.float32)
    frf = FRF([1.0, 2.0, 3.0], np.ones((3, 1, 1)), ["1:X"], ["1:X"], "mobility", coherence)
    assert frf.coherence is not None
    assert frf.coherence.ravel().tolist() == [0.5, 1.0, 0.0]
    assert not frf.coherence.flags.writeable
    assert coherence[1, 0, 0] == above  # what was given stays as it is


@pytest.mark.parametrize("value", [1.0 + 3e-7, np.float32(1 + 1e-6), -1e-7])
def test_coherence_further_off_is_refused(value: float) -> None:
    with pytest.raises(DataError, match=r"coherence at 1 Hz.*expected 0 to 1"):
        FRF([1.0], np.ones((1, 1, 1)), ["1:X"], ["1:X"], "mobility", [[[value]]])
