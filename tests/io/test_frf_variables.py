"""FRFs in variables of any name, selected by the user, in .npz, .mat and HDF5 files."""

import h5py
import numpy as np
import pytest
import scipy.io

import updyn
from matlab73 import write_matlab73
from updyn.errors import FormatError, OptionError, UpdynWarning
from updyn.job import load_job
from updyn.job.prepare import read_measurement

LINES = np.array([1.0, 2.5, 4.0])
H = np.arange(1, 7).reshape(3, 2, 1) * (1.0 - 0.5j)
COH = np.linspace(0.5, 1.0, 6).reshape(3, 2, 1)
LABELS = {"response_labels": ["3:Z", "5:-X"], "reference_labels": ["1:Z"]}
TABLE = np.column_stack([LINES, H[:, 0, 0]])


def npz(path, arrays):
    np.savez(path.with_suffix(".npz"), **{k.replace("/", "."): v for k, v in arrays.items()})
    return path.with_suffix(".npz")


def mat(path, arrays):
    nested = {}
    for name, value in arrays.items():
        *groups, last = name.split("/")
        place = nested
        for group in groups:
            place = place.setdefault(group, {})
        place[last] = value
    scipy.io.savemat(path.with_suffix(".mat"), nested)
    return path.with_suffix(".mat")


def hdf5(path, arrays):
    with h5py.File(path.with_suffix(".h5"), "w") as file:
        for name, value in arrays.items():
            file[name] = value
    return path.with_suffix(".h5")


WRITERS = [npz, mat, hdf5]


def check(frf, values=H, coherence=None):
    np.testing.assert_array_equal(frf.freq, LINES)
    np.testing.assert_allclose(frf.values, values, rtol=1e-14)
    assert frf.responses.labels == LABELS["response_labels"][: values.shape[1]]
    assert frf.references.labels == ["1:Z"]
    assert frf.quantity == "mobility"
    if coherence is None:
        assert frf.coherence is None
    else:
        np.testing.assert_array_equal(frf.coherence, coherence)


@pytest.mark.parametrize("write", WRITERS)
def test_names_and_paths(tmp_path, write):
    path = write(tmp_path / "x", {"f0": LINES, "run/H1_2": H, "run/cohe": COH, "other": 1.0})
    variables = {"freq": "f0", "H": "run.H1_2", "coherence": "run.cohe"}
    frf = updyn.read_frf(path, quantity="mobility", variables=variables, **LABELS)
    check(frf, coherence=COH)


@pytest.mark.parametrize("write", WRITERS)
def test_units_in_the_names_of_frequencies(tmp_path, write):
    path = write(tmp_path / "x", {"f_MHz": LINES / 2**20, "omega_rad_s": 6.28 * LINES, "Y": H})
    frf = updyn.read_frf(path, variables={"freq": "f_MHz", "H": "Y"}, quantity="mobility", **LABELS)
    np.testing.assert_allclose(frf.freq, LINES * 1e6 / 2**20, rtol=1e-14)
    variables = {"freq": "omega_rad_s", "H": "Y"}
    with pytest.raises(OptionError, match="'omega_rad_s' may be in rad/s or in Hz"):
        updyn.read_frf(path, variables=variables, quantity="mobility", **LABELS)


@pytest.mark.parametrize("write", WRITERS)
def test_parts_with_units_and_another_order_of_axes(tmp_path, write):
    angle = np.angle(H, deg=True).transpose(1, 0, 2)
    size = 20.0 * np.log10(np.abs(H) / 1e-3).transpose(1, 0, 2)
    path = write(tmp_path / "x", {"w": LINES * 2.0 * np.pi, "level": size, "angle": angle})
    frf = updyn.read_frf(
        path,
        order=["response", "freq", "reference"],
        variables={
            "freq": "w",
            "frequency_unit": "rad/s",
            "magnitude_dB": "level",
            "phase_deg": "angle",
            "unit": "mm/s/N",
        },
        **LABELS,
    )
    np.testing.assert_allclose(frf.freq, LINES, rtol=1e-14)
    np.testing.assert_allclose(frf.values, H, rtol=1e-13)
    assert frf.quantity == "mobility"


