"""MATLAB files: version 5 there and back, version 7.3 as MATLAB lays it out, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp

import updyn
from io_samples import assert_same_frf, assert_same_model, frf, model
from matlab73 import write_matlab73
from updyn.errors import FormatError
from updyn.foreign import box
from updyn.io.matlab import read_frf, read_model, read_variables, write_frf, write_model
from updyn.io.named import frf_items, model_items
from updyn.model import Group, Model

K = np.array([[2.0, -1.0], [-1.0, 1.0]])
M = np.diag([0.5, 0.25])
TABLE = np.array([[1.0, 1.0], [2.0, 6.0]])
EXPECTED = Model.from_groups({"model": Group(K, M, loss_factor=0.02)}, ["1:X", "2:RZ"])


def save_5(path, variables):
    scipy.io.savemat(path, variables, oned_as="column")


@pytest.fixture
def path(tmp_path):
    return tmp_path / "case.mat"


@pytest.fixture(params=[save_5, write_matlab73], ids=["v5", "v7.3"])
def save(request):
    return request.param


@pytest.mark.parametrize("with_geometry", [True, False])
def test_model_round_trip_is_exact(path, with_geometry):
    write_model(model(with_geometry), path)
    assert_same_model(read_model(path), model(with_geometry))


@pytest.mark.parametrize("n_references", [1, 2])
def test_frf_round_trip_is_exact(path, n_references):
    write_frf(frf(n_references), path)
    assert_same_frf(read_frf(path), frf(n_references))


def test_what_is_written_has_the_types_that_matlab_computes_with(path):
    write_model(model(), path)
    stored = scipy.io.loadmat(path, simplify_cells=True)
    assert list(stored["groups"]) == ["shaft", "group_2", "a_first"]
    assert stored["groups"]["group_2"]["name"] == "gear 1/é"
    assert sp.issparse(stored["groups"]["shaft"]["K"])
    assert stored["dofs"].tolist() == ["7:RZ", "1:X", "1:Y"]
    assert stored["nodes"].dtype == np.float64


def test_model_of_version_73_is_exact(path):
    items = model_items(model())
    groups = {
        "shaft": items["groups"]["shaft"],
        "g2": {**items["groups"]["gear 1/é"], "name": "gear 1/é"},
    }
    groups["a_first"] = items["groups"]["a_first"]
    write_matlab73(path, {**items, "groups": groups})
    assert_same_model(read_model(path), model())


@pytest.mark.parametrize("n_references", [1, 2])
def test_frf_of_version_73_is_exact(path, n_references):
    write_matlab73(path, frf_items(frf(n_references)))
    assert_same_frf(read_frf(path), frf(n_references))


@pytest.mark.parametrize("stiffness", [K, sp.csc_array(K)], ids=["full", "sparse"])
def test_plain_matrices_and_a_table_of_dofs(path, save, stiffness):
    save(path, {"K": stiffness, "M": M, "loss_factor": 0.02, "dofs": TABLE})
    assert_same_model(read_model(path), EXPECTED)


@pytest.mark.parametrize("dofs", [["1:X", "2:RZ"], TABLE], ids=["cellstr", "table"])
def test_one_struct_is_opened(path, save, dofs):
    cells = (
        np.array(dofs, dtype=object)[:, None] if isinstance(dofs, list) and save is save_5 else dofs
    )
    save(path, {"beam": {"K": K, "M": M, "loss_factor": 0.02, "dofs": cells}})
    assert_same_model(read_model(path), EXPECTED)


def test_char_matrix_padded_with_blanks(path):
    save_5(path, {"K": K, "M": M, "loss_factor": 0.02, "dofs": np.array(["1:X ", "2:RZ"])})
    assert_same_model(read_model(path), EXPECTED)


def test_direction_of_a_sensor_may_be_negative(path, save):
    H = np.array([[1.0, -2.0], [3.0, -4.0], [5.0, 6.0]]) * (1 + 1j)
    table = np.array([[3.0, -3.0], [4.0, 5.0]])
    save(
        path,
        {
            "freq": [1.0, 2.0, 3.0],
            "H": H,
            "responses": table,
            "references": [[3, 1]],
            "quantity": "mobility",
        },
    )
    found = read_frf(path)
    assert found.responses.labels == ["3:-Z", "4:RY"]
    np.testing.assert_array_equal(found.values[:, :, 0], H)


def test_dropped_axis_is_restored_only_where_labels_say_so(path, save):
    H = np.ones((3, 2)) * (1 + 1j)
    table, one = np.array([[3.0, 1.0], [4.0, 1.0]]), np.array([[3.0, 1.0]])
    common = {"freq": [1.0, 2.0, 3.0], "quantity": "mobility"}
    save(path, {**common, "H": H, "responses": one, "references": table})
    with pytest.raises(FormatError, match=r"H: found shape \(3, 2\), expected .* = \(3, 1, 2\)"):
        read_frf(path)
    save(path, {**common, "H": H[:, :1].T, "responses": one, "references": one})
    with pytest.raises(FormatError, match=r"H: found shape \(1, 3\), expected .* = \(3, 1, 1\)"):
        read_frf(path)


def test_frf_without_damping_is_stored_real_by_matlab(path, save):
    one = np.array([[3.0, 1.0]])
    H = np.array([[1.0], [-2.0], [-0.5]])
    known = {"freq": [1.0, 2, 3], "responses": one, "references": one, "quantity": "receptance"}
    save(path, {"H": H, **known})
    found = read_frf(path, real_valued=True)
    np.testing.assert_array_equal(found.values[:, 0, 0], [1.0, -2.0, -0.5])
    with pytest.raises(FormatError, match=r"holds real numbers.*set real_valued=True"):
        read_frf(path)


@pytest.mark.parametrize(
    ("variables", "message"),
    [
        ({"K": K, "M": M}, "no 'dofs': the 2 DOFs need labels"),
        (
            {"M": np.diag([1.0, np.nan]), "dofs": TABLE},
            "mass: row 2 holds a number that is not finite",
        ),
        ({"K": np.array([[2.0, -0.9], [-1.0, 1.0]]), "dofs": TABLE}, "stiffness is not symmetric"),
        ({"K": K, "dofs": np.array([[1.0, 1.0], [1.0, 1.0]])}, "1:X occurs twice"),
        ({"K": K, "dofs": np.array([[1.5, 1.0], [2.0, 1.0]])}, "dofs: expected whole numbers"),
        ({"K": K, "dofs": "1:X"}, "has 2 DOFs, the model has 1 labels"),
        (
            {"groups": {"a": {"K": K, "gamma": 0.1}}, "dofs": TABLE},
            "group 'a': unknown name 'gamma'",
        ),
        ({"groups": {"a": K}, "dofs": TABLE}, "groups: 'a' is float64 of shape"),
        (
            {"groups": {"a": {"K": K}, "b": {"K": K, "name": "a"}}, "dofs": TABLE},
            "group 'a' occurs twice",
        ),
        ({"K": K, "dofs": TABLE, "stiffness": K}, "unknown name 'stiffness'"),
    ],
)
def test_model_that_cannot_be_used(path, save, variables, message):
    save(path, variables)
    with pytest.raises(FormatError, match=message) as caught:
        read_model(path)
    assert str(path) in str(caught.value)


def test_classes_that_cannot_be_used(path):
    scipy.io.savemat(path, {"K": K, "dofs": np.array([[1.0, 2.0], "a"], dtype=object)})
    with pytest.raises(FormatError, match="dofs: cell 1 is not a text"):
        read_model(path)
    struct_array = np.array([(1.0,), (2.0,)], dtype=[("K", object)])
    scipy.io.savemat(path, {"parts": struct_array, "dofs": TABLE})
    with pytest.raises(FormatError, match="parts: struct array of shape"):
        read_model(path)


def test_string_class_of_version_73_is_refused_with_advice(path):
    import h5py

    write_matlab73(path, {"K": K})
    with h5py.File(path, "r+") as file:
        file["dofs"] = np.zeros((1, 6), dtype=np.uint32)
        file["dofs"].attrs["MATLAB_class"] = np.bytes_("string")
    with pytest.raises(FormatError, match=r"MATLAB class 'string' cannot be used .*cellstr"):
        read_model(path)


@pytest.mark.parametrize(
    "missing", [1, 100, 511, 512, 513, 5000]
)  # 512: what stands before the HDF5 part
def test_version_73_cut_short(path, missing):
    write_matlab73(path, frf_items(frf()))
    path.write_bytes(path.read_bytes()[:-missing])
    with pytest.raises(FormatError, match="truncated"):
        read_frf(path)


@pytest.mark.parametrize("name", ["case.mat", "case.dat"])
def test_version_73_is_told_by_content_also_of_the_releases_that_called_it_70(tmp_path, name):
    path = tmp_path / name
    write_matlab73(path, frf_items(frf()))
    path.write_bytes(path.read_bytes().replace(b"MATLAB 7.3 MAT-file", b"MATLAB 7.0 MAT-file", 1))
    assert_same_frf(updyn.read_frf(path), frf())
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(FormatError, match=r"MATLAB 7\.3 file without a readable HDF5 part"):
        updyn.read_frf(path)


def test_files_that_matlab_itself_wrote():
    """The examples that scipy brings along, where it does: MATLAB's own bytes, version 5 to 7.3."""
    data = Path(scipy.io.matlab.__file__).parent / "tests" / "data"
    if not (data / "testhdf5_7.4_GLNX86.mat").is_file():
        pytest.skip("this scipy comes without its test data")
    wave = np.arange(0.0, 2 * np.pi + 0.1, np.pi / 4)[:9]
    for version in ("6.1_SOL2", "7.4_GLNX86"):
        np.testing.assert_allclose(
            read_variables(data / f"testdouble_{version}.mat")["testdouble"], [wave]
        )
        assert read_variables(data / f"teststring_{version}.mat")["teststring"] == [
            '"Do nine men interpret?" "Nine men," I nod.'
        ]
        sparse = read_variables(data / f"testsparse_{version}.mat")["testsparse"]
        assert (sparse.shape, sparse.nnz) == ((3, 5), 7)
    assert read_variables(data / "testunicode_7.4_GLNX86.mat")["testunicode"][0].startswith(
        "Japanese: "
    )
    with pytest.raises(FormatError):
        read_variables(data / "corrupted_zlib_data.mat")


