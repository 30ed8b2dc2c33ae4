"""Functions of universal files: every data case, what they are called, units, senses, duplicates."""

import re

import numpy as np
import pytest

import uff_samples as uff
import updyn
from updyn.errors import FormatError, OptionError, UpdynWarning

Y = np.array([1.5 - 2j, -0.25 + 1e-3j, 3e4 + 7j, -1e-6 - 1j / 3])
X = np.array([1.0, 1.25, 40.0, 1000.5])


@pytest.fixture
def path(tmp_path):
    return tmp_path / "case.uff"


def read(path, *parts, **options):
    path.write_bytes(b"".join(parts))
    return updyn.read_frf(path, **options)


# -- the data cases of the format ------------------------------------------------------------------------
@pytest.mark.parametrize("x", [None, X])
@pytest.mark.parametrize(("ordinate", "rtol"), [(5, 5e-6), (6, 1e-12)])
def test_text(path, ordinate, rtol, x):
    found = read(path, uff.ascii58(Y, ordinate=ordinate, x=x))
    np.testing.assert_allclose(found.values[:, 0, 0], Y, rtol=rtol)
    np.testing.assert_array_equal(found.freq, [1.0, 1.5, 2.0, 2.5] if x is None else X)
    assert (found.quantity, found.responses.labels, found.references.labels) == (
        "accelerance",
        ["1:Z"],
        ["1:Z"],
    )


@pytest.mark.parametrize("x", [None, X])
@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize(("ordinate", "kind"), [(5, np.complex64), (6, np.complex128)])
def test_binary(path, ordinate, kind, big, x):
    found = read(path, uff.binary58(Y, ordinate=ordinate, big=big, x=x))
    np.testing.assert_array_equal(found.values[:, 0, 0], Y.astype(kind))
    np.testing.assert_array_equal(found.freq, [1.0, 1.5, 2.0, 2.5] if x is None else X)


@pytest.mark.parametrize("x", [None, X])
@pytest.mark.parametrize("ordinate", [2, 4])
@pytest.mark.parametrize("write", [uff.ascii58, uff.binary58])
@pytest.mark.parametrize("y", [Y.real, abs(Y), 20 * np.log10(abs(Y))])
def test_real_ordinates_are_refused_unless_they_are_stated_to_be_frfs(path, write, ordinate, x, y):
    data = write(y, ordinate=ordinate, x=x)
    with pytest.raises(FormatError, match=r"uff:2: holds real ordinates.*set real_valued=True"):
        read(path, data)
    found = read(path, data, real_valued=True)
    np.testing.assert_allclose(found.values[:, 0, 0], y, rtol=5e-6)
    assert not found.values.imag.any()


def test_values_that_are_stated_to_be_real_have_no_imaginary_part(path):
    with pytest.raises(FormatError, match=r"uff:2: .*imaginary part, which contradicts"):
        read(path, uff.ascii58(Y), real_valued=True)
    found = read(path, uff.ascii58(Y.real + 0j), real_valued=True)
    np.testing.assert_allclose(found.values[:, 0, 0], Y.real, rtol=5e-6)


def test_other_real_functions_may_be_there(path):
    """A coherence and time responses are real."""
    gamma = uff.ascii58(np.full(4, 0.5), kind=6, types=(18, 0, 0))
    assert read(path, uff.ascii58(Y), gamma).coherence is not None


def test_a_line_at_0_hz_is_kept(path):
    found = read(path, uff.ascii58(Y, start=0.0, step=2.0))
    np.testing.assert_array_equal(found.freq, [0.0, 2.0, 4.0, 6.0])


# -- deviations that real files have ------------------------------------------------------------------------
GOOD = uff.ascii58(Y)


@pytest.mark.parametrize(
    "data",
    [
        GOOD.replace(b"\n", b"\r\n"),
        b"\n".join(line.ljust(80) for line in GOOD.split(b"\n")),
        GOOD.rstrip(b"\n"),
        b"\n\n" + GOOD + b"\n  \n\x1a",
        GOOD.replace(b"E+", b"D+").replace(b"E-", b"d-"),
        uff.text(9999, f"{1:10d}{-1:10d}", "text")
        + GOOD,  # a line that ends in what looks like a delimiter
        uff.text(
            58, *uff.records(), *(f"{v:14.5E}" for v in uff.flat(Y))
        ),  # wider fields, one a line
        uff.text(58, *uff.records(), " ".join(f"{v:.6e}" for v in uff.flat(Y))),
    ],
)
def test_forms_of_text(path, data):
    np.testing.assert_allclose(read(path, data).values[:, 0, 0], Y, rtol=5e-6)