@pytest.mark.parametrize("write", WRITERS)
def test_a_table_of_frequency_and_values(tmp_path, write):
    path = write(tmp_path / "x", {"data": TABLE})
    frf = updyn.read_frf(
        path,
        quantity="mobility",
        response_labels=["3:Z"],
        reference_labels=["1:Z"],
        variables={"freq": "data(:,1)", "H": "data(:,2)"},
    )
    check(frf, H[:, :1])


@pytest.mark.parametrize("write", WRITERS)
def test_channels(tmp_path, write):
    other = np.column_stack([LINES, H[:, 1, 0].real, H[:, 1, 0].imag, COH[:, 1, 0]])
    path = write(tmp_path / "x", {"p/a": TABLE, "p/b": other, "c": COH[:, 0, 0]})
    channels = [
        {"response": "3:Z", "reference": "1:Z", "complex": "p.a(:,2)", "coherence": "c"},
        {
            "response": "5:-X",
            "reference": "1:Z",
            "real": "p.b(:,2)",
            "imaginary": "p.b( :, 3)",
            "coherence": "p.b(:,4)",
        },
    ]
    variables = {"freq": "p.a(:,1)", "channels": channels}
    check(updyn.read_frf(path, quantity="mobility", variables=variables), coherence=COH)


def test_a_file_of_one_struct_by_fields_and_by_paths(tmp_path):
    path = mat(tmp_path / "x", {"DPsv/f": LINES, "DPsv/H1_2": H})
    for before in ("", "DPsv."):
        variables = {"freq": f"{before}f", "H": f"{before}H1_2"}
        check(updyn.read_frf(path, quantity="mobility", variables=variables, **LABELS))


def test_version_73(tmp_path):
    write_matlab73(tmp_path / "x.mat", {"f": LINES[:, None], "frf": H[:, :, 0]})
    variables = {"freq": "f", "H": "frf"}
    check(updyn.read_frf(tmp_path / "x.mat", quantity="mobility", variables=variables, **LABELS))


def test_units_of_an_hdf5_file(tmp_path):
    path = hdf5(tmp_path / "x", {"f": LINES / 1e3, "g/H": H * 1e3})
    with h5py.File(path, "r+") as file:
        file["f"].attrs["units"] = "kHz"
        file["g/H"].attrs["unit"] = "mm/s/N"
    variables = {"freq": "f", "H": "g.H"}
    check(updyn.read_frf(path, variables=variables, **LABELS))
    with pytest.raises(FormatError, match="'Hz' contradicts the file, which states 'kHz'"):
        updyn.read_frf(path, variables={**variables, "frequency_unit": "Hz"}, **LABELS)
    with pytest.raises(FormatError, match="unit = 'm/N' contradicts the file"):
        updyn.read_frf(path, variables={**variables, "unit": "m/N"}, **LABELS)


@pytest.mark.parametrize("write", WRITERS)
def test_standard_names_are_read_and_other_values_are_not(tmp_path, write):
    items = {"freq": LINES, "H": 2.0 * H, "H0": H, "coherence": COH}
    path = write(tmp_path / "x", items)
    with pytest.warns(UpdynWarning, match="H, coherence of the file not read"):
        frf = updyn.read_frf(path, quantity="mobility", variables={"H": "H0"}, **LABELS)
    check(frf)