@pytest.mark.parametrize("stiffness", [K, sp.csc_array(K)], ids=["full", "sparse"])
def test_matrices_of_truth_values_and_of_complex_numbers_that_are_real(path, save, stiffness):
    save(path, {"K": stiffness.astype(complex), "M": np.eye(2) == 1, "dofs": TABLE})
    found = read_model(path)
    np.testing.assert_array_equal(found.stiffness.toarray(), K)
    np.testing.assert_array_equal(found.mass.toarray(), np.eye(2))
    save(path, {"K": stiffness, "M": sp.csc_array(np.eye(2) == 1), "dofs": TABLE})
    np.testing.assert_array_equal(read_model(path).mass.toarray(), np.eye(2))
    save(path, {"K": stiffness * (1 + 0.1j), "M": M, "dofs": TABLE})
    with pytest.raises(FormatError, match="stiffness: found complex numbers; damping goes into"):
        read_model(path)


def test_big_endian_matrices_of_version_5():
    """Of a SPARC, as scipy brings it along; the numbers are those of other machines."""
    data = Path(scipy.io.matlab.__file__).parent / "tests" / "data"
    if not (data / "testmatrix_6.1_SOL2.mat").is_file():
        pytest.skip("this scipy comes without its test data")
    found = read_variables(data / "testmatrix_6.1_SOL2.mat")["testmatrix"]
    assert found.dtype.isnative
    np.testing.assert_array_equal(found, [[1, 2, 3, 4, 5], [2, 0, 0, 0, 0], [3, 0, 0, 0, 0]])
    assert sp.csr_array(found).nnz == 7