def test_exponents_of_three_digits_without_a_letter(path):
    y = np.array([1.5 - 2j, 1e-120 - 1e120j, 2e-101 + 3e100j, 1.0])
    for ordinate in (5, 6):
        lines = uff.numbers(uff.flat(y), ordinate, 1)
        lines = [re.sub(r"(-?[0-9.]+)E([+-][0-9]{3})", r" \1\2", line) for line in lines]
        data = uff.text(58, *uff.records(ordinate=ordinate), *lines)
        assert b"E-1" not in data
        assert b"0-120" in data
        np.testing.assert_allclose(read(path, data).values[:, 0, 0], y)


def test_numbers_that_touch(path):
    y = np.array([-1e-100 - 2e-100j, -3e-100 - 4e-100j])
    data = uff.ascii58(y, points=2)
    assert b"E-100-2.0" in data
    np.testing.assert_allclose(read(path, data).values[:, 0, 0], y)


def test_forms_of_binary(path):
    for end in (
        b"    -1\n",
        b"\n    -1\n",
        b"\r\n    -1\r\n",
        b"    -1",
        b"    -1" + b" " * 74 + b"\n",
    ):
        np.testing.assert_array_equal(read(path, uff.binary58(Y, end=end)).values[:, 0, 0], Y)
    points_only = uff.binary58(Y, n_bytes=8 * len(Y))  # as pyuff counts
    np.testing.assert_array_equal(read(path, points_only).values[:, 0, 0], Y)


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("y", [Y, Y.real])
def test_an_abscissa_in_single_precision(path, y, big):
    """The form of the format: E13.5 before E20.12 in text, so single before double in binary."""
    order = ">" if big else "<"
    row = np.dtype([("x", order + "f4"), ("y", order + ("c16" if y.dtype.kind == "c" else "f8"))])
    data = np.zeros(4, row)
    data["x"], data["y"] = X, y
    raw = uff.binary58(y, x=X, big=big, n_bytes=data.nbytes)
    double = uff.flat(y, X).astype(order + "f8").tobytes()
    assert raw.count(double) == 1
    found = read(path, raw.replace(double, data.tobytes()), real_valued=y.dtype.kind == "f")
    np.testing.assert_array_equal(found.values[:, 0, 0], y)
    np.testing.assert_array_equal(found.freq, X)


@pytest.mark.parametrize("ordinate", [5, 6])
@pytest.mark.parametrize("big", [False, True])
def test_a_wrong_byte_order_is_refused(path, ordinate, big):
    rng = np.random.default_rng(3)
    y = rng.standard_normal(64) + 1j * rng.standard_normal(64)
    data = uff.binary58(y, ordinate=ordinate, big=big)
    head, wrong = (f"58b{n:6d}".encode() for n in ((2, 1) if big else (1, 2)))
    with pytest.raises(FormatError, match=r"uff:2: 58b: magnitudes from .* byte order .* is wrong"):
        read(path, data.replace(head, wrong))


def test_bytes_that_look_like_a_delimiter(path):
    y = np.frombuffer(b"    -1\n    58\n    -1\n\n    -1\n    -1\n" * 4, dtype="<c16", count=8)
    found = read(path, uff.binary58(y), uff.binary58(Y[:1].repeat(8), (9, 1)))
    np.testing.assert_array_equal(found.values[:, 0, 0], y)
    np.testing.assert_array_equal(found.values[:, 1, 0], Y[0])


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
@pytest.mark.parametrize("name", ["Gehäuse", "Träger üäö"])
@pytest.mark.parametrize("padded", ["characters", "bytes"])
def test_names_that_are_not_ascii(path, encoding, name, padded):
    lines = uff.records((12, -3), (7, 1), title="Prüfstand", units=("Hz", "m/s²", "NONE"))
    raw = [line.encode(encoding) for line in lines]
    field = (
        name.ljust(10)[:10].encode(encoding)
        if padded == "characters"
        else name.encode(encoding)[:10].ljust(10)
    )
    if padded == "bytes" and encoding == "utf-8":
        field = name.encode(encoding).decode(encoding)[:6].encode(encoding).ljust(10)
    raw[5] = raw[5].replace(b" NONE      ", b" " + field, 1)
    data = b"\n".join(
        [b"    -1", b"    58", *raw, *(s.encode() for s in uff.numbers(uff.flat(Y), 5, 1)), uff.END]
    )
    found = read(path, data)
    assert (found.responses.labels, found.references.labels) == (["12:-Z"], ["7:X"])
    assert "Prüfstand" in found.source