@pytest.mark.parametrize("write", WRITERS)
@pytest.mark.parametrize(
    ("variables", "message", "key"),
    [
        ({"freq": "f", "H": "Hx"}, r"no variable 'Hx'; .*H", ("variables", "H")),
        (
            {"freq": "g.f1", "H": "H0"},
            "no variable 'g.f1'; did you mean 'g.f",
            ("variables", "freq"),
        ),
        ({"freq": "f", "H": "H0(:,4)"}, "expected a table with column 4", ("variables", "H")),
    ],
)
def test_missing_variables(tmp_path, write, variables, message, key):
    path = write(tmp_path / "x", {"f": LINES, "H0": H[:, :, 0], "g/f12": LINES})
    with pytest.raises(FormatError, match=message) as caught:
        updyn.read_frf(path, quantity="mobility", variables=variables, **LABELS)
    assert caught.value.key == key
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("write", WRITERS)
@pytest.mark.parametrize(
    ("variables", "message"),
    [
        ({}, "expected a table"),
        ({"freq": "f"}, "found no values; expected H, or its parts"),
        ({"H": "H0"}, "missing key 'freq'"),
        ({"frequency": "f", "H": "H0"}, "no key 'frequency'; did you mean 'freq"),
        ({"freq": "f", "H": "H0", "real": "f"}, "found H and parts"),
        ({"freq": "f", "real": "H0"}, "complex numbers; expected real ones"),
        ({"freq": "f", "real": "f", "imaginary": "one"}, "parts of different shapes"),
        ({"freq": "f", "H": 3}, "expected the name of a variable"),
        ({"freq": "f", "H": "H0", "unit": "g"}, "'g'; expected a motion per force"),
        ({"freq": "f", "H": "real"}, "real numbers, which may be magnitudes"),
        ({"freq": "one", "H": "H0"}, "found shape"),
        ({"freq": "text", "H": "H0"}, "expected numbers"),
    ],
)
def test_mappings_that_are_not_valid(tmp_path, write, variables, message):
    arrays = {"f": LINES, "H0": H, "one": np.ones((2, 2)), "real": H.real, "text": "word"}
    path = write(tmp_path / "x", arrays)
    with pytest.raises((FormatError, OptionError), match=message):
        updyn.read_frf(path, quantity="mobility", variables=variables, **LABELS)


def test_labels_of_arrays_without_variables_are_refused_for_netcdf(tmp_path):
    path = hdf5(tmp_path / "x", {"f": LINES})
    with pytest.raises(
        OptionError, match="order is only used with variables; state variables, too"
    ):
        updyn.read_frf(path, order=["freq", "response", "reference"])


def test_a_job(tmp_path):
    mat(tmp_path / "x", {"run/f": LINES, "run/H": H})
    path = tmp_path / "job.toml"
    text = (
        '[model]\nfile = "none.h5"\n[test]\nfile = "x.mat"\nquantity = "mobility"\n'
        'response_labels = ["3:Z", "5:-X"]\nreference_labels = ["1:Z"]\n'
        'variables = { freq = "run.f", H = "run.H" }\n'
        '[[parameter]]\ngroups = "*"\nquantity = "mass"\n'
    )
    path.write_text(text)
    check(read_measurement(load_job(path)))
    path.write_text(text.replace("run.H", "run.G"))
    job = load_job(path)
    with job.located(), pytest.raises(FormatError) as caught:
        read_measurement(job)
    assert caught.value.key[:2] == ("test", "variables")


@pytest.mark.parametrize("write", WRITERS)
@pytest.mark.parametrize(
    ("arrays", "listed", "proposal"),
    [
        (
            {"run/f0": LINES, "run/frf": H, "run/cohe": COH, "n": np.ones(1)},
            "run.frf (complex, 3 x 2 x 1)",
            'variables = { freq = "run.f0", H = "run.frf", coherence = "run.cohe" }',
        ),
        (
            {"w": LINES, "re": H.real, "im": H.imag},
            "re (real, 3 x 2 x 1)",
            'variables = { freq = "w", real = "re", imaginary = "im" }',
        ),
        (
            {"p/H1": TABLE, "p/H2": TABLE},
            "p.H1 (complex, 3 x 2)",
            'variables = { freq = "p.H1(:,1)", channels = [\n'
            '  { response = "?", reference = "?", complex = "p.H1(:,2)" },\n'
            '  { response = "?", reference = "?", complex = "p.H2(:,2)" },\n] }',
        ),
        ({"a": LINES, "b": COH}, "", ""),
    ],
)
def test_a_file_that_is_refused_shows_its_arrays_and_a_proposal(
    tmp_path, write, arrays, listed, proposal
):
    path = write(tmp_path / "x", arrays)
    with pytest.raises(FormatError) as caught:
        updyn.read_frf(path, quantity="mobility")
    text = str(caught.value)
    assert ("variables = {" in text) == bool(proposal)
    assert listed in text
    assert proposal in text