# -- version 4 --------------------------------------------------------------------------------------
def save_4(path, variables):
    scipy.io.savemat(path, variables, format="4", oned_as="column")


def variable_4(name, kind, array, order="<"):
    """Bytes of a variable of version 4: header, name and numbers by columns (MAT-File Format)."""
    array = np.atleast_2d(np.asarray(array))
    head = np.array([kind, *array.shape, 0, len(name) + 1], dtype=f"{order}i4")
    return head.tobytes() + name.encode() + b"\0" + array.astype(f"{order}f8").tobytes("F")


@pytest.mark.parametrize("stiffness", [K, sp.csc_array(K)], ids=["full", "sparse"])
@pytest.mark.parametrize("dofs", [TABLE, np.array(["1:X ", "2:RZ"])], ids=["table", "char"])
def test_a_model_of_version_4(path, stiffness, dofs):
    save_4(path, {"K": stiffness, "M": M, "loss_factor": 0.02, "dofs": dofs})
    assert_same_model(updyn.read_model(path), EXPECTED)
    assert_same_model(updyn.read_model(path, format="mat"), EXPECTED)


@pytest.mark.parametrize(("kind", "order"), [(0, "<"), (1000, ">")])
def test_the_bytes_of_version_4_in_both_orders(path, kind, order):
    parts = {"K": K, "M": M, "dofs": TABLE, "loss_factor": 0.02}
    path.write_bytes(b"".join(variable_4(n, kind, a, order) for n, a in parts.items()))
    assert_same_model(updyn.read_model(path), EXPECTED)