# -- what they are -------------------------------------------------------------------------------------------
@pytest.mark.parametrize("below", [9, 13])
@pytest.mark.parametrize(
    ("above", "quantity"), [(8, "receptance"), (11, "mobility"), (12, "accelerance")]
)
def test_quantity_follows_from_the_data_types(path, above, below, quantity):
    data = uff.ascii58(Y, types=(18, above, below))
    assert read(path, data).quantity == quantity
    assert read(path, data, quantity=quantity).quantity == quantity
    with pytest.raises(FormatError, match=f"contradicts the file, which states '{quantity}'"):
        read(path, data, quantity="receptance" if above != 8 else "mobility")


@pytest.mark.parametrize("types", [(18, 0, 0), (18, 1, 13), (18, 12, 0), (0, 0, 13)])
def test_quantity_that_the_file_does_not_say_has_to_be_given(path, types):
    data = uff.ascii58(Y, types=types)
    with pytest.raises(
        FormatError, match=r"case.uff:11: records 9 and 10 do not define .* give quantity="
    ):
        read(path, data)
    assert read(path, data, quantity="accelerance").quantity == "accelerance"


def test_half_a_word_of_the_file_can_be_contradicted_too(path):
    both = [uff.ascii58(Y, types=(18, 0, 0)), uff.ascii58(Y, (2, 3), types=(18, 12, 13))]
    assert read(path, *both, quantity="accelerance").quantity == "accelerance"
    with pytest.raises(FormatError, match="contradicts"):
        read(path, *both, quantity="mobility")


@pytest.mark.parametrize("code", [1, 2, 3, 4, 5, 6])
@pytest.mark.parametrize("sign", [1, -1])
def test_direction_codes(path, code, sign):
    found = read(path, uff.ascii58(Y, (5, sign * code), (8, -sign * code)))
    direction = ("X", "Y", "Z", "RX", "RY", "RZ")[code - 1]
    minus = {1: "", -1: "-"}
    assert found.responses.labels == [f"5:{minus[sign]}{direction}"]
    assert found.references.labels == [f"8:{minus[-sign]}{direction}"]


@pytest.mark.parametrize("direction", ["Z", "-Z", "+RX"])
def test_scalars_take_the_direction_given(path, direction):
    found = read(path, uff.ascii58(Y, (5, 0), (8, 2)), scalar_direction=direction)
    assert found.responses.labels == [f"5:{direction.lstrip('+')}"]
    assert found.references.labels == ["8:Y"]


@pytest.mark.parametrize(
    "option",
    [
        {"scalar_direction": "W"},
        {"duplicates": "first"},
        {"scale": 0.0},
        {"scale": "g"},
        {"real_valued": "yes"},
    ],
)
def test_options_are_checked(path, option):
    with pytest.raises(OptionError, match=next(iter(option))):
        read(path, GOOD, **option)


def test_an_unknown_option_names_the_nearest(path):
    with pytest.raises(
        OptionError, match="no option 'scalar_directions'; did you mean 'scalar_direction'"
    ):
        read(path, GOOD, scalar_directions="Z")


def test_other_functions_are_left_out_with_a_warning_that_counts_them(path):
    extra = [
        uff.ascii58(Y.real, kind=1, types=(17, 12, 0)),
        uff.ascii58(Y.real, kind=2),
        uff.ascii58(Y.real, kind=2),
    ]
    with pytest.warns(
        UpdynWarning, match=r"ignored: 1 time response, 2 auto spectrum \(first: line 2\)"
    ):
        found = read(path, extra[0], GOOD, *extra[1:])
    assert found.values.shape == (4, 1, 1)


def test_datasets_of_other_numbers_are_named_in_the_source(path):
    found = read(path, uff.text(151, "model"), uff.text(2467, "x"), uff.text(2467, "y"), GOOD)
    assert found.source == "case.uff, case; ignored: dataset 151, dataset 2467 (2 times)"


# -- the matrix ----------------------------------------------------------------------------------------------
def grid(scale=1.0):
    """Responses 1:Z, 2:X by references 1:Z, 4:-Y, each distinct."""
    dofs = [((1, 3), (1, 3)), ((2, 1), (1, 3)), ((1, 3), (4, -2)), ((2, 1), (4, -2))]
    return [uff.binary58(scale * (k + 1) * Y, *pair) for k, pair in enumerate(dofs)]


def test_a_matrix_in_the_order_of_the_file(path):
    found = read(path, *grid())
    assert (found.responses.labels, found.references.labels) == (["1:Z", "2:X"], ["1:Z", "4:-Y"])
    np.testing.assert_array_equal(found.values, np.array([[1, 3], [2, 4]]) * Y[:, None, None])


def test_a_part_can_be_read_alone_with_the_sense_asked_for(path):
    parts = grid()[:3]
    with pytest.raises(
        FormatError, match=r"1 of 4 pairs .* missing: 2:X / 4:-Y. Select a complete part"
    ):
        read(path, *parts)
    found = read(path, *parts, references=["1:-Z"])
    np.testing.assert_array_equal(found.values[:, :, 0], -np.array([1, 2]) * Y[:, None])
    found = read(path, *parts, responses=["1:Z"], references=["4:Y", "1:Z"])
    np.testing.assert_array_equal(found.values[:, 0, :], np.array([-3, 1]) * Y[:, None])
    with pytest.raises(FormatError, match="reference 9:Z is not among the 2 DOFs"):
        read(path, *parts, references=["9:Z"])


def test_opposite_senses_of_one_dof_are_brought_to_the_first(path):
    found = read(path, uff.binary58(Y, (5, -3), (1, 3)), uff.binary58(2 * Y, (5, 3), (2, 3)))
    assert found.responses.labels == ["5:-Z"]
    np.testing.assert_array_equal(found.values[:, 0, :], np.array([1, -2]) * Y[:, None])


def test_coherence_goes_to_its_pair(path):
    gamma = [np.array([0.1, 0.2, 0.3, 0.4]) + k / 10 for k in range(4)]
    dofs = [((1, 3), (1, 3)), ((2, 1), (1, 3)), ((1, 3), (4, -2)), ((2, 1), (4, -2))]
    cohs = [
        uff.binary58(g, *pair, kind=6, types=(18, 0, 0))
        for g, pair in zip(gamma, dofs, strict=True)
    ]
    found = read(path, *reversed(cohs), *grid())
    np.testing.assert_array_equal(found.coherence[:, 1, 0], gamma[1])
    np.testing.assert_array_equal(found.coherence[:, 0, 1], gamma[2])
    with pytest.warns(UpdynWarning, match="only 3 of 4 pairs of DOFs have a coherence"):
        assert read(path, *grid(), *cohs[:3]).coherence is None


def test_duplicates_are_averaged_when_told(path):
    pair = [uff.binary58(Y), uff.binary58(4 * Y)]
    with pytest.raises(
        FormatError,
        match=r"frequency response function at response 1:Z, reference 1:Z occurs twice",
    ):
        read(path, *pair)
    np.testing.assert_allclose(
        read(path, *pair, duplicates="average").values[:, 0, 0], 2.5 * Y, rtol=1e-15
    )


def test_the_average_is_weighted_with_coherence(path):
    first, second = np.array([1.0, 0.5, 0.0, 0.0]), np.array([1.0, 0.25, 0.5, 0.0])
    cohs = [uff.binary58(g, kind=6, types=(18, 0, 0)) for g in (first, second)]
    found = read(path, uff.binary58(Y), uff.binary58(4 * Y), *cohs, duplicates="average")
    np.testing.assert_allclose(
        found.values[:, 0, 0], np.array([2.5, 2.0, 4.0, 2.5]) * Y, rtol=1e-15
    )
    np.testing.assert_array_equal(found.coherence[:, 0, 0], [1.0, 0.375, 0.25, 0.0])


# -- units ---------------------------------------------------------------------------------------------------
INCH, POUND = 39.37007874015748, 0.22480894387096  # of a metre, of a newton


@pytest.mark.parametrize(
    ("response", "reference", "factor"),
    [
        ((1, 3), (1, 3), 0.0254 / 4.4482216),
        ((1, 4), (1, 3), 1 / 4.4482216),
        ((1, 3), (1, 6), 0.0254 / (4.4482216 * 0.0254)),
        ((1, 4), (1, 6), 1 / (4.4482216 * 0.0254)),
    ],
)
def test_units_are_converted_to_si(path, response, reference, factor):
    data = uff.binary58(Y, response, reference)
    found = read(path, uff.units(7, INCH, POUND), data)
    np.testing.assert_allclose(found.values[:, 0, 0], factor * Y, rtol=1e-7)


def test_units_of_mm_and_newton(path):
    """Code 10, which is of later revisions of the format: 1 mm/s^2 per N is 0.001 m/s^2 per N."""
    data = uff.binary58(Y, (1, 3), (1, 3), units=("Hz", "mm/s^2", "N"))
    found = read(path, uff.units(10, 1000.0, 1.0), data)
    np.testing.assert_allclose(found.values[:, 0, 0], 1e-3 * Y, rtol=1e-15)
    with pytest.raises(FormatError, match=r"units code 10 requires factors 1000 .* and 1 \(force"):
        read(path, uff.units(10, 1000.0, 1000.0), data)