def test_frfs_of_version_4_have_two_axes(path):
    H = np.array([[1.0 - 2j, 3.0], [4.0, 5.0 + 1j]])
    table = np.array([[3.0, -3.0], [4.0, 5.0]])
    save_4(path, {"freq": [1.0, 2.0], "H": H, "responses": table, "references": [[3.0, 1.0]]})
    found = updyn.read_frf(path, quantity="mobility")
    np.testing.assert_array_equal(found.values[:, :, 0], H)


def test_records_of_version_4(path):
    save_4(path, {"f": np.arange(5.0), "a": np.arange(5.0) ** 2, "fs": 100.0})
    found = updyn.read_records(path, values=["f", "a"], rate="fs")
    np.testing.assert_array_equal(found.values[0], [np.arange(5.0), np.arange(5.0) ** 2])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (variable_4("K", 0, K)[:-1], "truncated or damaged in variable 1, at byte 0 of 53"),
        (
            variable_4("K", 0, K) + variable_4("M", 0, M)[:9],
            "truncated or damaged in variable 2, at byte 54",
        ),
        (variable_4("K", 0, K) * 2, "variable 'K' occurs twice"),
        (variable_4("K", 2000, K, ">"), "variable 1: type 2000"),
        (variable_4("K", 60, K), "variable 1: type 60"),
        (variable_4("s", 2, K), "not a readable MATLAB file"),
        (b"K = [1 2; 3 4];" + bytes(130), "not a MATLAB file: it starts with b'K = "),
        (b"MATLAB", "not a MATLAB file"),
    ],
)
def test_what_is_not_of_version_4_is_refused(path, content, message):
    path.write_bytes(content)
    with pytest.raises(FormatError, match=rf"case\.mat: {message}"):
        updyn.read_model(path)


def test_files_that_matlab_4_wrote():
    """MATLAB's own bytes, as scipy brings them along, big-endian."""
    data = Path(scipy.io.matlab.__file__).parent / "tests" / "data"
    if not (data / "testdouble_4.2c_SOL2.mat").is_file():
        pytest.skip("this scipy comes without its test data")
    wave = np.arange(0.0, 2 * np.pi + 0.1, np.pi / 4)[:9]
    found = read_variables(data / "testdouble_4.2c_SOL2.mat")["testdouble"]
    np.testing.assert_allclose(found, [wave])
    text = read_variables(data / "teststring_4.2c_SOL2.mat")["teststring"]
    assert text == ['"Do nine men interpret?" "Nine men," I nod.']
    sparse = read_variables(data / "testsparse_4.2c_SOL2.mat")["testsparse"]
    assert (sparse.shape, sparse.nnz) == ((3, 5), 7)
    both = read_variables(data / "testmulti_4.2c_SOL2.mat")
    assert sorted(both) == ["a", "theta"]


@pytest.mark.parametrize(
    ("write", "read", "whole"), [(write_model, read_model, model()), (write_frf, read_frf, frf())]
)
def test_a_file_that_ends_after_one_of_its_variables_is_refused(
    path, monkeypatch, write, read, whole
):
    """The format has no end mark: what a reader needs is written last."""
    here = lambda function, path, *, what, reader: box.load_in_process(function, path, what=what)  # noqa: E731
    monkeypatch.setattr(box, "load", here)
    write(whole, path)
    raw, end = path.read_bytes(), 128
    while end < len(raw):
        path.write_bytes(raw[:end])
        with pytest.raises(FormatError):
            read(path)
        end += 8 + int.from_bytes(raw[end + 4 : end + 8], "little")
    assert end == len(raw)
